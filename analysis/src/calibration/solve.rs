//! Weighted least squares with priors: Gauss–Newton steps on parameters counted in standard deviations of their priors.
//!
//! The equations are solved in square-root form (Givens rotations into a triangle that starts as the prior), because products of the Jacobian
//! would lose the combinations that are known best beside those that only the prior knows.

use num_complex::Complex64;

use super::model::{COUNT, Harness, Slope};
use super::{CalibrationError, Controls, Correction, KnownImpedance};
use crate::spectrum::ChannelPhasors;

const MAX_STEPS: usize = 60;
/// Step that changes nothing, in standard deviations of the result.
const SETTLED: f64 = 1e-4;
/// Relative rise of the sum of squares that a full step may bring: the weights move a little with the parameters, so that the sum is not strictly
/// what the step lowers.
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
    if ![priors.gain_sigma, priors.skew_sigma_s, priors.mutual_sigma_h].into_iter().all(positive) {
        return Err(CalibrationError::Priors { priors });
    }
    check_points("shunt", controls.shunt)?;
    let mut count = controls.shunt.len();
    if let Some((known, points)) = controls.fake_cell {
        check_known("fake cell", known)?;
        check_points("fake cell", points)?;
        count += points.len();
    }
    if count == 0 { Err(CalibrationError::NoPoints) } else { Ok(()) }
}

fn check_known(name: &'static str, known: KnownImpedance) -> Result<(), CalibrationError> {
    let sigma = |sigma: f64| sigma >= 0.0 && sigma.is_finite();
    let good = known.r_ohm > 0.0 && known.r_ohm.is_finite() && known.l_h.is_finite() && sigma(known.r_sigma_ohm) && sigma(known.l_sigma_h);
    if good { Ok(()) } else { Err(CalibrationError::Known { name, known }) }
}

fn check_points(control: &'static str, points: &[ChannelPhasors]) -> Result<(), CalibrationError> {
    for (index, point) in points.iter().enumerate() {
        if let Some((expected, found)) = fault(point) {
            return Err(CalibrationError::Point { control, number: index + 1, freq_hz: point.freq_hz, expected, found });
        }
    }
    Ok(())
}

fn fault(point: &ChannelPhasors) -> Option<(&'static str, String)> {
    if !(point.freq_hz > 0.0 && point.freq_hz.is_finite()) {
        return Some(("a frequency above 0 Hz", format!("{} Hz", point.freq_hz)));
    }
    if let Some(volts) = point.volts.iter().find(|v| !(v.re.is_finite() && v.im.is_finite())) {
        return Some(("finite phasors", format!("{volts} V")));
    }
    if let Some(variance) = point.variance.iter().find(|v| !(**v > 0.0 && v.is_finite())) {
        return Some(("positive, finite variances", format!("{variance} V²")));
    }
    let [v1, v2, ..] = point.volts;
    let noise = (point.variance[0] + point.variance[1]).sqrt();
    if (v2 - v1).norm() < LEAST_CURRENT * noise {
        return Some(("a current through the shunt", format!("{:.3e} V across it, of noise {noise:.3e} V", (v2 - v1).norm())));
    }
    None
}

/// Means and standard deviations of the priors. An absent fake cell is one that is exactly nothing.
fn priors(controls: &Controls<'_>) -> ([f64; COUNT], [f64; COUNT]) {
    let p = controls.priors;
    let s = controls.current_shunt;
    let f = controls.fake_cell.map_or(KnownImpedance { r_ohm: 0.0, r_sigma_ohm: 0.0, l_h: 0.0, l_sigma_h: 0.0 }, |(known, _)| known);
    let means = [1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, s.r_ohm, s.l_h, f.r_ohm, f.l_h];
    let (gain, skew, mutual) = (p.gain_sigma, p.skew_sigma_s, p.mutual_sigma_h);
    let sigmas = [gain, gain, gain, skew, skew, skew, mutual, mutual, s.r_sigma_ohm, s.l_sigma_h, f.r_sigma_ohm, f.l_sigma_h];
    (means, sigmas)
}

