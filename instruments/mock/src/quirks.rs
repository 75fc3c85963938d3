//! Differences between two instruments of one model, or between the model and its manual. They are
//! named switches, each with the model's own way as its default.
//!
//! The switches that every model has, and those of the transfer of blocks and of the error queue,
//! are worked by one piece each; the others by the model.

use std::{collections::BTreeMap, fmt};

/// One switch.
#[derive(Debug, Clone, Copy)]
pub struct Quirk {
    /// Its name in a bench file.
    pub name: &'static str,
    /// Effect of the quirk, for people.
    pub about: &'static str,
    /// Values that it can take, and its default.
    pub kind: Kind,
}

/// Values that a switch can take.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Kind {
    /// On or off.
    Switch(bool),
    /// A number, with its least and its greatest value.
    Number(f64, (f64, f64)),
    /// One of these keywords; the first is the default.
    Word(&'static [&'static str]),
    /// Any text; empty by default.
    Text,
}

/// State of a quirk.
#[derive(Debug, Clone, PartialEq, serde::Deserialize)]
#[serde(untagged)]
pub enum Value {
    /// On or off.
    Switch(bool),
    /// A number.
    Number(f64),
    /// A keyword.
    Word(String),
}

/// A switch that a model does not have, or a value that it cannot take.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("quirk {name}: expected {expected}, found {found}")]
pub struct QuirkError {
    /// The name that was given.
    pub name: String,
    expected: String,
    found: String,
}

/// States of the quirks of one instrument.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Quirks(BTreeMap<String, Value>);

const fn quirk(name: &'static str, about: &'static str, kind: Kind) -> Quirk {
    Quirk { name, about, kind }
}

/// Quirks of the wire or of a box before the instrument that any of them may have.
pub(super) const COMMON: &[Quirk] = &[
    quirk(
        "echo",
        "every message is sent back before it is answered",
        Kind::Switch(false),
    ),
    quirk(
        "min_gap",
        "interval after a message within which the next one is lost, s",
        Kind::Number(0.0, (0.0, 10.0)),
    ),
    quirk(
        "first_answer",
        "delay of the first answer on a connection, s",
        Kind::Number(0.0, (0.0, 60.0)),
    ),
    quirk(
        "late_end",
        "delay of the last byte of an answer, s",
        Kind::Number(0.0, (0.0, 10.0)),
    ),
    quirk(
        "digits",
        "significant digits of an answer of one number; 0: as the model prints it",
        Kind::Number(0.0, (0.0, 12.0)),
    ),
    quirk(
        "lacks",
        "a text, such as `BTWV?`: a message that holds it gets no answer, as with firmware that does \
        not know it; empty: none",
        Kind::Text,
    ),
    quirk(
        "identity",
        "the answer to `*IDN?` of another unit or firmware; empty: the model's own",
        Kind::Text,
    ),
    quirk(
        "latency",
        "how long it takes to answer: no time, or as owners measured it, where that is known",
        Kind::Word(&["none", "measured"]),
    ),
    quirk(
        "second_client",
        "a client that connects while another is served waits, or is refused",
        Kind::Word(&["starve", "refuse"]),
    ),
];
/// Of models that send blocks with one line end.
pub(super) const BLOCKS: &[Quirk] = &[
    quirk(
        "double_end",
        "two line ends behind a block",
        Kind::Switch(false),
    ),
    PREFIX,
];
/// Of models that send blocks with two line ends.
pub(super) const DOUBLE_BLOCKS: &[Quirk] = &[
    quirk(
        "double_end",
        "two line ends behind a block",
        Kind::Switch(true),
    ),
    PREFIX,
];
const PREFIX: Quirk = quirk(
    "block_prefix",
    "a text before the `#` of a block",
    Kind::Switch(false),
);
/// Of models with an error queue.
pub(super) const QUEUE: &[Quirk] = &[quirk(
    "unknown",
    "what an unknown header gets",
    Kind::Word(&["error", "silence"]),
)];
/// Quirk of models that refuse out-of-range values.
pub(super) const REFUSES: &[Quirk] = &[quirk(
    "clamps",
    "an out-of-range value is clamped without an error",
    Kind::Switch(false),
)];
/// Quirk of models that clamp out-of-range values.
pub(super) const CLAMPS: &[Quirk] = &[quirk(
    "clamps",
    "an out-of-range value is clamped without an error",
    Kind::Switch(true),
)];

