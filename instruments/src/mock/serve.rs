//! Puts a simulated instrument on a port: in process, TCP or a pseudo terminal.
//!
//! One client at a time, as the instruments have it: the next one waits until the first has gone. The instrument keeps its settings from one
//! client to the next. Everything runs on the caller's runtime, without threads, so that in virtual time in-process streams stay exact.

use std::{io, net::SocketAddr};

use tokio::{
    io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt},
    net::{TcpListener, TcpStream, ToSocketAddrs},
    task::JoinHandle,
};

use super::{Device, Fault, Trouble};
use crate::{
    clock::Clock,
    scpi::decode::ProgramFramer,
    transport::{MemoryHub, MemoryListener, Pty, TransportError},
};

/// Longest message that a mock reads, bytes; a longer one is dropped.
const LONGEST_MESSAGE: usize = 1 << 20;
const READ_BYTES: usize = 4096;

/// Answers one client until it goes.
///
/// # Errors
/// What the transport says when reading or writing fails.
pub async fn serve(device: &mut dyn Device, mut stream: impl AsyncRead + AsyncWrite + Unpin + Send, clock: &Clock) -> io::Result<()> {
    let mut framer = ProgramFramer::new(device.terminator(), LONGEST_MESSAGE);
    device.connected(clock.now_s());
    let mut buffer = [0_u8; READ_BYTES];
    loop {
        let count = stream.read(&mut buffer).await?;
        let Some(bytes) = buffer.get(..count).filter(|bytes| !bytes.is_empty()) else { return Ok(()) };
        framer.push(bytes);
        while let Some(message) = framer.pull() {
            let message = match message {
                Ok(message) => message,
                Err(error) => {
                    tracing::warn!(%error, "message dropped");
                    continue;
                }
            };
            let now_s = clock.now_s();
            let trouble = device.trouble(now_s, &message);
            let reply = match trouble {
                // The power is back before anybody asks again, and what was asked is forgotten.
                Some(Trouble { fault: Fault::LoseMessage | Fault::PowerCycle, .. }) => Vec::new(),
                _ => device.handle(now_s, &message),
            };
            if !reply.is_empty() {
                clock.sleep_s(device.late_s(now_s)).await;
            }
            match trouble {
                None => answer_in_two(&mut stream, &reply, device.end_late_s(), clock).await?,
                Some(trouble) => {
                    if !answer_badly(&mut stream, reply, (trouble, &message), clock).await? {
                        return Ok(());
                    }
                }
            }
        }
    }
}

async fn answer(stream: &mut (impl AsyncWrite + Unpin), reply: &[u8]) -> io::Result<()> {
    stream.write_all(reply).await?;
    stream.flush().await
}

/// An answer whose last byte may come later than the others.
async fn answer_in_two(stream: &mut (impl AsyncWrite + Unpin), reply: &[u8], end_late_s: f64, clock: &Clock) -> io::Result<()> {
    let Some((end, rest)) = reply.split_last().filter(|_| end_late_s > 0.0) else { return answer(stream, reply).await };
    answer(stream, rest).await?;
    clock.sleep_s(end_late_s).await;
    answer(stream, &[*end]).await
}

/// A late answer that is still in time, one that is not for most links, and a silence that outlasts every one, s.
const LATE_S: f64 = 1.0;
const TOO_LATE_S: f64 = 4.0;
const STALL_S: f64 = 12.0;
/// Pause between two pieces of an answer, s.
const PIECE_S: f64 = 0.05;

/// Sends an answer, or what is left of it; false when the connection is gone.
async fn answer_badly(
    stream: &mut (impl AsyncWrite + Unpin),
    mut reply: Vec<u8>,
    (Trouble { fault, share }, message): (Trouble, &[u8]),
    clock: &Clock,
) -> io::Result<bool> {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, clippy::cast_precision_loss, reason = "an index")]
    let place = (share * reply.len() as f64) as usize;
    match fault {
        Fault::LoseMessage | Fault::LoseReply => return Ok(true),
        Fault::PowerCycle | Fault::Reset => return Ok(false),
        Fault::Delay => clock.sleep_s(share * LATE_S).await,
        Fault::TooLate => clock.sleep_s(TOO_LATE_S).await,
        Fault::Stall => clock.sleep_s(STALL_S).await,
        Fault::Duplicate => reply.extend_from_within(..),
        Fault::Garble => {
            if let Some(byte) = reply.get_mut(place) {
                *byte ^= message.first().map_or(1, |first| first & 0x1f) | 1;
            }
        }
        Fault::Truncate => reply.truncate(place),
        Fault::Split => {
            let (first, second) = reply.split_at(place);
            answer(stream, first).await?;
            clock.sleep_s(PIECE_S).await;
            answer(stream, second).await?;
            return Ok(true);
        }
        Fault::HalfClose => {
            answer(stream, &reply).await?;
            stream.shutdown().await?;
            return Ok(true);
        }
        Fault::Overflow | Fault::OutputOff => {}
    }
    answer(stream, &reply).await?;
    Ok(true)
}

