//! A scripted instrument behind every transport, for the tests of all transports.

use std::{
    path::PathBuf,
    sync::{
        Arc, Mutex,
        atomic::{AtomicU32, Ordering},
    },
    time::Duration,
};

use instruments::{
    clock::{Clock, TimeMode},
    link::{Grammar, Link, LinkError, LinkProfile},
    mock::{self, Device, Fault, Trouble},
    scpi::{block::encode_definite, decode::Terminator},
    transcript::Tap,
    transport::{Address, Channel, MemoryHub, connect},
};

use crate::device;

pub(crate) const IDENTITY: &str = "ACME,MODEL 1,SN7,1.0";

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    Memory,
    Tcp,
    Serial,
    Vxi11,
    Vxi11Mapped,
    HiSlip,
    UsbTmc,
    Gpib,
    GpibSerial,
}

impl Kind {
    pub(crate) const ALL: [Self; 9] = [
        Self::Memory,
        Self::Tcp,
        Self::Serial,
        Self::Vxi11,
        Self::Vxi11Mapped,
        Self::HiSlip,
        Self::UsbTmc,
        Self::Gpib,
        Self::GpibSerial,
    ];

    /// Returns whether the transport is a byte stream: it marks no end of a reply, and it cannot
    /// clear the instrument.
    pub(crate) fn is_stream(self) -> bool {
        matches!(self, Self::Memory | Self::Tcp | Self::Serial)
    }

    /// Returns whether the connection is the instrument's own: it breaks with it, and can be closed
    /// in one direction.
    pub(crate) fn breaks(self) -> bool {
        matches!(
            self,
            Self::Memory | Self::Tcp | Self::Vxi11 | Self::Vxi11Mapped | Self::HiSlip
        )
    }
}

/// Bytes with every value in them, NL first.
pub(crate) fn payload(length: usize) -> Vec<u8> {
    (0..length)
        .map(|index| ((index * 7 + 10) % 251) as u8)
        .collect()
}

/// A text without control characters.
pub(crate) fn text(length: usize) -> String {
    (0..length)
        .map(|index| char::from(b'!' + (index % 90) as u8))
        .collect()
}

/// Replies as its messages request: `LATE? 1.5` answers after 1.5 s, `BLOCK? 100` with a block of
/// 100 bytes.
#[derive(Clone, Default)]
pub(crate) struct Script {
    heard: Arc<Mutex<Vec<String>>>,
    late_s: f64,
}

impl Script {
    pub(crate) fn heard(&self) -> Vec<String> {
        self.heard.lock().unwrap().clone()
    }

    fn answer(&mut self, message: &str) -> Vec<u8> {
        let (header, argument) = message.split_once(' ').unwrap_or((message, ""));
        let number = || argument.parse::<usize>().unwrap();
        let block = |tail: &[u8]| [&encode_definite(&payload(number())).unwrap(), tail].concat();
        match header {
            "*IDN?" => format!("{IDENTITY}\n").into_bytes(),
            "SYST:ERR?" => b"+0,\"No error\"\n".to_vec(),
            "FAST?" => b"fast\n".to_vec(),
            "LATE?" => {
                self.late_s = argument.parse().unwrap();
                b"late\n".to_vec()
            }
            "LATEBLOCK?" => {
                self.late_s = argument.parse().unwrap();
                [&encode_definite(&payload(100_000)).unwrap(), &b"\n"[..]].concat()
            }
            "SPLIT?" | "HALF?" | "HANGUP?" => b"1.2345\n".to_vec(),
            "EMPTY?" => b"\n".to_vec(),
            "TEXT?" => format!("{}\n", text(number())).into_bytes(),
            "LENGTH?" => format!("{}\n", message.len()).into_bytes(),
            "BLOCK?" => block(b"\n"),
            "TAIL?" => block(b"\n\n"),
            "BARE?" => b"without a line end".to_vec(),
            "ENDLESS?" => [b"#0", &payload(number())[..], b"\n"].concat(),
            _ => Vec::new(),
        }
    }
}

impl Device for Script {
    fn terminator(&self) -> Terminator {
        Terminator::Lf
    }

    fn handle(&mut self, _: f64, message: &[u8]) -> Vec<u8> {
        let message = String::from_utf8(message.to_vec()).unwrap();
        self.late_s = 0.0;
        let answer = self.answer(&message);
        self.heard.lock().unwrap().push(message);
        answer
    }

    fn trouble(&mut self, _: f64, message: &[u8]) -> Option<Trouble> {
        let fault = match message {
            b"SPLIT?" => Fault::Split,
            b"HALF?" => Fault::HalfClose,
            b"HANGUP?" => Fault::Reset,
            _ => return None,
        };
        Some(Trouble { fault, share: 0.5 })
    }

