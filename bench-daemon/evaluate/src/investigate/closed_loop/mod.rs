//! Closed loop of `eis-bench investigate`: a campaign, a model fitted to its sweeps, and a
//! diagnosis. The recommended run follows on the same bench, and then a diagnosis of all data so
//! far. The loop ends when no question is open or the budget is spent.
//!
//! Not here: the execution of a run (`command::run`) and the diagnosis (`analysis::diagnosis`). A
//! simulated world persists over all runs: its time, its charge, its wear and its noise continue.
//! The diagnosis reads only its files.

mod follow_up;
mod investigation;
mod join;
mod map;
mod map_result;
mod page;
mod played;
mod price;
mod rule;
mod worth;

use std::{
    path::PathBuf,
    sync::{Arc, Mutex},
};

use analysis::{
    diagnosis::{
        self, BaseModel, BenchLimits, Diagnosis, DiagnosisOptions, NextExperiment, Outcome,
        PlannedRun, Playable, gate,
    },
    fit::{Bounds, CellSweeps, FitOptions, ModelFile, OrderOptions, fit_erm, select_order},
    run_folder::MODEL,
    spectrum::Spectrum,
};
use follow_up::Site;
use played::{Bench, Ended, Next, Planned, Played, Question, campaign, folder_name};

use crate::{
    files::write_augmented,
    investigate::dataset::{Loaded, read_dataset, write_dataset},
    run::{
        Measured,
        results::{every_sweep, leave_out, refused_points},
    },
};
use bench_core::safety::failure::Failure;
use bench_plan::config::Experiment;
pub use investigation::{FollowUpRun, Investigation, NotPlayed, Step, WhyNot};
pub use join::{Later, add_played};
pub use map::investigate_map;
pub use map_result::{MapEnd, MapInvestigation, Round};
pub use page::not_played_text;
pub use played::Means;
pub use rule::{Budget, End, MOST_AGAIN, MOST_RUNS, most_played, settled, verdict_named};
pub use worth::Aims;

/// Name of the schema of `investigation.json`.
const SCHEMA: &str = "eis-bench/investigation";
/// Highest order that is tried if the experiment states none.
const MOST_RC: usize = 6;
/// Fraction of a limit that planned currents use, because the actual current scatters around the
/// set-point.
const LIMIT_PART: f64 = 0.94;
/// Greatest current of the bipolar supplies that drive traces, A.
const BENCH_A: f64 = 20.0;

/// Highest frequency of a planned sweep, Hz: beyond it the bipolar supply falls behind.
const HIGHEST_HZ: f64 = 1000.0;

/// Runs an investigation and writes `investigation.json`, `.md` and `.html` with their pictures,
/// `model.json`, `model_augmented.json` if something was added, the joined data set, and a run
/// folder per step. A later run that ended early, and an error after the first diagnosis, end the
/// investigation, which is written nevertheless.
///
/// # Errors
/// A campaign that ended early, a model that cannot be fitted, a folder that cannot be written.
pub fn investigate(experiment: &Experiment, means: &Means<'_>) -> Result<Investigation, Failure> {
    let (mut bench, measured) = Bench::first(experiment, means.out, means.budget)?;
    let (file, model) = base_model(experiment, &measured, means)?;
    let first = campaign(means.out);
    let mut workspace = Workspace {
        experiment,
        model,
        loaded: read_dataset(&first)?,
        outcome: None,
        menu: MenuOutcome::default(),
        steps: Vec::new(),
        first,
    };
    workspace.diagnose(None, bench.left())?;
    let (ended, failure) = bench.play(&mut workspace);
    write_dataset(&means.out.join("dataset"), &workspace.loaded.set)
        .map_err(|error| Failure::Analysis(error.to_string()))?;
    let Workspace {
        loaded,
        outcome: Some(outcome),
        steps,
        ..
    } = workspace
    else {
        return Err(nothing_diagnosed());
    };
    write_augmented(means.out, &file.into(), &outcome, &loaded.refused)?;
    let investigation = Investigation {
        schema: SCHEMA,
        name: experiment.name.clone(),
        budget: means.budget,
        spent: bench.so_far.spent,
        steps,
        end: ended.end,
        end_text: ended.text,
        not_played: ended.not_played,
        refused_points: bench.so_far.refused,
        diagnosis: outcome.diagnosis,
        failure,
    };
    page::write(means.out, &investigation, &outcome.curves)?;
    Ok(investigation)
}

