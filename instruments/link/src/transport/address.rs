//! Addresses as text; a written address parses to the same address.
//!
//! * `tcp://HOST:PORT`: a raw socket
//! * `serial:/dev/ttyUSB0?baud=4800&parity=even&data=7&stop=1&flow=rtscts`: a serial port
//! * `vxi11:HOST/inst0`, `vxi11:HOST/inst0?portmapper=PORT`, `vxi11:HOST:PORT/inst0`: VXI-11; the
//!   port mapper is queried for the port, or the port is known
//! * `hislip:HOST/hislip0`, `hislip:HOST:PORT/hislip0`: HiSLIP
//! * `usbtmc:/dev/usbtmc0`: USBTMC
//! * `usb:VID:PID:SERIAL`: the same, wherever the device is plugged in; written as
//!   `usbtmc:/dev/usbtmc-VID-PID-SERIAL`
//! * `gpib:tcp:HOST:1234/ADDRESS`, `gpib:serial:/dev/ttyUSB0/ADDRESS?baud=…`: GPIB behind an
//!   adapter of the Prologix type
//! * `memory:NAME`: a pipe inside this process

mod error;
mod serial;
#[cfg(test)]
mod tests;

use std::{fmt, str::FromStr};

pub use serial::{DataBits, Flow, Parity, SerialSettings, StopBits};

use super::usb::UsbName;
use crate::wire::{hislip, prologix, rpc};
pub use error::AddressError;

/// Address of an instrument.
///
/// ```
/// use instruments_link::transport::Address;
/// # fn main() -> Result<(), instruments_link::transport::AddressError> {
/// let address: Address = "tcp://192.0.2.20:5025".parse()?;
/// assert_eq!(address.host(), Some("192.0.2.20"));
/// assert_eq!(address.to_string(), "tcp://192.0.2.20:5025");
/// assert!("tcp://192.0.2.20".parse::<Address>().is_err());
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum Address {
    /// A raw TCP socket.
    Tcp(Socket),
    /// A serial port.
    Serial(SerialSettings),
    /// A VXI-11 device.
    Vxi11 {
        /// A host name, an IPv4 address, or an IPv6 address in brackets.
        host: String,
        /// How its port is found.
        port: Vxi11Port,
        /// The device's name there, such as `inst0`.
        device: String,
    },
    /// A HiSLIP device.
    HiSlip {
        /// Host and port.
        socket: Socket,
        /// The device's name there, such as `hislip0`.
        device: String,
    },
    /// A USBTMC device.
    UsbTmc {
        /// The device's file, such as `/dev/usbtmc0`.
        path: String,
    },
    /// An instrument on a GPIB bus.
    Gpib {
        /// The adapter.
        adapter: Adapter,
        /// Its primary address, 0 to 30.
        address: u8,
    },
    /// A pipe inside this process.
    Memory {
        /// The name under which a mock listens: letters, digits, `.`, `_` and `-`.
        name: String,
    },
}

/// A TCP port.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Socket {
    /// A host name, an IPv4 address, or an IPv6 address in brackets.
    pub host: String,
    /// The port, not zero.
    pub port: u16,
}

impl fmt::Display for Socket {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}", self.host, self.port)
    }
}

/// How the core channel of a VXI-11 device is found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Vxi11Port {
    /// The port mapper at this port provides it; 111 by the standard.
    Mapped(u16),
    /// It is at this port.
    Fixed(u16),
}

/// Address of a GPIB adapter.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub enum Adapter {
    /// On the network.
    Tcp(Socket),
    /// On a serial port.
    Serial(SerialSettings),
}

impl Address {
    /// Returns the host, if there is one.
    pub fn host(&self) -> Option<&str> {
        match self {
            Self::Tcp(socket)
            | Self::HiSlip { socket, .. }
            | Self::Gpib {
                adapter: Adapter::Tcp(socket),
                ..
            } => Some(&socket.host),
            Self::Vxi11 { host, .. } => Some(host),
            Self::Serial(_)
            | Self::UsbTmc { .. }
            | Self::Gpib {
                adapter: Adapter::Serial(_),
                ..
            }
            | Self::Memory { .. } => None,
        }
    }

