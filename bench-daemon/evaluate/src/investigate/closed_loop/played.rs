//! The loop of every investigation: the next experiment of a question, until the question ends it,
//! on one bench, within a budget.

use std::path::{Path, PathBuf};

use super::{
    investigation::NotPlayed,
    rule::{Budget, End},
};
use crate::run::{Measured, Session};
use analysis::ocv::OcvCurve;
use bench_core::safety::failure::Failure;
use bench_plan::config::Experiment;

/// Name of the folder of the first run.
pub(super) const CAMPAIGN: &str = "campaign";

/// Settings of an investigation.
#[derive(Debug, Clone)]
pub struct Means<'a> {
    /// Folder of everything that is written; new or empty.
    pub out: &'a Path,
    /// The open-circuit voltage that the model is given.
    pub ocv: OcvCurve,
    /// Budget that may be spent.
    pub budget: Budget,
}

/// End of an investigation.
pub(super) struct Ended {
    pub(super) end: End,
    pub(super) text: String,
    pub(super) not_played: Vec<NotPlayed>,
}

impl Ended {
    pub(super) fn without_runs(end: End, text: impl Into<String>) -> Self {
        Self {
            end,
            text: text.into(),
            not_played: Vec::new(),
        }
    }
}

/// An experiment that is to be played.
pub(super) struct Planned {
    /// The last part of the name of its folder.
    pub(super) name: String,
    pub(super) description: String,
    pub(super) experiment: Experiment,
    /// Charge that it moves in both directions together, Ah.
    pub(super) charge_ah: f64,
}

/// What follows from everything measured so far.
pub(super) enum Next {
    /// An experiment that is worth its price.
    Play(Box<Planned>),
    /// The investigation ends.
    End(Ended),
}

/// An experiment that was played.
pub(super) struct Played<'a> {
    /// Its run folder.
    pub(super) folder: &'a Path,
    /// Time that it took on the bench, min.
    pub(super) minutes: f64,
    /// Rest of the budget after it.
    pub(super) left: Budget,
}

/// What an investigation wants to know.
pub(super) trait Question {
    /// Returns the next experiment for the rest of the budget, or why the investigation ends.
    fn next(&mut self, left: Budget) -> Result<Next, Failure>;

    /// Takes the measurements of an experiment that was played.
    fn take(&mut self, played: &Played<'_>) -> Result<(), Failure>;
}

/// A bench on which experiments are played one after the other.
pub(super) struct Bench<'a> {
    session: Session,
    out: &'a Path,
    budget: Budget,
    /// Time that the first experiment took, min.
    pub(super) first_minutes: f64,
    /// Part of the budget that was spent.
    pub(super) spent: Budget,
    /// Points that the quality gate has refused so far.
    pub(super) refused: usize,
    /// Number of experiments after the first.
    played: usize,
}

impl<'a> Bench<'a> {
    /// Starts with the first experiment, which the budget does not pay.
    pub(super) fn first(
        experiment: &Experiment,
        out: &'a Path,
        budget: Budget,
    ) -> Result<(Self, Measured), Failure> {
        let mut session = Session::new(&experiment.bench)?;
        let start_s = session.now_s();
        let measured = session.run(experiment, &out.join(CAMPAIGN))?.measured;
        let bench = Self {
            first_minutes: (session.now_s() - start_s) / 60.0,
            session,
            out,
            budget,
            spent: Budget::default(),
            refused: measured.refused(),
            played: 0,
        };
        Ok((bench, measured))
    }

    /// Rest of the budget.
    pub(super) fn left(&self) -> Budget {
        self.budget.less(self.spent)
    }

    /// Plays experiments until the question ends it or a run ends early, whose error is returned too.
    pub(super) fn play(
        &mut self,
        question: &mut impl Question,
    ) -> Result<(Ended, Option<Failure>), Failure> {
        loop {
            let planned = match question.next(self.left())? {
                Next::Play(planned) => planned,
                Next::End(ended) => return Ok((ended, None)),
            };
            self.played += 1;
            let folder = self.out.join(format!("{}_{}", self.played, planned.name));
            let minutes = match self.run(&planned, &folder) {
                Ok(minutes) => minutes,
                Err(error) => {
                    let text = format!("a run ended early: {}: {error}", planned.description);
                    return Ok((Ended::without_runs(End::Stopped, text), Some(error)));
                }
            };
            let left = self.left();
            question.take(&Played {
                folder: &folder,
                minutes,
                left,
            })?;
        }
    }

    /// Runs an experiment and pays for it; returns the minutes that it took.
    fn run(&mut self, planned: &Planned, folder: &Path) -> Result<f64, Failure> {
        let start_s = self.session.now_s();
        let finished = self.session.run(&planned.experiment, folder)?;
        self.refused += finished.measured.refused();
        let minutes = (self.session.now_s() - start_s) / 60.0;
        self.spent = self.spent.plus(Budget {
            minutes,
            charge_ah: planned.charge_ah,
        });
        Ok(minutes)
    }
}

/// The last part of a path, as results name a run folder.
pub(super) fn folder_name(folder: &Path) -> String {
    let name = folder.file_name();
    name.map_or_else(String::new, |name| name.to_string_lossy().into_owned())
}

/// The folder of the first run.
pub(super) fn campaign(out: &Path) -> PathBuf {
    out.join(CAMPAIGN)
}
