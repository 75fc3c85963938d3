//! Logs under load against spectra at rest.
//!
//! At low frequencies a cell at rest may show more resistance than under load, more than charge transfer
//! takes off (the spectra of the Panasonic 18650PF do). One map cannot have both, and a robot's load is
//! what it is for. The logs decide: if the map predicts pieces of logs that it has not seen better
//! without the frequencies that logs show as well, those frequencies are predicted only.

use super::design::Design;
use super::error;
use super::options::{MapFitError, MapOptions};
use super::solution::Solution;
use super::sweep::Sweep;
use super::train::Train;

/// Largest error on pieces without the low frequencies, as a part of that with them.
const LARGEST_RATIO: f64 = 0.9;
/// Least fall of that error, V: less does not matter under a load.
const LEAST_FALL_V: f64 = 2e-3;

/// Low frequencies of spectra that contradict the logs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Conflict {
    /// Frequency from which on spectra are fitted, Hz.
    pub(super) from_hz: f64,
    /// Error on pieces of the logs with all points, and without those below, rms V.
    pub(super) with_v: f64,
    pub(super) without_v: f64,
}

impl Conflict {
    /// Compares the map of all data with one without the points below the highest frequency of the logs,
    /// half their sampling rate; `None` if these points predict the logs as well, or if there are none.
    pub(super) fn find(
        all: &Solution,
        train: &Train,
        sweeps: &[Sweep],
        options: &MapOptions,
    ) -> Result<Option<Self>, MapFitError> {
        let from_hz = 0.5 / train.shortest_step_s();
        let cut: Vec<Sweep> = sweeps.iter().map(|s| s.clone().fit_from(from_hz)).collect();
        if from_hz == 0.0 || cut.iter().all(|sweep| sweep.low() == 0) {
            return Ok(None);
        }
        let without = Train {
            sweeps: cut.iter().filter(|sweep| sweep.is_fitted()).collect(),
            ..train.clone()
        };
        let with_v = left_out_v(all, train);
        // Energies and charge transfer of all data: a search of its own could only be better.
        let design = Design::new(&without, &[], options)?;
        let high = Solution::new(design, &without, all.kinetics.clone())?;
        let without_v = left_out_v(&high, &without);
        let conflict = Self {
            from_hz,
            with_v,
            without_v,
        };
        let is_better = without_v < (LARGEST_RATIO * with_v).min(with_v - LEAST_FALL_V);
        Ok(is_better.then_some(conflict))
    }

    pub(super) fn note(&self) -> String {
        format!(
            "the spectra are fitted from {:.3} Hz on: with their lower frequencies the map misses pieces of \
            the logs that it has not seen by {:.1} mV instead of {:.1} mV (rms): at rest this cell has \
            another impedance than under load",
            self.from_hz,
            1e3 * self.with_v,
            1e3 * self.without_v
        )
    }
}

/// Error on pieces of the fitted logs that the map has not seen, rms V.
fn left_out_v(solution: &Solution, train: &Train) -> f64 {
    error::rms_v(&train.logs, &error::predict_left_out(solution, train))
}
