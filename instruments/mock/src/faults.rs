//! Seeded faults between an instrument and its client. Messages and replies are lost, delayed,
//! split, duplicated, garbled or truncated. Connections stall or break. An error queue overflows,
//! the power is cut, or a protection or a person at the panel switches an output off. Some
//! instruments give false replies from some message on: an output stays on, another user changes
//! settings, a meter does not update, replies lag.
//!
//! The faults wrap any device; neither the device nor its client knows of them. The seed and the
//! number of the message alone determine which fault occurs when, so that a schedule is
//! reproducible.

mod remote;
mod troubled;

use std::sync::{
    Arc, Mutex,
    atomic::{AtomicBool, Ordering},
};

pub use remote::{Armed, Remote};
pub use troubled::make_troubled;

/// Fault of one message.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Fault {
    /// The message never reaches the instrument.
    LoseMessage,
    /// The instrument acts, but its answer is lost.
    LoseReply,
    /// The answer comes late, but in time.
    Delay,
    /// The answer comes after the client has given up.
    TooLate,
    /// The answer comes in pieces with pauses between them.
    Split,
    /// The answer comes twice.
    Duplicate,
    /// One byte of the answer is changed.
    Garble,
    /// The second half of the answer, with its end, is missing.
    Truncate,
    /// The instrument stops sending after this answer, but continues to receive.
    HalfClose,
    /// The connection breaks before the answer.
    Reset,
    /// Nothing is read or answered for a while.
    Stall,
    /// The error queue runs over.
    Overflow,
    /// The power fails: all settings return to their power-on values, and the connection is lost.
    PowerCycle,
    /// The output goes off by itself.
    OutputOff,
    /// From now on no message switches the output off; all others are obeyed.
    StuckOutput,
    /// Another client changes a setting, once.
    SecondClient,
    /// Every query of a measurement repeats its first answer.
    FrozenMeter,
    /// Every answer belongs to the previous question.
    Lagging,
    /// Blocks lack their last third, and their headers are consistent with that.
    ShortBlock,
    /// From now on the zero error of the bipolar supply grows.
    OffsetDrift,
    /// A running bath heats without limit, regardless of its set-point. It stops heating when it is
    /// stopped.
    BathRunsAway,
}

impl Fault {
    /// Those of the wire and of the day.
    pub const ALL: [Self; 14] = [
        Self::LoseMessage,
        Self::LoseReply,
        Self::Delay,
        Self::TooLate,
        Self::Split,
        Self::Duplicate,
        Self::Garble,
        Self::Truncate,
        Self::HalfClose,
        Self::Reset,
        Self::Stall,
        Self::Overflow,
        Self::PowerCycle,
        Self::OutputOff,
    ];

    /// Faults of an instrument with false replies. [`Self::BathRunsAway`] is not one of them: the
    /// bath reports its true temperature.
    pub const LIES: [Self; 6] = [
        Self::StuckOutput,
        Self::SecondClient,
        Self::FrozenMeter,
        Self::Lagging,
        Self::ShortBlock,
        Self::OffsetDrift,
    ];
}

/// Extent of the faults.
#[derive(Debug, Clone, PartialEq)]
pub struct Schedule {
    /// Seed; each instrument has its own sequence.
    pub seed: u64,
    /// Chance of a fault with each message.
    pub per_message: f64,
    /// Maximum number of faults on one instrument.
    pub most: usize,
    /// Faults that may happen.
    pub faults: Vec<Fault>,
    /// Only to the instrument of this role; to all without it.
    pub role: Option<String>,
    /// Not before this bench time, s.
    pub from_s: f64,
    /// Not before this switch is thrown; without one, `from_s` alone decides.
    pub awaits: Option<FaultSwitch>,
    /// Which of the things that another client may do; left to chance without it.
    pub variant: Option<usize>,
    /// Switch that repairs the instruments.
    pub repaired: FaultSwitch,
}

/// A switch that begins or ends the faults of a bench; all clones share its state.
#[derive(Debug, Clone, Default)]
pub struct FaultSwitch(Arc<AtomicBool>);

impl FaultSwitch {
    /// Throws the switch for good.
    pub fn throw(&self) {
        self.0.store(true, Ordering::SeqCst);
    }

    fn is_thrown(&self) -> bool {
        self.0.load(Ordering::SeqCst)
    }
}

impl PartialEq for FaultSwitch {
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.0, &other.0) || self.is_thrown() == other.is_thrown()
    }
}

impl Default for Schedule {
    fn default() -> Self {
        Self {
            seed: 0,
            per_message: 0.0,
            most: 0,
            faults: Vec::new(),
            role: None,
            from_s: 0.0,
            awaits: None,
            variant: None,
            repaired: FaultSwitch::default(),
        }
    }
}

/// A fault that happened.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Happened {
    /// Bench time, s.
    pub time_s: f64,
    /// Model of the instrument.
    pub model: &'static str,
    /// Kind of the fault.
    pub fault: Fault,
    /// The message that it befell.
    pub message: String,
}

/// Faults of a bench so far, in order; all clones share the list.
pub type FaultLog = Arc<Mutex<Vec<Happened>>>;

/// Fault that is to happen on the wire with the message in hand.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Trouble {
    /// Kind of the fault.
    pub fault: Fault,
    /// A number from 0 to 1 that chooses place or length.
    pub share: f64,
}
