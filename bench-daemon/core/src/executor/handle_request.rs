//! Handles run control requests between two points of a running run: to pause without any current,
//! or to stop.

use instruments::{
    clock::TimeMode,
    fixture::Fixture,
    units::{Amps, Seconds},
};

use super::{ExecuteError, Executor, Rig};
use crate::{
    clock::TypedClock,
    journal::Entry,
    operator::run_control::{RunAction, RunControl},
    record::Event,
};
use bench_plan::plan::{Purpose, Stage, Step};

/// Seconds between two checks while the run waits, on request or for a person.
pub(super) const PAUSE_POLL_S: Seconds = Seconds(5.0);

impl Rig<'_> {
    /// Ends the run on request within a step of which only the end is kept. Checks for requests a
    /// few times per minute.
    pub(super) fn handle_request_within_step(&mut self) -> Result<(), ExecuteError> {
        let now_s = self.clock.now();
        if !self.watching.requests.ends_early
            || self.clock.mode() == TimeMode::Virtual
            || now_s - self.watching.requests.looked_s < PAUSE_POLL_S
        {
            return Ok(());
        }
        self.watching.requests.looked_s = now_s;
        // A pause starts at the end of the step.
        self.paused(false).map(|_| ())
    }

    /// Ends the run on request before a point is measured again; a pause starts at the end of the
    /// step.
    pub(super) fn handle_abort(&self) -> Result<(), ExecuteError> {
        if self.clock.mode() == TimeMode::Virtual {
            Ok(())
        } else {
            self.paused(false).map(|_| ())
        }
    }

    /// Checks whether to pause; `waits` is the answer if the request cannot be read.
    fn paused(&self, waits: bool) -> Result<bool, ExecuteError> {
        match RunControl::read_if_present(self.recorder.folder()).map(|request| request.action) {
            None => Ok(waits),
            Some(RunAction::GoOn) => Ok(false),
            Some(RunAction::Pause) => Ok(true),
            Some(RunAction::Abort) => Err(ExecuteError::Aborted),
        }
    }
}

impl Executor<'_> {
    /// Pauses as long as requested, with every output off. Outputs that were on before are
    /// switched on again afterwards.
    pub(super) async fn handle_request(
        &mut self,
        stage: &Stage,
        step: usize,
        fixture: Fixture,
    ) -> Result<(), ExecuteError> {
        self.rig.watching.requests.ends_early = stage.steps.get(step).is_some_and(Step::ends_early);
        if self.rig.clock.mode() == TimeMode::Virtual || !self.rig.paused(false)? {
            return Ok(());
        }
        let since_s = self.rig.clock.now();
        self.wait_without_current(fixture).await?;
        if step > 0 && matches!(stage.purpose, Purpose::OcvSoc) {
            let text = format!(
                "paused for {:.0} s between two legs: the curve has a rest there",
                (self.rig.clock.now() - since_s).0
            );
            self.rig.recorder.warning(&self.of_run(&text));
        }
        let before = stage.steps.get(..step).unwrap_or_default();
        let power = before
            .iter()
            .rev()
            .find(|step| matches!(step, Step::PowerUp { .. } | Step::PowerDown));
        if let Some(power @ Step::PowerUp { .. }) = power {
            self.rig.begin(fixture, power);
            let idle = self.known.idle;
            self.power(fixture, power).await?;
            self.begin_count().await?;
            if stage.bias_a() != Amps::ZERO {
                // The charge so far counts from the rest before the sweep.
                self.known.idle = idle;
                self.resume_bias(before).await?;
            }
        }
        Ok(())
    }

    async fn wait_without_current(&mut self, fixture: Fixture) -> Result<(), ExecuteError> {
        // After a pause, record the step and send the scope's settings again: a person may have
        // used its panel.
        self.sweep.fall_back();
        self.scope.armed = None;
        self.scope.forget_verticals();
        if let Some(scope) = self.rig.bench.instruments.scope.as_mut() {
            scope.forget_settings();
        }
        self.rig
            .bench
            .made_safe()
            .await
            .map_err(crate::bench::BenchError::from)?;
        self.rig.driving.bias.cut(self.rig.clock.now());
        self.end_count()?;
        self.rig.recorder.journal(Entry::Safe)?;
        self.rig.recorder.journal(Entry::Paused)?;
        let outputs = if self.rig.setup.wiring.analog.is_some() {
            "the generator commands zero, and the program does not switch the bipolar supply"
        } else {
            "every output is off"
        };
        let text = format!("paused on request: {outputs}");
        self.rig.recorder.event(Event::Request, &text)?;
        self.person.progress.say(&format!(
            "{text}; `eis-bench go-on` with the run folder lets it go on"
        ));
        self.rig.begin(
            fixture,
            &Step::Pause {
                span_s: Seconds::ZERO,
            },
        );
        while self.rig.paused(true)? {
            self.rig.clock.sleep_for(PAUSE_POLL_S).await;
            self.rig.watch_idle("paused", fixture).await?;
        }
        self.rig.recorder.journal(Entry::GoneOn)?;
        self.person.progress.say("goes on on request");
        Ok(self
            .rig
            .recorder
            .event(Event::Request, "goes on on request")?)
    }
}
