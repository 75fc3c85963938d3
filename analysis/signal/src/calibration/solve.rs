//! Weighted least squares with priors: Gauss–Newton steps on parameters counted in standard
//! deviations of their priors.
//!
//! The equations are solved in square-root form (Givens rotations into a triangle that starts as
//! the prior), because products of the Jacobian would lose the best-known combinations beside those
//! that only the prior determines.

use num_complex::Complex64;

use super::model::{COUNT, Harness, NAMES, Slope};
use super::{CalibrationError, Controls, Correction, KnownImpedance, Source, StrayAdmittance};
use crate::spectrum::ChannelPhasors;
use analysis_numeric::Covariance2;

const MAX_STEPS: usize = 60;
/// Step that changes nothing, in standard deviations of the result.
const SETTLED: f64 = 1e-4;
/// Relative increase of the sum of squares that is accepted for a full step: the weights change a
/// little with the parameters, so the step does not minimise exactly this sum.
const SLACK: f64 = 1e-2;
/// Part of a step below which halving on is useless.
const SHORTEST: f64 = 1e-3;
/// Standard deviations that the reduced χ² may lie above 1 by chance.
const SIGNIFICANT: f64 = 3.0;
/// Noise amplitudes that the voltage across the shunt must exceed to count as a current.
const LEAST_CURRENT: f64 = 5.0;

pub(super) fn check(controls: &Controls<'_>) -> Result<(), CalibrationError> {
    check_known("current shunt", controls.current_shunt)?;
    let priors = controls.priors;
    let positive = |sigma: f64| sigma > 0.0 && sigma.is_finite();
    if ![
        priors.gain_sigma,
        priors.skew_sigma_s,
        priors.mutual_sigma_h,
    ]
    .into_iter()
    .all(positive)
    {
        return Err(CalibrationError::Priors { priors });
    }
    check_points("shunt", controls.shunt)?;
    let mut count = controls.shunt.len();
    for (name, load) in [("fake cell", controls.fake_cell), ("short", controls.short)] {
        let Some((known, points)) = load else {
            continue;
        };
        check_known(name, known)?;
        check_points(name, points)?;
        count += points.len();
    }
    if let Some(stray) = controls.open {
        let sound = |value: f64, sigma: f64| value.is_finite() && sigma >= 0.0 && sigma.is_finite();
        if !(sound(stray.g_s, stray.g_sigma_s) && sound(stray.c_f, stray.c_sigma_f)) {
            return Err(CalibrationError::Stray { stray });
        }
    }
    if count == 0 {
        Err(CalibrationError::NoPoints)
    } else {
        Ok(())
    }
}

fn check_known(name: &'static str, known: KnownImpedance) -> Result<(), CalibrationError> {
    let sigma = |sigma: f64| sigma >= 0.0 && sigma.is_finite();
    let good = known.r_ohm > 0.0
        && known.r_ohm.is_finite()
        && known.l_h.is_finite()
        && sigma(known.r_sigma_ohm)
        && sigma(known.l_sigma_h);
    if good {
        Ok(())
    } else {
        Err(CalibrationError::Known { name, known })
    }
}

fn check_points(control: &'static str, points: &[ChannelPhasors]) -> Result<(), CalibrationError> {
    for (index, point) in points.iter().enumerate() {
        if let Some((expected, found)) = fault(point) {
            return Err(CalibrationError::Point {
                control,
                number: index + 1,
                freq_hz: point.freq_hz,
                expected,
                found,
            });
        }
    }
    Ok(())
}

fn fault(point: &ChannelPhasors) -> Option<(&'static str, String)> {
    if !(point.freq_hz > 0.0 && point.freq_hz.is_finite()) {
        return Some(("a frequency above 0 Hz", format!("{} Hz", point.freq_hz)));
    }
    if let Some(volts) = point
        .volts
        .iter()
        .find(|v| !(v.re.is_finite() && v.im.is_finite()))
    {
        return Some(("finite phasors", format!("{volts} V")));
    }
    let totals = point.totals();
    if let Some(Covariance2 {
        re_re,
        re_im,
        im_im,
    }) = totals
        .iter()
        .find(|v| !(v.is_valid() && v.re_re > 0.0 && v.im_im > 0.0))
    {
        return Some((
            "positive, finite variances",
            format!("{re_re}, {re_im}, {im_im} V²"),
        ));
    }
    let [v1, v2, ..] = point.volts;
    let noise =
        (0.5 * (totals[0].re_re + totals[0].im_im + totals[1].re_re + totals[1].im_im)).sqrt();
    if (v2 - v1).norm() < LEAST_CURRENT * noise {
        return Some((
            "a current through the shunt",
            format!(
                "{:.3e} V across it, of noise {noise:.3e} V",
                (v2 - v1).norm()
            ),
        ));
    }
    None
}

