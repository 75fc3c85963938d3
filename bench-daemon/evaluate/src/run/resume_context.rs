//! Reads the finished part of a run whose process died or was stopped, and checks that the run is
//! unchanged.

use std::{path::Path, sync::Arc};

use analysis::{
    dataset::{RunIndex, TraceEntry},
    run_folder::{self, INDEX},
};
use instruments::clock::{self, TimeMode};

use super::FINISHED;
use bench_core::{
    executor::charge_of,
    journal::replay::{JournalReplay, ResumeDecision},
    journal::{self, ConfigCopy, Entry, Read, Started},
    record::{Event, Recorder},
    safety::failure::Failure,
};
use bench_plan::{
    config::{Copies, Experiment, Source, resolve_experiment},
    plan::{Plan, Purpose, Stage, Step},
    procedure,
    support::hash,
};

/// Greatest difference of the voltage at rest from that before the sweep, V. A sweep moves no net
/// charge, so no relaxation of more than a few millivolts follows it; two voltmeters differ by a
/// few more. A larger difference indicates another state of charge.
const MOVED_V: f64 = 0.02;

/// Changes that a person has checked and accepted, so that a run may continue.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Accepted {
    /// Whether the charge of the cell may differ from the recorded one.
    pub charge: bool,
    /// Whether the instruments may differ from before.
    pub instruments: bool,
}

/// Finished part of a run, and the point where it continues.
pub struct ResumeContext {
    pub(super) read: Read,
    pub(super) replay: JournalReplay,
    pub(super) next: ResumeDecision,
    pub(super) accepted: Accepted,
    /// Reason for an automatic retry, as text; `None` if a person resumes the run.
    after: Option<String>,
}

/// Returns for each stage of a plan the first digits of the hash of its whole content: of
/// everything that is sent, including the shared settings of its steps.
pub(super) fn fingerprints(plan: &Plan) -> Vec<String> {
    plan.stages
        .iter()
        .map(|stage| journal::checksum(&format!("{stage:?}")))
        .collect()
}

impl ResumeContext {
    /// Reads a run folder: the original experiment, and how far it came. Calls `bench` to check
    /// whether the bench may be used, before deciding where to continue.
    ///
    /// # Errors
    /// Fails if the run is finished; if the folder, the configuration or the program has changed;
    /// if `bench` fails; or if a step moved an unknown charge.
    pub fn read(
        folder: &Path,
        accepted: Accepted,
        bench: impl FnOnce(&Experiment) -> Result<(), Failure>,
    ) -> Result<(Experiment, Self), Failure> {
        let read = journal::read(folder).map_err(|error| Failure::Usage(error.to_string()))?;
        let usage = |text: String| Failure::Usage(format!("{}: {text}", folder.display()));
        let replay = JournalReplay::of(&read.lines).map_err(|error| {
            usage(format!(
                "{error}: nothing was done yet, so that it can be run \
            from the beginning in another folder"
            ))
        })?;
        if replay.ended.as_deref() == Some(FINISHED) {
            return Err(usage(
                "expected a run that was interrupted, found one that is finished".to_owned(),
            ));
        }
        let experiment = begun_experiment(folder, &replay.started)?;
        bench(&experiment)?;
        let plan = procedure::plan(&experiment).check(&experiment.cell.limits)?;
        same_plan(&replay.started, plan.plan()).map_err(usage)?;
        let index = std::fs::read_to_string(folder.join(INDEX)).unwrap_or_default();
        let index: RunIndex = serde_json::from_str(&index).unwrap_or_default();
        let recorded = |step: &Step| match step {
            Step::Trace(trace) => index
                .traces
                .iter()
                .any(|known| known.name == trace.name && known.repeat == trace.repeat),
            _ => false,
        };
        // A world in virtual time is repeated from its beginning, so its charge is always known.
        // The charge of a map is counted, so that only a full charge makes an unknown one known.
        let counts = plan
            .plan()
            .stages
            .iter()
            .any(|stage| stage.point().is_some());
        let accept_charge =
            (accepted.charge && !counts) || replay.started.time == TimeMode::Virtual.to_string();
        let next = replay
            .next(plan.plan(), recorded, accept_charge)
            .map_err(|error| usage(error.to_string()))?;
        Ok((
            experiment,
            Self {
                read,
                replay,
                next,
                accepted,
                after: None,
            },
        ))
    }

    /// Marks the run as resumed automatically, with the reason.
    pub(super) fn after(self, text: String) -> Self {
        Self {
            after: Some(text),
            ..self
        }
    }

