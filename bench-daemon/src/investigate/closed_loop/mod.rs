//! Closed loop of `eis-bench investigate`: a campaign, a model fitted to its sweeps, and a
//! diagnosis. The recommended run follows on the same bench, and a diagnosis of all data so far. It
//! ends when no question is open or the budget is spent.
//!
//! Not here: what a run is (`command::run`), what a diagnosis is (`analysis::diagnosis`). A
//! simulated world is one and the same over all runs: its time, its charge, its wear and its noise
//! go on; the diagnosis sees its files alone.

mod follow_up;
mod investigation;
mod join;
mod page;

use std::{
    path::{Path, PathBuf},
    sync::{Arc, Mutex},
};

use analysis::{
    diagnosis::{
        self, BaseModel, BenchLimits, Diagnosis, DiagnosisOptions, NextExperiment, Outcome,
        PlannedRun, Playable, Verdict, gate,
    },
    fit::{Bounds, CellSweeps, FitOptions, ModelFile, OrderOptions, fit_erm, select_order},
    ocv::OcvCurve,
    run_folder::MODEL,
    spectrum::Spectrum,
};
use follow_up::Site;

use crate::{
    config::Experiment,
    investigate::dataset::{Loaded, read_dataset, write_dataset},
    run::{
        Measured, Session,
        results::{every_sweep, leave_out, refused_points},
    },
    safety::failure::Failure,
};
pub use investigation::{Budget, End, FollowUpRun, Investigation, Step};

/// Name of the schema of `investigation.json`.
const SCHEMA: &str = "eis-bench/investigation";
/// Runs that a diagnosis may ask for, at most.
const MOST_RUNS: usize = 6;
/// Times that the same run may be asked for.
const MOST_AGAIN: usize = 2;
/// Highest order that is tried where the experiment states none.
const MOST_RC: usize = 6;
/// Part of a limit that planned currents use: what is driven scatters around what is commanded.
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

