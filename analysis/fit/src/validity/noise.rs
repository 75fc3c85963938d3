//! Noise that a spectrum is judged by: as stated, else from repeats, else from the residual of a
//! smoother.
//!
//! The smoother is an RC ladder fitted to the real and to the imaginary part *each for itself*. It
//! follows all smooth curves, without the Kramers–Kronig relations. So a spectrum that violates
//! them smoothly does not hide in its own noise.

use super::ladder::{Ladder, Whitening};
use super::tail::deviate_tail;
use super::{ValidityError, same_grid};
use crate::sizes::weight_sizes_ohm;
use analysis_numeric::Covariance2;
use analysis_signal::spectrum::{ImpedancePoint, Spectrum};
use num_complex::Complex64;
use serde::Serialize;
use std::f64::consts::TAU;

/// Minimum number of repeats of one grid and amplitude whose scatter gives the noise.
pub const FEWEST_REPEATS: usize = 3;
/// Number of scales per decade for a smoother of 20 to 60 points, and its reach beyond the band.
const SMOOTHER_PER_DECADE: f64 = 3.0;
const SMOOTHER_REACH: f64 = 2.0;
/// Share of clean parts of a spectrum in which a point may be left out of the smoother.
const OUTLIER_RATE: f64 = 0.01;
/// Number of neighbours on either side that share the noise of a point, and the degrees of freedom
/// that they must leave.
const NEIGHBOURS: usize = 5;
const LEAST_NEAR: f64 = 4.0;
/// No estimate below this share of |Z|: beyond it, the numbers' own rounding and the ladder's are
/// met.
const LEAST: f64 = 1e-7;

/// Source of the noise.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum NoiseSource {
    /// The spectrum states the covariance of every point.
    Stated,
    /// The scatter between repeats.
    Repeats,
    /// The residual of a smoother.
    Smoother,
}

/// Standard uncertainty of every point of one spectrum.
#[derive(Debug, Clone, PartialEq)]
pub struct Noise {
    /// Covariance of each point, Ω².
    pub covariance: Vec<Covariance2>,
    /// Degrees of freedom of an estimate; `None` for a stated covariance.
    pub dof: Option<f64>,
    /// Source of the noise.
    pub source: NoiseSource,
}

impl Noise {
    /// The noise of a spectrum: the stated covariances without the errors that its points share (a
    /// gain, a skew, an inductance, charge storage, which are impedances of linear systems
    /// themselves); else the scatter of the repeats (which include it) if there are
    /// [`FEWEST_REPEATS`] on its grid and at its amplitude; else a smoother's residual.
    ///
    /// # Errors
    /// [`ValidityError::TooFewPoints`] where a smoother has nothing to smooth,
    /// [`ValidityError::Zero`] for an impedance of zero.
    pub fn of(spectrum: &Spectrum, repeats: &[Spectrum]) -> Result<Self, ValidityError> {
        if let Some((index, point)) = spectrum
            .points
            .iter()
            .enumerate()
            .find(|(_, p)| p.z_ohm.norm() == 0.0)
        {
            return Err(ValidityError::Zero {
                spectrum: spectrum.name.clone(),
                number: index + 1,
                freq_hz: point.freq_hz,
            });
        }
        let stated = spectrum.points.iter().all(|p| {
            p.covariance.is_valid() && p.covariance.re_re > 0.0 && p.covariance.im_im > 0.0
        });
        if stated {
            let covariance = (0..spectrum.points.len())
                .map(|k| spectrum.own_covariance(k))
                .collect();
            return Ok(Self {
                covariance,
                dof: None,
                source: NoiseSource::Stated,
            });
        }
        let alike: Vec<&Spectrum> = repeats
            .iter()
            .filter(|r| same_grid(r, spectrum) && same_amplitude(r, spectrum))
            .collect();
        let (source, (relative, dof)): (_, (Vec<f64>, f64)) = if alike.len() >= FEWEST_REPEATS {
            (NoiseSource::Repeats, from_repeats(&alike))
        } else {
            (NoiseSource::Smoother, from_smoother(spectrum)?)
        };
        let covariance = weight_sizes_ohm(&spectrum.points)
            .into_iter()
            .zip(&relative)
            .map(|(size, r)| Covariance2::circular((r * size).powi(2)))
            .collect();
        Ok(Self {
            covariance,
            dof: Some(dof),
            source,
        })
    }

