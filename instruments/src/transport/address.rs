//! Addresses as text: `tcp://host:port`, `serial:/dev/ttyUSB0?baud=4800&parity=even&data=7&stop=1&flow=rtscts`, `memory:name`. What is written is read
//! back to the same address.

use std::{fmt, str::FromStr};

/// Where an instrument is.
#[derive(Debug, Clone, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum Address {
    /// A raw TCP socket.
    Tcp {
        /// A host name, an IPv4 address, or an IPv6 address in brackets.
        host: String,
        /// The port, not zero.
        port: u16,
    },
    /// A serial port.
    Serial(SerialSettings),
    /// A pipe inside this process.
    Memory {
        /// The name under which a mock listens: letters, digits, `.`, `_` and `-`.
        name: String,
    },
}

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
    /// `path` at 9600 baud, 8 data bits, no parity, one stop bit, no flow control.
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
            const WORDS: &'static [(&'static str, Self)] = &[$(($word, Self::$variant)),+];

            fn word(self) -> &'static str {
                match self {
                    $(Self::$variant => $word,)+
                }
            }

            fn read(field: &'static str, found: &str) -> Result<Self, AddressError> {
                Self::WORDS.iter().find(|(word, _)| *word == found).map(|&(_, value)| value).ok_or_else(|| AddressError {
                    field,
                    expected: Self::WORDS.iter().map(|(word, _)| *word).collect::<Vec<_>>().join(", "),
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

/// An address that could not be read.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{field}: expected {expected}, found `{found}`")]
pub struct AddressError {
    field: &'static str,
    expected: String,
    found: String,
}

impl AddressError {
    fn new(field: &'static str, expected: &str, found: &str) -> Self {
        Self { field, expected: expected.to_owned(), found: found.to_owned() }
    }

    /// The part of the address that is wrong: `address`, `host`, `port`, `path`, `baud`, `parity`, `data`, `stop`, `flow`, `option` or `name`.
    pub fn field(&self) -> &'static str {
        self.field
    }
}

impl FromStr for Address {
    type Err = AddressError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        if let Some(rest) = text.strip_prefix("tcp://") {
            tcp(rest)
        } else if let Some(rest) = text.strip_prefix("serial:") {
            serial(rest).map(Self::Serial)
        } else if let Some(name) = text.strip_prefix("memory:") {
            let good = |byte: u8| byte.is_ascii_alphanumeric() || matches!(byte, b'.' | b'_' | b'-');
            if name.is_empty() || !name.bytes().all(good) {
                return Err(AddressError::new("name", "letters, digits, `.`, `_` and `-`", name));
            }
            Ok(Self::Memory { name: name.to_owned() })
        } else {
            Err(AddressError::new("address", "tcp://HOST:PORT, serial:/dev/PORT?baud=9600&parity=none or memory:NAME", text))
        }
    }
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Tcp { host, port } => write!(f, "tcp://{host}:{port}"),
            Self::Memory { name } => write!(f, "memory:{name}"),
            Self::Serial(SerialSettings { path, baud, parity, data_bits, stop_bits, flow }) => {
                let (parity, data, stop, flow) = (parity.word(), data_bits.word(), stop_bits.word(), flow.word());
                write!(f, "serial:{path}?baud={baud}&parity={parity}&data={data}&stop={stop}&flow={flow}")
            }
        }
    }
}

impl TryFrom<String> for Address {
    type Error = AddressError;

    fn try_from(text: String) -> Result<Self, Self::Error> {
        text.parse()
    }
}

impl From<Address> for String {
    fn from(address: Address) -> Self {
        address.to_string()
    }
}

fn tcp(rest: &str) -> Result<Address, AddressError> {
    let (host, port) = rest.rsplit_once(':').filter(|(_, port)| !port.contains(']')).unwrap_or((rest, ""));
    let bracketed = host.strip_prefix('[').and_then(|inner| inner.strip_suffix(']'));
    let good = match bracketed {
        Some(inner) => inner.parse::<std::net::Ipv6Addr>().is_ok(),
        None => !host.is_empty() && host.bytes().all(|byte| byte.is_ascii_alphanumeric() || matches!(byte, b'.' | b'-' | b'_')),
    };
    if !good {
        return Err(AddressError::new("host", "a host name, an IPv4 address or an IPv6 address in brackets", host));
    }
    let digits = !port.is_empty() && port.bytes().all(|byte| byte.is_ascii_digit());
    match port.parse() {
        Ok(port @ 1..=u16::MAX) if digits => Ok(Address::Tcp { host: host.to_owned(), port }),
        _ => Err(AddressError::new("port", "a number from 1 to 65535 after the host", port)),
    }
}

fn serial(rest: &str) -> Result<SerialSettings, AddressError> {
    let (path, options) = rest.split_once('?').unwrap_or((rest, ""));
    if !path.starts_with('/') || path.chars().any(|c| c.is_control() || c == '?') {
        return Err(AddressError::new("path", "the absolute path of a device such as /dev/ttyUSB0", path));
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
            _ => return Err(AddressError::new("option", "baud, parity, data, stop or flow", option)),
        }
    }
    Ok(settings)
}

