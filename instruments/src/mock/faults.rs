//! What goes wrong between an instrument and its client on a bad day, seeded: messages and answers that get lost, come late, in pieces, twice, garbled or
//! half; connections that stall or break; an error queue that runs over, a power cut, an output that a protection or a hand at the panel switches off.
//!
//! The faults lie around any device: it does not know of them, and neither does its client. Which one comes when follows from the seed and the number of
//! the message alone, so that a schedule can be played again.

use std::sync::{Arc, Mutex, PoisonError};

use super::{Device, MakeError, MockOptions, make, model, plant::SharedPlant};
use crate::scpi::decode::Terminator;

/// What can go wrong with one message.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Fault {
    /// The message never reaches the instrument.
    LoseMessage,
    /// The instrument acts, and its answer is lost.
    LoseReply,
    /// The answer comes late, but in time.
    Delay,
    /// The answer comes after the client has given up.
    TooLate,
    /// The answer comes in pieces with pauses between them.
    Split,
    /// The answer comes twice.
    Duplicate,
    /// One byte of the answer is another one.
    Garble,
    /// The second half of the answer is missing, its end too.
    Truncate,
    /// The instrument stops sending for good after this answer, and goes on listening.
    HalfClose,
    /// The connection breaks before the answer.
    Reset,
    /// Nothing is read or answered for a while.
    Stall,
    /// The error queue runs over.
    Overflow,
    /// The power fails: settings are those of switching on, the connection is gone.
    PowerCycle,
    /// The output goes off by itself.
    OutputOff,
}

impl Fault {
    /// All of them.
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
}

/// How much goes wrong.
#[derive(Debug, Clone, PartialEq)]
pub struct Schedule {
    /// Seed; each instrument has its own sequence.
    pub seed: u64,
    /// Chance of a fault with each message.
    pub per_message: f64,
    /// So many at most on one instrument.
    pub most: usize,
    /// What may happen.
    pub faults: Vec<Fault>,
}

/// A fault that happened.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Happened {
    /// Bench time, s.
    pub time_s: f64,
    /// Model of the instrument.
    pub model: &'static str,
    /// What it was.
    pub fault: Fault,
    /// The message that it befell.
    pub message: String,
}

/// What happened on a bench, in order; clones are the same list.
pub type FaultLog = Arc<Mutex<Vec<Happened>>>;

/// What is to happen on the wire with the message in hand.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Trouble {
    /// What it is.
    pub fault: Fault,
    /// A number from 0 to 1 that chooses place or length.
    pub share: f64,
}

/// A device on which things go wrong.
struct Troubled {
    device: Box<dyn Device>,
    plant: SharedPlant,
    options: MockOptions,
    model: &'static str,
    panel_off: Option<&'static str>,
    schedule: Schedule,
    random: u64,
    happened: usize,
    log: FaultLog,
}

/// Makes a simulated instrument on which things go wrong as scheduled.
///
/// # Errors
/// As [`make`].
pub fn make_troubled(
    key: &str,
    (plant, options): (SharedPlant, &MockOptions),
    schedule: &Schedule,
    log: &FaultLog,
) -> Result<Box<dyn Device>, MakeError> {
    let (device, known) = (make(key, plant.clone(), options)?, model(key)?);
    // Each model's own sequence.
    let random = key.bytes().fold(schedule.seed ^ 0x9e37_79b9_7f4a_7c15, |state, byte| mix(state ^ u64::from(byte)));
    Ok(Box::new(Troubled {
        device,
        plant,
        options: options.clone(),
        model: known.key,
        panel_off: known.panel_off,
        schedule: schedule.clone(),
        random,
        happened: 0,
        log: log.clone(),
    }))
}

/// `SplitMix64` (Steele, Lea, Flood 2014).
fn mix(state: u64) -> u64 {
    let mut z = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

impl Troubled {
    /// From 0 to 1.
    #[expect(clippy::cast_precision_loss, reason = "53 bits")]
    fn uniform(&mut self) -> f64 {
        self.random = mix(self.random);
        (self.random >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// More wrong messages than any error queue holds.
    fn overflow(&mut self, now_s: f64) {
        for _ in 0..40 {
            self.device.handle(now_s, b"NO:SUCH:HEADER 1");
        }
    }

    fn power_cycle(&mut self, now_s: f64) {
        let options = MockOptions { since_s: now_s, ..self.options.clone() };
        if let Ok(device) = make(self.model, self.plant.clone(), &options) {
            self.device = device;
        }
    }
}

impl Device for Troubled {
    fn terminator(&self) -> Terminator {
        self.device.terminator()
    }

    fn handle(&mut self, now_s: f64, message: &[u8]) -> Vec<u8> {
        self.device.handle(now_s, message)
    }

    fn connected(&mut self, now_s: f64) {
        self.device.connected(now_s);
    }

    fn late_s(&self, now_s: f64) -> f64 {
        self.device.late_s(now_s)
    }

    fn end_late_s(&self) -> f64 {
        self.device.end_late_s()
    }

    fn refuses_second(&self) -> bool {
        self.device.refuses_second()
    }

    fn trouble(&mut self, now_s: f64, message: &[u8]) -> Option<Trouble> {
        let (chance, which, share) = (self.uniform(), self.uniform(), self.uniform());
        if self.happened >= self.schedule.most || chance >= self.schedule.per_message || self.schedule.faults.is_empty() {
            return None;
        }
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, clippy::cast_precision_loss, reason = "an index")]
        let index = (which * self.schedule.faults.len() as f64) as usize;
        let fault = *self.schedule.faults.get(index)?;
        self.happened += 1;
        let message = String::from_utf8_lossy(message).into_owned();
        self.log.lock().unwrap_or_else(PoisonError::into_inner).push(Happened { time_s: now_s, model: self.model, fault, message });
        match fault {
            Fault::Overflow => self.overflow(now_s),
            Fault::OutputOff => {
                if let Some(off) = self.panel_off {
                    self.device.handle(now_s, off.as_bytes());
                }
            }
            Fault::PowerCycle => {
                self.power_cycle(now_s);
                return Some(Trouble { fault, share });
            }
            _ => return Some(Trouble { fault, share }),
        }
        None
    }
}