    /// Returns the noise with each point's whole uncertainty: stated covariances then include the
    /// errors that points share.
    #[must_use]
    pub fn with_shared(self, spectrum: &Spectrum) -> Self {
        match self.source {
            NoiseSource::Stated => Self {
                covariance: spectrum.points.iter().map(|p| p.covariance).collect(),
                ..self
            },
            _ => self,
        }
    }

    /// Standard deviation of the points relative to |Z|, the median of both parts.
    pub fn relative(&self, points: &[ImpedancePoint]) -> f64 {
        let ratio = |(c, p): (&Covariance2, &ImpedancePoint)| {
            (0.5 * (c.re_re + c.im_im)).sqrt() / p.z_ohm.norm()
        };
        median(self.covariance.iter().zip(points).map(ratio).collect())
    }

    pub(crate) fn whitening(&self) -> Vec<Whitening> {
        self.covariance.iter().map(whitening).collect()
    }
}

/// The inverse of the covariance's Cholesky factor.
fn whitening(c: &Covariance2) -> Whitening {
    let l11 = c.re_re.sqrt();
    let l21 = c.re_im / l11;
    // A correlation of one, by rounding or by statement, must not make a point infinitely sharp.
    let l22 = (c.im_im - l21 * l21).max(1e-6 * c.im_im).sqrt();
    Whitening {
        a: 1.0 / l11,
        b: -l21 / (l11 * l22),
        c: 1.0 / l22,
    }
}

fn same_amplitude(a: &Spectrum, b: &Spectrum) -> bool {
    let equal = |a: f64, b: f64| (a.is_nan() && b.is_nan()) || (a / b - 1.0).abs() < 0.05;
    a.points
        .iter()
        .zip(&b.points)
        .all(|(a, b)| equal(a.amplitude_a, b.amplitude_a))
}

/// Returns the scatter of each point relative to |Z| and its degrees of freedom: the median over
/// the points, so that one bad point counts no more than another; larger if the neighbouring points
/// scatter more.
fn from_repeats(repeats: &[&Spectrum]) -> (Vec<f64>, f64) {
    let count = repeats.len() as f64;
    let points = repeats[0].points.len();
    let mut variances = Vec::with_capacity(points);
    for k in 0..points {
        let mean = repeats.iter().map(|r| r.points[k].z_ohm).sum::<Complex64>() / count;
        let sum: f64 = repeats
            .iter()
            .map(|r| (r.points[k].z_ohm - mean).norm_sqr())
            .sum();
        variances.push(sum / (2.0 * (count - 1.0)) / mean.norm_sqr());
    }
    let dof = 2.0 * (count - 1.0);
    // The median of χ²/dof after Wilson and Hilferty; a median has about half the information of a
    // mean.
    let of_median = 1.0 / (1.0 - 2.0 / (9.0 * dof)).powi(3);
    let whole = median(variances.clone());
    let around = |k: usize| median(variances[neighbours(k, points)].to_vec());
    (
        (0..points)
            .map(|k| (whole.max(around(k)) * of_median).sqrt().max(LEAST))
            .collect(),
        0.5 * dof * points as f64,
    )
}

/// Returns the points that determine the noise of one of them.
fn neighbours(point: usize, points: usize) -> std::ops::Range<usize> {
    point.saturating_sub(NEIGHBOURS)..(point + NEIGHBOURS + 1).min(points)
}