fn nothing_diagnosed() -> Failure {
    Failure::Analysis("expected a diagnosis of the campaign, found none".to_owned())
}

/// Everything measured so far, and what follows from it.
struct Workspace<'a> {
    experiment: &'a Experiment,
    model: BaseModel,
    loaded: Loaded,
    /// The last diagnosis.
    outcome: Option<Outcome>,
    menu: MenuOutcome,
    steps: Vec<Step>,
    /// Folder of the campaign.
    first: PathBuf,
}

/// Results of the runs of the menu.
#[derive(Debug, Clone, Default)]
struct MenuOutcome {
    /// Names of runs that can be executed.
    allowed: Vec<String>,
    /// Runs that cannot be executed, as requested.
    refused: Vec<NotPlayed>,
}

impl MenuOutcome {
    /// Returns every run of the menu once, with the reason why it is not executed. A run that can
    /// be executed gives no information, otherwise it would have been requested.
    fn not_played(self) -> Vec<NotPlayed> {
        let mut runs: Vec<NotPlayed> = Vec::new();
        let nothing = |run| NotPlayed {
            run,
            why: WhyNot::TellsNothing,
            detail: "would move no open question forward".to_owned(),
        };
        for run in self.allowed.into_iter().map(nothing).chain(self.refused) {
            match runs.iter_mut().find(|known| known.run == run.run) {
                // Of several forms of a run, the one closest to execution is reported.
                Some(known) if run.why < known.why => *known = run,
                Some(_) => {}
                None => runs.push(run),
            }
        }
        runs
    }
}

