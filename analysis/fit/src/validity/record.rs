//! Tests from the harmonics in the records whether the cell responds linearly.
//!
//! The test yields the size of an error of Z: in a polynomial without memory, v = Σ aₙ iⁿ, the term
//! of odd order n puts C(n, (n−1)/2) times its n-th harmonic into the fundamental (3 times the
//! third, 10 times the fifth), even orders nothing. A sweep has many harmonics, so that the
//! probabilities are corrected for their number after Holm.

use super::FALSE_ALARM_RATE;
use super::stationarity::Drift;
use super::tail::{holm, pair_tail};
use serde::Serialize;

/// Harmonics and drift in the record of one point, besides the fundamental.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Record {
    /// Frequency, Hz.
    pub freq_hz: f64,
    /// Harmonics of the voltage.
    pub harmonics: Vec<Harmonic>,
    /// Drift of the offset that no trend term took up.
    pub drift: Option<Drift>,
}

/// A harmonic in the voltage of a record.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Harmonic {
    /// Its order, 2 or more.
    pub order: u32,
    /// Amplitude over that of the fundamental.
    pub ratio: f64,
    /// Standard deviation of the ratio.
    pub sigma: f64,
}

/// Harmonics that are larger than noise explains, record by record, with one false alarm in a
/// hundred sweeps. The probabilities are corrected after Holm for all harmonics of all records that
/// can count against a point. Even orders cannot (see [`Harmonic::error_percent`]) and are not
/// counted.
pub fn beyond_noise(records: &[Record]) -> Vec<Vec<bool>> {
    let can = |harmonic: &&Harmonic| !harmonic.order.is_multiple_of(2);
    let tested: Vec<f64> = records
        .iter()
        .flat_map(|record| record.harmonics.iter().filter(can))
        .map(Harmonic::p)
        .collect();
    let mut adjusted = holm(&tested).into_iter();
    let mut judge = |harmonic: &Harmonic| {
        can(&harmonic) && adjusted.next().is_some_and(|p| p < FALSE_ALARM_RATE)
    };
    records
        .iter()
        .map(|record| record.harmonics.iter().map(&mut judge).collect())
        .collect()
}

impl Harmonic {
    /// Probability that noise alone makes as much, by itself.
    fn p(&self) -> f64 {
        pair_tail((self.ratio / self.sigma).powi(2), None)
    }

    /// Largest change of Z by the same nonlinearity, %.
    pub fn error_percent(&self) -> f64 {
        if self.order.is_multiple_of(2) {
            return 0.0;
        }
        let half = (self.order.saturating_sub(1) / 2).min(20);
        let binomial = (0..half).fold(1.0, |c, k| c * f64::from(self.order - k) / f64::from(k + 1));
        100.0 * binomial * self.ratio
    }
}
