//! The client of HiSLIP: synchronous and asynchronous channel, version 1.0, synchronised mode. A
//! reply counts only if it carries the id of the last message, so that a reply to an earlier
//! message is never accepted.

use std::io;

use tokio::{
    io::{AsyncReadExt, AsyncWriteExt},
    net::TcpStream,
};

use super::{Arrival, Socket, cut_off, tcp};
use crate::wire::hislip::{FIRST_ID, HEADER_BYTES, ID_STEP, Kind, Message, Messages, VERSION};

/// Greatest message that is taken, bytes.
const MOST_BYTES: usize = 1 << 20;
const READ_BYTES: usize = 64 << 10;
/// Id of data that belong to no message.
const ANY_ID: u32 = 0xffff_ffff;
/// The server would like to answer several messages at once.
const OVERLAPPED: u8 = 1;

/// A session.
#[derive(Debug)]
pub struct HiSlip {
    synchronous: Half,
    asynchronous: Half,
    /// Id of the next message.
    next_id: u32,
    /// Id of the last one.
    last_id: u32,
    /// Most bytes in one message, its header included.
    most_bytes: usize,
    /// The reply was read completely. The next message reports this to the server.
    delivered: bool,
}

impl HiSlip {
    pub(super) async fn open(socket: &Socket, device: &str) -> io::Result<Self> {
        let mut synchronous = Half::connect(socket).await?;
        // The lower half is the vendor ID; this vendor has no letters.
        synchronous
            .send(
                &Message::new(
                    Kind::Initialize,
                    0,
                    VERSION << 16 | u32::from(u16::from_be_bytes(*b"xx")),
                )
                .with(device),
            )
            .await?;
        let response = synchronous.expect(Kind::InitializeResponse).await?;
        let (version, session) = (response.parameter >> 16, response.parameter & 0xffff);
        if version >> 8 != VERSION >> 8 {
            return Err(io::Error::other(format!(
                "expected a server of HiSLIP 1, found version {}.{}",
                version >> 8,
                version & 0xff
            )));
        }
        let mut asynchronous = Half::connect(socket).await?;
        asynchronous
            .send(&Message::new(Kind::AsyncInitialize, 0, session))
            .await?;
        asynchronous.expect(Kind::AsyncInitializeResponse).await?;
        asynchronous
            .send(
                &Message::new(Kind::AsyncMaxMsgSize, 0, 0).with((MOST_BYTES as u64).to_be_bytes()),
            )
            .await?;
        let size = asynchronous
            .expect(Kind::AsyncMaxMsgSizeResponse)
            .await?
            .payload
            .iter()
            .fold(0_u64, |size, &byte| size << 8 | u64::from(byte));
        let most_bytes = usize::try_from(size)
            .unwrap_or(usize::MAX)
            .clamp(HEADER_BYTES + 1, MOST_BYTES);
        let mut client = Self {
            synchronous,
            asynchronous,
            next_id: FIRST_ID,
            last_id: FIRST_ID,
            most_bytes,
            delivered: false,
        };
        if response.control & OVERLAPPED != 0 {
            client.clear().await?;
        }
        Ok(client)
    }

    pub(super) async fn send(&mut self, message: &[u8]) -> io::Result<()> {
        let mut pieces = message.chunks(self.most_bytes - HEADER_BYTES).peekable();
        while let Some(piece) = pieces.next() {
            let kind = if pieces.peek().is_some() {
                Kind::Data
            } else {
                Kind::DataEnd
            };
            let control = u8::from(std::mem::take(&mut self.delivered));
            self.last_id = self.next_id;
            self.next_id = self.next_id.wrapping_add(ID_STEP);
            self.synchronous
                .send(&Message::new(kind, control, self.last_id).with(piece))
                .await?;
        }
        Ok(())
    }

    pub(super) async fn receive(&mut self) -> io::Result<Arrival> {
        loop {
            let message = self.synchronous.next().await?;
            let end = message.kind == Ok(Kind::DataEnd);
            let is_ours = message.parameter == self.last_id || message.parameter == ANY_ID;
            if matches!(message.kind, Ok(Kind::Data | Kind::DataEnd)) && is_ours {
                self.delivered |= end;
                return Ok(Arrival {
                    bytes: message.payload,
                    end,
                });
            }
            tracing::debug!(kind = ?message.kind, id = message.parameter, "thrown away");
        }
    }

    pub(super) async fn clear(&mut self) -> io::Result<()> {
        self.asynchronous
            .send(&Message::new(Kind::AsyncDeviceClear, 0, 0))
            .await?;
        self.asynchronous
            .expect(Kind::AsyncDeviceClearAcknowledge)
            .await?;
        // No feature is requested: synchronised mode.
        self.synchronous
            .send(&Message::new(Kind::DeviceClearComplete, 0, 0))
            .await?;
        self.synchronous
            .expect(Kind::DeviceClearAcknowledge)
            .await?;
        (self.next_id, self.last_id, self.delivered) = (FIRST_ID, FIRST_ID, false);
        Ok(())
    }

    pub(super) async fn status_byte(&mut self) -> io::Result<u8> {
        let control = u8::from(std::mem::take(&mut self.delivered));
        self.asynchronous
            .send(&Message::new(Kind::AsyncStatusQuery, control, self.last_id))
            .await?;
        self.asynchronous
            .expect(Kind::AsyncStatusResponse)
            .await
            .map(|response| response.control)
    }
}

/// One of the two channels.
#[derive(Debug)]
struct Half {
    stream: TcpStream,
    messages: Messages,
    /// A message was abandoned while it was sent; the stream is unusable.
    cut_off: bool,
}

impl Half {
    async fn connect(socket: &Socket) -> io::Result<Self> {
        Ok(Self {
            stream: tcp::open(&socket.host, socket.port).await?,
            messages: Messages::new(MOST_BYTES),
            cut_off: false,
        })
    }

    async fn send(&mut self, message: &Message) -> io::Result<()> {
        if std::mem::replace(&mut self.cut_off, true) {
            return Err(cut_off());
        }
        self.stream.write_all(&message.encode()).await?;
        self.cut_off = false;
        Ok(())
    }

    /// Returns the next message that reports no error. May be abandoned.
    async fn next(&mut self) -> io::Result<Message> {
        loop {
            if let Some(message) = self.messages.pull()? {
                if let Ok(kind @ (Kind::FatalError | Kind::Error)) = message.kind {
                    let text = String::from_utf8_lossy(&message.payload).into_owned();
                    return Err(io::Error::other(format!(
                        "the server reports {kind:?} {}: {text}",
                        message.control
                    )));
                }
                return Ok(message);
            }
            let mut buffer = vec![0; READ_BYTES];
            let count = self.stream.read(&mut buffer).await?;
            if count == 0 {
                return Err(io::ErrorKind::UnexpectedEof.into());
            }
            self.messages.push(buffer.get(..count).unwrap_or_default());
        }
    }

    /// Waits for a message of this kind; others before it are thrown away.
    async fn expect(&mut self, kind: Kind) -> io::Result<Message> {
        loop {
            let message = self.next().await?;
            if message.kind == Ok(kind) {
                return Ok(message);
            }
        }
    }
}
