//! A device behind a GPIB adapter of the Prologix type (GPIB-ETHERNET and GPIB-USB manuals, section
//! 8). The adapter is not part of the instrument: if the instrument breaks off or half-closes its
//! connection, the adapter stays and does not notice.

use std::{collections::BTreeMap, io, net::SocketAddr, time::Duration};

use instruments_link::{
    clock::Clock,
    transport::Pty,
    wire::prologix::{Line, Lines},
};
use instruments_scpi::decode::ProgramFramer;
use tokio::{
    io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt},
    net::{TcpListener, ToSocketAddrs},
    task::JoinHandle,
};

use super::{LONGEST_MESSAGE, accept, backplane::Backplane, finish};
use crate::Device;

const NAME: &str = "Prologix GPIB-ETHERNET Controller version 01.06.06.00";
const READ_BYTES: usize = 4096;
/// Bytes that the adapter passes on at once.
const CHUNK: usize = 4096;
/// Settings and their values after switching on (manual, section 8); `++read_tmo_ms` in
/// milliseconds.
const SETTINGS: [(&str, u32, u32); 8] = [
    ("mode", 1, 1),
    ("auto", 0, 1),
    ("eoi", 1, 1),
    ("eos", 0, 3),
    ("eot_enable", 0, 1),
    ("eot_char", 0, 255),
    ("read_tmo_ms", 500, 3000),
    ("savecfg", 1, 1),
];

/// Serves at the address `gpib` of an adapter on a TCP port until the task is aborted. Returns the
/// address actually bound, so that port 0 can be requested.
///
/// # Errors
/// The operating system's error if the address cannot be bound.
pub async fn serve_gpib(
    device: Box<dyn Device>,
    address: impl ToSocketAddrs,
    gpib: u8,
    clock: Clock,
) -> io::Result<(SocketAddr, JoinHandle<()>)> {
    let listener = TcpListener::bind(address).await?;
    let bound = listener.local_addr()?;
    let (plane, _work) = Backplane::start(device, clock.clone());
    let task = tokio::spawn(async move {
        loop {
            let stream = accept(&listener, &clock).await;
            finish(Adapter::new(&plane, gpib, &clock).serve(stream).await);
        }
    });
    Ok((bound, task))
}

/// Serves at the address `gpib` of an adapter on a new pseudo terminal until the task is aborted.
/// Returns the path.
///
/// # Errors
/// The operating system's error if it has no pseudo terminal left.
pub fn serve_gpib_pty(
    device: Box<dyn Device>,
    gpib: u8,
    clock: Clock,
) -> io::Result<(String, JoinHandle<()>)> {
    let pty = Pty::open()?;
    let path = pty.path().to_owned();
    let (plane, _work) = Backplane::start(device, clock.clone());
    let task =
        tokio::spawn(async move { finish(Adapter::new(&plane, gpib, &clock).serve(pty).await) });
    Ok((path, task))
}

struct Adapter<'a> {
    plane: &'a Backplane,
    clock: &'a Clock,
    /// The address of the only instrument on the bus.
    instrument: u8,
    /// GPIB address in use.
    addressed: u8,
    settings: BTreeMap<&'static str, u32>,
    framer: ProgramFramer,
}

impl<'a> Adapter<'a> {
    fn new(plane: &'a Backplane, instrument: u8, clock: &'a Clock) -> Self {
        let settings = SETTINGS
            .iter()
            .map(|&(name, value, _)| (name, value))
            .collect();
        Self {
            plane,
            clock,
            instrument,
            addressed: 0,
            settings,
            framer: plane.framer(),
        }
    }

    fn setting(&self, name: &str) -> u32 {
        self.settings.get(name).copied().unwrap_or(0)
    }