/// Returns means and standard deviations of the priors. A parameter without any measurement is
/// exactly zero.
fn priors(controls: &Controls<'_>) -> ([f64; COUNT], [f64; COUNT]) {
    const NOTHING: KnownImpedance = KnownImpedance {
        r_ohm: 0.0,
        r_sigma_ohm: 0.0,
        l_h: 0.0,
        l_sigma_h: 0.0,
    };
    let p = controls.priors;
    let s = controls.current_shunt;
    let f = controls.fake_cell.map_or(NOTHING, |(known, _)| known);
    let k = controls.short.map_or(NOTHING, |(known, _)| known);
    let o = controls.open.unwrap_or(StrayAdmittance::NONE);
    let means = [
        1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, s.r_ohm, s.l_h, f.r_ohm, f.l_h, k.r_ohm, k.l_h,
        o.g_s, o.c_f,
    ];
    let (gain, skew, mutual) = (p.gain_sigma, p.skew_sigma_s, p.mutual_sigma_h);
    let harness = [gain, gain, gain, skew, skew, skew, mutual, mutual];
    let known = [
        s.r_sigma_ohm,
        s.l_sigma_h,
        f.r_sigma_ohm,
        f.l_sigma_h,
        k.r_sigma_ohm,
        k.l_sigma_h,
        o.g_sigma_s,
        o.c_sigma_f,
    ];
    (
        means,
        std::array::from_fn(|index| {
            if index < 8 {
                harness[index]
            } else {
                known[index - 8]
            }
        }),
    )
}

pub(super) fn unmeasured(controls: &Controls<'_>) -> Correction {
    let (values, prior_sigmas) = priors(controls);
    let mut covariance = [[0.0; COUNT]; COUNT];
    for (index, sigma) in prior_sigmas.iter().enumerate() {
        covariance[index][index] = sigma * sigma;
    }
    let known = known_parameters(controls);
    Correction {
        values,
        covariance,
        prior_sigmas,
        known,
        reduced_chi2: None,
        dof: 0,
        noise_factor: 1.0,
        span_hz: None,
    }
}

/// Returns which parameters are known: those of controls that were never measured are not.
fn known_parameters(controls: &Controls<'_>) -> [bool; COUNT] {
    std::array::from_fn(|index| match NAMES[index].2 {
        Source::FakeCell => controls.fake_cell.is_some(),
        Source::Short => controls.short.is_some(),
        Source::Open => controls.open.is_some(),
        _ => true,
    })
}

pub(super) fn fit(controls: &Controls<'_>) -> Result<Correction, CalibrationError> {
    let problem = Problem::new(controls);
    let first = problem.solve(&[0.0; COUNT], 1.0)?;
    let dof = first.rows;
    let reduced_chi2 = first.sum_squares / dof as f64;
    let (solution, noise_factor) = if reduced_chi2 > 1.0 + SIGNIFICANT * (2.0 / dof as f64).sqrt() {
        let factor = reduced_chi2.sqrt();
        (problem.solve(&first.x, factor)?, factor)
    } else {
        (first, 1.0)
    };
    Ok(Correction {
        values: problem.values(&solution.x),
        covariance: problem.covariance(&solution.triangle),
        prior_sigmas: problem.sigmas,
        known: known_parameters(controls),
        reduced_chi2: Some(reduced_chi2),
        dof,
        noise_factor,
        span_hz: problem.span_hz(),
    })
}

struct Problem<'a> {
    controls: &'a Controls<'a>,
    means: [f64; COUNT],
    sigmas: [f64; COUNT],
}

struct Solution {
    x: [f64; COUNT],
    triangle: Triangle,
    sum_squares: f64,
    rows: usize,
}

impl<'a> Problem<'a> {
    fn new(controls: &'a Controls<'a>) -> Self {
        let (means, sigmas) = priors(controls);
        Self {
            controls,
            means,
            sigmas,
        }
    }

    fn values(&self, x: &[f64; COUNT]) -> [f64; COUNT] {
        std::array::from_fn(|k| self.means[k] + self.sigmas[k] * x[k])
    }

