//! Device on which things go wrong as scheduled.

use std::{collections::BTreeMap, sync::PoisonError};

use instruments_scpi::decode::Terminator;

use super::{
    super::{
        Absence, Device, MakeError, MockOptions, Model, make, model,
        plant::{Drift, SharedPlant},
    },
    Fault, FaultLog, FaultSwitch, Happened, Schedule, Trouble,
};

/// A device on which things go wrong.
struct Troubled {
    device: Box<dyn Device>,
    plant: SharedPlant,
    options: MockOptions,
    known: &'static Model,
    schedule: Schedule,
    lies: FalseAnswers,
    random: u64,
    happened: usize,
    log: FaultLog,
}

/// How the instrument lies from now on.
#[derive(Default)]
struct FalseAnswers {
    stuck: bool,
    short: bool,
    /// The first answer to each question for a measurement.
    frozen: Option<BTreeMap<Vec<u8>, Vec<u8>>>,
    /// The answer that comes next.
    lagging: Option<Vec<u8>>,
}

/// How the zero error of the bipolar supply grows.
const DRIFT: Drift = Drift {
    a_per_s: 0.02,
    greatest_a: 0.9,
};

/// Temperature towards which a bath heats that runs away, °C.
const RUNAWAY_C: f64 = 90.0;