/// Models whose function query returns another keyword than the one that sets it.
const FUNCTION: Quirk = quirk(
    "function_word",
    "the function query returns another keyword than the one that sets it",
    Kind::Switch(true),
);
pub(super) const KEPCO_MG: &[Quirk] = &[
    quirk(
        "off_active",
        "its output, when off, is held at zero volts until a command changes that",
        Kind::Switch(false),
    ),
    FUNCTION,
];
pub(super) const KEPCO_LINEAR: &[Quirk] = &[
    quirk(
        "analog_wired",
        "the analog input is wired up and commands the output whenever that is on",
        Kind::Switch(true),
    ),
    FUNCTION,
];
const BURSTS: Quirk = quirk(
    "bursts",
    "it can play bursts of a given number of periods",
    Kind::Switch(true),
);
pub(super) const B33500: &[Quirk] = &[BURSTS];
pub(super) const SDG: &[Quirk] = &[
    BURSTS,
    quirk(
        "least_amplitude",
        "its least amplitude into an open circuit, V peak to peak",
        Kind::Number(2e-3, (2e-3, 2e-2)),
    ),
    quirk(
        "header",
        "answers begin with the header of the question",
        Kind::Switch(true),
    ),
    quirk(
        "units",
        "numbers in answers have their units behind them",
        Kind::Switch(true),
    ),
    quirk(
        "errors",
        "what `SYST:ERR?` gets where nothing is queued",
        Kind::Word(&["text", "signed", "silence"]),
    ),
];
/// Of supplies whose cheaper variants have coarser steps.
pub(super) const STEPS: &[Quirk] = &[quirk(
    "step",
    "smallest step of voltage and current, V and A: 0.01 in an SPD3303X-E and in a DP832 without A",
    Kind::Number(0.001, (0.001, 0.01)),
)];
const LEADS: Quirk = quirk(
    "lead_ohm",
    "resistance of the leads of the load, whose drop it measures without remote sense, Ω",
    Kind::Number(0.0, (0.0, 1.0)),
);
pub(super) const SDL: &[Quirk] = &[
    FUNCTION,
    LEADS,
    quirk(
        "unknown",
        "what an unknown question gets: nothing, or `**ERROR**`",
        Kind::Word(&["silence", "stars"]),
    ),
];
pub(super) const FAST_PS: &[Quirk] = &[
    quirk("local", "it takes no command: NAK 15", Kind::Switch(false)),
    quirk(
        "fault",
        "a fault is latched: NAK 08 to MON",
        Kind::Switch(false),
    ),
    quirk(
        "no_analog_input",
        "it lacks the option: NAK 24",
        Kind::Switch(false),
    ),
    quirk(
        "own_volts",
        "what MLIMITS says of the voltage, V",
        Kind::Number(20.0, (0.0, 20.0)),
    ),
    quirk(
        "own_amps",
        "what MLIMITS says of the current, A",
        Kind::Number(20.0, (0.0, 20.0)),
    ),
];
const PAGE: Quirk = quirk(
    "page_points",
    "points in one page of a waveform",
    Kind::Number(10_000_000.0, (1.0, 10_000_000.0)),
);
const STICKY: Quirk = quirk(
    "sticky_transfer",
    "how waveforms are sent stays from one client to the next",
    Kind::Switch(true),
);
const STOP: Quirk = quirk(
    "stop_delay",
    "time for which it continues after a stop command, s",
    Kind::Number(0.0, (0.0, 60.0)),
);
const BUSY: Quirk = quirk(
    "busy_opc",
    "`*OPC?` is not answered while it acquires; else it says nothing of that",
    Kind::Switch(false),
);
const UNIT: Quirk = quirk(
    "unit_after_probe",
    "another probe factor makes amperes of the volts",
    Kind::Switch(false),
);
pub(super) const SDS: &[Quirk] = &[
    PAGE,
    quirk(
        "announced_points",
        "points that it announces for a page; 0: as many as it sends",
        Kind::Number(0.0, (0.0, 10_000_000.0)),
    ),
    quirk(
        "zeroed_descriptor",
        "a descriptor of zeros before the first frame; else it does not answer",
        Kind::Switch(true),
    ),
    STICKY,
    STOP,
    BUSY,
    UNIT,
];
pub(super) const DHO: &[Quirk] = &[
    PAGE,
    STICKY,
    STOP,
    BUSY,
    UNIT,
    quirk(
        "flash",
        "the status shows `TD` only for a moment",
        Kind::Switch(true),
    ),
];
pub(super) const DL3000: &[Quirk] = &[
    LEADS,
    quirk(
        "measured_end",
        "two line ends behind a measurement",
        Kind::Switch(true),
    ),
    FUNCTION,
];
pub(super) const JULABO: &[Quirk] = &[
    quirk(
        "local",
        "left in manual mode at its panel: it obeys no command",
        Kind::Switch(false),
    ),
    quirk(
        "strict_pacing",
        "a command that comes too soon after a write is lost",
        Kind::Switch(false),
    ),
];
pub(super) const HUBER: &[Quirk] = &[quirk(
    "bath_sensor",
    "what its bath shows",
    Kind::Word(&["present", "absent", "unknown"]),
)];
pub(super) const SDM: &[Quirk] = &[
    quirk(
        "unit",
        "unit of temperatures that an earlier client left",
        Kind::Word(&["C", "F", "K"]),
    ),
    quirk(
        "open_thermocouple",
        "nothing is connected",
        Kind::Switch(false),
    ),
];
pub(super) const SCANNER: &[Quirk] = &[quirk(
    "open_thermocouple",
    "nothing is connected",
    Kind::Switch(false),
)];
pub(super) const RELAYS: &[Quirk] = &[
    quirk(
        "sensor",
        "what becomes of a conversion",
        Kind::Word(&["sound", "crc", "power_on", "stuck", "absent"]),
    ),
    quirk(
        "relay",
        "what the relays do",
        Kind::Word(&["sound", "refused", "welded"]),
    ),
];