    /// Returns the bench time at which the run continues, s: in real time as if it had never
    /// stopped, on scaled mocks the time of the last entry.
    pub fn time_s(&self, folder: &Path) -> f64 {
        let real = self.replay.started.time == TimeMode::Real.to_string();
        let passed_s = run_folder::started_unix_s(folder)
            .filter(|_| real)
            .map_or(0.0, |start_s| clock::unix_time_s() - start_s);
        passed_s.max(self.replay.last_s.0)
    }

    /// Checks whether the run has begun anything that may have left a current flowing.
    pub(super) fn has_driven(&self) -> bool {
        self.read
            .lines
            .iter()
            .any(|line| matches!(line.entry, Entry::Intent { live: true, .. }))
    }

    /// Checks whether the run has ever reached every instrument and brought the bench into a safe
    /// state.
    pub(super) fn has_reached_the_bench(&self) -> bool {
        let lines = &self.read.lines;
        self.has_driven() || lines.iter().any(|line| line.entry == Entry::Safe)
    }

    /// Returns the number of finished points.
    pub(super) fn points(&self) -> usize {
        self.replay
            .stages
            .values()
            .map(|stage| stage.points.len())
            .sum()
    }

    /// Returns a warning if the points of the open sweep were measured at another state of charge
    /// than the cell has now.
    pub(super) fn moved(&self, volts: f64) -> Option<String> {
        let (open, _) = self.next.open?;
        let points = &self.replay.stages.get(&open)?.points;
        let first = points.values().next()?;
        if first.point.conditions.is_some() {
            // A sweep under a direct current is repeated as a whole.
            return None;
        }
        let before_v = first.idle.voltage_v?.value();
        if self.next.repeated_reset.is_some() || (volts - before_v).abs() <= MOVED_V {
            return None;
        }
        let at: Vec<String> = points
            .values()
            .map(|done| format!("{:.4}", done.point.phasors.freq_hz))
            .collect();
        Some(format!(
            "stage {}: expected the cell within {MOVED_V} V of the {before_v:.4} V at which this \
            sweep began, found {volts:.4} V: its points at {} Hz \
             belong to another state of charge than those that follow",
            open + 1,
            at.join(", ")
        ))
    }

    /// Checks whether the run began on a simulated bench, or with a correction, of earlier runs.
    pub fn inherited(&self) -> bool {
        self.replay.started.inherited
    }

    /// Returns the charge that traces have left in the cell in the jig since it was brought to a
    /// state of charge or taken into use, C.
    pub(super) fn charge_left_coulomb(
        &self,
        recorder: &Recorder,
        plan: &Plan,
    ) -> Result<f64, Failure> {
        let last = recorder.index().traces.last();
        if let Some((charge_coulomb, time_s)) = self.replay.charge.counted {
            return match last.filter(|last| last.start_time_s >= time_s) {
                None => Ok(charge_coulomb),
                Some(last) => left_by(recorder, last),
            };
        }
        let Some(last) = last else {
            return Ok(0.0);
        };
        let latest = self
            .replay
            .latest
            .and_then(|number| plan.stages.get(number));
        let same_cell = latest
            .and_then(Stage::specimen)
            .is_none_or(|specimen| last.cell.as_deref() == Some(specimen.name.as_str()));
        let resets = |stage: &Stage| matches!(stage.purpose, Purpose::SocReset | Purpose::OcvSoc);
        let began = |number: usize| self.replay.stages.get(&number).map(|replay| replay.began_s);
        let reset = plan
            .stages
            .iter()
            .enumerate()
            .filter(|(_, stage)| resets(stage))
            .filter_map(|(number, _)| Some(began(number)?.value()));
        if !same_cell || reset.fold(f64::NEG_INFINITY, f64::max) > last.start_time_s {
            return Ok(0.0);
        }
        left_by(recorder, last)
    }

    /// Records in the run folder that the run continues, and where.
    pub(super) fn tell(&self, recorder: &mut Recorder, plan: &Plan) -> Result<(), Failure> {
        let purpose = |number: usize| {
            plan.stages
                .get(number)
                .map_or_else(String::new, |stage| stage.purpose.to_string())
        };
        let open = self.next.open.map_or_else(
            || "with the next stage".to_owned(),
            |(stage, step)| {
                format!(
                    "in stage {} ({}) from step {}",
                    stage + 1,
                    purpose(stage),
                    step + 1
                )
            },
        );
        let repeated_reset = self.next.repeated_reset.map_or_else(String::new, |stage| {
            format!(", after stage {} ({}) again", stage + 1, purpose(stage))
        });
        let points = self.points();
        let text =
            format!("the run goes on {open}{repeated_reset}; {points} points were finished before");
        tracing::info!("{text}");
        if let Some(after) = &self.after {
            recorder.warning(after);
        }
        recorder.event(Event::Resumed, &text)?;
        Ok(recorder.journal(Entry::Resumed { text })?)
    }
}

