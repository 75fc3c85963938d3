//! Simulated instruments on ports, for all transports.

use std::{io, path::Path, str::FromStr};

use instruments::{
    clock::Clock,
    transport::{Adapter, Address, SerialSettings, Socket, Vxi11Port},
};

use bench_plan::mocks::{self, Device};

/// Transport behind which a mock can be put on a free port.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Transport {
    /// A raw socket.
    Tcp,
    /// VXI-11 without a port mapper.
    Vxi11,
    /// VXI-11 with its own port mapper.
    Vxi11Mapped,
    /// HiSLIP.
    HiSlip,
    /// A GPIB adapter on the network, at address 9.
    Gpib,
    /// A pseudo terminal.
    Serial,
}

impl Transport {
    const WORDS: [(&'static str, Self); 6] = [
        ("tcp", Self::Tcp),
        ("vxi11", Self::Vxi11),
        ("vxi11-mapped", Self::Vxi11Mapped),
        ("hislip", Self::HiSlip),
        ("gpib", Self::Gpib),
        ("serial", Self::Serial),
    ];
}

/// Serves mocks over another transport than that in their addresses: all of them (`TRANSPORT`), or
/// one (`ROLE=TRANSPORT`).
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Over {
    /// Only this role.
    pub role: Option<String>,
    /// The transport.
    pub transport: Transport,
}

impl FromStr for Over {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let (role, word) = text
            .split_once('=')
            .map_or((None, text), |(role, word)| (Some(role.to_owned()), word));
        let transport = Transport::WORDS
            .iter()
            .find(|(known, _)| *known == word)
            .map(|&(_, transport)| transport);
        let known = || Transport::WORDS.map(|(word, _)| word).join(", ");
        Ok(Self {
            role,
            transport: transport.ok_or_else(|| {
                format!(
                    "expected TRANSPORT or ROLE=TRANSPORT out of {}, found `{text}`",
                    known()
                )
            })?,
        })
    }
}

const LOOPBACK: &str = "127.0.0.1";
const GPIB_ADDRESS: u8 = 9;

/// Serves on a free port of the loopback interface.
pub(super) async fn on_a_free_port(
    device: Box<dyn Device>,
    transport: Transport,
    clock: &Clock,
) -> io::Result<Address> {
    let (any, clock) = ((LOOPBACK, 0), clock.clone());
    let socket = |port| Socket {
        host: LOOPBACK.to_owned(),
        port,
    };
    let vxi11 = |port| Address::Vxi11 {
        host: LOOPBACK.to_owned(),
        port,
        device: "inst0".to_owned(),
    };
    Ok(match transport {
        Transport::Tcp => {
            Address::Tcp(socket(mocks::serve_tcp(device, any, clock).await?.0.port()))
        }
        Transport::Vxi11 => vxi11(Vxi11Port::Fixed(
            mocks::serve_vxi11(device, any, None, clock)
                .await?
                .0
                .core
                .port(),
        )),
        Transport::Vxi11Mapped => {
            let (ports, _task) = mocks::serve_vxi11(device, any, Some(any), clock).await?;
            vxi11(Vxi11Port::Mapped(
                ports.port_mapper.map_or(0, |mapper| mapper.port()),
            ))
        }
        Transport::HiSlip => Address::HiSlip {
            socket: socket(mocks::serve_hislip(device, any, clock).await?.0.port()),
            device: "hislip0".to_owned(),
        },
        Transport::Gpib => {
            let (bound, _task) = mocks::serve_gpib(device, any, GPIB_ADDRESS, clock).await?;
            Address::Gpib {
                adapter: Adapter::Tcp(socket(bound.port())),
                address: GPIB_ADDRESS,
            }
        }
        Transport::Serial => {
            Address::Serial(SerialSettings::new(&mocks::serve_pty(device, clock)?.0))
        }
    })
}

/// Serves at the configured address; a serial port becomes a pseudo terminal with the same
/// settings.
pub(super) async fn at(
    device: Box<dyn Device>,
    address: &Address,
    clock: &Clock,
) -> io::Result<Address> {
    let clock = clock.clone();
    let text = |host: &str, port: u16| format!("{host}:{port}");
    let mut address = address.clone();
    match &mut address {
        Address::Tcp(socket) => drop(mocks::serve_tcp(device, socket.to_string(), clock).await?),
        Address::Vxi11 {
            host,
            port: Vxi11Port::Fixed(port),
            ..
        } => drop(mocks::serve_vxi11(device, text(host, *port), None, clock).await?),
        Address::Vxi11 {
            host,
            port: Vxi11Port::Mapped(mapper),
            ..
        } => {
            drop(
                mocks::serve_vxi11(device, text(host, 0), Some(text(host, *mapper)), clock).await?,
            );
        }
        Address::HiSlip { socket, .. } => {
            drop(mocks::serve_hislip(device, socket.to_string(), clock).await?);
        }
        Address::Gpib {
            adapter: Adapter::Tcp(socket),
            address,
        } => {
            drop(mocks::serve_gpib(device, socket.to_string(), *address, clock).await?);
        }
        Address::Gpib {
            adapter: Adapter::Serial(settings),
            address,
        } => settings.path = mocks::serve_gpib_pty(device, *address, clock)?.0,
        Address::Serial(settings) => settings.path = mocks::serve_pty(device, clock)?.0,
        Address::UsbTmc { path } => drop(mocks::serve_usbtmc(device, Path::new(path), clock)?),
        Address::Memory { .. } => {
            return Err(io::Error::other(
                "expected a port, found a name in this process",
            ));
        }
    }
    Ok(address)
}
