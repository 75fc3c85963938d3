//! Trait of every mock, and its options.

use instruments_scpi::decode::Terminator;

use super::{
    faults::Trouble,
    quirks::{Quirks, Value},
};

/// A simulated instrument: answers messages, acts on its world, reads it.
///
/// ```
/// use instruments_mock::Device;
/// use instruments_scpi::decode::Terminator;
///
/// struct Thermometer;
///
/// impl Device for Thermometer {
///     fn terminator(&self) -> Terminator {
///         Terminator::Lf
///     }
///
///     fn handle(&mut self, _now_s: f64, message: &[u8]) -> Vec<u8> {
///         match message {
///             b"MEAS:TEMP?" => b"25.0\n".to_vec(),
///             _ => Vec::new(),
///         }
///     }
/// }
///
/// assert_eq!(Thermometer.handle(0.0, b"MEAS:TEMP?"), b"25.0\n");
/// ```
pub trait Device: Send {
    /// Terminator of messages to the instrument.
    fn terminator(&self) -> Terminator;

    /// Handles one message (without its terminator) at bench time `now_s` and returns the whole
    /// reply, terminators included, or nothing for silence. Times never decrease from one call to
    /// the next.
    fn handle(&mut self, now_s: f64, message: &[u8]) -> Vec<u8>;

    /// Fault of the wire with the message that is about to be handled; `None` with a sound
    /// instrument.
    fn trouble(&mut self, _now_s: f64, _message: &[u8]) -> Option<Trouble> {
        None
    }

    /// A client has come.
    fn connected(&mut self, _now_s: f64) {}

    /// How late the answer to a message of `now_s` is, s.
    fn late_s(&self, now_s: f64) -> f64 {
        let _ = now_s;
        0.0
    }

    /// How much later the last byte of an answer comes than the others, s.
    fn end_late_s(&self) -> f64 {
        0.0
    }

    /// How the instrument is away from its network at `now_s`; `None` while it is reached.
    fn absence(&self, now_s: f64) -> Option<Absence> {
        let _ = now_s;
        None
    }

    /// Returns whether a second client is refused while the first is served. Otherwise it waits.
    fn refuses_second(&self) -> bool {
        false
    }
}

/// How an instrument is away from its network.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Absence {
    /// The cable is out until this bench time, s: messages arrive when it is back, as TCP repeats
    /// them.
    Silent {
        /// When it is back, s.
        until_s: f64,
    },
    /// Every connection is closed, and its messages are lost.
    Closed,
}

/// Options of a mock.
#[derive(Debug, Clone, PartialEq)]
pub struct MockOptions {
    /// Serial number in the identity (`34970A` has none, `julabo` no identity).
    pub serial_number: String,
    /// In which ways it differs from the usual one; each model has its own (`Model::quirks`).
    pub quirks: Quirks,
    /// Bench time at which it is switched on, s.
    pub since_s: f64,
}

impl MockOptions {
    /// Returns the usual one but for one quirk.
    pub fn quirk(name: &str, value: impl Into<Value>) -> Self {
        Self {
            quirks: Quirks::default().with(name, value),
            ..Self::default()
        }
    }
}

impl Default for MockOptions {
    fn default() -> Self {
        Self {
            serial_number: "SIM00001".to_owned(),
            quirks: Quirks::default(),
            since_s: 0.0,
        }
    }
}
