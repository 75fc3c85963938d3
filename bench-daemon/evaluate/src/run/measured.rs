//! Measurements of a run.

use std::collections::BTreeMap;

use analysis::{
    calibration::Correction,
    spectrum::{FlaggedPoint, Spectrum},
};

use super::multisine::MultisineRun;
use crate::doctor::fixture_check::ControlResult;
use bench_plan::measure::SweepPoint;

/// Measurements of a run.
#[derive(Debug)]
pub struct Measured {
    /// Verdicts of the controls.
    pub controls: Vec<ControlResult>,
    /// Points as read, by fixture.
    pub sweeps: BTreeMap<&'static str, Vec<SweepPoint>>,
    /// The correction of the bench.
    pub correction: Correction,
    /// The corrected spectrum of the cell from its first sweep; without points if there was no
    /// sweep.
    pub spectrum: Spectrum,
    /// Spectra of further sweeps.
    pub repeats: Vec<Spectrum>,
    /// All spectra with the noise of their own records only: the remaining uncertainty of the
    /// correction is the same in each.
    pub own_noise: Vec<Spectrum>,
    /// The points of all spectra as read.
    pub points: Vec<Vec<SweepPoint>>,
    /// Whether they are runs of a campaign or points of a map, and named after them.
    pub campaign: bool,
    /// The file of each spectrum.
    pub files: Vec<String>,
    /// Points of the controls that the quality gate has refused, with the name of the control.
    pub refused_controls: Vec<(&'static str, FlaggedPoint)>,
    /// Multisine measurements of the cell.
    pub multisines: Vec<MultisineRun>,
}

impl Measured {
    /// Returns the corrected spectra of all sweeps of the cell.
    pub fn spectra(&self) -> impl Iterator<Item = &Spectrum> {
        std::iter::once(&self.spectrum)
            .chain(&self.repeats)
            .filter(|spectrum| !spectrum.points.is_empty())
    }

    /// Returns the commanded direct current under a spectrum, by its place, A.
    pub(crate) fn bias_a(&self, place: usize) -> f64 {
        let point = self.points.get(place).and_then(|points| points.first());
        let conditions = point.and_then(|point| point.conditions);
        conditions.map_or(0.0, |conditions| conditions.bias_a)
    }

    /// Returns the name of each spectrum among the others; empty if there is only one at rest.
    pub fn names(&self) -> Vec<String> {
        let several = self
            .repeats
            .iter()
            .any(|spectrum| !spectrum.points.is_empty());
        let name = |(number, spectrum): (usize, &Spectrum)| {
            let bias_a = self.bias_a(number - 1);
            match (several, self.campaign) {
                (_, true) => spectrum.name.clone(),
                _ if bias_a != 0.0 => format!("sweep {number}, {bias_a:+} A"),
                (true, false) => format!("sweep {number}"),
                (false, false) => String::new(),
            }
        };
        (1..).zip(self.spectra()).map(name).collect()
    }

    /// Returns the number of points that the quality gate refused to the end, including those of
    /// the controls.
    pub fn refused(&self) -> usize {
        let sweeps = self
            .points
            .iter()
            .flatten()
            .filter(|point| !point.failing.is_empty())
            .count();
        sweeps
            + self.refused_controls.len()
            + self
                .multisines
                .iter()
                .map(|run| run.flagged.len())
                .sum::<usize>()
    }

    /// Returns the name of the first spectrum, if there are others.
    pub(crate) fn first_of_several(&self) -> Option<String> {
        self.names()
            .into_iter()
            .next()
            .filter(|_| !self.repeats.is_empty())
    }
}
