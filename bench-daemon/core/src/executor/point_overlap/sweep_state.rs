//! State of the present sweep: the next point, and the cost of its points.

use instruments::units::{Amps, Hertz, Seconds};

use super::super::ExecuteError;
use crate::{
    journal::Entry,
    record::{Event, Recorder},
};
use bench_plan::{
    measure::Spent,
    plan::{Stage, Step},
};

/// A sinusoid as it is driven.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Tone {
    /// Frequency, Hz.
    pub freq_hz: Hertz,
    /// Amplitude of the current, A.
    pub amplitude_a: Amps,
    /// Shortest wait for the record, s.
    pub wait_s: Seconds,
}

/// The point after the present one.
#[derive(Debug, Clone)]
pub(crate) struct NextPoint {
    stage: usize,
    step: usize,
    pub(super) sine: Step,
    pub(super) tone: Tone,
}

/// A next point that the generator already drives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct StartedPoint {
    pub(super) tone: Tone,
    /// Start time, bench s.
    pub(super) since_s: Seconds,
}

/// State of the present sweep: the next point, and the cost of its points.
#[derive(Default)]
pub(crate) struct SweepState {
    /// The point after the present one, if the generator may proceed to it.
    pub next: Option<NextPoint>,
    /// The step that was written to the journal before its turn.
    pub announced: Option<usize>,
    /// The point that the generator has already started.
    pub started: Option<StartedPoint>,
    /// Effort spent on measuring points of the sweep again.
    pub spent: Spent,
}

impl NextPoint {
    /// Returns the point after a step of a stage, if both are points and the next is to be
    /// executed.
    pub(crate) fn after(
        number: usize,
        stage: &Stage,
        index: usize,
        plays: impl Fn(usize, &Step) -> bool,
    ) -> Option<Self> {
        let Some(Step::Sine { .. }) = stage.steps.get(index) else {
            return None;
        };
        let step = stage.steps.get(index + 1)?;
        let Step::Sine {
            freq_hz,
            amplitude_a,
            wait_s,
            ..
        } = *step
        else {
            return None;
        };
        plays(index + 1, step).then_some(Self {
            stage: number,
            step: index + 1,
            sine: step.clone(),
            tone: Tone {
                freq_hz,
                amplitude_a,
                wait_s,
            },
        })
    }
}

impl SweepState {
    /// Records that the next point is about to begin, while the present one still settles: later,
    /// time is critical.
    pub(crate) fn announce(&mut self, recorder: &mut Recorder) -> Result<(), ExecuteError> {
        let next = self.next.as_ref();
        if let Some(next) = next.filter(|next| self.announced != Some(next.step)) {
            let text = next.sine.to_string();
            recorder.journal(Entry::Intent {
                stage: next.stage,
                step: next.step,
                text: text.clone(),
                live: true,
            })?;
            recorder.event(Event::Step, &text)?;
            self.announced = Some(next.step);
        }
        Ok(())
    }

    /// Checks whether the journal already contains the start of a step.
    pub(crate) fn was_announced(&self, step: usize) -> bool {
        self.announced == Some(step)
    }

    /// Returns since when the generator has driven this point, if it does.
    pub(crate) fn take_started(&mut self, tone: &Tone) -> Option<Seconds> {
        let same = |started: &StartedPoint| {
            started.tone.freq_hz == tone.freq_hz && started.tone.amplitude_a == tone.amplitude_a
        };
        self.started
            .take()
            .filter(same)
            .map(|started| started.since_s)
    }

    /// Discards a step that was started before its turn.
    pub(crate) fn fall_back(&mut self) {
        (self.announced, self.started) = (None, None);
    }
}
