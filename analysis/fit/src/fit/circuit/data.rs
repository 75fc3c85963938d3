//! The data of a circuit's fit, with weights.

use super::options::{CircuitFitError, CircuitOptions, Weight};
use crate::fit::{
    clusters::Clusters,
    common::{self, MeasuredPoint},
    options::{Objective, check_spectra},
    pooled::{DataPoint, Pooled, TaggedPoint, inverse_covariance, quadratic},
};
use analysis_signal::spectrum::{ImpedancePoint, Spectrum};
use std::ops::Deref;

/// Data, objective and weight.
#[derive(Debug, Clone)]
pub(super) struct Data {
    pub(super) pooled: Pooled,
    pub(super) weight: Weight,
    /// Points with a usable covariance.
    pub(super) known: usize,
    pub(super) clusters: Clusters,
    /// Median of the weighted |Z|: the natural size of the objective's residuals.
    pub(super) scale: f64,
}

impl Deref for Data {
    type Target = Pooled;

    fn deref(&self) -> &Pooled {
        &self.pooled
    }
}

impl Data {
    pub(super) fn new(
        spectra: &[Spectrum],
        clusters: Clusters,
        options: &CircuitOptions,
    ) -> Result<Self, CircuitFitError> {
        check_spectra(spectra)?;
        let all = || {
            spectra
                .iter()
                .enumerate()
                .flat_map(|(i, s)| s.points.iter().map(move |p| (i, p)))
        };
        let (points, known) = (
            all().count(),
            all()
                .filter(|(_, p)| inverse_covariance(&p.covariance).is_some())
                .count(),
        );
        let default = match options.objective {
            Objective::Complex if known == points => Weight::Covariance,
            Objective::Complex => Weight::Modulus,
            Objective::SumAbs | Objective::Modulus => Weight::Unit,
        };
        let weight = options.weight.unwrap_or(default);
        if weight == Weight::Covariance && known < points {
            return Err(CircuitFitError::UnknownCovariance { known, points });
        }
        let carried = weight == Weight::Covariance && options.objective == Objective::Complex;
        let names = if carried {
            common::names(spectra)
        } else {
            Vec::new()
        };
        let one = |(i, s): (usize, &Spectrum), (k, p): (usize, &ImpedancePoint)| {
            let covariance = if names.is_empty() {
                p.covariance
            } else {
                s.own_covariance(k)
            };
            let point = weighted(&ImpedancePoint { covariance, ..*p }, weight, i);
            let seen = MeasuredPoint {
                z: p.z_ohm,
                weight: point.weight,
                directions: common::directions(s, k, &names),
            };
            TaggedPoint {
                freq_hz: p.freq_hz,
                point,
                seen,
            }
        };
        let tagged: Vec<TaggedPoint> = spectra
            .iter()
            .enumerate()
            .flat_map(|(i, s)| {
                s.points
                    .iter()
                    .enumerate()
                    .map(move |point| ((i, s), point))
            })
            .map(|(spectrum, point)| one(spectrum, point))
            .collect();
        let mut norms: Vec<f64> = tagged
            .iter()
            .map(|one| quadratic(&one.point.weight, one.point.z).sqrt())
            .collect();
        norms.sort_by(f64::total_cmp);
        let scale = norms.get(norms.len() / 2).copied().unwrap_or(1.0);
        Ok(Self {
            pooled: Pooled::new(options.objective, tagged, &names, true),
            weight,
            known,
            clusters,
            scale,
        })
    }

    /// All points of a frequency are the same.
    pub(super) fn is_repeated(&self) -> bool {
        self.groups.iter().all(|g| {
            g.points
                .iter()
                .all(|p| g.points.first().is_some_and(|first| first.z == p.z))
        })
    }

    /// The objective is a χ²: squares in standard deviations.
    pub(super) fn is_chi2(&self) -> bool {
        self.weight == Weight::Covariance && self.kind != Objective::SumAbs
    }

    /// Independent numbers among the data.
    pub(super) fn numbers(&self) -> usize {
        if self.kind == Objective::Modulus {
            self.points
        } else {
            2 * self.points
        }
    }
}

/// A point with the weights that are chosen.
fn weighted(p: &ImpedancePoint, weight: Weight, spectrum: usize) -> DataPoint {
    let relative = p.z_ohm.norm_sqr().recip();
    let (weight, weight_abs) = match weight {
        Weight::Unit => ([1.0, 0.0, 1.0], 1.0),
        Weight::Modulus => ([relative, 0.0, relative], relative),
        // Checked before: there is a covariance.
        Weight::Covariance => (
            inverse_covariance(&p.covariance).unwrap_or([relative, 0.0, relative]),
            p.magnitude_sigma_ohm().powi(-2),
        ),
    };
    DataPoint {
        z: p.z_ohm,
        weight,
        weight_abs,
        spectrum,
    }
}
