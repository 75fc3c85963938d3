//! GPIB through an adapter of the Prologix type, on the network or on a serial port. No other
//! client may use the adapter.
//!
//! The adapter passes on the data it reads without marking their end. After each read the client
//! therefore queries the adapter's version: this text, known from the start, arrives when the read
//! is done, and cannot be mistaken for data.

use std::io;

use instruments_scpi::excerpt;
use tokio::io::{AsyncReadExt, AsyncWriteExt};

use super::{Arrival, Stream, cut_off};
use crate::wire::prologix::{Marked, escaped};

/// Settings of the adapter: controller, no automatic reads, nothing added to data but EOI, a read
/// timeout of half a second, and none of this is written into its memory.
const SETTINGS: &[u8] =
    b"++savecfg 0\n++mode 1\n++auto 0\n++eos 3\n++eoi 1\n++eot_enable 0\n++read_tmo_ms 500\n";
/// Number of unrecognised bytes from an adapter after which the client gives up.
const MOST_GREETING: usize = 1 << 20;
/// Shortest text of an adapter about itself, bytes.
const LEAST_NAME: usize = 5;
const READ_BYTES: usize = 64 << 10;

/// An instrument behind an adapter.
#[derive(Debug)]
pub struct Gpib {
    stream: Stream,
    answers: Marked,
    /// Outstanding replies of the adapter. The data before all but the last reply are discarded.
    under_way: usize,
    /// Bytes of the message in hand came in an earlier read.
    has_begun: bool,
    /// Bytes came in the read in hand.
    has_data: bool,
    /// The last byte was NL.
    at_line_end: bool,
    /// Something was given up while it was sent.
    cut_off: bool,
}

impl Gpib {
    pub(super) async fn open(mut stream: Stream, address: u8) -> io::Result<Self> {
        let name = greet(&mut stream).await?;
        let answers = Marked::new(name);
        let mut client = Self {
            stream,
            answers,
            under_way: 0,
            has_begun: false,
            has_data: false,
            at_line_end: false,
            cut_off: false,
        };
        let answer = client
            .tell(&[SETTINGS, format!("++addr {address}\n++addr\n").as_bytes()].concat())
            .await?;
        // An adapter that repeats its identity has passed so far. It may have answered unknown
        // settings, too.
        match String::from_utf8_lossy(&answer)
            .split_ascii_whitespace()
            .last()
        {
            Some(taken) if taken == address.to_string() => Ok(client),
            _ => Err(no_adapter(&format!("takes address {address}"), &answer)),
        }
    }

    pub(super) async fn send(&mut self, message: &[u8]) -> io::Result<()> {
        (self.has_begun, self.has_data) = (false, false);
        self.write(&escaped(message)).await
    }

    pub(super) async fn receive(&mut self) -> io::Result<Arrival> {
        loop {
            if self.under_way == 0 {
                self.has_data = false;
                self.order(b"++read eoi\n").await?;
            }
            let (bytes, done) = self.piece().await?;
            if let Some(&last) = bytes.last() {
                (self.has_data, self.at_line_end) = (true, last == b'\n');
            }
            // A read may also be over because the instrument paused. A message ends with NL, or
            // nothing comes after it.
            let end = done
                && if self.has_data {
                    self.at_line_end
                } else {
                    self.has_begun
                };
            if done {
                self.has_begun = self.has_data && !end;
            }
            if end || !bytes.is_empty() {
                return Ok(Arrival { bytes, end });
            }
        }
    }

    pub(super) async fn clear(&mut self) -> io::Result<()> {
        (self.has_begun, self.has_data) = (false, false);
        self.tell(b"++clr\n").await.map(drop)
    }

    pub(super) async fn status_byte(&mut self) -> io::Result<u8> {
        let answer = self.tell(b"++spoll\n").await?;
        let text = String::from_utf8_lossy(&answer);
        text.trim().parse().map_err(|_| {
            io::Error::new(
                io::ErrorKind::InvalidData,
                format!(
                    "expected a status byte from the adapter, found `{}`",
                    excerpt(&answer)
                ),
            )
        })
    }

    /// Sends commands to the adapter, waits until it is done, and returns its output.
    async fn tell(&mut self, commands: &[u8]) -> io::Result<Vec<u8>> {
        self.order(commands).await?;
        let mut answer = Vec::new();
        loop {
            let (bytes, done) = self.piece().await?;
            answer.extend(bytes);
            if done {
                return Ok(answer);
            }
        }
    }

    async fn order(&mut self, commands: &[u8]) -> io::Result<()> {
        self.under_way += 1;
        self.write(&[commands, b"++ver\n"].concat()).await
    }

    /// Returns a part of the data for the last order, and whether the adapter is done with it. May
    /// be abandoned.
    async fn piece(&mut self) -> io::Result<(Vec<u8>, bool)> {
        loop {
            let (bytes, done) = self.answers.pull();
            let is_last = self.under_way <= 1;
            if done {
                self.under_way = self.under_way.saturating_sub(1);
            }
            if is_last && (done || !bytes.is_empty()) {
                return Ok((bytes, done));
            }
            if !done {
                let mut buffer = vec![0; READ_BYTES];
                let count = self.stream.read(&mut buffer).await?;
                if count == 0 {
                    return Err(io::ErrorKind::UnexpectedEof.into());
                }
                self.answers.push(buffer.get(..count).unwrap_or_default());
            }
        }
    }

    async fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        if std::mem::replace(&mut self.cut_off, true) {
            return Err(cut_off());
        }
        self.stream.write_all(bytes).await?;
        self.stream.flush().await?;
        self.cut_off = false;
        Ok(())
    }
}

/// Asks the adapter twice for its identity. The text that is repeated at the end is its reply;
/// anything before it belongs to an earlier session.
async fn greet(stream: &mut Stream) -> io::Result<Vec<u8>> {
    stream.write_all(b"++ver\n++ver\n").await?;
    stream.flush().await?;
    let mut heard = Vec::new();
    let mut buffer = vec![0; READ_BYTES];
    while heard.len() < MOST_GREETING {
        let count = stream.read(&mut buffer).await?;
        if count == 0 {
            return Err(io::ErrorKind::UnexpectedEof.into());
        }
        heard.extend_from_slice(buffer.get(..count).unwrap_or_default());
        let mut lines = heard.split_inclusive(|&byte| byte == b'\n').rev();
        if let (Some(last), Some(before)) = (lines.next(), lines.next())
            && last.ends_with(b"\n")
            && before.ends_with(last)
            && last.len() >= LEAST_NAME
        {
            if last.to_ascii_lowercase().starts_with(b"unrecogni") {
                break;
            }
            return Ok(last.to_vec());
        }
    }
    Err(no_adapter("reports its version", &heard))
}

fn no_adapter(that: &str, found: &[u8]) -> io::Error {
    io::Error::new(
        io::ErrorKind::InvalidData,
        format!(
            "expected a GPIB adapter that {that}, found `{}`",
            excerpt(found)
        ),
    )
}
