//! A sweep that does not wait for its own bookkeeping: once the scope holds a record, the generator
//! goes on to the next point, whose settling passes while the record is fetched, analysed and
//! written down.
//!
//! Every step is in the journal before it is begun, as always. A record that is to be taken again
//! brings the generator back.

mod sweep_state;

use instruments::{clock::TimeMode, fixture::Fixture};

use super::{ExecuteError, Executor, POLL_S, Rig};
use crate::{interlock::Reading, plan::SweepSettings};
pub(super) use sweep_state::{NextPoint, StartedPoint, SweepState, Tone};

/// A command that was obeyed within this time counts from when it was handed over, s.
const PROMPT_S: f64 = 0.05;
/// After arming the scope needs a screen and a period for a record, and this, s.
const ARMED_S: f64 = 0.05;

impl Rig<'_> {
    /// Whether points overlap; where nobody has said so, in real time only: in any other nobody
    /// waits.
    pub(super) fn overlaps(&self, settings: &SweepSettings) -> bool {
        settings
            .overlap
            .unwrap_or(self.clock.mode() == TimeMode::Real)
    }

    /// A reading while a record is being fetched, as soon as the last one is as old as two readings
    /// may be apart.
    pub(super) async fn watch_between(
        &mut self,
        settings: &SweepSettings,
        fixture: Fixture,
    ) -> Result<(), ExecuteError> {
        if self.overlaps(settings) && self.clock.now_s() - self.watching.watched_s < POLL_S {
            Ok(())
        } else {
            self.timed_watch(fixture).await.map(|_| ())
        }
    }

    async fn timed_watch(&mut self, fixture: Fixture) -> Result<Reading, ExecuteError> {
        let start_s = self.clock.now_s();
        let reading = self.watch("sine", fixture).await?;
        self.watching.took_s = self.clock.now_s() - start_s;
        Ok(reading)
    }

    /// When a point may be stopped: settled, and the scope armed for long enough, bench s.
    pub(super) fn settled_at_s(&self, tone: &Tone, driven_s: f64, screen_s: f64) -> f64 {
        (driven_s + tone.wait_s).max(self.clock.now_s() + screen_s + 1.0 / tone.freq_hz + ARMED_S)
    }
}

impl Executor<'_> {
    /// The scope holds its record: the generator goes on. Where crests would not be allowed the
    /// next step is to say so.
    pub(super) async fn start_next_point(&mut self, fixture: Fixture) -> Result<(), ExecuteError> {
        let Some(next) = self.sweep.next.clone() else {
            return Ok(());
        };
        let tone = next.tone;
        if self
            .headroom(fixture, tone.freq_hz, tone.amplitude_a)
            .is_err()
        {
            return Ok(());
        }
        self.rig.begin(fixture, &next.sine);
        let told_s = self.rig.clock.now_s();
        self.rig.drive(&tone).await?;
        let proven_s = self.rig.clock.now_s();
        let since_s = if proven_s - told_s <= PROMPT_S {
            told_s
        } else {
            proven_s
        };
        self.sweep.started = Some(StartedPoint { tone, since_s });
        Ok(())
    }

    /// Waits until an instant, bench s, reading and judging as often as ever, but never beyond that
    /// instant.
    pub(super) async fn watch_until(
        &mut self,
        end_s: f64,
        fixture: Fixture,
    ) -> Result<(), ExecuteError> {
        loop {
            let left_s = end_s - self.rig.clock.now_s();
            // A reading takes a while: one that would end too late comes right after the wait.
            let poll_s = self.rig.poll_s();
            if left_s <= poll_s + self.rig.watching.took_s {
                self.read_before(left_s, fixture).await?;
                self.rig.clock.sleep_s(end_s - self.rig.clock.now_s()).await;
                return Ok(());
            }
            self.rig.clock.sleep_s(poll_s).await;
            let reading = self.rig.timed_watch(fixture).await?;
            self.rig
                .watch_mean(
                    reading,
                    end_s - self.rig.clock.now_s() - self.rig.watching.took_s,
                )
                .await?;
        }
    }

    /// Behind the last point no other one settles, during which a reading would cost nothing: where
    /// there is time for it, it comes before the record.
    async fn read_before(&mut self, left_s: f64, fixture: Fixture) -> Result<(), ExecuteError> {
        let early_s = left_s - 2.0 * self.rig.watching.took_s - ARMED_S;
        if self.sweep.next.is_some() || self.rig.watching.took_s <= 0.0 || early_s <= 0.0 {
            return Ok(());
        }
        self.rig.clock.sleep_s(early_s).await;
        self.rig.timed_watch(fixture).await.map(|_| ())
    }
}