impl Workspace<'_> {
    /// Diagnoses everything measured so far, and notes what became of the runs of the menu for the rest
    /// of the budget. A step is added: that of the run that was bought, else that of the campaign.
    fn diagnose(&mut self, bought: Option<Bought>, left: Budget) -> Result<(), Failure> {
        let names = self.steps.iter().filter_map(Step::bought);
        let names: Vec<&'static str> = names
            .chain(bought.iter().map(|bought| bought.run.experiment.name))
            .collect();
        let (outcome, menu) = self.diagnosed(&names, left)?;
        let (folder, run) = bought.map_or_else(
            || (folder_name(&self.first), None),
            |bought| (bought.folder, Some(bought.run)),
        );
        self.steps.push(step(folder, run, &outcome.diagnosis));
        (self.outcome, self.menu) = (Some(outcome), menu);
        Ok(())
    }

    /// The diagnosis of everything measured so far, and what became of the runs of the menu.
    fn diagnosed(
        &self,
        bought: &[&'static str],
        left: Budget,
    ) -> Result<(Outcome, MenuOutcome), Failure> {
        let limits = &self.experiment.cell.limits;
        let part = |limit_a: f64| LIMIT_PART * limit_a.min(BENCH_A);
        let limits = BenchLimits {
            discharge_a: part(limits.discharge_a.0),
            charge_a: part(limits.charge_a.0),
            highest_hz: HIGHEST_HZ,
            shunt_ohm: Some(self.experiment.bench.wiring.shunt.r_ohm),
        };
        let menu = Arc::new(Mutex::new(MenuOutcome::default()));
        let options = DiagnosisOptions {
            limits: Some(limits),
            playable: Some(self.playable(bought, left, menu.clone())),
            next_run_first: true,
            ..DiagnosisOptions::default()
        };
        let unreadable = self
            .loaded
            .problems
            .iter()
            .map(|problem| gate::Reason::unreadable(&problem.run, &problem.text))
            .collect();
        let mut outcome = diagnosis::diagnose(&self.loaded.set, unreadable, &self.model, &options)
            .map_err(|error| Failure::Analysis(error.to_string()))?;
        outcome
            .diagnosis
            .notes
            .extend(self.loaded.notes.iter().cloned());
        let menu = menu
            .lock()
            .map_or_else(|_| MenuOutcome::default(), |menu| menu.clone());
        Ok((outcome, menu))
    }

    /// Refuses runs that were executed often enough, that bench or cell do not permit, or that
    /// exceed the budget.
    fn playable(
        &self,
        bought: &[&'static str],
        left: Budget,
        menu: Arc<Mutex<MenuOutcome>>,
    ) -> Playable {
        let (site, bought) = (
            Site::new(self.experiment, &self.loaded.set, &self.model.ocv),
            bought.to_vec(),
        );
        Arc::new(move |name, runs| {
            let charge_ah: f64 = runs.iter().map(PlannedRun::charge_ah).sum();
            let found = match site
                .as_ref()
                .map_err(String::clone)
                .and_then(|site| site.experiment(runs))
            {
                _ if bought.iter().filter(|played| **played == name).count() >= MOST_AGAIN => {
                    Err((WhyNot::Played, format!("played {MOST_AGAIN} times")))
                }
                Err(reason) => Err((WhyNot::Limit, reason)),
                Ok((_, minutes)) => left
                    .shortfall(Budget { minutes, charge_ah })
                    .map_or(Ok(()), |lack| Err((WhyNot::Cost, lack))),
            };
            let allowed = found.is_ok();
            if let Ok(mut menu) = menu.lock() {
                match found {
                    Ok(()) => menu.allowed.push(name.to_owned()),
                    Err((why, detail)) => menu.refused.push(NotPlayed {
                        run: name.to_owned(),
                        why,
                        detail,
                    }),
                }
            }
            allowed
        })
    }

    /// The experiment that is worth its price, or why the investigation ends.
    fn worth(&self, outcome: &Outcome) -> Result<(NextExperiment, Experiment), Ended> {
        match settled(outcome.diagnosis.verdict) {
            Some((end, text)) => Err(Ended::without_runs(end, text)),
            None => self.worth_open(outcome),
        }
    }

    /// As [`Self::worth`], while a question is open.
    fn worth_open(&self, outcome: &Outcome) -> Result<(NextExperiment, Experiment), Ended> {
        let Some(next) = &outcome.diagnosis.next_experiment else {
            let not_played = self.menu.clone().not_played();
            let dear = not_played.iter().any(|run| run.why == WhyNot::Cost);
            let (end, text) = if dear {
                (
                    End::Budget,
                    "the rest of the budget does not pay for a run that may add information",
                )
            } else {
                (
                    End::NoExperiment,
                    "no run that this bench can execute adds information",
                )
            };
            return Err(Ended {
                not_played,
                ..Ended::without_runs(end, text)
            });
        };
        if self.steps.len() > MOST_RUNS {
            return Err(Ended::without_runs(End::Budget, most_played()));
        }
        let site = Site::new(self.experiment, &self.loaded.set, &self.model.ocv);
        let planned = site.and_then(|site| site.experiment(&outcome.next_runs));
        match planned {
            Ok((experiment, _)) => Ok((next.clone(), experiment)),
            Err(detail) => Err(Ended {
                not_played: vec![NotPlayed {
                    run: next.name.to_owned(),
                    why: WhyNot::Limit,
                    detail,
                }],
                ..Ended::without_runs(
                    End::NoExperiment,
                    "the run that was asked for cannot be played",
                )
            }),
        }
    }
}

impl Question for Workspace<'_> {
    fn next(&mut self, _: Budget) -> Result<Next, Failure> {
        let outcome = self.outcome.as_ref().ok_or_else(nothing_diagnosed)?;
        Ok(match self.worth(outcome) {
            Ok((next, experiment)) => Next::Play(Box::new(Planned {
                name: next.name.to_owned(),
                description: next.description,
                experiment,
                charge_ah: next.charge_ah,
            })),
            Err(ended) => Next::End(ended),
        })
    }

    /// Joins the measurements of the recommended run, and diagnoses all.
    fn take(&mut self, played: &Played<'_>) -> Result<(), Failure> {
        let outcome = self.outcome.as_ref().ok_or_else(nothing_diagnosed)?;
        let Some(experiment) = outcome.diagnosis.next_experiment.clone() else {
            return Err(nothing_diagnosed());
        };
        let folders = join::Folders {
            first: &self.first,
            later: played.folder,
        };
        join::add(&mut self.loaded, folders, &outcome.next_runs)?;
        let bought = Bought {
            folder: folder_name(played.folder),
            run: FollowUpRun {
                experiment,
                minutes: played.minutes,
            },
        };
        self.diagnose(Some(bought), played.left)
    }
}