    async fn serve(mut self, mut stream: impl AsyncRead + AsyncWrite + Unpin) -> io::Result<()> {
        let mut lines = Lines::new(LONGEST_MESSAGE);
        let mut buffer = [0; READ_BYTES];
        loop {
            let count = stream.read(&mut buffer).await?;
            if count == 0 {
                return Ok(());
            }
            lines.push(buffer.get(..count).unwrap_or_default());
            while let Some(line) = lines.pull() {
                match line {
                    Line::TooLong => tracing::warn!("line dropped"),
                    Line::Data(data) => {
                        self.listen(&data).await;
                        if self.setting("auto") == 1 {
                            self.read(&mut stream, None).await?;
                        }
                    }
                    Line::Command(command) => {
                        let reply = self.command(&mut stream, &command).await?;
                        stream.write_all(reply.as_bytes()).await?;
                    }
                }
                stream.flush().await?;
            }
        }
    }

    /// The instrument hears a line.
    async fn listen(&mut self, data: &[u8]) {
        if self.addressed != self.instrument {
            return;
        }
        let end: &[u8] = match self.setting("eos") {
            0 => b"\r\n",
            1 => b"\r",
            2 => b"\n",
            _ => b"",
        };
        self.framer.push(data);
        self.framer.push(end);
        if self.setting("eoi") == 1 {
            self.framer.end();
        }
        self.plane.hand_over(&mut self.framer, 0).await;
    }

    /// Passes on the instrument's output up to its end, or up to the byte `until`.
    async fn read(
        &mut self,
        stream: &mut (impl AsyncWrite + Unpin),
        until: Option<u8>,
    ) -> io::Result<()> {
        let patience = Duration::from_millis(self.setting("read_tmo_ms").into());
        if self.addressed != self.instrument {
            self.clock.sleep(patience).await;
            return Ok(());
        }
        while let Ok(taken) = self
            .clock
            .deadline(patience, self.plane.take(CHUNK, until))
            .await
        {
            stream.write_all(&taken.bytes).await?;
            if taken.end && self.setting("eot_enable") == 1 {
                stream
                    .write_all(&self.setting("eot_char").to_be_bytes()[3..])
                    .await?;
            }
            stream.flush().await?;
            if taken.end || until.is_some_and(|until| taken.bytes.last() == Some(&until)) {
                break;
            }
        }
        Ok(())
    }

    async fn command(
        &mut self,
        stream: &mut (impl AsyncWrite + Unpin),
        command: &str,
    ) -> io::Result<String> {
        let mut words = command.split_ascii_whitespace();
        let (name, argument) = (
            words.next().unwrap_or_default().to_ascii_lowercase(),
            words.next(),
        );
        let number = argument.and_then(|argument| argument.parse::<u32>().ok());
        let unknown = || Ok("Unrecognized command\r\n".to_owned());
        if let Some(&(name, _, most)) = SETTINGS.iter().find(|(setting, ..)| *setting == name) {
            return Ok(match (argument, number.filter(|&number| number <= most)) {
                (None, _) => format!("{}\r\n", self.setting(name)),
                (Some(_), Some(number)) => {
                    self.settings.insert(name, number);
                    String::new()
                }
                (Some(_), None) => return unknown(),
            });
        }
        let address = |number: u32| {
            u8::try_from(number)
                .ok()
                .filter(|&number| number <= instruments_link::wire::prologix::MOST_ADDRESS)
        };
        let is_there = self.addressed == self.instrument;
        match (name.as_str(), argument) {
            ("addr", None) => return Ok(format!("{}\r\n", self.addressed)),
            ("addr", Some(_)) => match number.and_then(address) {
                Some(number) => self.addressed = number,
                None => return unknown(),
            },
            ("read", Some("eoi") | None) => self.read(stream, None).await?,
            ("read", Some(_)) => {
                self.read(stream, number.and_then(|number| u8::try_from(number).ok()))
                    .await?;
            }
            ("clr", _) => {
                if is_there {
                    self.framer.clear();
                    self.plane.clear();
                }
            }
            ("spoll", _) => {
                let polled = number.map_or(is_there, |number| number == u32::from(self.instrument));
                return Ok(format!(
                    "{}\r\n",
                    if polled { self.plane.status_byte() } else { 0 }
                ));
            }
            ("ver", _) => return Ok(format!("{NAME}\r\n")),
            ("srq", _) => return Ok("0\r\n".to_owned()),
            // Nothing on the bus that these would change.
            ("ifc" | "loc" | "llo" | "trg", _) => {}
            _ => return unknown(),
        }
        Ok(String::new())
    }
}
