//! Windows of a run in which a fault occurs: every kind of step, and every kind of wait.

use super::job::Job;

/// A part of a run that can be recognised from outside while the run is in progress.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Window {
    Start,
    Hold,
    Discharge,
    Charge,
    Rest,
    Leg,
    PowerUp,
    SlowSine,
    FastSine,
    PowerDown,
    Multisine,
    Zero,
    Trace,
    LoadTrace,
    BiasRamp,
    BiasedSine,
    BringBack,
    Pause,
    Prompt,
    Wait,
    Reconnection,
    Download,
    Analysis,
    End,
}

/// Criterion for a window.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Cue {
    /// A step whose text contains this has been in progress for a time, s.
    Step(&'static str, f64),
    /// An entry of this kind has been the last of the journal for a time, s.
    Entry(&'static str, f64),
    /// The journal states that everything is off after the last stage.
    LastSafe,
    /// The program has written this some time ago, s.
    Said(&'static str, f64),
    /// The instrument of this role has received a message that contains this.
    Heard(&'static str, &'static str),
}

const BIPOLAR: &[&str] = &["supply4q", "generator"];

impl Window {
    pub(crate) const ALL: [Self; 24] = [
        Self::Start,
        Self::Hold,
        Self::Discharge,
        Self::Charge,
        Self::Rest,
        Self::Leg,
        Self::PowerUp,
        Self::SlowSine,
        Self::FastSine,
        Self::PowerDown,
        Self::Multisine,
        Self::Zero,
        Self::Trace,
        Self::LoadTrace,
        Self::BiasRamp,
        Self::BiasedSine,
        Self::BringBack,
        Self::Pause,
        Self::Prompt,
        Self::Wait,
        Self::Reconnection,
        Self::Download,
        Self::Analysis,
        Self::End,
    ];

    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Start => "start, before the first step",
            Self::Hold => "temperature hold",
            Self::Discharge => "discharge",
            Self::Charge => "charge",
            Self::Rest => "rest",
            Self::Leg => "leg of OCV over SOC",
            Self::PowerUp => "power-up",
            Self::SlowSine => "slow sine",
            Self::FastSine => "fast sine",
            Self::PowerDown => "power-down",
            Self::Multisine => "multisine",
            Self::Zero => "zero",
            Self::Trace => "trace",
            Self::LoadTrace => "trace through the load",
            Self::BiasRamp => "direct current, ramp",
            Self::BiasedSine => "direct current, sine",
            Self::BringBack => "direct current, bringing back the charge",
            Self::Pause => "pause on request",
            Self::Prompt => "prompt for a person",
            Self::Wait => "wait after a fault of the wire",
            Self::Reconnection => "reconnection",
            Self::Download => "download of a block",
            Self::Analysis => "end of a sweep",
            Self::End => "end of the run",
        }
    }

    pub(crate) const fn job(self) -> Job {
        match self {
            Self::Hold => Job::Hold,
            Self::Discharge | Self::Charge | Self::Rest => Job::Reset,
            Self::Leg => Job::Leg,
            Self::SlowSine => Job::Slow,
            Self::Multisine => Job::Multisine,
            Self::Zero | Self::Trace => Job::Trace,
            Self::LoadTrace => Job::LoadTrace,
            Self::BiasRamp | Self::BiasedSine | Self::BringBack => Job::Biased,
            Self::Prompt => Job::Prompt,
            Self::Pause => Job::Pause,
            Self::Analysis => Job::Twice,
            Self::Download => Job::SlowBlocks,
            Self::Start
            | Self::PowerUp
            | Self::FastSine
            | Self::PowerDown
            | Self::Wait
            | Self::Reconnection
            | Self::End => Job::Fast,
        }
    }

    pub(crate) const fn cue(self) -> Cue {
        match self {
            Self::Start => Cue::Entry("started", 0.0),
            Self::Hold => Cue::Step("hold ", 3.0),
            Self::Discharge => Cue::Step("discharge at", 5.0),
            Self::Charge => Cue::Step("charge at 3 A", 3.0),
            Self::Rest => Cue::Step("until slower than", 3.0),
            Self::Leg => Cue::Step("into ocv_charge", 5.0),
            Self::PowerUp => Cue::Step("bipolar supply up", 0.3),
            Self::SlowSine => Cue::Step("0.2000 Hz", 8.0),
            Self::FastSine => Cue::Step("173.2051 Hz", 0.8),
            Self::PowerDown => Cue::Step("bipolar supply down", 0.0),
            Self::Multisine => Cue::Step("multisine", 5.0),
            Self::Zero => Cue::Step("then the zeros", 2.0),
            Self::Trace => Cue::Step("trace pulse", 4.0),
            Self::LoadTrace => Cue::Step("trace pulse", 6.0),
            Self::BiasRamp => Cue::Step("ramp the direct current to", 2.0),
            Self::BiasedSine => Cue::Step("0.5000 Hz", 5.0),
            Self::BringBack => Cue::Step("bring back", 5.0),
            Self::Pause => Cue::Entry("paused", 3.0),
            Self::Prompt => Cue::Entry("asked", 3.0),
            Self::Wait => Cue::Said("going on by itself", 1.0),
            Self::Reconnection => Cue::Entry("resumed", 0.0),
            Self::Download => Cue::Heard("scope", "DATA?"),
            Self::Analysis => Cue::Entry("stage_done", 0.0),
            Self::End => Cue::LastSafe,
        }
    }

    /// Returns the roles whose outputs are on according to the plan.
    pub(crate) const fn on(self) -> &'static [&'static str] {
        match self {
            Self::Discharge | Self::LoadTrace => &["load"],
            Self::Charge | Self::Leg => &["supply"],
            Self::PowerUp
            | Self::SlowSine
            | Self::FastSine
            | Self::PowerDown
            | Self::Multisine
            | Self::Trace
            | Self::BiasRamp
            | Self::BiasedSine
            | Self::BringBack
            | Self::Download => BIPOLAR,
            Self::Start
            | Self::Hold
            | Self::Rest
            | Self::Zero
            | Self::Pause
            | Self::Prompt
            | Self::Wait
            | Self::Reconnection
            | Self::Analysis
            | Self::End => &[],
        }
    }

    pub(crate) fn is_on(self, role: &str) -> bool {
        self.on().contains(&role)
    }

    /// Checks whether the scope is read in this window.
    pub(crate) const fn reads_scope(self) -> bool {
        matches!(
            self,
            Self::SlowSine
                | Self::FastSine
                | Self::Multisine
                | Self::Zero
                | Self::Trace
                | Self::BiasedSine
                | Self::Download
        )
    }

    /// Checks whether a fault of the wire precedes this window.
    pub(crate) const fn is_after_fault(self) -> bool {
        matches!(self, Self::Wait | Self::Reconnection)
    }

    /// Checks whether the run ends on its own in a time that can be waited for, and goes on after an
    /// outage: under a direct current it does not, because its charge is not known then.
    pub(crate) const fn ends_soon(self) -> bool {
        !matches!(
            self,
            Self::Hold | Self::Leg | Self::BiasRamp | Self::BiasedSine | Self::BringBack
        )
    }

    /// Checks whether the run holds the bench: not every output was read back as off for the last
    /// time.
    pub(crate) const fn is_watched(self) -> bool {
        !matches!(self, Self::End)
    }

    /// Checks whether each kind of message fault is tested in this window.
    pub(crate) const fn has_exchanges(self) -> bool {
        matches!(
            self,
            Self::SlowSine | Self::FastSine | Self::Discharge | Self::Charge
        )
    }

    /// Returns the period of the signal, s.
    pub(crate) const fn period_s(self) -> f64 {
        match self {
            Self::SlowSine => 5.0,
            Self::BiasedSine => 2.0,
            Self::Multisine => 1.0,
            _ => 0.1,
        }
    }
}
