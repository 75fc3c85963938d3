//! Executes one run from its first connection to its last file: guardian, instruments, plan, safe
//! state, results.

mod begun;
mod identities;

use std::collections::BTreeMap;

use analysis::run_folder::FAULTS;
use instruments::transport::MemoryHub;

use super::{
    FINISHED, Finished, Measured, ResumeContext,
    drive::{self, PriorResults, RunEnvironment},
    results,
    stop::{StopSignals, caught},
};
use crate::doctor;
pub(super) use begun::Run;
use bench_core::{
    bench::{BathOrder, Bench, Connections, Identified, state_readback},
    executor::ExecuteError,
    journal::Entry,
    operator::progress::Progress,
    record::Event,
    safety::{bench_lease::BenchLease, failure::Failure},
    sim::Simulation,
    watch::{Pace, Watch, unwatched},
};
use bench_plan::{
    interlock::NO_CURRENT_A,
    support::{quoted::quoted, terminal::remark},
};

/// Returns an error if an instrument that can move charge is switched on: another program may be
/// using the bench, and nothing was changed yet.
pub async fn ensure_outputs_off(bench: &mut Bench) -> Result<(), Failure> {
    let found = state_readback::look(bench).await?;
    // A bipolar supply without an output switch is at zero while its generator is off.
    let commanded = found
        .iter()
        .any(|found| found.role == "generator" && !found.off);
    let driven = found.iter().find(|found| {
        let on = match found.role.as_str() {
            // A bath moves no charge.
            "generator" | "chiller" => false,
            "supply4q" => !found.off && commanded,
            _ => !found.off,
        };
        on || found.amps.is_some_and(|amps| amps.abs() > NO_CURRENT_A)
    });
    match driven {
        None => Ok(()),
        Some(found) => Err(Failure::Usage(format!(
            "expected every output off at the beginning, {found}: if no other program uses this \
            bench, `eis-bench safe` switches it off"
        ))),
    }
}

