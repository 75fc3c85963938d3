//! A sweep that does not wait for its own bookkeeping: once the scope holds a record, the generator goes on to the next point, whose settling passes while
//! the record is fetched, analysed and written down.
//!
//! What is begun is in the journal before it is begun, as everything is. A record that is to be taken again brings the generator back.

use instruments::{clock::TimeMode, mock::plant::Fixture};

use super::{ExecuteError, Executor, POLL_S};
use crate::{
    journal::Entry,
    plan::{Stage, Step},
};

/// After arming the scope needs a screen and a period for a record, and this, s.
const ARMED_S: f64 = 0.05;

/// The point that comes after the one in work.
#[derive(Debug, Clone, Copy)]
pub(super) struct Next {
    stage: usize,
    step: usize,
    freq_hz: f64,
    amplitude_a: f64,
    wait_s: f64,
    index: usize,
}

/// The generator is at the next point already.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Ahead {
    step: usize,
    freq_hz: f64,
    amplitude_a: f64,
    /// Since when, bench s.
    pub(super) since_s: f64,
}

impl Executor<'_> {
    /// Whether points overlap; where nobody has said so, in real time only: in any other nobody waits.
    pub(super) fn overlaps(&self) -> bool {
        let wanted = self.experiment.eis.as_ref().and_then(|eis| eis.overlap);
        wanted.unwrap_or(self.clock.mode() == TimeMode::Real)
    }

    /// Looks for the point after a step.
    pub(super) fn look_ahead(&mut self, (number, stage): (usize, &Stage), index: usize, plays: impl Fn(usize, &Step) -> bool) {
        let wanted = self.overlaps();
        self.next = None;
        if let (true, Some(Step::Sine { .. }), Some(step @ &Step::Sine { index: point, freq_hz, amplitude_a, wait_s })) =
            (wanted, stage.steps.get(index), stage.steps.get(index + 1))
            && plays(index + 1, step)
        {
            self.next = Some(Next { stage: number, step: index + 1, freq_hz, amplitude_a, wait_s, index: point });
        }
    }

    /// Whether a step was begun, and is in the journal, while the one before it was still being fetched.
    pub(super) fn begun_ahead(&self, step: usize) -> bool {
        self.ahead.is_some_and(|ahead| ahead.step == step)
    }

    /// Since when the generator plays this point, if it does.
    pub(super) fn taken_ahead(&mut self, freq_hz: f64, amplitude_a: f64) -> Option<f64> {
        let same = |ahead: &Ahead| ahead.freq_hz == freq_hz && ahead.amplitude_a == amplitude_a;
        self.ahead.take().filter(same).map(|ahead| ahead.since_s)
    }

    /// The scope holds its record: the generator goes on. Where crests would not be allowed the next step is to say so.
    pub(super) async fn go_ahead(&mut self, fixture: Fixture) -> Result<(), ExecuteError> {
        let Some(next @ Next { freq_hz, amplitude_a, .. }) = self.next else { return Ok(()) };
        if self.headroom(fixture, (freq_hz, amplitude_a)).is_err() {
            return Ok(());
        }
        let step = Step::Sine { index: next.index, freq_hz, amplitude_a, wait_s: next.wait_s };
        self.recorder.journal(Entry::Intent { stage: next.stage, step: next.step, text: step.to_string() })?;
        self.recorder.event(&step.to_string())?;
        self.interlock.begin(self.allowance(fixture, &step), self.clock.machine_s());
        self.drive(freq_hz, amplitude_a).await?;
        self.ahead = Some(Ahead { step: next.step, freq_hz, amplitude_a, since_s: self.clock.now_s() });
        Ok(())
    }

    /// Waits until an instant, bench s, reading and judging as often as ever, but never beyond that instant.
    pub(super) async fn watch_until(&mut self, end_s: f64, fixture: Fixture) -> Result<(), ExecuteError> {
        loop {
            let left_s = end_s - self.clock.now_s();
            // A reading takes a while: one that would end too late comes right after the wait.
            if left_s <= POLL_S + self.watch_took_s {
                self.clock.sleep_s(left_s).await;
                return Ok(());
            }
            self.clock.sleep_s(POLL_S).await;
            self.timed_watch(fixture).await?;
        }
    }

    /// A reading while a record is being fetched, as soon as the last one is as old as two readings may be apart.
    pub(super) async fn watch_between(&mut self, fixture: Fixture) -> Result<(), ExecuteError> {
        if self.overlaps() && self.clock.now_s() - self.watched_s < POLL_S { Ok(()) } else { self.timed_watch(fixture).await }
    }

    async fn timed_watch(&mut self, fixture: Fixture) -> Result<(), ExecuteError> {
        let start_s = self.clock.now_s();
        self.watch("sine", fixture).await?;
        self.watch_took_s = self.clock.now_s() - start_s;
        Ok(())
    }

    /// When a point may be stopped: settled, and the scope armed for long enough, bench s.
    pub(super) fn ripe_s(&self, (freq_hz, wait_s): (f64, f64), driven_s: f64, screen_s: f64) -> f64 {
        (driven_s + wait_s).max(self.clock.now_s() + screen_s + 1.0 / freq_hz + ARMED_S)
    }
}
