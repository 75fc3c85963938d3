//! The loop of every investigation: the next experiment of a question, until the question ends it,
//! on one bench, within a budget.

use std::path::{Path, PathBuf};

use super::{
    investigation::NotPlayed,
    rule::{Budget, End},
};
use crate::run::{Measured, Session, StopSignals};
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

/// End of an investigation by an error.
struct Broken {
    ended: Ended,
    failure: Failure,
}

/// What was spent and refused so far.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct SoFar {
    /// Part of the budget that was spent.
    pub(super) spent: Budget,
    /// Points that the quality gate has refused.
    pub(super) refused: usize,
}

/// What an investigation wants to know.
pub(super) trait Question {
    /// Returns the next experiment for the rest of the budget, or why the investigation ends.
    fn next(&mut self, left: Budget) -> Result<Next, Failure>;

    /// Takes the measurements of an experiment that was played.
    fn take(&mut self, played: &Played<'_>) -> Result<(), Failure>;

    /// Charge that a run has moved, by its folder, Ah; `None` if only its plan states it.
    fn moved_ah(&self, _folder: &Path) -> Option<f64> {
        None
    }

    /// Writes what is known before the next experiment.
    fn save(&self, _so_far: &SoFar) -> Result<(), Failure> {
        Ok(())
    }
}

/// A bench on which experiments are played one after the other.
pub(super) struct Bench<'a> {
    session: Session,
    /// Stop signals also of the time between two experiments.
    stop: StopSignals,
    out: &'a Path,
    budget: Budget,
    pub(super) so_far: SoFar,
    /// Number of experiments after the first.
    played: usize,
}

impl<'a> Bench<'a> {
    /// Starts with the first experiment, which the budget does not pay for.
    pub(super) fn first(
        experiment: &Experiment,
        out: &'a Path,
        budget: Budget,
    ) -> Result<(Self, Measured), Failure> {
        let mut session = Session::new(&experiment.bench)?;
        let stop = session.signals()?;
        let measured = session.run(experiment, &out.join(CAMPAIGN))?.measured;
        let bench = Self {
            session,
            stop,
            out,
            budget,
            so_far: SoFar {
                refused: measured.refused(),
                ..SoFar::default()
            },
            played: 0,
        };
        Ok((bench, measured))
    }

    /// Rest of the budget.
    pub(super) fn left(&self) -> Budget {
        self.budget.less(self.so_far.spent)
    }

    /// Plays experiments until the question ends it, or something fails, whose error is returned too.
    pub(super) fn play(&mut self, question: &mut impl Question) -> (Ended, Option<Failure>) {
        loop {
            match self.round(question) {
                Ok(None) => {}
                Ok(Some(ended)) => return (ended, None),
                Err(broken) => return (broken.ended, Some(broken.failure)),
            }
        }
    }

    /// Plays the next experiment, or returns the end.
    fn round(&mut self, question: &mut impl Question) -> Result<Option<Ended>, Box<Broken>> {
        let planned = match question.next(self.left()).map_err(failed)? {
            Next::Play(planned) => planned,
            Next::End(ended) => return Ok(Some(ended)),
        };
        question.save(&self.so_far).map_err(failed)?;
        if self.session.has_stopped(&mut self.stop) {
            let text = format!("stopped on request before a run: {}", planned.description);
            return Err(ended_by(End::Stopped, Failure::Stopped(text)));
        }
        self.played += 1;
        let folder = run_folder(self.out, self.played, &planned.name);
        let start_s = self.session.now_s();
        let finished = self.session.run(&planned.experiment, &folder);
        let minutes = (self.session.now_s() - start_s) / 60.0;
        let charge_ah = question.moved_ah(&folder).unwrap_or(planned.charge_ah);
        // A run that ended early has taken its time and charge, too.
        let price = Budget { minutes, charge_ah };
        self.so_far.spent = self.so_far.spent.plus(price);
        let finished = finished.map_err(|failure| {
            let text = format!("a run ended early: {}: {failure}", planned.description);
            Box::new(Broken {
                ended: Ended::without_runs(End::Stopped, text),
                failure,
            })
        })?;
        self.so_far.refused += finished.measured.refused();
        let left = self.left();
        let played = Played {
            folder: &folder,
            minutes,
            left,
        };
        question.take(&played).map_err(failed)?;
        Ok(None)
    }
}

/// The end by an error between two runs.
fn failed(failure: Failure) -> Box<Broken> {
    ended_by(End::Failed, failure)
}

fn ended_by(end: End, failure: Failure) -> Box<Broken> {
    Box::new(Broken {
        ended: Ended::without_runs(end, failure.to_string()),
        failure,
    })
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

/// The folder of a run after the first, by its number, from 1.
pub(super) fn run_folder(out: &Path, number: usize, name: &str) -> PathBuf {
    out.join(format!("{number}_{name}"))
}