/// The rates that every driver knows; others would be rounded or refused by the hardware without a word.
fn baud(value: &str) -> Result<u32, AddressError> {
    const RATES: [u32; 12] = [300, 600, 1200, 2400, 4800, 9600, 19_200, 38_400, 57_600, 115_200, 230_400, 460_800];
    let rate = RATES.into_iter().find(|rate| rate.to_string() == value);
    rate.ok_or_else(|| AddressError::new("baud", &RATES.map(|rate| rate.to_string()).join(", "), value))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn addresses_are_read() {
        let julabo = SerialSettings {
            path: "/dev/ttyUSB0".to_owned(),
            baud: 4800,
            parity: Parity::Even,
            data_bits: DataBits::Seven,
            stop_bits: StopBits::One,
            flow: Flow::RtsCts,
        };
        let table = [
            ("tcp://192.168.1.20:5025", Address::Tcp { host: "192.168.1.20".to_owned(), port: 5025 }),
            ("tcp://scope.lab:5555", Address::Tcp { host: "scope.lab".to_owned(), port: 5555 }),
            ("tcp://[::1]:5025", Address::Tcp { host: "[::1]".to_owned(), port: 5025 }),
            ("serial:/dev/ttyUSB0?baud=4800&parity=even&data=7&stop=1&flow=rtscts", Address::Serial(julabo.clone())),
            ("serial:/dev/ttyUSB0?flow=rtscts&data=7&parity=even&baud=4800", Address::Serial(julabo)),
            ("serial:/dev/ttyS0", Address::Serial(SerialSettings::new("/dev/ttyS0"))),
            ("memory:scope-1", Address::Memory { name: "scope-1".to_owned() }),
        ];
        for (text, address) in table {
            assert_eq!(text.parse(), Ok(address), "{text}");
        }
    }

    #[test]
    fn mistakes_are_named_by_field() {
        let table = [
            (
                "192.168.1.20:5025",
                "address: expected tcp://HOST:PORT, serial:/dev/PORT?baud=9600&parity=none or memory:NAME, found `192.168.1.20:5025`",
            ),
            ("tcp://:5025", "host: expected a host name, an IPv4 address or an IPv6 address in brackets, found ``"),
            ("tcp://a b:5025", "host: expected a host name, an IPv4 address or an IPv6 address in brackets, found `a b`"),
            ("tcp://::1:5025", "host: expected a host name, an IPv4 address or an IPv6 address in brackets, found `::1`"),
            ("tcp://host", "port: expected a number from 1 to 65535 after the host, found ``"),
            ("tcp://[::1]", "port: expected a number from 1 to 65535 after the host, found ``"),
            ("tcp://host:0", "port: expected a number from 1 to 65535 after the host, found `0`"),
            ("tcp://host:65536", "port: expected a number from 1 to 65535 after the host, found `65536`"),
            ("tcp://host:+25", "port: expected a number from 1 to 65535 after the host, found `+25`"),
            ("serial:COM1", "path: expected the absolute path of a device such as /dev/ttyUSB0, found `COM1`"),
            ("serial:/dev/ttyS0?parity=mark", "parity: expected none, even, odd, found `mark`"),
            ("serial:/dev/ttyS0?data=9", "data: expected 7, 8, found `9`"),
            ("serial:/dev/ttyS0?stop=", "stop: expected 1, 2, found ``"),
            ("serial:/dev/ttyS0?flow=hard", "flow: expected none, rtscts, xonxoff, found `hard`"),
            ("serial:/dev/ttyS0?bauds=9600", "option: expected baud, parity, data, stop or flow, found `bauds=9600`"),
            ("serial:/dev/ttyS0?data=7&data=8", "option: expected every option once, found `data=8`"),
            ("memory:", "name: expected letters, digits, `.`, `_` and `-`, found ``"),
            ("memory:a/b", "name: expected letters, digits, `.`, `_` and `-`, found `a/b`"),
        ];
        for (text, message) in table {
            assert_eq!(text.parse::<Address>().unwrap_err().to_string(), message, "{text}");
        }
        let baud = "serial:/dev/ttyS0?baud=9601".parse::<Address>().unwrap_err();
        assert!(baud.to_string().starts_with("baud: expected 300, 600,") && baud.to_string().ends_with("found `9601`"), "{baud}");
        assert_eq!(baud.field(), "baud");
    }

    fn any_address() -> impl Strategy<Value = Address> {
        let words = (0_usize..3, 0_usize..2, 0_usize..2, 0_usize..3);
        prop_oneof![
            ("[a-z0-9.-]{1,20}", 1_u16..).prop_map(|(host, port)| Address::Tcp { host, port }),
            (any::<u128>(), 1_u16..)
                .prop_map(|(bits, port)| Address::Tcp { host: format!("[{}]", std::net::Ipv6Addr::from_bits(bits)), port }),
            "[A-Za-z0-9._-]{1,20}".prop_map(|name| Address::Memory { name }),
            ("/dev/[a-zA-Z0-9/=&._-]{1,20}", prop::sample::select(vec![300, 4800, 115_200]), words).prop_map(
                |(path, baud, (parity, data, stop, flow))| {
                    Address::Serial(SerialSettings {
                        path,
                        baud,
                        parity: Parity::WORDS[parity].1,
                        data_bits: DataBits::WORDS[data].1,
                        stop_bits: StopBits::WORDS[stop].1,
                        flow: Flow::WORDS[flow].1,
                    })
                }
            ),
        ]
    }

    proptest! {
        #[test]
        fn what_is_written_is_read_back(address in any_address()) {
            prop_assert_eq!(address.to_string().parse(), Ok(address));
        }

        #[test]
        fn no_text_makes_the_reader_panic(text in "(tcp://|serial:/|memory:)?[ -~]{0,30}") {
            if let Ok(address) = text.parse::<Address>() {
                prop_assert_eq!(address.to_string().parse(), Ok(address));
            }
        }
    }
}