/// The residual of the smoother relative to |Z|, over the band or over the points around, whichever
/// is larger, and the degrees of freedom of the first.
fn from_smoother(spectrum: &Spectrum) -> Result<(Vec<f64>, f64), ValidityError> {
    let points = &spectrum.points;
    let z: Vec<Complex64> = points.iter().map(|p| p.z_ohm).collect();
    let omega: Vec<f64> = points.iter().map(|p| TAU * p.freq_hz).collect();
    let (lo, hi) = (omega[0], omega[omega.len() - 1]);
    let tau_range_s = 1.0 / (SMOOTHER_REACH * hi)..=SMOOTHER_REACH / lo;
    let wanted = (SMOOTHER_PER_DECADE * (tau_range_s.end() / tau_range_s.start()).log10()).ceil()
        as usize
        + 1;
    let order = wanted.min(3 * z.len() / 5).max(2);
    let mut ladder = Ladder::new(omega, tau_range_s, order);
    let sizes = weight_sizes_ohm(points);
    let re = Whitening {
        a: 1.0,
        b: 0.0,
        c: 0.0,
    };
    let im = Whitening {
        a: 0.0,
        b: 0.0,
        c: 1.0,
    };
    let mut left = vec![(0.0, 0.0); z.len()];
    for part in [re, im] {
        for (left, (square, dof)) in
            left.iter_mut()
                .zip(smooth_part(&mut ladder, &z, &sizes, part, order))
        {
            *left = (left.0 + square, left.1 + dof);
        }
    }
    let total = |of: &[(f64, f64)]| {
        of.iter()
            .fold((0.0, 0.0), |sum, one| (sum.0 + one.0, sum.1 + one.1))
    };
    let (sum, dof) = total(&left);
    if dof < 2.0 {
        return Err(ValidityError::TooFewPoints {
            spectrum: spectrum.name.clone(),
            expected: 6,
            met: z.len(),
        });
    }
    let variance = |k: usize| {
        let (near, near_dof) = total(&left[neighbours(k, z.len())]);
        // Fewer degrees of freedom do not determine a local variance.
        if near_dof > LEAST_NEAR {
            (sum / dof).max(near / near_dof)
        } else {
            sum / dof
        }
    };
    Ok((
        (0..z.len())
            .map(|k| variance(k).sqrt().max(LEAST))
            .collect(),
        dof,
    ))
}

/// Returns the squares that the smoother of one part leaves, relative to |Z|, and their degrees of
/// freedom; without outliers.
fn smooth_part(
    ladder: &mut Ladder,
    z: &[Complex64],
    sizes: &[f64],
    part: Whitening,
    order: usize,
) -> Vec<(f64, f64)> {
    let scaled = |size: &f64| Whitening {
        a: part.a / size,
        b: 0.0,
        c: part.c / size,
    };
    let mut whiten: Vec<Whitening> = sizes.iter().map(scaled).collect();
    let mut used = z.len() as f64;
    let mut leverage = Vec::new();
    loop {
        ladder.load(z, &whiten, 0.0);
        ladder.solve(order);
        ladder.leverage(&mut leverage);
        let dof = used - leverage.iter().map(|h| h.0 + h.2).sum::<f64>();
        let sum = ladder.chi2();
        // The square that the sum loses with a point.
        let square = |k: usize| {
            let (re, im) = ladder.residual(k);
            (re + im).powi(2) / (1.0 - leverage[k].0 - leverage[k].2).max(1e-3)
        };
        let worst = (0..z.len())
            .max_by(|a, b| square(*a).total_cmp(&square(*b)))
            .unwrap_or(0);
        let others = (sum - square(worst)).max(1e-12 * sum) / (dof - 1.0);
        let p = deviate_tail((square(worst) / others).sqrt(), Some(dof - 1.0));
        let enough_out = z.len() as f64 - used > 0.1 * z.len() as f64;
        if dof < 3.0 || enough_out || p.is_nan() || p > OUTLIER_RATE / used {
            let of = |k: usize| {
                let (re, im) = ladder.residual(k);
                let used = whiten[k] != Whitening::NONE;
                (
                    (re + im).powi(2),
                    if used {
                        (1.0 - leverage[k].0 - leverage[k].2).max(0.0)
                    } else {
                        0.0
                    },
                )
            };
            return (0..z.len()).map(of).collect();
        }
        whiten[worst] = Whitening::NONE;
        used -= 1.0;
    }
}

pub(super) fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    let n = values.len();
    if n == 0 {
        f64::NAN
    } else {
        0.5 * (values[(n - 1) / 2] + values[n / 2])
    }
}