    /// Returns the device file, if there is one.
    pub fn path(&self) -> Option<&str> {
        match self {
            Self::Serial(settings)
            | Self::Gpib {
                adapter: Adapter::Serial(settings),
                ..
            } => Some(&settings.path),
            Self::UsbTmc { path } => Some(path),
            _ => None,
        }
    }
}

const FORMS: &str = "tcp://HOST:PORT, serial:/dev/PORT?baud=9600&parity=none, vxi11:HOST/inst0, \
hislip:HOST/hislip0, usbtmc:/dev/usbtmc0, usb:VID:PID:SERIAL, \
     gpib:tcp:HOST:PORT/ADDRESS, gpib:serial:/dev/PORT/ADDRESS or memory:NAME";

impl FromStr for Address {
    type Err = AddressError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let unknown = || AddressError::new("address", FORMS, text);
        let (kind, rest) = text.split_once(':').ok_or_else(unknown)?;
        match kind {
            "tcp" => socket(rest.strip_prefix("//").ok_or_else(unknown)?, None).map(Self::Tcp),
            "serial" => SerialSettings::read(rest).map(Self::Serial),
            "vxi11" => vxi11(rest),
            "hislip" => {
                let (place, device) = rest.split_once('/').unwrap_or((rest, "hislip0"));
                Ok(Self::HiSlip {
                    socket: socket(place, Some(hislip::PORT))?,
                    device: named(device)?,
                })
            }
            "usbtmc" => match rest.starts_with('/') && !rest.chars().any(char::is_control) {
                true => Ok(Self::UsbTmc {
                    path: rest.to_owned(),
                }),
                false => Err(AddressError::new(
                    "path",
                    "the absolute path of a device such as /dev/usbtmc0",
                    rest,
                )),
            },
            "usb" => match rest.parse::<UsbName>() {
                Ok(name) => Ok(Self::UsbTmc { path: name.alias() }),
                Err(()) => Err(AddressError::new(
                    "usb device",
                    "vendor and product in four hexadecimal digits and a serial number, such as \
                    f4ec:1017:SDS08A0X000001",
                    rest,
                )),
            },
            "gpib" => gpib(rest).ok_or_else(unknown)?,
            "memory" => {
                let good =
                    |byte: u8| byte.is_ascii_alphanumeric() || matches!(byte, b'.' | b'_' | b'-');
                if rest.is_empty() || !rest.bytes().all(good) {
                    return Err(AddressError::new(
                        "name",
                        "letters, digits, `.`, `_` and `-`",
                        rest,
                    ));
                }
                Ok(Self::Memory {
                    name: rest.to_owned(),
                })
            }
            _ => Err(unknown()),
        }
    }
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Tcp(socket) => write!(f, "tcp://{socket}"),
            Self::Memory { name } => write!(f, "memory:{name}"),
            Self::Serial(settings) => write!(f, "serial:{settings}"),
            Self::Vxi11 { host, port, device } => match port {
                Vxi11Port::Fixed(port) => write!(f, "vxi11:{host}:{port}/{device}"),
                Vxi11Port::Mapped(rpc::PORT_MAPPER_PORT) => write!(f, "vxi11:{host}/{device}"),
                Vxi11Port::Mapped(port) => write!(f, "vxi11:{host}/{device}?portmapper={port}"),
            },
            Self::HiSlip { socket, device } => write!(f, "hislip:{socket}/{device}"),
            Self::UsbTmc { path } => write!(f, "usbtmc:{path}"),
            Self::Gpib {
                adapter: Adapter::Tcp(socket),
                address,
            } => write!(f, "gpib:tcp:{socket}/{address}"),
            Self::Gpib {
                adapter: Adapter::Serial(settings),
                address,
            } => {
                write!(
                    f,
                    "gpib:serial:{}/{address}?{}",
                    settings.path,
                    settings.options()
                )
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

/// Parses `HOST:PORT`; the port may be omitted if there is a usual one.
fn socket(text: &str, usual: Option<u16>) -> Result<Socket, AddressError> {
    let (host, port) = match text
        .rsplit_once(':')
        .filter(|(_, port)| !port.contains(']'))
    {
        Some((host, port)) => (host, Some(port)),
        None => (text, None),
    };
    let bracketed = host
        .strip_prefix('[')
        .and_then(|inner| inner.strip_suffix(']'));
    let good = match bracketed {
        Some(inner) => inner.parse::<std::net::Ipv6Addr>().is_ok(),
        None => {
            !host.is_empty()
                && host
                    .bytes()
                    .all(|byte| byte.is_ascii_alphanumeric() || matches!(byte, b'.' | b'-' | b'_'))
        }
    };
    if !good {
        return Err(AddressError::new(
            "host",
            "a host name, an IPv4 address or an IPv6 address in brackets",
            host,
        ));
    }
    let port = match (port, usual) {
        (None, Some(usual)) => usual,
        (port, _) => port_number(port.unwrap_or_default())?,
    };
    Ok(Socket {
        host: host.to_owned(),
        port,
    })
}

fn port_number(text: &str) -> Result<u16, AddressError> {
    let digits = !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    match text.parse() {
        Ok(port @ 1..=u16::MAX) if digits => Ok(port),
        _ => Err(AddressError::new(
            "port",
            "a number from 1 to 65535 after the host",
            text,
        )),
    }
}

fn named(device: &str) -> Result<String, AddressError> {
    let good = |byte: u8| byte.is_ascii_alphanumeric() || matches!(byte, b'_' | b'-' | b',');
    match !device.is_empty() && device.bytes().all(good) {
        true => Ok(device.to_owned()),
        false => Err(AddressError::new(
            "device",
            "a name such as inst0 or hislip0",
            device,
        )),
    }
}

fn vxi11(text: &str) -> Result<Address, AddressError> {
    let (text, option) = text
        .split_once('?')
        .map_or((text, None), |(text, option)| (text, Some(option)));
    let (place, device) = text.split_once('/').unwrap_or((text, "inst0"));
    // Zero marks an omitted port.
    let Socket { host, port } = socket(place, Some(0))?;
    let port = match (port, option) {
        (0, None) => Vxi11Port::Mapped(rpc::PORT_MAPPER_PORT),
        (0, Some(option)) => {
            let number = option.strip_prefix("portmapper=");
            Vxi11Port::Mapped(port_number(
                number.ok_or_else(|| AddressError::new("option", "portmapper=PORT", option))?,
            )?)
        }
        (port, None) => Vxi11Port::Fixed(port),
        (_, Some(option)) => {
            return Err(AddressError::new(
                "option",
                "a port or a port mapper, not both",
                option,
            ));
        }
    };
    Ok(Address::Vxi11 {
        host,
        port,
        device: named(device)?,
    })
}

/// Returns `None` for another kind of adapter.
fn gpib(text: &str) -> Option<Result<Address, AddressError>> {
    let (kind, rest) = text.split_once(':')?;
    let (place, options) = rest.split_once('?').unwrap_or((rest, ""));
    let (place, address) = place.rsplit_once('/').unwrap_or((place, ""));
    let adapter = match kind {
        "tcp" if !options.is_empty() => Err(AddressError::new(
            "option",
            "none for an adapter on the network",
            options,
        )),
        "tcp" => socket(place, None).map(Adapter::Tcp),
        "serial" => SerialSettings::read(&format!("{place}?{options}")).map(Adapter::Serial),
        _ => return None,
    };
    let number = address
        .parse()
        .ok()
        .filter(|&number| number <= prologix::MOST_ADDRESS && !address.starts_with('+'));
    let wrong = || {
        AddressError::new(
            "gpib address",
            "a number from 0 to 30 behind the adapter and a `/`",
            address,
        )
    };
    Some(adapter.and_then(|adapter| {
        Ok(Address::Gpib {
            adapter,
            address: number.ok_or_else(wrong)?,
        })
    }))
}
