//! Measurements of a run.

use std::collections::BTreeMap;

use analysis::{
    calibration::Correction,
    spectrum::{FlaggedPoint, Spectrum},
};

use super::multisine::MultisineRun;
use crate::{doctor::fixture_check::ControlResult, measure::SweepPoint};

/// Measurements of a run.
#[derive(Debug)]
pub struct Measured {
    /// The controls' verdicts.
    pub controls: Vec<ControlResult>,
    /// Points as read, by fixture.
    pub sweeps: BTreeMap<&'static str, Vec<SweepPoint>>,
    /// The correction of the bench.
    pub correction: Correction,
    /// The corrected spectrum of the cell, of its first sweep; without points where it was not
    /// swept.
    pub spectrum: Spectrum,
    /// Those of its further sweeps.
    pub repeats: Vec<Spectrum>,
    /// All of them with the noise of their own records only: what the correction leaves uncertain
    /// is the same in each.
    pub own_noise: Vec<Spectrum>,
    /// The points of all of them as read.
    pub points: Vec<Vec<SweepPoint>>,
    /// They are runs of a campaign, and called after cell and repeat.
    pub campaign: bool,
    /// The file of each of them.
    pub files: Vec<String>,
    /// Points of the controls that the quality gate has refused, with the name of the control.
    pub refused_controls: Vec<(&'static str, FlaggedPoint)>,
    /// Multisine measurements of the cell.
    pub multisines: Vec<MultisineRun>,
}

impl Measured {
    /// The corrected spectra of all sweeps of the cell.
    pub fn spectra(&self) -> impl Iterator<Item = &Spectrum> {
        std::iter::once(&self.spectrum)
            .chain(&self.repeats)
            .filter(|spectrum| !spectrum.points.is_empty())
    }

    /// Name of each of them among the others; empty where there is no other.
    pub fn names(&self) -> Vec<String> {
        let several = self
            .repeats
            .iter()
            .any(|spectrum| !spectrum.points.is_empty());
        let name = |(number, spectrum): (usize, &Spectrum)| match (several, self.campaign) {
            (_, true) => spectrum.name.clone(),
            (true, false) => format!("sweep {number}"),
            (false, false) => String::new(),
        };
        (1..).zip(self.spectra()).map(name).collect()
    }

    /// Points that the quality gate has refused to the end, those of the controls among them.
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

    /// Name of the first of them, where there are others.
    pub(crate) fn first_of_several(&self) -> Option<String> {
        self.names()
            .into_iter()
            .next()
            .filter(|_| !self.repeats.is_empty())
    }
}
