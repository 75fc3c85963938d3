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
mod page;
mod rule;

use std::{
    path::{Path, PathBuf},
    sync::{Arc, Mutex},
};

use analysis::{
    diagnosis::{
        self, BaseModel, BenchLimits, Diagnosis, DiagnosisOptions, NextExperiment, Outcome,
        PlannedRun, Playable, gate,
    },
    fit::{Bounds, CellSweeps, FitOptions, ModelFile, OrderOptions, fit_erm, select_order},
    ocv::OcvCurve,
    run_folder::MODEL,
    spectrum::Spectrum,
};
use follow_up::Site;

use crate::{
    files::write_augmented,
    investigate::dataset::{Loaded, read_dataset, write_dataset},
    run::{
        Measured, Session,
        results::{every_sweep, leave_out, refused_points},
    },
};
use bench_core::safety::failure::Failure;
use bench_plan::config::Experiment;
pub use investigation::{FollowUpRun, Investigation, NotPlayed, Step, WhyNot};
pub use join::{Later, add_played};
pub use page::not_played_text;
pub use rule::{Budget, End, MOST_AGAIN, MOST_RUNS, most_played, settled, verdict_named};

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

/// Runs an investigation and writes `investigation.json`, `.md` and `.html` with their pictures,
/// `model.json`, `model_augmented.json` if something was added, the joined data set, and a run
/// folder per step. A later run that ended early ends the investigation, which is written
/// nevertheless.
///
/// # Errors
/// A campaign that ended early, a model that cannot be fitted, a folder that cannot be written.
pub fn investigate(experiment: &Experiment, means: &Means<'_>) -> Result<Investigation, Failure> {
    let mut session = Session::new(&experiment.bench)?;
    let first = means.out.join("campaign");
    let measured = session.run(experiment, &first)?.measured;
    let (file, model) = base_model(experiment, &measured, means)?;
    let mut workspace = Workspace {
        experiment,
        means,
        session,
        model,
        loaded: read_dataset(&first)?,
        spent: Budget::default(),
        refused: measured.refused(),
    };
    let (mut outcome, mut menu) = workspace.diagnose(&[])?;
    let mut steps = vec![step(&first, None, &outcome.diagnosis)];
    let mut failure = None;
    let ended = loop {
        let (next, experiment) = match workspace.next(&outcome, menu, &steps) {
            Ok(next) => next,
            Err(ended) => break ended,
        };
        let folder = means.out.join(format!("{}_{}", steps.len(), next.name));
        let minutes = match workspace.buy(&experiment, &next, &outcome.next_runs, &folder) {
            Ok(minutes) => minutes,
            Err(error) => {
                let text = format!("a run ended early: {}: {error}", next.description);
                failure = Some(error);
                break Ended::without_runs(End::Stopped, text);
            }
        };
        let bought = steps.iter().filter_map(Step::bought).chain([next.name]);
        (outcome, menu) = workspace.diagnose(&bought.collect::<Vec<_>>())?;
        let run = FollowUpRun {
            experiment: next,
            minutes,
        };
        steps.push(step(&folder, Some(run), &outcome.diagnosis));
    };
    write_dataset(&means.out.join("dataset"), &workspace.loaded.set)
        .map_err(|error| Failure::Analysis(error.to_string()))?;
    let refused = &workspace.loaded.refused;
    write_augmented(means.out, &file.into(), &outcome, refused)?;
    let investigation = Investigation {
        schema: SCHEMA,
        name: experiment.name.clone(),
        budget: means.budget,
        spent: workspace.spent,
        steps,
        end: ended.end,
        end_text: ended.text,
        not_played: ended.not_played,
        refused_points: workspace.refused,
        diagnosis: outcome.diagnosis,
        failure,
    };
    page::write(means.out, &investigation, &outcome.curves)?;
    Ok(investigation)
}

/// End of an investigation.
struct Ended {
    end: End,
    text: String,
    not_played: Vec<NotPlayed>,
}

impl Ended {
    fn without_runs(end: End, text: impl Into<String>) -> Self {
        Self {
            end,
            text: text.into(),
            not_played: Vec::new(),
        }
    }
}

struct Workspace<'a> {
    experiment: &'a Experiment,
    means: &'a Means<'a>,
    session: Session,
    model: BaseModel,
    loaded: Loaded,
    spent: Budget,
    /// Points that the quality gate has refused so far.
    refused: usize,
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
    /// The diagnosis of everything measured so far, and what became of the runs of the menu.
    fn diagnose(&self, bought: &[&'static str]) -> Result<(Outcome, MenuOutcome), Failure> {
        let limits = &self.experiment.cell.limits;
        let part = |limit_a: f64| LIMIT_PART * limit_a.min(BENCH_A);
        let limits = BenchLimits {
            discharge_a: part(limits.discharge_a),
            charge_a: part(limits.charge_a),
            highest_hz: HIGHEST_HZ,
            shunt_ohm: Some(self.experiment.bench.wiring.shunt.r_ohm),
        };
        let menu = Arc::new(Mutex::new(MenuOutcome::default()));
        let options = DiagnosisOptions {
            limits: Some(limits),
            playable: Some(self.playable(bought, menu.clone())),
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
    fn playable(&self, bought: &[&'static str], menu: Arc<Mutex<MenuOutcome>>) -> Playable {
        let (site, bought) = (
            Site::new(self.experiment, &self.loaded.set, &self.model.ocv),
            bought.to_vec(),
        );
        let left = self.means.budget.less(self.spent);
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
    fn next(
        &self,
        outcome: &Outcome,
        menu: MenuOutcome,
        steps: &[Step],
    ) -> Result<(NextExperiment, Experiment), Ended> {
        match settled(outcome.diagnosis.verdict) {
            Some((end, text)) => Err(Ended::without_runs(end, text)),
            None => self.next_open(outcome, menu, steps),
        }
    }

    /// As [`Self::next`], while a question is open.
    fn next_open(
        &self,
        outcome: &Outcome,
        menu: MenuOutcome,
        steps: &[Step],
    ) -> Result<(NextExperiment, Experiment), Ended> {
        let Some(next) = &outcome.diagnosis.next_experiment else {
            let not_played = menu.not_played();
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
        if steps.len() > MOST_RUNS {
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

    /// Runs an experiment and joins its measurements; returns the minutes that it took.
    fn buy(
        &mut self,
        experiment: &Experiment,
        next: &NextExperiment,
        runs: &[PlannedRun],
        folder: &Path,
    ) -> Result<f64, Failure> {
        let start_s = self.session.now_s();
        self.refused += self.session.run(experiment, folder)?.measured.refused();
        let minutes = (self.session.now_s() - start_s) / 60.0;
        self.spent = self.spent.plus(Budget {
            minutes,
            charge_ah: next.charge_ah,
        });
        join::add(
            &mut self.loaded,
            join::Folders {
                first: &self.means.out.join("campaign"),
                later: folder,
            },
            runs,
        )?;
        Ok(minutes)
    }
}

fn step(folder: &Path, bought: Option<FollowUpRun>, diagnosis: &Diagnosis) -> Step {
    Step {
        folder: folder
            .file_name()
            .map_or_else(String::new, |name| name.to_string_lossy().into_owned()),
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