impl Run<'_> {
    /// Executes the plan; the bench is in a safe state when this returns.
    ///
    /// # Errors
    /// Any failure that ended the run early.
    pub(super) async fn go(mut self) -> Result<Finished, Failure> {
        match &self.context {
            None => self.begin()?,
            Some(context) => context.tell(&mut self.recorder, self.plan.plan())?,
        }
        let hub = MemoryHub::new();
        let simulation = self.before.0.take();
        if let Some(simulation) = &simulation {
            simulation.serve_in_process(&self.experiment.bench, &self.clock, &hub)?;
        }
        let mut taps = BTreeMap::new();
        for (role, _) in self.experiment.bench.instruments.addressed() {
            taps.insert(role, self.recorder.tap(role)?);
        }
        let mut stop = StopSignals::install()?;
        let connections = Connections {
            clock: self.clock.clone(),
            hub,
            taps,
        };
        if self.experiment.bench.instruments.logger.is_none() {
            self.recorder
                .warning("nothing watches the cell's temperature: the bench has no logger");
        }
        if self.experiment.bench.wiring.analog.is_some() {
            self.recorder.warning(
                "the bipolar supply (analog) is not switched by this program: switch it off at its \
                panel when the run has ended",
            );
        }
        self.experiment
            .cell
            .wide
            .iter()
            .for_each(|text| self.recorder.warning(text));
        let progress = Progress::new(self.plan.plan());
        let watch_clock = self.clock.apart();
        let before_watch = watch_clock.wait(None);
        let mut lease = tokio::select! {
            taken = BenchLease::take(
                self.experiment,
                self.recorder.folder(),
                [&self.clock, &watch_clock],
                progress.doing(),
            ) => taken?,
            () = stop.requested() => return Err(Failure::Interrupted(self.recorder.folder().display().to_string())),
        };
        let pace = Pace::of(self.experiment);
        let mut bench = match Bench::open(&self.experiment.bench, &connections).await {
            Ok(bench) => bench,
            Err(error) => return lease.end(Err(error.into()), None).await,
        };
        // Only outputs that this run may have left on may be switched off here; otherwise the
        // watch begins after it is verified that no other program drives the bench.
        let has_driven = self.context.as_ref().is_some_and(ResumeContext::has_driven);
        let mut watch = match has_driven.then(|| Watch::start(&bench, pace, &watch_clock)) {
            Some(Ok(watch)) => watch,
            Some(Err(error)) => return lease.end(Err(error.into()), None).await,
            None => None,
        };
        let opened = tokio::select! {
            opened = self.check_bench(&mut bench) => opened,
            alarm = Watch::alarm_of(watch.as_mut()) => Err(ExecuteError::from(alarm).into()),
        };
        let identities = match opened {
            Ok(identities) => identities,
            Err(failure) => {
                let alarm = match watch {
                    Some(watch) => watch.end(&mut bench).await.0,
                    None => None,
                };
                let failure = alarm.map_or(failure, |alarm| ExecuteError::from(alarm).into());
                return lease.end(Err(failure), None).await;
            }
        };
        if !has_driven {
            watch = match Watch::start(&bench, pace, &watch_clock) {
                Ok(watch) => watch,
                Err(error) => return lease.end(Err(error.into()), None).await,
            };
        }
        drop(before_watch);
        for line in unwatched(&self.experiment.bench) {
            if watch.is_some() {
                self.recorder.warning(&line);
            }
        }
        let environment = RunEnvironment {
            clock: &self.clock,
            operator: &self.operator,
            progress: &progress,
            watch: watch.as_ref().map(Watch::link),
        };
        let before = PriorResults {
            inherited: self.before.1.take(),
            context: self.context.as_ref(),
        };
        let outcome = tokio::select! {
            outcome = caught(
                drive::drive(&mut bench, &mut self.recorder, self.experiment, self.plan, environment, before)
            ) => outcome,
            () = stop.requested() => Err(Failure::Interrupted(self.recorder.folder().display().to_string())),
            lost = lease.lost() => Err(lost.into()),
            alarm = Watch::alarm_of(watch.as_mut()) => Err(ExecuteError::from(alarm).into()),
        };
        progress.finish();
        let _after_watch = watch_clock.wait(None);
        let outcome = match watch {
            Some(watch) => self.end_watch(watch, &mut bench, outcome).await,
            None => outcome,
        };
        let hot = (outcome.as_ref().err())
            .filter(|failure| failure.is_of_temperature())
            .map(ToString::to_string);
        let outcome = match caught(async { Ok(bench.made_safe().await) }).await {
            Ok(safe) => Failure::unsafe_first(safe, outcome),
            Err(panic) => Err(Failure::Unsafe {
                failures: format!("what the outputs do is not known: {panic}"),
                cause: String::new(),
            }),
        };
        let outcome = match outcome {
            Err(failure) => Err(self.settle_bath(&mut bench, failure, hot).await),
            finished => finished,
        };
        // Outputs that could not be switched off are left to the guardian, which needs exclusive
        // access to the instruments.
        let read = bench.close();
        let outcome = lease.end(outcome, read).await;
        self.conclude(outcome, &identities, &connections, simulation)
    }

    /// Ends the watch, and records its statistics. Its alarm takes precedence over the error that
    /// the procedure received when the watch took over its connections.
    async fn end_watch(
        &mut self,
        watch: Watch,
        bench: &mut Bench,
        outcome: Result<Measured, Failure>,
    ) -> Result<Measured, Failure> {
        // The procedure waits for the watch, whose own clock shows that it makes progress.
        let waits = self.clock.wait(None);
        let (alarm, log) = watch.end(bench).await;
        drop(waits);
        for line in log.lines() {
            tracing::info!("{line}");
            // The reason for the end outweighs an event that cannot be written.
            let _ = self.recorder.event(Event::Bench, &line);
        }
        for remark in &log.remarks {
            self.recorder.warning(remark);
        }
        match alarm {
            Some(alarm) => Err(ExecuteError::from(alarm).into()),
            None => outcome,
        }
    }

    /// Stops a bath that must not continue after a run that ended early: one that is not under
    /// control, and any bath if a temperature ended the run. A cell without current cools without
    /// a bath. A bath that must stop and does not is reported before the reason for the end.
    async fn settle_bath(
        &mut self,
        bench: &mut Bench,
        failure: Failure,
        hot: Option<String>,
    ) -> Failure {
        let limits = &self.experiment.cell.limits;
        let must_stop = hot.is_some();
        let order = BathOrder {
            cell_degc: Some((limits.min_degc, limits.max_degc)),
            stop: hot,
        };
        let settled = caught(async { Ok(bench.stop_stray_bath(&order).await) }).await;
        let Ok(Some(bath)) = settled else {
            return failure;
        };
        remark!("eis-bench: {bath}");
        self.recorder.warning(&bath.words);
        if !(bath.astray && must_stop) || matches!(failure, Failure::Unsafe { .. }) {
            return failure;
        }
        Failure::Unsafe {
            failures: bath.words,
            cause: format!(" (after: {failure})"),
        }
    }

    /// Records how the run ended, and computes results from the measurements.
    fn conclude(
        mut self,
        outcome: Result<Measured, Failure>,
        identities: &[Identified],
        connections: &Connections,
        simulation: Option<Simulation>,
    ) -> Result<Finished, Failure> {
        for (role, tap) in &connections.taps {
            if let Some(error) = tap.take_error() {
                self.recorder
                    .warning(&format!("the transcript of {role} is incomplete: {error}"));
            }
        }
        let happened = simulation
            .as_ref()
            .map(Simulation::happened)
            .unwrap_or_default();
        if !happened.is_empty() {
            self.recorder.warning(&format!(
                "{} faults were played on the simulated instruments: {FAULTS}",
                happened.len()
            ));
            self.recorder.json(FAULTS, &happened)?;
        }
        let readings = self.recorder.finish_readings();
        match outcome {
            Ok(measured) => {
                self.recorder.journal(Entry::Safe)?;
                let summary = readings
                    .map_err(Failure::from)
                    .and_then(|()| results::write(&mut self.recorder, self.experiment, &measured));
                let summary = match summary {
                    Ok(summary) => summary,
                    Err(failure) => {
                        self.ended_early(identities, "measured, but not evaluated", &failure);
                        return Err(failure);
                    }
                };
                self.manifest(identities, "finished")?;
                self.recorder.journal(Entry::Ended {
                    how: FINISHED.to_owned(),
                })?;
                Ok(Finished {
                    measured,
                    summary,
                    simulation,
                })
            }
            Err(failure) => {
                self.ended_early(identities, "ended early", &failure);
                Err(failure)
            }
        }
    }

    /// Checks that the instruments are the configured ones, without changing them.
    async fn check_bench(&mut self, bench: &mut Bench) -> Result<Vec<Identified>, Failure> {
        let identities = bench.identify_strictly().await?;
        self.check_instruments(&identities)?;
        self.doctored(&identities)?;
        self.manifest(&identities, "running")?;
        // Only outputs that this run may have left on may be switched off here.
        if !self.context.as_ref().is_some_and(ResumeContext::has_driven) {
            ensure_outputs_off(bench).await?;
        }
        if self.context.is_some() {
            self.read_back_outputs(bench).await?;
        }
        Ok(identities)
    }

    /// Adds a remark if no report of the doctor is valid for the bench, or returns an error if the
    /// bench file requires one.
    fn doctored(&mut self, identities: &[Identified]) -> Result<(), Failure> {
        let config = &self.experiment.bench;
        let source = self
            .experiment
            .sources
            .iter()
            .find(|source| source.path() == config.path);
        let Some(why) = doctor::standing(
            config,
            source.map_or("", |source| source.text()),
            identities,
        ) else {
            return Ok(());
        };
        let what = format!(
            "{why}; `eis-bench doctor {}` looks at it",
            quoted(&config.path)
        );
        if config.doctor.required {
            return Err(Failure::Usage(format!(
                "the bench file requires a report of the doctor: {what}"
            )));
        }
        self.recorder.warning(&what);
        Ok(())
    }

    /// Records how the run ended early. The reason for the end outweighs a manifest that cannot be
    /// written.
    fn ended_early(&mut self, identities: &[Identified], how: &str, failure: &Failure) {
        tracing::info!("{how}: {failure}");
        let recorded = self.manifest(identities, &format!("{how}: {failure}"));
        let recorded = recorded.and(
            self.recorder
                .journal(Entry::Ended {
                    how: format!("{how}: {failure}"),
                })
                .map_err(Failure::from),
        );
        if let Err(error) = recorded {
            tracing::error!("{error}");
        }
    }
}

impl Run<'_> {
    /// Records the state in which the instruments are found, before any command changes it.
    pub(super) async fn read_back_outputs(&mut self, bench: &mut Bench) -> Result<(), Failure> {
        let found = state_readback::look(bench).await?;
        for found in &found {
            self.recorder.event(Event::Bench, &found.to_string())?;
            self.recorder.journal(Entry::Found(found.clone()))?;
        }
        // The sense leads of the load are connected to the cell itself; a current would change the
        // voltage.
        let volts = found
            .iter()
            .find(|found| found.role == "load")
            .and_then(|found| found.volts);
        let quiet = found
            .iter()
            .filter(|found| found.moves_charge())
            .all(|found| found.off);
        let Some((context, volts)) = self.context.as_ref().zip(volts).filter(|_| quiet) else {
            return Ok(());
        };
        let Some(text) = context.moved(volts.0) else {
            return Ok(());
        };
        if !context.accepted.charge {
            let help = "bring the cell to its state by hand, or go on with --accept-charge, which \
            flags these points";
            return Err(Failure::Usage(format!(
                "{}: {text}; {help}",
                self.recorder.folder().display()
            )));
        }
        self.recorder.warning(&text);
        Ok(())
    }
}
