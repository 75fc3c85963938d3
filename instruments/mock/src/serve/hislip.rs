//! A device on HiSLIP: synchronous and asynchronous channel, version 1.0, synchronised mode.

use std::{
    collections::HashMap,
    io,
    net::SocketAddr,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, AtomicUsize, Ordering},
    },
};

use instruments_link::{
    clock::Clock,
    wire::{
        WireError,
        hislip::{
            BAD_INITIALISATION, HEADER_BYTES, Kind, Message, Messages, TOO_MANY_CLIENTS,
            UNKNOWN_MESSAGE, VERSION,
        },
    },
};
use instruments_scpi::decode::ProgramFramer;
use tokio::{
    io::{AsyncReadExt, AsyncWriteExt},
    net::{TcpListener, TcpStream, ToSocketAddrs},
    sync::watch,
    task::JoinHandle,
};

use super::{
    accept_all,
    backplane::{Backplane, MESSAGE_AVAILABLE, ResponsePiece},
};
use crate::Device;

/// Maximum message size announced to the client, bytes.
const MOST_BYTES: usize = 256 << 10;
/// Least message that a client may ask for, bytes.
const LEAST_BYTES: usize = 64;
const READ_BYTES: usize = 16 << 10;
/// Flag by which a client confirms that it has read the whole of the last answer.
const DELIVERED: u8 = 1;

/// Serves on HiSLIP until the task is aborted. Returns the address actually bound, so that port 0
/// can be requested.
///
/// # Errors
/// The operating system's error if the address cannot be bound.
pub async fn serve_hislip(
    device: Box<dyn Device>,
    address: impl ToSocketAddrs,
    clock: Clock,
) -> io::Result<(SocketAddr, JoinHandle<()>)> {
    let listener = TcpListener::bind(address).await?;
    let bound = listener.local_addr()?;
    let (plane, _work) = Backplane::start(device, clock.clone());
    let server = Arc::new(Server {
        plane,
        clock: clock.clone(),
        sessions: Mutex::default(),
    });
    let task = tokio::spawn(accept_all(listener, clock, move |stream| {
        let server = server.clone();
        async move {
            server
                .connection(Channel {
                    stream,
                    messages: Messages::new(MOST_BYTES),
                })
                .await
        }
    }));
    Ok((bound, task))
}

struct Server {
    plane: Backplane,
    clock: Clock,
    sessions: Mutex<Sessions>,
}

#[derive(Default)]
struct Sessions {
    next: u16,
    open: HashMap<u16, Arc<Session>>,
}

struct Session {
    /// Most bytes in a message to the client.
    most_bytes: AtomicUsize,
    has_async: AtomicBool,
    /// Between the two halves of a device clear.
    clearing: AtomicBool,
    /// A reply was sent completely, and the client has not acknowledged it.
    unread: AtomicBool,
    locked: AtomicBool,
    ended: watch::Sender<bool>,
}

impl Session {
    fn new() -> Arc<Self> {
        Arc::new(Self {
            most_bytes: AtomicUsize::new(MOST_BYTES),
            has_async: AtomicBool::new(false),
            clearing: AtomicBool::new(false),
            unread: AtomicBool::new(false),
            locked: AtomicBool::new(false),
            ended: watch::Sender::new(false),
        })
    }

    async fn ended(&self) {
        // An error would mean that the sender is dropped, but it lives as long as this value.
        let _ = self.ended.subscribe().wait_for(|ended| *ended).await;
    }

    fn delivered(&self, control: u8) {
        if control & DELIVERED != 0 {
            self.unread.store(false, Ordering::Relaxed);
        }
    }
}

/// One of the two connections of a session.
struct Channel {
    stream: TcpStream,
    messages: Messages,
}

impl Channel {
    /// Returns the next message; `None` when the client has gone. May be abandoned.
    async fn next(&mut self) -> io::Result<Option<Message>> {
        loop {
            match self.messages.pull() {
                Ok(Some(message)) => return Ok(Some(message)),
                Ok(None) => {}
                Err(error) => {
                    self.fatal(1, &error.to_string()).await?;
                    return Err(error.into());
                }
            }
            let mut buffer = [0; READ_BYTES];
            let count = self.stream.read(&mut buffer).await?;
            if count == 0 {
                return Ok(None);
            }
            self.messages.push(buffer.get(..count).unwrap_or_default());
        }
    }