/// Makes a simulated instrument on which things go wrong as scheduled.
///
/// # Errors
/// As [`make`].
pub fn make_troubled(
    key: &str,
    plant: SharedPlant,
    options: &MockOptions,
    schedule: &Schedule,
    log: &FaultLog,
) -> Result<Box<dyn Device>, MakeError> {
    let (device, known) = (make(key, plant.clone(), options)?, model(key)?);
    let schedule = match &schedule.role {
        Some(role) if role != known.role => Schedule {
            most: 0,
            ..schedule.clone()
        },
        _ => schedule.clone(),
    };
    // Each model's own sequence, and another one when it is made again after something has
    // happened.
    let (before, happened) = {
        let log = log.lock().unwrap_or_else(PoisonError::into_inner);
        (
            log.len() as u64,
            log.iter()
                .filter(|happened| happened.model == known.key)
                .count(),
        )
    };
    let random = key.bytes().fold(
        mix(before) ^ schedule.seed ^ 0x9e37_79b9_7f4a_7c15,
        |state, byte| mix(state ^ u64::from(byte)),
    );
    Ok(Box::new(Troubled {
        device,
        plant,
        options: options.clone(),
        known,
        schedule,
        lies: FalseAnswers::default(),
        random,
        happened,
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

    /// Returns whether the fault means anything to this instrument.
    fn can(&self, fault: Fault) -> bool {
        match fault {
            Fault::StuckOutput => !self.known.messages.off.is_empty(),
            Fault::SecondClient => !self.known.meddling.is_empty(),
            Fault::ShortBlock => self.known.role == "scope",
            Fault::OffsetDrift => self.known.role == "supply4q",
            // A bath with relays has no controller of its own that could fail.
            Fault::BathRunsAway => {
                self.known.role == "chiller" && self.known.key != "relay-thermostat"
            }
            Fault::FrozenMeter => !self.known.messages.measure.is_empty(),
            _ => true,
        }
    }

    fn power_cycle(&mut self, now_s: f64) {
        let options = MockOptions {
            since_s: now_s,
            ..self.options.clone()
        };
        if let Ok(device) = make(self.known.key, self.plant.clone(), &options) {
            self.device = device;
        }
    }
}

/// Returns a definite block without its last third, as one that is whole.
fn short(reply: Vec<u8>) -> Vec<u8> {
    let Some(at) = reply.iter().position(|byte| *byte == b'#') else {
        return reply;
    };
    let digits = reply
        .get(at + 1)
        .filter(|digit| digit.is_ascii_digit())
        .map_or(0, |digit| usize::from(digit - b'0'));
    let length = reply
        .get(at + 2..at + 2 + digits)
        .and_then(|text| std::str::from_utf8(text).ok()?.parse::<usize>().ok());
    let Some((length, start)) = length
        .map(|length| (length, at + 2 + digits))
        .filter(|(length, start)| reply.len() >= start + length)
    else {
        return reply;
    };
    // Whole words of two bytes.
    let kept = 2 * (length / 3);
    let head = format!("#{digits}{kept:0digits$}");
    [
        &reply[..at],
        head.as_bytes(),
        &reply[start..start + kept],
        &reply[start + length..],
    ]
    .concat()
}

impl Device for Troubled {
    fn terminator(&self) -> Terminator {
        self.device.terminator()
    }

    fn handle(&mut self, now_s: f64, message: &[u8]) -> Vec<u8> {
        if self.schedule.repaired.is_thrown() {
            return self.device.handle(now_s, message);
        }
        let known = &self.known.messages;
        if self.lies.stuck && known.switches_off(message) {
            // It confirms this if it answers every command.
            return known.off_answer.as_bytes().to_vec();
        }
        let mut reply = self.device.handle(now_s, message);
        if let Some(frozen) = self
            .lies
            .frozen
            .as_mut()
            .filter(|_| known.measures(message))
        {
            reply = frozen.entry(message.to_vec()).or_insert(reply).clone();
        }
        if self.lies.short {
            reply = short(reply);
        }
        match &mut self.lies.lagging {
            Some(late) if !reply.is_empty() => std::mem::replace(late, reply),
            _ => reply,
        }
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

    fn absence(&self, now_s: f64) -> Option<Absence> {
        self.device.absence(now_s)
    }

    fn trouble(&mut self, now_s: f64, message: &[u8]) -> Option<Trouble> {
        let (chance, which, share) = (self.uniform(), self.uniform(), self.uniform());
        let may = !self.schedule.repaired.is_thrown()
            && now_s >= self.schedule.from_s
            && self
                .schedule
                .awaits
                .as_ref()
                .is_none_or(FaultSwitch::is_thrown)
            && self.happened < self.schedule.most
            && chance < self.schedule.per_message;
        if !may || self.schedule.faults.is_empty() {
            return None;
        }
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            clippy::cast_precision_loss,
            reason = "an index"
        )]
        let index = (which * self.schedule.faults.len() as f64) as usize;
        let fault = *self
            .schedule
            .faults
            .get(index)
            .filter(|fault| self.can(**fault))?;
        self.happened += 1;
        let text = String::from_utf8_lossy(message).into_owned();
        self.log
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .push(Happened {
                time_s: now_s,
                model: self.known.key,
                fault,
                message: text,
            });
        match fault {
            Fault::Overflow => self.overflow(now_s),
            Fault::OutputOff => {
                if let Some(off) = self.known.panel_off {
                    self.device.handle(now_s, off.as_bytes());
                }
            }
            Fault::PowerCycle => {
                self.power_cycle(now_s);
                return Some(Trouble { fault, share });
            }
            Fault::StuckOutput => self.lies.stuck = true,
            Fault::ShortBlock => self.lies.short = true,
            Fault::FrozenMeter => self.lies.frozen = Some(BTreeMap::new()),
            // The answer to the message in hand is the last right one.
            Fault::Lagging => self.lies.lagging = Some(self.device.handle(now_s, message)),
            Fault::OffsetDrift => self
                .plant
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
                .drift(now_s, DRIFT),
            Fault::BathRunsAway => self
                .plant
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
                .bath_runs_away(now_s, RUNAWAY_C),
            Fault::SecondClient => {
                #[expect(
                    clippy::cast_possible_truncation,
                    clippy::cast_sign_loss,
                    clippy::cast_precision_loss,
                    reason = "an index"
                )]
                let which = self
                    .schedule
                    .variant
                    .unwrap_or((share * self.known.meddling.len() as f64) as usize);
                for meddled in self.known.meddling.get(which).copied().unwrap_or_default() {
                    self.device.handle(now_s, meddled.as_bytes());
                }
            }
            _ => return Some(Trouble { fault, share }),
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_short_block_is_whole_by_its_own_head() {
        assert_eq!(
            short(b"C1:WF ALL,#209abcdefghi\n\n".to_vec()),
            b"C1:WF ALL,#206abcdef\n\n"
        );
        assert_eq!(short(b"1.5\n".to_vec()), b"1.5\n");
        assert_eq!(short(b"#9".to_vec()), b"#9");
    }
}