impl Quirks {
    /// Quirks of a model as they are given, the others at their defaults.
    pub(super) fn of(known: &[&'static [Quirk]], given: &Self) -> Result<Self, QuirkError> {
        let all = || known.iter().copied().flatten();
        let mut quirks: BTreeMap<String, Value> = all()
            .map(|quirk| (quirk.name.to_owned(), quirk.kind.usual()))
            .collect();
        for (name, value) in &given.0 {
            let Some(quirk) = all().find(|quirk| quirk.name == name) else {
                let expected = format!(
                    "one of {}",
                    all().map(|quirk| quirk.name).collect::<Vec<_>>().join(", ")
                );
                return Err(QuirkError {
                    name: name.clone(),
                    expected,
                    found: format!("`{name}`"),
                });
            };
            if !quirk.kind.takes(value) {
                return Err(QuirkError {
                    name: name.clone(),
                    expected: quirk.kind.to_string(),
                    found: value.to_string(),
                });
            }
            quirks.insert(name.clone(), value.clone());
        }
        Ok(Self(quirks))
    }

    /// Returns the same with one more.
    #[must_use]
    pub fn with(mut self, name: &str, value: impl Into<Value>) -> Self {
        self.0.insert(name.to_owned(), value.into());
        self
    }

    /// Returns a switch; off if the model does not have it.
    pub(super) fn is(&self, name: &str) -> bool {
        self.0.get(name) == Some(&Value::Switch(true))
    }

    /// Returns a number; 0 if the model does not have it.
    pub(super) fn number(&self, name: &str) -> f64 {
        if let Some(Value::Number(number)) = self.0.get(name) {
            *number
        } else {
            0.0
        }
    }

    /// A number of things.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "of a bounded kind"
    )]
    pub(super) fn count(&self, name: &str) -> usize {
        self.number(name).max(0.0) as usize
    }

    /// Returns a keyword; empty if the model does not have it.
    pub(super) fn word(&self, name: &str) -> &str {
        if let Some(Value::Word(word)) = self.0.get(name) {
            word
        } else {
            ""
        }
    }
}

impl FromIterator<(String, Value)> for Quirks {
    fn from_iter<T: IntoIterator<Item = (String, Value)>>(given: T) -> Self {
        Self(given.into_iter().collect())
    }
}

impl Kind {
    fn usual(self) -> Value {
        match self {
            Self::Switch(on) => on.into(),
            Self::Number(number, _) => number.into(),
            Self::Word(words) => words.first().copied().unwrap_or("").into(),
            Self::Text => "".into(),
        }
    }

    fn takes(self, value: &Value) -> bool {
        match (self, value) {
            (Self::Switch(_), Value::Switch(_)) => true,
            (Self::Number(_, (least, greatest)), Value::Number(number)) => {
                (least..=greatest).contains(number)
            }
            (Self::Word(words), Value::Word(word)) => words.contains(&word.as_str()),
            (Self::Text, Value::Word(_)) => true,
            _ => false,
        }
    }

    /// Settings worth trying, the usual one left out.
    pub fn others(self) -> Vec<Value> {
        match self {
            Self::Switch(on) => vec![(!on).into()],
            Self::Number(usual, (least, greatest)) => {
                // Of a wide span its geometric middle too.
                let middle = (least.max(1e-3) * greatest).sqrt();
                [least, middle, greatest]
                    .into_iter()
                    .filter(|number| *number != usual)
                    .map(Value::from)
                    .collect()
            }
            Self::Word(words) => words.iter().skip(1).map(|word| (*word).into()).collect(),
            Self::Text => Vec::new(),
        }
    }
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Switch(_) => f.write_str("true or false"),
            Self::Number(_, (least, greatest)) => write!(f, "a number from {least} to {greatest}"),
            Self::Word(words) => write!(f, "one of {}", words.join(", ")),
            Self::Text => f.write_str("a text"),
        }
    }
}

impl fmt::Display for Value {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Switch(on) => on.fmt(f),
            Self::Number(number) => number.fmt(f),
            Self::Word(word) => write!(f, "`{word}`"),
        }
    }
}

impl From<bool> for Value {
    fn from(on: bool) -> Self {
        Self::Switch(on)
    }
}

impl From<f64> for Value {
    fn from(number: f64) -> Self {
        Self::Number(number)
    }
}

impl From<&str> for Value {
    fn from(word: &str) -> Self {
        Self::Word(word.to_owned())
    }
}
