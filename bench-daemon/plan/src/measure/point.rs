//! A finished point of a sweep.

use analysis_files::dataset::PointConditions;
use analysis_signal::spectrum::ChannelPhasors;
use instruments::{
    fixture::Fixture,
    units::{Coulombs, Hertz, Seconds},
};

use super::{
    harmonics_and_drift::HarmonicsAndDrift,
    quality::{Failing, Measures, Quality},
};

/// A finished point of a sweep.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct SweepPoint {
    /// Fixture in the jig.
    pub fixture: Fixture,
    /// Number in the sweep, from 0.
    pub index: usize,
    /// Phasors of the four channels.
    pub phasors: ChannelPhasors,
    /// Vertical scale of the four channels, V per division.
    pub volts_per_div: [f64; 4],
    /// Frequency from a fit with free frequency, Hz.
    pub free_freq_hz: Hertz,
    /// Greatest lag-1 correlation of the residuals: near 0 for noise, near 1 for a signal that the
    /// sinusoid does not explain.
    pub residual_lag1: f64,
    /// Content of the record beside the sinusoid.
    #[serde(rename = "beside")]
    pub harmonics_and_drift: HarmonicsAndDrift,
    /// Warnings about the point.
    pub warnings: Vec<String>,
    /// Bench time of the middle of its record, s, accurate to a period and a half.
    pub time_s: Seconds,
    /// Number of its records.
    pub captures: usize,
    /// How often it was measured again because the finished sweep rejected it.
    pub rechecked: usize,
    /// Effort of its retries.
    #[serde(default)]
    pub spent: Spent,
    /// Quality of its record.
    pub measures: Measures,
    /// Limits of the quality gate that it exceeds.
    pub failing: Vec<Failing>,
    /// Direct current under the sinusoid, charge and temperature; `None` without a direct current.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub conditions: Option<PointConditions>,
}

/// Effort of retries: of a point, or of all points of a sweep.
#[derive(Debug, Clone, Copy, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Spent {
    /// Time, s.
    pub time_s: Seconds,
    /// Charge moved back and forth, C.
    #[serde(rename = "charge_c")]
    pub charge_coulomb: Coulombs,
}

impl std::ops::Add for Spent {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self {
            time_s: self.time_s + other.time_s,
            charge_coulomb: self.charge_coulomb + other.charge_coulomb,
        }
    }
}

impl Spent {
    /// Returns the effort of the finished points of a sweep; it continues to accumulate after a
    /// resume.
    pub fn of<'a>(points: impl Iterator<Item = &'a SweepPoint>) -> Self {
        points.fold(Self::default(), |sum, point| sum + point.spent)
    }

    /// Checks whether an additional effort is within the budget.
    pub fn allows(&self, quality: &Quality, more: Self) -> bool {
        let spent = *self + more;
        spent.time_s <= quality.time_s && spent.charge_coulomb <= quality.charge_coulomb
    }
}