/// Returns the charge of the cell after a trace, C.
fn left_by(recorder: &Recorder, trace: &TraceEntry) -> Result<f64, Failure> {
    let rows = analysis::dataset::read_trace_csv(&recorder.path(&trace.file))
        .map_err(bench_core::record::RecordError::from)?;
    Ok(trace.charge_before_coulomb + charge_of(&rows).value())
}

/// Reads the experiment that a run began with, from the copies in its folder.
///
/// # Errors
/// Fails if the version of the program differs or a copy has changed.
pub fn begun_experiment(folder: &Path, started: &Started) -> Result<Experiment, Failure> {
    let version = env!("CARGO_PKG_VERSION");
    if started.version != version {
        let text = format!(
            "expected a run of version {version} of this program, found one of {}",
            started.version
        );
        return Err(Failure::Usage(format!("{}: {text}", folder.display())));
    }
    copied_experiment(folder, started)
}

/// As [`begun_experiment`], for any version of the program.
pub(super) fn copied_experiment(folder: &Path, started: &Started) -> Result<Experiment, Failure> {
    let usage = |path: &Path, text: String| Failure::Usage(format!("{}: {text}", path.display()));
    let mut copies = Copies::new();
    for ConfigCopy { path, copy, sha256 } in &started.files {
        let file = folder.join(copy);
        let text = std::fs::read_to_string(&file).map_err(|error| {
            usage(
                &file,
                format!("expected the copy of {}: {error}", path.display()),
            )
        })?;
        let found = hash::sha256(&text);
        if found != *sha256 {
            return Err(usage(
                &file,
                format!(
                    "expected the file that the run began with (SHA-256 {sha256}), found another \
                    one ({found})"
                ),
            ));
        }
        copies.insert(path.clone(), text);
    }
    let copies = Arc::new(copies);
    let [first, bench, ..] = started.files.as_slice() else {
        return Err(usage(
            folder,
            "expected the copies of an experiment and a bench".to_owned(),
        ));
    };
    let mut experiment =
        resolve_experiment(Source::copy(&first.path, &copies)?, Some(&bench.path))?;
    experiment.seed = started.seed;
    Ok(experiment)
}

/// Checks that the plan is the same as at the beginning: another configuration gives another plan,
/// and another build of the program may.
fn same_plan(started: &Started, plan: &Plan) -> Result<(), String> {
    let found = fingerprints(plan);
    if let Some(number) = (0..found.len().max(started.plan.len()))
        .find(|number| found.get(*number) != started.plan.get(*number))
    {
        let what = plan
            .stages
            .get(number)
            .map_or_else(|| "none".to_owned(), |stage| stage.purpose.to_string());
        return Err(format!(
            "expected the plan that the run began with; stage {} ({what}) would be another one: the \
            configuration or the program has changed since; go on with the program that began it, \
            or begin the run anew in another folder",
            number + 1
        ));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use bench_plan::{
        config::{Eis, load_experiment},
        measure::quality::Quality,
    };
    use instruments::units::{Coulombs, Hertz, Seconds};

    const QUALITY: Quality = Quality {
        noise: 0.01,
        distortion: 0.01,
        drift: 0.01,
        repeatability: 0.01,
        kramers_kronig: 0.01,
        again: 0,
        time_s: Seconds(0.0),
        charge_coulomb: Coulombs(0.0),
    };

    #[test]
    fn a_stage_has_another_fingerprint_where_its_sweep_sends_something_else() {
        let file =
            Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs/experiments/campaign.toml");
        let of = |change: fn(&mut Eis)| {
            let mut experiment = load_experiment(&file, None).unwrap();
            change(experiment.eis.as_mut().unwrap());
            let plan = procedure::plan(&experiment);
            (fingerprints(&plan), plan)
        };
        let (before, plan) = of(|_| {});
        assert_eq!(before, of(|_| {}).0, "the same experiment");
        let changes: [fn(&mut Eis); 6] = [
            |eis| eis.record_points += 1,
            |eis| eis.memory_points *= 10,
            |eis| eis.periods_on_screen += 1.0,
            |eis| eis.mains_hz = Some(Hertz(60.0)),
            |eis| eis.overlap = Some(!eis.overlap.unwrap_or_default()),
            |eis| eis.quality = Some(QUALITY),
        ];
        for (number, change) in changes.into_iter().enumerate() {
            let (after, _) = of(change);
            for (stage, (before, after)) in plan.stages.iter().zip(before.iter().zip(&after)) {
                let sweeps = matches!(stage.purpose, Purpose::Sweep(..));
                assert_eq!(
                    before != after,
                    sweeps,
                    "change {number}: {}",
                    stage.title()
                );
            }
        }
    }
}