pub(super) fn unmeasured(controls: &Controls<'_>) -> Correction {
    let (values, sigmas) = priors(controls);
    let mut covariance = [[0.0; COUNT]; COUNT];
    for (index, sigma) in sigmas.iter().enumerate() {
        covariance[index][index] = sigma * sigma;
    }
    Correction { values, covariance, has_fake_cell: false, reduced_chi2: None, dof: 0, noise_factor: 1.0, span_hz: None }
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
        has_fake_cell: controls.fake_cell.is_some(),
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
        Self { controls, means, sigmas }
    }

    fn values(&self, x: &[f64; COUNT]) -> [f64; COUNT] {
        std::array::from_fn(|k| self.means[k] + self.sigmas[k] * x[k])
    }

    fn span_hz(&self) -> Option<(f64, f64)> {
        let fake = self.controls.fake_cell.map_or(&[][..], |(_, points)| points);
        let all = self.controls.shunt.iter().chain(fake).map(|point| point.freq_hz);
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
                let next = self.linearise(&std::array::from_fn(|k| now.x[k] + scale * step[k]), noise_factor);
                if next.sum_squares <= now.sum_squares + SLACK * (1.0 + now.sum_squares) || scale < SHORTEST {
                    break next;
                }
                scale *= 0.5;
            };
        }
        Err(CalibrationError::NotConverged { steps: MAX_STEPS, sum_squares: now.sum_squares })
    }

    /// The problem around `x`: prior and all points, whitened.
    fn linearise(&self, x: &[f64; COUNT], noise_factor: f64) -> Solution {
        let values = self.values(x);
        let mut sum = Solution { x: *x, triangle: Triangle::prior(x), sum_squares: x.iter().map(|x| x * x).sum(), rows: 0 };
        for point in self.controls.shunt {
            let residuals = Harness::new(&values, point).shunt_residuals();
            self.add(&mut sum, &whiten(&residuals, &point.variance), noise_factor);
        }
        if let Some((_, points)) = self.controls.fake_cell {
            for point in points {
                let residual = Harness::new(&values, point).fake_cell_residual();
                self.add(&mut sum, &whiten_one(&residual, &point.variance), noise_factor);
            }
        }
        sum
    }

    fn add(&self, sum: &mut Solution, rows: &[Row], noise_factor: f64) {
        for row in rows {
            let value = row.value / noise_factor;
            let slopes: [Complex64; COUNT] = std::array::from_fn(|k| row.slopes[k] * (self.sigmas[k] / noise_factor));
            sum.triangle.add(slopes.map(|s| s.re), -value.re);
            sum.triangle.add(slopes.map(|s| s.im), -value.im);
            sum.sum_squares += value.norm_sqr();
            sum.rows += 2;
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

/// A complex residual in units of its noise, with derivatives towards the parameters.
struct Row {
    value: Complex64,
    slopes: [Complex64; COUNT],
}

fn whiten_one(residual: &Slope, variance: &[f64; 4]) -> [Row; 1] {
    let sigma = covariance(residual, residual, variance).re.sqrt();
    [Row { value: residual.value / sigma, slopes: residual.by_parameters().map(|s| s / sigma) }]
}

/// Two residuals share noise: the second is freed of what the first tells of it.
fn whiten([first, second]: &[Slope; 2], variance: &[f64; 4]) -> [Row; 2] {
    let sigma = covariance(first, first, variance).re.sqrt();
    let shared = covariance(second, first, variance) / sigma;
    let rest = (covariance(second, second, variance).re - shared.norm_sqr()).max(0.0).sqrt();
    let [row] = whiten_one(first, variance);
    let own = second.by_parameters();
    let slopes = std::array::from_fn(|k| (own[k] - shared * row.slopes[k]) / rest);
    let other = Row { value: (second.value - shared * row.value) / rest, slopes };
    [row, other]
}

/// Covariance of two residuals, per part, from circular noise of the phasors.
fn covariance(a: &Slope, b: &Slope, variance: &[f64; 4]) -> Complex64 {
    let parts = a.by_volts().into_iter().zip(b.by_volts()).zip(variance);
    parts.map(|((a, b), variance)| a * b.conj() * *variance).sum()
}

/// Upper triangle R and right-hand side z of the least-squares problem |R·step − z|².
struct Triangle {
    r: [[f64; COUNT]; COUNT],
    z: [f64; COUNT],
}

impl Triangle {
    /// The prior alone: unit variance around 0.
    fn prior(x: &[f64; COUNT]) -> Self {
        let mut r = [[0.0; COUNT]; COUNT];
        for (index, row) in r.iter_mut().enumerate() {
            row[index] = 1.0;
        }
        Self { r, z: x.map(|x| -x) }
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
            let known: f64 = self.r[k].iter().zip(&x).skip(k + 1).map(|(r, x)| r * x).sum();
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
