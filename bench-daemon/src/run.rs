//! A run: from a checked experiment to its folder, from the first exchange to its models.
//!
//! The bench is brought into safe state before this returns, once the instruments are known to be
//! the configured ones. This also holds after a panic and after a request to stop.

mod auto_resume;
mod drive;
mod manifest;
mod multisine;
mod play;
mod recompute;
pub(crate) mod results;
mod resume_context;
mod run_accumulator;
mod session;
mod stop;
mod sweep_writer;

use std::{collections::BTreeMap, path::Path};

use analysis::{
    calibration::Correction,
    spectrum::{FlaggedPoint, Spectrum},
};
pub(crate) use play::nobody_drives;
pub(crate) use recompute::{OtherResults, RecomputedPoint, Recorded, RecordedPoint, on_all_cores};
pub(crate) use resume_context::{ResumeContext, begun_experiment};
pub(crate) use stop::{StopSignals, caught};

use crate::{
    doctor::fixture_check::ControlResult, measure::SweepPoint, safety::failure::Failure,
    sim::Simulation,
};

pub use multisine::MultisineRun;
pub use session::Session;

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
    pub(super) fn first_of_several(&self) -> Option<String> {
        self.names()
            .into_iter()
            .next()
            .filter(|_| !self.repeats.is_empty())
    }
}

/// A run that went to its end.
pub struct Finished {
    /// Measurements of the run.
    pub measured: Measured,
    /// Summary for the terminal.
    pub summary: String,
    /// The simulated world, where there is one in this process.
    pub simulation: Option<Simulation>,
}

impl Finished {
    /// Returns the summary for the terminal, and the judgement of the quality gate.
    pub(crate) fn told(self) -> (String, Result<(), Failure>) {
        let gated = self.gated();
        (self.summary, gated)
    }

    /// Refuses a run whose quality gate has refused points: whoever reads nothing but the exit code
    /// must know.
    ///
    /// # Errors
    /// [`Failure::Refused`].
    pub fn gated(&self) -> Result<(), Failure> {
        let count = self.measured.refused();
        if count == 0 {
            Ok(())
        } else {
            Err(Failure::Refused { count })
        }
    }
}

/// How a run ends of which nothing is left to do.
pub(super) const FINISHED: &str = "finished";

fn folder_of(path: &Path) -> String {
    path.parent()
        .and_then(Path::file_name)
        .map_or_else(String::new, |name| name.to_string_lossy().into_owned())
}
