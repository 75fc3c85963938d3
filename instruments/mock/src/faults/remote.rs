//! Remote control of one simulated instrument while it is served: the messages of another client at
//! a given moment, the delay of its replies, one failing exchange, and an absence from its network.
//! A schedule waits for the next message of the client under test; another client does not.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use instruments_scpi::decode::Terminator;

use super::{
    super::{Absence, Device},
    Fault, Trouble,
};

/// An answer of more bytes than this is a block of data.
const BLOCK_BYTES: usize = 1000;

/// Controls an instrument that is served elsewhere; all clones control the same one.
#[derive(Clone)]
pub struct Remote(Arc<Mutex<Controlled>>);

/// A fault that befalls one exchange.
#[derive(Debug, Clone, PartialEq)]
pub struct Armed {
    /// Kind of the fault, one of the wire.
    pub fault: Fault,
    /// Text in the message that it befalls; every message has the empty one.
    pub within: String,
}

struct Controlled {
    device: Box<dyn Device>,
    /// How late answers are, s; blocks of data as much later again as the second number.
    late_s: (f64, f64),
    absence: Option<(Absence, f64)>,
    armed: Option<Armed>,
    /// Bench time of the last armed fault, s.
    befell_s: Option<f64>,
    /// The last message of a client and its bench time, s.
    heard: Option<(f64, Vec<u8>)>,
    is_block: bool,
    connections: usize,
}

/// The instrument as its server sees it.
struct Served(Remote);

impl Remote {
    /// Puts a device under remote control. Returns the device to serve in its place.
    pub fn of(device: Box<dyn Device>) -> (Box<dyn Device>, Self) {
        let remote = Self(Arc::new(Mutex::new(Controlled {
            device,
            late_s: (0.0, 0.0),
            absence: None,
            armed: None,
            befell_s: None,
            heard: None,
            is_block: false,
            connections: 0,
        })));
        (Box::new(Served(remote.clone())), remote)
    }

    fn lock(&self) -> MutexGuard<'_, Controlled> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Sends a message as another client does, and gives its answer.
    pub fn send(&self, now_s: f64, message: &str) -> Vec<u8> {
        self.lock().device.handle(now_s, message.as_bytes())
    }

    /// Makes every answer late by a time, s.
    pub fn delay(&self, late_s: f64) {
        self.lock().late_s.0 = late_s;
    }

    /// Makes blocks of data later still, s.
    pub fn delay_blocks(&self, late_s: f64) {
        self.lock().late_s.1 = late_s;
    }

    /// Takes the instrument off its network until a bench time, s: its cable is out, or, `closed`,
    /// its connections are.
    pub fn leave(&self, until_s: f64, closed: bool) {
        let absence = if closed {
            Absence::Closed
        } else {
            Absence::Silent { until_s }
        };
        self.lock().absence = Some((absence, until_s));
    }

    /// Makes the next exchange that fits go wrong.
    pub fn arm(&self, armed: Armed) {
        self.lock().armed = Some(armed);
    }

    /// When an armed fault befell an exchange last, bench s.
    pub fn befell_s(&self) -> Option<f64> {
        self.lock().befell_s
    }

    /// Returns the last message of a client, and its bench time, s.
    pub fn heard(&self) -> Option<(f64, String)> {
        let controlled = self.lock();
        let (now_s, message) = controlled.heard.as_ref()?;
        Some((*now_s, String::from_utf8_lossy(message).into_owned()))
    }

    /// Returns the number of connections so far.
    pub fn connections(&self) -> usize {
        self.lock().connections
    }
}

impl Device for Served {
    fn terminator(&self) -> Terminator {
        self.0.lock().device.terminator()
    }

    fn handle(&mut self, now_s: f64, message: &[u8]) -> Vec<u8> {
        let mut controlled = self.0.lock();
        let reply = controlled.device.handle(now_s, message);
        controlled.heard = Some((now_s, message.to_vec()));
        controlled.is_block = reply.len() > BLOCK_BYTES;
        reply
    }

    fn trouble(&mut self, now_s: f64, message: &[u8]) -> Option<Trouble> {
        let mut controlled = self.0.lock();
        let text = String::from_utf8_lossy(message);
        let fits = |armed: &Armed| text.contains(&armed.within);
        if controlled.armed.as_ref().is_some_and(fits)
            && let Some(armed) = controlled.armed.take()
        {
            controlled.befell_s = Some(now_s);
            return Some(Trouble {
                fault: armed.fault,
                share: 0.5,
            });
        }
        controlled.device.trouble(now_s, message)
    }

    fn connected(&mut self, now_s: f64) {
        let mut controlled = self.0.lock();
        controlled.connections += 1;
        controlled.device.connected(now_s);
    }

    fn late_s(&self, now_s: f64) -> f64 {
        let controlled = self.0.lock();
        let (late_s, block_s) = controlled.late_s;
        let block_s = if controlled.is_block { block_s } else { 0.0 };
        controlled.device.late_s(now_s) + late_s + block_s
    }

    fn end_late_s(&self) -> f64 {
        self.0.lock().device.end_late_s()
    }

    fn absence(&self, now_s: f64) -> Option<Absence> {
        let controlled = self.0.lock();
        let away = controlled.absence.filter(|(_, until_s)| now_s < *until_s);
        away.map(|(absence, _)| absence)
            .or_else(|| controlled.device.absence(now_s))
    }

    fn refuses_second(&self) -> bool {
        self.0.lock().device.refuses_second()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Echo;

    impl Device for Echo {
        fn terminator(&self) -> Terminator {
            Terminator::Lf
        }

        fn handle(&mut self, _now_s: f64, message: &[u8]) -> Vec<u8> {
            message.to_vec()
        }
    }

    #[test]
    fn an_armed_fault_befalls_the_first_message_that_fits_and_no_other() {
        let (mut device, remote) = Remote::of(Box::new(Echo));
        remote.arm(Armed {
            fault: Fault::Truncate,
            within: "DATA".to_owned(),
        });
        assert_eq!(device.trouble(1.0, b"*IDN?"), None);
        assert_eq!(remote.befell_s(), None);
        let trouble = device.trouble(2.0, b"WAV:DATA?").map(|one| one.fault);
        assert_eq!(trouble, Some(Fault::Truncate));
        assert_eq!(device.trouble(3.0, b"WAV:DATA?"), None);
        assert_eq!(remote.befell_s(), Some(2.0));
    }

    #[test]
    fn an_instrument_is_away_until_it_is_back_and_late_where_it_answers_a_block() {
        let (mut device, remote) = Remote::of(Box::new(Echo));
        remote.leave(7.0, false);
        let silent = Some(Absence::Silent { until_s: 7.0 });
        assert_eq!(device.absence(6.9), silent);
        assert_eq!(device.absence(7.0), None);
        remote.leave(9.0, true);
        assert_eq!(device.absence(8.0), Some(Absence::Closed));
        remote.delay(0.3);
        remote.delay_blocks(3.0);
        device.handle(10.0, b"1.5");
        assert!((device.late_s(10.0) - 0.3).abs() < 1.0e-9);
        device.handle(10.0, &[b'7'; 2000]);
        assert!((device.late_s(10.0) - 3.3).abs() < 1.0e-9);
        assert_eq!(remote.heard().map(|(now_s, _)| now_s), Some(10.0));
        assert_eq!(remote.send(11.0, ":INP ON"), b":INP ON");
    }
}