    fn span_hz(&self) -> Option<(f64, f64)> {
        let loads = [self.controls.fake_cell, self.controls.short]
            .into_iter()
            .flatten()
            .flat_map(|(_, points)| points);
        let all = self
            .controls
            .shunt
            .iter()
            .chain(loads)
            .map(|point| point.freq_hz);
        all.fold(None, |span, freq_hz| {
            let (low, high) = span.unwrap_or((freq_hz, freq_hz));
            Some((freq_hz.min(low), freq_hz.max(high)))
        })
    }

    fn solve(&self, start: &[f64; COUNT], noise_factor: f64) -> Result<Solution, CalibrationError> {
        let mut now = self.linearise(start, noise_factor);
        for _ in 0..MAX_STEPS {
            let step = now.triangle.solve();
            // The right-hand side of the triangle is the step in standard deviations of the result.
            let length = now.triangle.z.iter().map(|z| z * z).sum::<f64>().sqrt();
            if length < SETTLED {
                return Ok(now);
            }
            let mut scale = 1.0;
            now = loop {
                let next = self.linearise(
                    &std::array::from_fn(|k| now.x[k] + scale * step[k]),
                    noise_factor,
                );
                if next.sum_squares <= now.sum_squares + SLACK * (1.0 + now.sum_squares)
                    || scale < SHORTEST
                {
                    break next;
                }
                scale *= 0.5;
            };
        }
        Err(CalibrationError::NotConverged {
            steps: MAX_STEPS,
            sum_squares: now.sum_squares,
        })
    }

    /// Returns the problem around `x`: prior and all points, whitened.
    fn linearise(&self, x: &[f64; COUNT], noise_factor: f64) -> Solution {
        let values = self.values(x);
        let mut sum = Solution {
            x: *x,
            triangle: Triangle::prior(x),
            sum_squares: x.iter().map(|x| x * x).sum(),
            rows: 0,
        };
        for point in self.controls.shunt {
            let residuals = Harness::new(&values, point).shunt_residuals();
            self.add(&mut sum, &whiten(&residuals, &point.totals()), noise_factor);
        }
        let fake_cell = self
            .controls
            .fake_cell
            .iter()
            .flat_map(|(_, points)| *points);
        let short = self.controls.short.iter().flat_map(|(_, points)| *points);
        for point in fake_cell {
            let residual = Harness::new(&values, point).fake_cell_residual();
            self.add(
                &mut sum,
                &whiten(&[residual], &point.totals()),
                noise_factor,
            );
        }
        for point in short {
            let residual = Harness::new(&values, point).short_residual();
            self.add(
                &mut sum,
                &whiten(&[residual], &point.totals()),
                noise_factor,
            );
        }
        sum
    }

    fn add(&self, sum: &mut Solution, rows: &[Row], noise_factor: f64) {
        for row in rows {
            let value = row.value / noise_factor;
            sum.triangle.add(
                std::array::from_fn(|k| row.slopes[k] * (self.sigmas[k] / noise_factor)),
                -value,
            );
            sum.sum_squares += value * value;
            sum.rows += 1;
        }
    }

    fn covariance(&self, triangle: &Triangle) -> [[f64; COUNT]; COUNT] {
        let inverse = triangle.inverse();
        let element = |i: usize, j: usize| {
            let product: f64 = (0..COUNT).map(|k| inverse[i][k] * inverse[j][k]).sum();
            product * self.sigmas[i] * self.sigmas[j]
        };
        std::array::from_fn(|i| std::array::from_fn(|j| element(i, j)))
    }
}

/// A real residual in units of its noise, with derivatives towards the parameters.
#[derive(Debug, Clone, Copy)]
struct Row {
    value: f64,
    slopes: [f64; COUNT],
}

