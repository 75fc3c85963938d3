//! List of the attacks: which fault or signal, on which instrument, during which measurement.

use instruments::mock::Fault;

/// Measurement that runs while the attack is made.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Job {
    /// Points from 0.2 Hz to 2 Hz.
    Slow,
    /// Points from 100 Hz to 300 Hz.
    Fast,
    /// A discharge and a charge.
    Reset,
}

/// Attack: a fault of an instrument, a signal to a process, or nothing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Deed {
    /// A fault of one instrument, and which of its variants.
    Fault(&'static str, Fault, usize),
    /// A signal to the daemon (0) or its guardian (1), or both (2).
    Signal(u8, nix::sys::signal::Signal),
    /// Nothing, to compare with.
    Nothing,
}

/// One attack.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Attack {
    pub(crate) job: Job,
    pub(crate) deed: Deed,
    /// Bench time from which on it may happen, s.
    pub(crate) from_s: f64,
}

impl Attack {
    pub(crate) fn name(&self) -> String {
        let job = match self.job {
            Job::Slow => "slow sweep",
            Job::Fast => "fast sweep",
            Job::Reset if self.from_s < RECHARGE_S => "discharge",
            Job::Reset => "charge",
        };
        match self.deed {
            Deed::Fault(role, fault, variant) => format!("{job}: {role} {fault:?} {variant}"),
            Deed::Signal(whom, signal) => {
                let whom = ["daemon", "guardian", "daemon and guardian"]
                    .get(usize::from(whom))
                    .unwrap_or(&"?");
                format!("{job}: {signal} to {whom}")
            }
            Deed::Nothing => format!("{job}: nothing"),
        }
    }
}

/// The charge of the reset is under way from here on, s.
pub(crate) const RECHARGE_S: f64 = 650.0;
/// Within the second point of a sweep, and within the discharge, s.
const SWEEP_S: f64 = 20.0;
const FAST_S: f64 = 6.0;
const DISCHARGE_S: f64 = 60.0;

/// All of them.
pub(crate) fn all() -> Vec<Attack> {
    let mut list = Vec::new();
    let mut add = |job, from_s, deeds: &[Deed]| {
        list.extend(deeds.iter().map(|deed| Attack {
            job,
            deed: *deed,
            from_s,
        }));
    };
    let fault = |role, fault| Deed::Fault(role, fault, 0);
    use Fault::{
        Delay, Duplicate, FrozenMeter, Garble, HalfClose, Lagging, LoseMessage, LoseReply,
        OffsetDrift, OutputOff, Overflow, PowerCycle, Reset, SecondClient, ShortBlock, Stall,
        StuckOutput, TooLate, Truncate,
    };
    use nix::sys::signal::Signal::{SIGKILL, SIGSTOP};
    let meddle = |role, count: usize| {
        (0..count)
            .map(move |variant| Deed::Fault(role, SecondClient, variant))
            .collect::<Vec<_>>()
    };

    add(Job::Slow, SWEEP_S, &[Deed::Nothing]);
    add(Job::Slow, SWEEP_S, &meddle("generator", 5));
    add(Job::Slow, SWEEP_S, &meddle("supply4q", 3));
    add(Job::Slow, SWEEP_S, &meddle("load", 2));
    add(Job::Slow, SWEEP_S, &meddle("supply", 2));
    add(Job::Slow, SWEEP_S, &meddle("scope", 3));
    add(Job::Slow, SWEEP_S, &meddle("chiller", 1));
    for role in ["supply4q", "generator"] {
        add(
            Job::Slow,
            SWEEP_S,
            &[
                fault(role, StuckOutput),
                fault(role, OutputOff),
                fault(role, PowerCycle),
            ],
        );
    }
    for role in ["supply4q", "load", "logger"] {
        add(Job::Slow, SWEEP_S, &[fault(role, FrozenMeter)]);
    }
    add(
        Job::Slow,
        SWEEP_S,
        &[fault("supply4q", OffsetDrift), fault("scope", ShortBlock)],
    );
    for role in ["supply4q", "generator", "scope", "load", "logger"] {
        add(
            Job::Slow,
            SWEEP_S,
            &[
                fault(role, Lagging),
                fault(role, TooLate),
                fault(role, Reset),
                fault(role, Stall),
            ],
        );
    }
    add(
        Job::Slow,
        SWEEP_S,
        &[
            Deed::Signal(0, SIGKILL),
            Deed::Signal(0, SIGSTOP),
            Deed::Signal(1, SIGKILL),
            Deed::Signal(1, SIGSTOP),
        ],
    );
    add(
        Job::Slow,
        SWEEP_S,
        &[Deed::Signal(2, SIGKILL), Deed::Signal(2, SIGSTOP)],
    );

    add(
        Job::Fast,
        FAST_S,
        &[Deed::Nothing, Deed::Signal(2, SIGKILL)],
    );
    add(Job::Fast, FAST_S, &meddle("generator", 4));
    add(Job::Fast, FAST_S, &meddle("supply4q", 1));
    add(
        Job::Fast,
        FAST_S,
        &[fault("supply4q", OffsetDrift), fault("scope", ShortBlock)],
    );
    for role in ["supply4q", "generator", "scope"] {
        let wire = [
            LoseMessage,
            LoseReply,
            Delay,
            Duplicate,
            Garble,
            Truncate,
            HalfClose,
            Overflow,
        ];
        add(Job::Fast, FAST_S, &wire.map(|one| fault(role, one)));
    }

    add(Job::Reset, DISCHARGE_S, &[Deed::Nothing]);
    add(Job::Reset, DISCHARGE_S, &meddle("load", 3));
    add(
        Job::Reset,
        DISCHARGE_S,
        &[
            fault("load", StuckOutput),
            fault("load", FrozenMeter),
            fault("load", Lagging),
            fault("load", PowerCycle),
        ],
    );
    add(
        Job::Reset,
        DISCHARGE_S,
        &[
            Deed::Signal(0, SIGKILL),
            Deed::Fault("supply", SecondClient, 1),
        ],
    );
    add(Job::Reset, RECHARGE_S, &meddle("supply", 3));
    add(
        Job::Reset,
        RECHARGE_S,
        &[Deed::Fault("load", SecondClient, 1)],
    );
    add(
        Job::Reset,
        RECHARGE_S,
        &[
            fault("supply", StuckOutput),
            fault("supply", FrozenMeter),
            fault("supply", Lagging),
            fault("supply", OutputOff),
        ],
    );
    add(
        Job::Reset,
        RECHARGE_S,
        &[
            fault("load", FrozenMeter),
            fault("load", Lagging),
            Deed::Signal(0, SIGKILL),
        ],
    );
    list
}
