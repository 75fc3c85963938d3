//! What a map says of a spectrum that it has not seen.

use super::score::{LeftOutScore, error_part, errors};
use super::solution::Solution;
use super::solve::Normal;
use super::sweep::Sweep;
use super::train::Train;
use analysis_model::map::BAND_SIGMAS;
use nalgebra::{DMatrix, DVector};

/// Spectra at least of which each can be left out.
const LEAST_SPECTRA: usize = 3;
/// Error of a spectrum that contradicts its neighbours, as a part of its modulus, and over the
/// standard deviation of the prediction without it.
const CONTRADICTS_PART: f64 = 0.1;
const CONTRADICTS_SIGMAS: f64 = 2.0;
/// Fall of the cost without it: over the median of all, and as a part of the largest. The neighbours
/// of an outlier are missed as well, but it is the outlier whose absence reconciles the others.
const CONTRADICTS_RATIO: f64 = 6.0;
const CONTRADICTS_LARGEST: f64 = 0.5;

/// The fitted spectra, each left out of a fit of its own.
pub(super) struct LeftOut<'a> {
    spectra: Vec<(&'a Sweep, Option<Error>)>,
}

/// Error on a spectrum and its standard deviation, as parts of the modulus, and what it costs.
#[derive(Clone, Copy)]
struct Error {
    part: f64,
    sigma_part: f64,
    /// Share of real and imaginary parts within the band of 95 %.
    inside: f64,
    /// Fall of the cost of the fit without it.
    fall: f64,
}

impl<'a> LeftOut<'a> {
    /// Fits the map once without each fitted spectrum, if there are three or more. `all` is the solution
    /// with every spectrum.
    pub(super) fn new(all: &Solution, train: &Train<'a>) -> Self {
        let (design, kinetics, solved) = (&all.design, &all.kinetics, &all.solved);
        if train.sweeps.len() < LEAST_SPECTRA {
            return Self {
                spectra: Vec::new(),
            };
        }
        let covariance = all.equations.covariance();
        let spectra = train.sweeps.iter().map(|sweep| {
            let error = covariance.as_ref().and_then(|covariance| {
                let mut own = (Normal::new(design.count()), DMatrix::zeros(0, 0));
                design.add_sweep(sweep, train.scales.spectra, kinetics, &mut |rows, y| {
                    own.0.add(rows, y);
                    own.1 = rows.clone();
                });
                let mut others = all.equations.clone();
                others.remove(&own.0);
                let without = others.solve(design.resistances(), Some(solved)).ok()?;
                let map = design.map(kinetics, &without);
                let inductance_h = design.inductance_h(&without);
                let variances = variances(covariance, &own.1)?;
                let (mut square, mut inside) = (0.0, 0);
                for (k, (point, error)) in errors(&map, sweep, inductance_h)
                    .skip(sweep.low())
                    .enumerate()
                {
                    let unit_ohm = train.scales.spectra * point.error_ohm;
                    for (error_ohm, variance) in [
                        (error.re, variances[2 * k]),
                        (error.im, variances[2 * k + 1]),
                    ] {
                        square += variance * unit_ohm.powi(2) / point.z_ohm.norm_sqr();
                        let is_inside = error_ohm.abs() <= BAND_SIGMAS * variance.sqrt() * unit_ohm;
                        inside += usize::from(is_inside);
                    }
                }
                let points = sweep.fitted().len() as f64;
                Some(Error {
                    part: error_part(&map, sweep, inductance_h, sweep.low()),
                    sigma_part: (square / points).sqrt(),
                    inside: inside as f64 / (2.0 * points),
                    fall: solved.cost - without.cost,
                })
            });
            (*sweep, error)
        });
        Self {
            spectra: spectra.collect(),
        }
    }

    /// Returns what the map without a spectrum misses of it.
    pub(super) fn score(&self, spectrum: &Sweep) -> Option<LeftOutScore> {
        let found = self
            .spectra
            .iter()
            .find(|(sweep, _)| std::ptr::eq(*sweep, spectrum));
        let error = found?.1?;
        Some(LeftOutScore {
            part: error.part,
            sigma_part: error.sigma_part,
            inside: error.inside,
        })
    }

    /// Names the spectra that contradict their neighbours.
    pub(super) fn notes(&self) -> Vec<String> {
        let errors = || self.spectra.iter().filter_map(|(_, error)| *error);
        let sorted = |of: fn(Error) -> f64| {
            let mut values: Vec<f64> = errors().map(of).collect();
            values.sort_by(f64::total_cmp);
            values
        };
        let falls = sorted(|error| error.fall);
        let (Some(largest), Some(middle)) = (falls.last(), falls.get(falls.len() / 2)) else {
            return Vec::new();
        };
        let least_fall = (CONTRADICTS_RATIO * middle).max(CONTRADICTS_LARGEST * largest);
        let parts = sorted(|error| error.part);
        let median = parts[parts.len() / 2];
        let named = self.spectra.iter().filter_map(|(sweep, error)| {
            let Error { part, sigma_part, fall, .. } = (*error)?;
            let is_missed = part > CONTRADICTS_PART.max(CONTRADICTS_SIGMAS * sigma_part);
            (is_missed && fall >= least_fall).then(|| {
                format!(
                    "{} (SOC {:.2}, {:.1} °C) contradicts its neighbours: without it, the map misses it \
                    by {:.0} % (expected {:.0} %, median of all {:.1} %)",
                    sweep.name,
                    sweep.soc,
                    sweep.temperature_degc,
                    100.0 * part,
                    100.0 * sigma_part,
                    100.0 * median
                )
            })
        });
        named.collect()
    }
}

/// Variances of a measured spectrum about its prediction without its own rows X, in units of the errors:
/// with H = X·Σ·Xᵀ of all rows they are the diagonal of (1 − H)⁻¹. One of these is the error of the
/// spectrum itself, the rest that of the prediction.
fn variances(covariance: &DMatrix<f64>, rows: &DMatrix<f64>) -> Option<DVector<f64>> {
    let seen = rows * covariance * rows.transpose();
    let n = seen.nrows();
    let predicted = (DMatrix::identity(n, n) - seen).try_inverse()?;
    Some(predicted.diagonal().map(|variance| variance.max(0.0)))
}