/// Residuals of one point share noise: the part that follows from the preceding residuals is
/// subtracted from each, which is forward substitution in the Cholesky triangle of their common
/// covariance.
fn whiten(residuals: &[Slope], covariances: &[Covariance2; 4]) -> Vec<Row> {
    let of = |k: usize| Part {
        residual: &residuals[k / 2],
        part: k % 2,
    };
    let parts: Vec<Row> = residuals.iter().flat_map(parts).collect();
    let mut lower = vec![vec![0.0; parts.len()]; parts.len()];
    let mut rows: Vec<Row> = Vec::with_capacity(parts.len());
    for (i, part) in parts.iter().enumerate() {
        let mut row = *part;
        for j in 0..=i {
            let shared: f64 = (0..j).map(|k| lower[i][k] * lower[j][k]).sum();
            let left = shared_noise(of(i), of(j), covariances) - shared;
            if i == j {
                let sigma = left.max(f64::MIN_POSITIVE).sqrt();
                lower[i][i] = sigma;
                row = Row {
                    value: row.value / sigma,
                    slopes: row.slopes.map(|slope| slope / sigma),
                };
            } else {
                let weight = left / lower[j][j];
                lower[i][j] = weight;
                let before = rows[j];
                row.value -= weight * before.value;
                row.slopes = std::array::from_fn(|k| row.slopes[k] - weight * before.slopes[k]);
            }
        }
        rows.push(row);
    }
    rows
}

/// Returns the real and imaginary part of a residual.
fn parts(residual: &Slope) -> [Row; 2] {
    let slopes = residual.by_parameters();
    [
        Row {
            value: residual.value.re,
            slopes: slopes.map(|slope| slope.re),
        },
        Row {
            value: residual.value.im,
            slopes: slopes.map(|slope| slope.im),
        },
    ]
}

/// A part of a residual.
#[derive(Clone, Copy)]
struct Part<'a> {
    /// The residual.
    residual: &'a Slope,
    /// 0 for the real part, 1 for the imaginary part.
    part: usize,
}

/// Returns the covariance of a part of one residual with a part of another, from that of the
/// phasors.
fn shared_noise(a: Part<'_>, b: Part<'_>, covariances: &[Covariance2; 4]) -> f64 {
    let (part_a, part_b) = (a.part, b.part);
    // How a part of slope·phasor depends on the phasor's real and imaginary part.
    let turn = |slope: Complex64, part: usize| {
        if part == 0 {
            [slope.re, -slope.im]
        } else {
            [slope.im, slope.re]
        }
    };
    let slopes = a
        .residual
        .by_volts()
        .into_iter()
        .zip(b.residual.by_volts())
        .zip(covariances);
    let channel = |((a, b), c): ((Complex64, Complex64), &Covariance2)| {
        let ([a0, a1], [b0, b1]) = (turn(a, part_a), turn(b, part_b));
        a0 * c.re_re * b0 + (a0 * b1 + a1 * b0) * c.re_im + a1 * c.im_im * b1
    };
    slopes.map(channel).sum()
}

/// Upper triangle R and right-hand side z of the least-squares problem |R·step − z|².
struct Triangle {
    r: [[f64; COUNT]; COUNT],
    z: [f64; COUNT],
}

impl Triangle {
    /// Returns the prior alone: unit variance around 0.
    fn prior(x: &[f64; COUNT]) -> Self {
        let mut r = [[0.0; COUNT]; COUNT];
        for (index, row) in r.iter_mut().enumerate() {
            row[index] = 1.0;
        }
        Self {
            r,
            z: x.map(|x| -x),
        }
    }

    /// Takes one more equation in, by rotations.
    fn add(&mut self, mut row: [f64; COUNT], mut right: f64) {
        for k in 0..COUNT {
            let length = self.r[k][k].hypot(row[k]);
            let (cos, sin) = (self.r[k][k] / length, row[k] / length);
            for (own, new) in self.r[k].iter_mut().zip(&mut row).skip(k) {
                (*own, *new) = (cos * *own + sin * *new, cos * *new - sin * *own);
            }
            (self.z[k], right) = (cos * self.z[k] + sin * right, cos * right - sin * self.z[k]);
        }
    }

    fn solve(&self) -> [f64; COUNT] {
        self.back_substitute(&self.z)
    }

    fn back_substitute(&self, right: &[f64; COUNT]) -> [f64; COUNT] {
        let mut x = [0.0; COUNT];
        for k in (0..COUNT).rev() {
            let known: f64 = self.r[k]
                .iter()
                .zip(&x)
                .skip(k + 1)
                .map(|(r, x)| r * x)
                .sum();
            x[k] = (right[k] - known) / self.r[k][k];
        }
        x
    }

    /// R⁻¹, row by row.
    fn inverse(&self) -> [[f64; COUNT]; COUNT] {
        let columns: [[f64; COUNT]; COUNT] = std::array::from_fn(|k| {
            let mut unit = [0.0; COUNT];
            unit[k] = 1.0;
            self.back_substitute(&unit)
        });
        std::array::from_fn(|i| std::array::from_fn(|k| columns[k][i]))
    }
}