/// A run that was bought, and its folder.
struct Bought {
    folder: String,
    run: FollowUpRun,
}

fn step(folder: String, bought: Option<FollowUpRun>, diagnosis: &Diagnosis) -> Step {
    Step {
        folder,
        bought,
        verdict: diagnosis.verdict,
        effects: diagnosis.effects.iter().map(|effect| effect.name).collect(),
        rivals: diagnosis.rivals.iter().map(|rival| rival.name).collect(),
        summary: diagnosis.summary.clone(),
    }
}

/// Returns the ERM of the campaign's sweeps, of the order that the data support, with the curve
/// that the user states.
fn base_model(
    experiment: &Experiment,
    measured: &Measured,
    means: &Means<'_>,
) -> Result<(ModelFile, BaseModel), Failure> {
    let refused = |error: &dyn std::fmt::Display| Failure::Analysis(format!("no model: {error}"));
    let mut sweeps: Vec<Spectrum> = every_sweep(measured).cloned().collect();
    let every: Vec<usize> = (0..sweeps.len()).collect();
    let gated = refused_points(measured, &every, experiment.fit.refused_points);
    leave_out(sweeps.iter_mut().enumerate(), &gated);
    sweeps.retain(|sweep| !sweep.points.is_empty());
    if sweeps.is_empty() {
        return Err(Failure::Refused { count: gated.len() });
    }
    let (seed, bounds) = (experiment.seed, Bounds::for_spectra(&sweeps));
    let rc = match experiment.fit.rc.as_slice() {
        [rc] => *rc,
        orders => {
            let most = orders.iter().copied().max().unwrap_or(MOST_RC);
            let cells = [CellSweeps {
                cell: experiment.cell.name.clone(),
                named: true,
                sweeps: sweeps.clone(),
            }];
            let options = OrderOptions { most, bounds, seed };
            select_order(&cells, &options)
                .map_err(|error| refused(&error))?
                .recommended
        }
    };
    let options = FitOptions {
        rc,
        objective: experiment.fit.objective,
        seed,
        bounds,
    };
    let fit = fit_erm(&sweeps, &options).map_err(|error| refused(&error))?;
    let erm = fit.erm.clone();
    let mut file = ModelFile::new(
        &experiment.cell.name,
        fit,
        sweeps.iter().map(|sweep| sweep.name.clone()).collect(),
        None,
    );
    file.ocv = Some(means.ocv.clone());
    file.refused = gated.into_iter().map(|(_, point)| point).collect();
    let path: PathBuf = means.out.join(MODEL);
    let text = file.to_json().map_err(|error| refused(&error))?;
    analysis::dataset::write_atomically(&path, text.as_bytes()).map_err(|error| refused(&error))?;
    let model = BaseModel {
        name: experiment.cell.name.clone(),
        erm,
        ocv: means.ocv.clone(),
    };
    Ok((file, model))
}