/// Plays an investigation and writes `investigation.json`, `investigation.md`, `model.json`, the
/// joined data set, and a run folder per step.
///
/// # Errors
/// A run that ended early, a model that cannot be fitted, a folder that cannot be written.
pub fn investigate(experiment: &Experiment, means: &Means<'_>) -> Result<Investigation, Failure> {
    let mut session = Session::new(&experiment.bench)?;
    let first = means.out.join("campaign");
    let measured = session.run(experiment, &first)?.measured;
    let model = base_model(experiment, &measured, means)?;
    let mut workspace = Workspace {
        experiment,
        means,
        session,
        model,
        loaded: read_dataset(&first)?,
        spent: Budget {
            minutes: 0.0,
            charge_ah: 0.0,
        },
        refused: measured.refused(),
    };
    let (mut outcome, mut menu) = workspace.diagnose(&[])?;
    let mut steps = vec![step(&first, None, &outcome.diagnosis)];
    let (end, end_text) = loop {
        let (next, experiment) = match workspace.next(&outcome, &menu, &steps) {
            Ok(next) => next,
            Err(end) => break end,
        };
        let folder = means.out.join(format!("{}_{}", steps.len(), next.name));
        let minutes = workspace.buy(&experiment, &next, &outcome.next_runs, &folder)?;
        (outcome, menu) = workspace.diagnose(
            &steps
                .iter()
                .filter_map(Step::bought)
                .chain([next.name])
                .collect::<Vec<_>>(),
        )?;
        steps.push(step(
            &folder,
            Some(FollowUpRun {
                experiment: next,
                minutes,
            }),
            &outcome.diagnosis,
        ));
    };
    write_dataset(&means.out.join("dataset"), &workspace.loaded.set)
        .map_err(|error| Failure::Analysis(error.to_string()))?;
    let investigation = Investigation {
        schema: SCHEMA,
        name: experiment.name.clone(),
        budget: means.budget,
        spent: workspace.spent,
        steps,
        end,
        end_text,
        refused_points: workspace.refused,
        diagnosis: outcome.diagnosis,
    };
    page::write(means.out, &investigation)?;
    Ok(investigation)
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
    /// Names of those that can be played.
    allowed: Vec<String>,
    /// Name, how it would let the investigation end, and why it cannot be played.
    refused: Vec<(String, End, String)>,
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

    /// Refuses what was bought often enough, what bench or cell cannot do, and what the budget does
    /// not pay.
    fn playable(&self, bought: &[&'static str], menu: Arc<Mutex<MenuOutcome>>) -> Playable {
        let (site, bought) = (
            Site::new(self.experiment, &self.loaded.set, &self.model.ocv),
            bought.to_vec(),
        );
        let (minutes_left, ah_left) = (
            self.means.budget.minutes - self.spent.minutes,
            self.means.budget.charge_ah - self.spent.charge_ah,
        );
        Arc::new(move |name, runs| {
            let charge_ah: f64 = runs.iter().map(PlannedRun::charge_ah).sum();
            let found = match site
                .as_ref()
                .map_err(String::clone)
                .and_then(|site| site.experiment(runs))
            {
                _ if bought.iter().filter(|played| **played == name).count() >= MOST_AGAIN => {
                    Err((End::NoExperiment, "was played already".to_owned()))
                }
                Err(reason) => Err((End::NoExperiment, reason)),
                Ok((_, minutes)) if minutes > minutes_left || charge_ah > ah_left => {
                    let left = format!(
                        "takes {minutes:.0} min and {charge_ah:.2} Ah; left are {minutes_left:.0} \
                        min and {ah_left:.2} Ah"
                    );
                    Err((End::Budget, left))
                }
                Ok(_) => Ok(()),
            };
            let allowed = found.is_ok();
            if let Ok(mut menu) = menu.lock() {
                match found {
                    Ok(()) => menu.allowed.push(name.to_owned()),
                    Err((end, reason)) => menu.refused.push((name.to_owned(), end, reason)),
                }
            }
            allowed
        })
    }

    /// The experiment that is worth its price, or why the investigation ends.
    fn next(
        &self,
        outcome: &Outcome,
        menu: &MenuOutcome,
        steps: &[Step],
    ) -> Result<(NextExperiment, Experiment), (End, String)> {
        let diagnosis = &outcome.diagnosis;
        match diagnosis.verdict {
            Verdict::Explained => {
                return Err((End::Explained, "what was missing has a name".to_owned()));
            }
            Verdict::AtNoiseFloor => {
                return Err((
                    End::AtNoiseFloor,
                    "nothing is missing that these repeats could show".to_owned(),
                ));
            }
            Verdict::Invalid => return Err((End::Invalid, "the data cannot be used".to_owned())),
            Verdict::Ambiguous | Verdict::Unexplained => {}
        }
        let Some(next) = diagnosis
            .next_experiment
            .as_ref()
            .filter(|_| steps.len() <= MOST_RUNS)
        else {
            let refused = || {
                menu.refused
                    .iter()
                    .filter(|(name, ..)| !menu.allowed.contains(name))
            };
            let budget =
                refused().any(|(_, end, _)| *end == End::Budget) || steps.len() > MOST_RUNS;
            let reasons: Vec<String> = refused()
                .map(|(name, _, reason)| format!("{name}: {reason}"))
                .collect();
            let without = if reasons.is_empty() {
                String::new()
            } else {
                format!("; not asked for: {}", reasons.join("; "))
            };
            let text = format!("no run that can be played would tell more{without}");
            return Err((
                if budget {
                    End::Budget
                } else {
                    End::NoExperiment
                },
                text,
            ));
        };
        let site = Site::new(self.experiment, &self.loaded.set, &self.model.ocv);
        let planned = site.and_then(|site| site.experiment(&outcome.next_runs));
        planned
            .map(|(experiment, _)| (next.clone(), experiment))
            .map_err(|reason| (End::NoExperiment, reason))
    }

    /// Plays an experiment and joins what it measured; returns the minutes that it took.
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
        self.spent.minutes += minutes;
        self.spent.charge_ah += next.charge_ah;
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

/// The ERM of the campaign's sweeps, of the order that they bear, with the curve that the user
/// states.
fn base_model(
    experiment: &Experiment,
    measured: &Measured,
    means: &Means<'_>,
) -> Result<BaseModel, Failure> {
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
    Ok(BaseModel {
        name: experiment.cell.name.clone(),
        erm,
        ocv: means.ocv.clone(),
    })
}
