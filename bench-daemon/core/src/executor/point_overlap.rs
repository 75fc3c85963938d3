//! Overlaps the points of a sweep with their processing: once the scope holds a record, the
//! generator proceeds to the next point, which settles while the record is fetched, analysed and
//! written.
//!
//! Every step is in the journal before it begins, as always. If a record must be repeated, the
//! generator returns to its point.

mod sweep_state;

use instruments::{clock::TimeMode, fixture::Fixture, units::Seconds};

use super::{ExecuteError, Executor, POLL_S, Rig};
use bench_plan::{interlock::Reading, plan::SweepSettings};

use crate::clock::TypedClock;
pub(super) use sweep_state::{NextPoint, StartedPoint, SweepState, Tone};

/// A command that was executed within this time counts from when it was sent, s.
const PROMPT_S: Seconds = Seconds(0.05);
/// Time that the scope needs after arming, beside a screen and a period for a record, s.
const ARMED_S: Seconds = Seconds(0.05);

impl Rig<'_> {
    /// Checks whether points overlap. By default they overlap in real time only, because other
    /// clocks do not need it.
    pub(super) fn overlaps(&self, settings: &SweepSettings) -> bool {
        settings
            .overlap
            .unwrap_or(self.clock.mode() == TimeMode::Real)
    }

    /// Takes a reading while a record is being fetched, as soon as the last one has the greatest
    /// allowed age.
    pub(super) async fn watch_between(
        &mut self,
        settings: &SweepSettings,
        fixture: Fixture,
    ) -> Result<(), ExecuteError> {
        if self.overlaps(settings) && self.clock.now() - self.watching.watched_s < POLL_S {
            Ok(())
        } else {
            self.timed_watch(fixture).await.map(|_| ())
        }
    }

    async fn timed_watch(&mut self, fixture: Fixture) -> Result<Reading, ExecuteError> {
        let start_s = self.clock.now();
        let reading = self.watch("sine", fixture).await?;
        self.watching.took_s = self.clock.now() - start_s;
        Ok(reading)
    }

    /// Returns when the scope may be stopped for a point, bench s: the signal has settled, and the
    /// scope has been armed for long enough.
    pub(super) fn settled_at_s(
        &self,
        tone: &Tone,
        driven_s: Seconds,
        screen_s: Seconds,
    ) -> Seconds {
        (driven_s + tone.wait_s).max(self.clock.now() + screen_s + 1.0 / tone.freq_hz + ARMED_S)
    }
}

impl Executor<'_> {
    /// Moves the generator to the next point once the scope holds its record. If the crests of the
    /// next point are not allowed, does nothing and leaves the error to the next step.
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
        let sent_s = self.rig.clock.now();
        self.rig.drive(&tone).await?;
        let proven_s = self.rig.clock.now();
        let since_s = if proven_s - sent_s <= PROMPT_S {
            sent_s
        } else {
            proven_s
        };
        self.sweep.started = Some(StartedPoint { tone, since_s });
        Ok(())
    }

    /// Waits until a time, bench s, with readings at the usual rate, but never beyond that time.
    pub(super) async fn watch_until(
        &mut self,
        end_s: Seconds,
        fixture: Fixture,
    ) -> Result<(), ExecuteError> {
        loop {
            let left_s = end_s - self.rig.clock.now();
            // A reading takes time: one that would end too late is taken right after the wait.
            let poll_s = self.rig.poll_s();
            if left_s <= poll_s + self.rig.watching.took_s {
                self.read_before(left_s, fixture).await?;
                self.rig.clock.sleep_for(end_s - self.rig.clock.now()).await;
                return Ok(());
            }
            self.rig.clock.sleep_for(poll_s).await;
            let reading = self.rig.timed_watch(fixture).await?;
            self.rig
                .watch_mean(
                    reading,
                    end_s - self.rig.clock.now() - self.rig.watching.took_s,
                )
                .await?;
        }
    }

    /// Takes a reading before the record, if there is time. After the last point no other point
    /// settles, during which a reading would take no extra time.
    async fn read_before(&mut self, left_s: Seconds, fixture: Fixture) -> Result<(), ExecuteError> {
        let early_s = left_s - 2.0 * self.rig.watching.took_s - ARMED_S;
        if self.sweep.next.is_some()
            || self.rig.watching.took_s <= Seconds::ZERO
            || early_s <= Seconds::ZERO
        {
            return Ok(());
        }
        self.rig.clock.sleep_for(early_s).await;
        self.rig.timed_watch(fixture).await.map(|_| ())
    }
}
