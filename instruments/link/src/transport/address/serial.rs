//! Serial ports: `/dev/ttyUSB0?baud=4800&parity=even&data=7&stop=1&flow=rtscts`.

use std::fmt;

use super::AddressError;

/// A serial port and how it is set.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct SerialSettings {
    /// The device's file.
    pub path: String,
    /// Bits per second.
    pub baud: u32,
    /// The parity bit.
    pub parity: Parity,
    /// Bits per character.
    pub data_bits: DataBits,
    /// Stop bits.
    pub stop_bits: StopBits,
    /// How the two ends slow each other down.
    pub flow: Flow,
}

impl SerialSettings {
    /// Creates the settings of `path` at 9600 baud, 8 data bits, no parity, one stop bit, no flow
    /// control.
    pub fn new(path: &str) -> Self {
        Self {
            path: path.to_owned(),
            baud: 9600,
            parity: Parity::None,
            data_bits: DataBits::Eight,
            stop_bits: StopBits::One,
            flow: Flow::None,
        }
    }
}

macro_rules! word_enum {
    ($(#[$doc:meta])* $name:ident { $($(#[$variant_doc:meta])* $variant:ident = $word:literal),+ $(,)? }) => {
        $(#[$doc])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
        pub enum $name {
            $($(#[$variant_doc])* $variant,)+
        }

        impl $name {
            pub(super) const WORDS: &'static [(&'static str, Self)] = &[$(($word, Self::$variant)),+];

            fn word(self) -> &'static str {
                match self {
                    $(Self::$variant => $word,)+
                }
            }

            fn read(field: &'static str, found: &str) -> Result<Self, AddressError> {
                Self::WORDS
                    .iter()
                    .find(|(word, _)| *word == found)
                    .map(|&(_, value)| value)
                    .ok_or_else(|| AddressError {
                        field,
                        expected: Self::WORDS
                            .iter()
                            .map(|(word, _)| *word)
                            .collect::<Vec<_>>()
                            .join(", "),
                        found: found.to_owned(),
                    })
            }
        }
    };
}

word_enum! {
    /// The parity bit.
    Parity {
        /// No parity bit.
        None = "none",
        /// Even.
        Even = "even",
        /// Odd.
        Odd = "odd",
    }
}

word_enum! {
    /// Bits per character.
    DataBits {
        /// Seven.
        Seven = "7",
        /// Eight.
        Eight = "8",
    }
}

word_enum! {
    /// Stop bits.
    StopBits {
        /// One.
        One = "1",
        /// Two.
        Two = "2",
    }
}

word_enum! {
    /// Flow control.
    Flow {
        /// None.
        None = "none",
        /// By the RTS and CTS lines.
        RtsCts = "rtscts",
        /// By XON and XOFF characters.
        XonXoff = "xonxoff",
    }
}

impl fmt::Display for SerialSettings {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}?{}", self.path, self.options())
    }
}

impl SerialSettings {
    /// Reads `PATH?OPTIONS`.
    pub(super) fn read(text: &str) -> Result<Self, AddressError> {
        serial(text)
    }

    /// Returns everything but the path.
    pub(super) fn options(&self) -> String {
        let (parity, data, stop, flow) = (
            self.parity.word(),
            self.data_bits.word(),
            self.stop_bits.word(),
            self.flow.word(),
        );
        format!(
            "baud={}&parity={parity}&data={data}&stop={stop}&flow={flow}",
            self.baud
        )
    }
}

fn serial(rest: &str) -> Result<SerialSettings, AddressError> {
    let (path, options) = rest.split_once('?').unwrap_or((rest, ""));
    if !path.starts_with('/') || path.chars().any(|c| c.is_control() || c == '?') {
        return Err(AddressError::new(
            "path",
            "the absolute path of a device such as /dev/ttyUSB0",
            path,
        ));
    }
    let mut settings = SerialSettings::new(path);
    let mut seen: Vec<&str> = Vec::new();
    for option in options.split('&').filter(|option| !option.is_empty()) {
        let (key, value) = option.split_once('=').unwrap_or((option, ""));
        if seen.contains(&key) {
            return Err(AddressError::new("option", "every option once", option));
        }
        seen.push(key);
        match key {
            "baud" => settings.baud = baud(value)?,
            "parity" => settings.parity = Parity::read("parity", value)?,
            "data" => settings.data_bits = DataBits::read("data", value)?,
            "stop" => settings.stop_bits = StopBits::read("stop", value)?,
            "flow" => settings.flow = Flow::read("flow", value)?,
            _ => {
                return Err(AddressError::new(
                    "option",
                    "baud, parity, data, stop or flow",
                    option,
                ));
            }
        }
    }
    Ok(settings)
}

/// Parses a rate that every driver supports; the hardware would round or refuse others silently.
fn baud(value: &str) -> Result<u32, AddressError> {
    const RATES: [u32; 12] = [
        300, 600, 1200, 2400, 4800, 9600, 19_200, 38_400, 57_600, 115_200, 230_400, 460_800,
    ];
    let rate = RATES.into_iter().find(|rate| rate.to_string() == value);
    rate.ok_or_else(|| {
        AddressError::new(
            "baud",
            &RATES.map(|rate| rate.to_string()).join(", "),
            value,
        )
    })
}