/// Serves under `name` inside this process until the task is aborted or the hub is gone. The name is taken when this returns.
///
/// # Errors
/// [`TransportError`] when the name is taken already.
pub fn serve_memory(device: Box<dyn Device>, hub: &MemoryHub, name: &str, clock: Clock) -> Result<JoinHandle<()>, TransportError> {
    let listener = hub.listen(name)?;
    Ok(tokio::spawn(accept_memory(device, listener, clock)))
}

async fn accept_memory(mut device: Box<dyn Device>, mut listener: MemoryListener, clock: Clock) {
    while let Some(stream) = listener.accept().await {
        if !device.refuses_second() {
            finish(serve(device.as_mut(), stream, &clock).await);
            continue;
        }
        let served = serve(device.as_mut(), stream, &clock);
        tokio::pin!(served);
        let outcome = loop {
            tokio::select! {
                outcome = &mut served => break outcome,
                // Dropped at once: the connection is closed from this side.
                second = listener.accept() => if second.is_none() { break served.await },
            }
        };
        finish(outcome);
    }
}

/// Serves on a TCP port until the task is aborted; gives the address really bound, so that port 0 can be asked for.
///
/// # Errors
/// What the operating system says when the address cannot be bound.
pub async fn serve_tcp(device: Box<dyn Device>, address: impl ToSocketAddrs, clock: Clock) -> io::Result<(SocketAddr, JoinHandle<()>)> {
    let listener = TcpListener::bind(address).await?;
    let bound = listener.local_addr()?;
    Ok((bound, tokio::spawn(accept_tcp(device, listener, clock))))
}

async fn accept_tcp(mut device: Box<dyn Device>, listener: TcpListener, clock: Clock) {
    loop {
        match listener.accept().await {
            Ok((stream, peer)) => {
                tracing::debug!(%peer, "client came");
                if !device.refuses_second() {
                    finish(serve_socket(device.as_mut(), stream, &clock).await);
                    continue;
                }
                let served = serve_socket(device.as_mut(), stream, &clock);
                tokio::pin!(served);
                let outcome = loop {
                    tokio::select! {
                        outcome = &mut served => break outcome,
                        // Dropped at once: the connection is closed from this side.
                        _ = listener.accept() => {}
                    }
                };
                finish(outcome);
            }
            // Such as too many open files: the next attempt may succeed, and must not spin.
            Err(error) => {
                tracing::warn!(%error, "cannot accept a client");
                clock.sleep_s(0.1).await;
            }
        }
    }
}

async fn serve_socket(device: &mut dyn Device, stream: TcpStream, clock: &Clock) -> io::Result<()> {
    // Every answer is one small packet that somebody waits for.
    stream.set_nodelay(true)?;
    serve(device, stream, clock).await
}

/// Serves on a new pseudo terminal until the task is aborted; gives the path that a client opens like a serial port.
///
/// # Errors
/// What the operating system says when it has no pseudo terminal left.
pub fn serve_pty(mut device: Box<dyn Device>, clock: Clock) -> io::Result<(String, JoinHandle<()>)> {
    let pty = Pty::open()?;
    let path = pty.path().to_owned();
    // The terminal outlives its clients: a serial line does not tell the instrument that somebody has gone.
    let task = tokio::spawn(async move { finish(serve(device.as_mut(), pty, &clock).await) });
    Ok((path, task))
}

/// A client that breaks off is no fault of the instrument's.
fn finish(outcome: io::Result<()>) {
    match outcome {
        Ok(()) => tracing::debug!("client gone"),
        Err(error) => tracing::debug!(%error, "client lost"),
    }
}