    async fn send(&mut self, message: Message) -> io::Result<()> {
        self.stream.write_all(&message.encode()).await
    }

    async fn fatal(&mut self, code: u8, text: &str) -> io::Result<()> {
        self.send(Message::new(Kind::FatalError, code, 0).with(text))
            .await
    }

    async fn refuse(&mut self, message: &Message) -> io::Result<()> {
        let text = format!("unexpected message {:?}", message.kind);
        self.send(Message::new(Kind::Error, UNKNOWN_MESSAGE, 0).with(text))
            .await
    }
}

impl Server {
    fn sessions(&self) -> MutexGuard<'_, Sessions> {
        self.sessions.lock().unwrap_or_else(PoisonError::into_inner)
    }

    async fn connection(&self, mut channel: Channel) -> io::Result<()> {
        let Some(first) = channel.next().await? else {
            return Ok(());
        };
        match first.kind {
            Ok(Kind::Initialize) => self.synchronous(channel, &first).await,
            Ok(Kind::AsyncInitialize) => {
                let session = u16::try_from(first.parameter)
                    .ok()
                    .and_then(|id| self.sessions().open.get(&id).cloned());
                match session {
                    Some(session) => self.asynchronous(channel, &session).await,
                    None => channel.fatal(BAD_INITIALISATION, "no such session").await,
                }
            }
            _ => {
                channel
                    .fatal(BAD_INITIALISATION, "expected Initialize or AsyncInitialize")
                    .await
            }
        }
    }

    async fn synchronous(&self, mut channel: Channel, first: &Message) -> io::Result<()> {
        if !first.payload.eq_ignore_ascii_case(b"hislip0") && !first.payload.is_empty() {
            return channel
                .fatal(BAD_INITIALISATION, "no such device: this is hislip0")
                .await;
        }
        let Some(_seat) = self.plane.sit_down(&self.clock).await else {
            return channel
                .fatal(TOO_MANY_CLIENTS, "another client is served")
                .await;
        };
        // Ids restart: an answer to the last client would pass for one to this.
        self.plane.clear();
        let session = Session::new();
        let id = {
            let mut sessions = self.sessions();
            sessions.next = sessions.next.wrapping_add(1);
            let id = sessions.next;
            sessions.open.insert(id, session.clone());
            id
        };
        let outcome = self.converse(&mut channel, &session, id).await;
        session.ended.send_replace(true);
        self.sessions().open.remove(&id);
        outcome
    }

    async fn converse(&self, channel: &mut Channel, session: &Session, id: u16) -> io::Result<()> {
        let mut framer = self.plane.framer();
        let mut breaks = self.plane.breaks();
        let mut is_silent = false;
        channel
            .send(Message::new(
                Kind::InitializeResponse,
                0,
                VERSION << 16 | u32::from(id),
            ))
            .await?;
        loop {
            let most = session.most_bytes.load(Ordering::Relaxed) - HEADER_BYTES;
            let may_send = !is_silent && !session.clearing.load(Ordering::Relaxed);
            tokio::select! {
                message = channel.next() => match message? {
                    None => return Ok(()),
                    Some(message) => self.synchronous_message(channel, session, &mut framer, message).await?,
                },
                taken = self.plane.take(most, None), if may_send => {
                    is_silent = taken.stops;
                    send_data(channel, session, taken).await?;
                }
                () = session.ended() => return Ok(()),
                _ = breaks.changed() => return Ok(()),
            }
        }
    }

    async fn synchronous_message(
        &self,
        channel: &mut Channel,
        session: &Session,
        framer: &mut ProgramFramer,
        message: Message,
    ) -> io::Result<()> {
        match message.kind {
            Ok(Kind::Data | Kind::DataEnd) if !session.has_async.load(Ordering::Relaxed) => {
                channel
                    .fatal(2, "the asynchronous channel is missing")
                    .await?;
                return Err(WireError::new("a session of two channels", "one").into());
            }
            Ok(Kind::Data | Kind::DataEnd) => {
                session.delivered(message.control);
                if !session.clearing.load(Ordering::Relaxed) {
                    framer.push(&message.payload);
                    if message.kind == Ok(Kind::DataEnd) {
                        framer.end();
                    }
                    self.plane.hand_over(framer, message.parameter).await;
                }
            }
            Ok(Kind::DeviceClearComplete) => {
                framer.clear();
                self.plane.clear();
                session.unread.store(false, Ordering::Relaxed);
                session.clearing.store(false, Ordering::Relaxed);
                channel
                    .send(Message::new(Kind::DeviceClearAcknowledge, 0, 0))
                    .await?;
            }
            // The mocks have no trigger input.
            Ok(Kind::Trigger) => session.delivered(message.control),
            Ok(Kind::Error) => {
                tracing::warn!(text = %String::from_utf8_lossy(&message.payload), "the client \
                reports an error");
            }
            Ok(Kind::FatalError) => return Err(io::ErrorKind::ConnectionAborted.into()),
            _ => channel.refuse(&message).await?,
        }
        Ok(())
    }

    async fn asynchronous(&self, mut channel: Channel, session: &Session) -> io::Result<()> {
        session.has_async.store(true, Ordering::Relaxed);
        // The vendor's two letters.
        channel
            .send(Message::new(
                Kind::AsyncInitializeResponse,
                0,
                u32::from_be_bytes(*b"\0\0xx"),
            ))
            .await?;
        let outcome = loop {
            tokio::select! {
                message = channel.next() => match message {
                    Err(error) => break Err(error),
                    Ok(None) => break Ok(()),
                    Ok(Some(message)) => {
                        let reply = self.asynchronous_message(session, &message);
                        let sent = match reply {
                            Some(reply) => channel.send(reply).await,
                            None => channel.refuse(&message).await,
                        };
                        if sent.is_err() {
                            break sent;
                        }
                    }
                },
                () = session.ended() => break Ok(()),
            }
        };
        session.ended.send_replace(true);
        outcome
    }

    fn asynchronous_message(&self, session: &Session, message: &Message) -> Option<Message> {
        let reply = |kind, control| Message::new(kind, control, 0);
        Some(match message.kind.ok()? {
            Kind::AsyncMaxMsgSize => {
                let size = message
                    .payload
                    .iter()
                    .fold(0_u64, |size, &byte| size << 8 | u64::from(byte));
                let size = usize::try_from(size)
                    .unwrap_or(usize::MAX)
                    .clamp(LEAST_BYTES, MOST_BYTES);
                session.most_bytes.store(size, Ordering::Relaxed);
                reply(Kind::AsyncMaxMsgSizeResponse, 0).with((MOST_BYTES as u64).to_be_bytes())
            }
            Kind::AsyncStatusQuery => {
                session.delivered(message.control);
                let unread = if session.unread.load(Ordering::Relaxed) {
                    MESSAGE_AVAILABLE
                } else {
                    0
                };
                reply(Kind::AsyncStatusResponse, self.plane.status_byte() | unread)
            }
            Kind::AsyncDeviceClear => {
                session.clearing.store(true, Ordering::Relaxed);
                self.plane.clear();
                reply(Kind::AsyncDeviceClearAcknowledge, 0)
            }
            // With one client at a time a lock is free; 1 is success, 3 that there was none to
            // release.
            Kind::AsyncLock => {
                let wanted = message.control == 1;
                let had = session.locked.swap(wanted, Ordering::Relaxed);
                reply(Kind::AsyncLockResponse, if wanted || had { 1 } else { 3 })
            }
            Kind::AsyncLockInfo => {
                let locked = u8::from(session.locked.load(Ordering::Relaxed));
                Message::new(Kind::AsyncLockInfoResponse, locked, locked.into())
            }
            Kind::AsyncRemoteLocalControl => reply(Kind::AsyncRemoteLocalResponse, 0),
            _ => return None,
        })
    }
}

async fn send_data(
    channel: &mut Channel,
    session: &Session,
    taken: ResponsePiece,
) -> io::Result<()> {
    let kind = if taken.end { Kind::DataEnd } else { Kind::Data };
    channel
        .send(Message::new(kind, 0, taken.id).with(taken.bytes))
        .await?;
    if taken.end {
        session.unread.store(true, Ordering::Relaxed);
    }
    if taken.stops {
        channel.stream.shutdown().await?;
    }
    Ok(())
}