    fn late_s(&self, _: f64) -> f64 {
        self.late_s
    }
}

/// The scripted instrument behind one transport.
pub(crate) struct Bench {
    pub(crate) kind: Kind,
    pub(crate) address: Address,
    pub(crate) script: Script,
    pub(crate) clock: Clock,
    pub(crate) hub: MemoryHub,
}

/// Returns a unique file name.
pub(crate) fn socket_file() -> PathBuf {
    static NUMBER: AtomicU32 = AtomicU32::new(0);
    std::env::temp_dir().join(format!(
        "usbtmc-{}-{}",
        std::process::id(),
        NUMBER.fetch_add(1, Ordering::Relaxed)
    ))
}

/// Puts a device behind a transport; gives its address.
pub(crate) async fn serve(
    kind: Kind,
    device: Box<dyn Device>,
    clock: &Clock,
    hub: &MemoryHub,
) -> Address {
    let (any, clock) = (("127.0.0.1", 0), clock.clone());
    let address = match kind {
        Kind::Memory => {
            mock::serve_memory(device, hub, "device", clock).unwrap();
            "memory:device".to_owned()
        }
        Kind::Tcp => format!(
            "tcp://{}",
            mock::serve_tcp(device, any, clock).await.unwrap().0
        ),
        Kind::Serial => format!("serial:{}", mock::serve_pty(device, clock).unwrap().0),
        Kind::Vxi11 => format!(
            "vxi11:{}/inst0",
            mock::serve_vxi11(device, any, None, clock)
                .await
                .unwrap()
                .0
                .core
        ),
        Kind::Vxi11Mapped => {
            let (ports, _) = mock::serve_vxi11(device, any, Some(any), clock)
                .await
                .unwrap();
            format!(
                "vxi11:127.0.0.1/inst0?portmapper={}",
                ports.port_mapper.unwrap().port()
            )
        }
        Kind::HiSlip => format!(
            "hislip:{}/hislip0",
            mock::serve_hislip(device, any, clock).await.unwrap().0
        ),
        Kind::UsbTmc => {
            let path = socket_file();
            mock::serve_usbtmc(device, &path, clock).unwrap();
            format!("usbtmc:{}", path.display())
        }
        Kind::Gpib => format!(
            "gpib:tcp:{}/9",
            mock::serve_gpib(device, any, 9, clock).await.unwrap().0
        ),
        Kind::GpibSerial => format!(
            "gpib:serial:{}/22?baud=115200",
            mock::serve_gpib_pty(device, 22, clock).unwrap().0
        ),
    };
    address.parse().unwrap()
}

impl Bench {
    async fn new(kind: Kind, clock: Clock) -> Self {
        let (script, hub) = (Script::default(), MemoryHub::new());
        let address = serve(kind, Box::new(script.clone()), &clock, &hub).await;
        Self {
            kind,
            address,
            script,
            clock,
            hub,
        }
    }

    pub(crate) async fn link(&self, profile: LinkProfile, tap: Tap) -> Result<Link, LinkError> {
        device::open(
            &self.address.to_string(),
            profile,
            &self.clock,
            &self.hub,
            tap,
        )
        .await
    }

    pub(crate) async fn patient(&self) -> Link {
        self.link(patient(), Tap::none())
            .await
            .unwrap_or_else(|error| panic!("{:?}: {error}", self.kind))
    }

    pub(crate) async fn channel(&self) -> Channel {
        connect(&self.address, &self.hub).await.unwrap()
    }
}

/// Deadlines that a busy machine does not miss.
pub(crate) fn patient() -> LinkProfile {
    let long = Duration::from_secs(30);
    LinkProfile {
        grammar: Grammar::Plain,
        first_timeout: long,
        timeout: long,
        block_timeout: long,
        ..device::plain()
    }
}

/// Runs a test in real time over each of these transports, one after the other.
#[expect(
    clippy::needless_pass_by_value,
    reason = "a closure is written where it is given"
)]
pub(crate) fn over(kinds: &[Kind], test: impl AsyncFn(&Bench)) {
    for &kind in kinds {
        Clock::runtime(TimeMode::Real).unwrap().block_on(async {
            let bench = Bench::new(kind, Clock::start(TimeMode::Real)).await;
            test(&bench).await;
        });
    }
}

pub(crate) fn kinds(wanted: impl Fn(Kind) -> bool) -> Vec<Kind> {
    Kind::ALL.into_iter().filter(|&kind| wanted(kind)).collect()
}
