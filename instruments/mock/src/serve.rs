//! Serves a simulated instrument on a port: in process, TCP, a pseudo terminal, VXI-11, HiSLIP, a
//! GPIB adapter, or in place of a USBTMC device.
//!
//! Like the instruments, it serves one client at a time. On a stream the next client waits until
//! the first has disconnected, or is refused if a quirk requires it; on other transports it is
//! refused. The instrument keeps its settings from one client to the next. Everything runs on the
//! caller's runtime, without threads, so that in virtual time in-process streams stay exact.

mod answer;
mod backplane;
mod gpib;
mod hislip;
mod usbtmc;
mod vxi11;

use std::{future::Future, io, net::SocketAddr};

pub use gpib::{serve_gpib, serve_gpib_pty};
pub use hislip::serve_hislip;
pub use usbtmc::serve_usbtmc;
pub use vxi11::{Vxi11Ports, serve_vxi11};

use tokio::{
    io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt},
    net::{TcpListener, TcpStream, ToSocketAddrs},
    task::{JoinHandle, JoinSet},
};

use answer::{Step, Then, answer};

use instruments_link::{
    clock::Clock,
    transport::{MemoryHub, MemoryListener, Pty, TransportError},
};
use instruments_scpi::decode::ProgramFramer;

use super::{Absence, Device};

/// Longest message that a mock reads, bytes; a longer one is dropped.
const LONGEST_MESSAGE: usize = 1 << 20;
const READ_BYTES: usize = 4096;

/// Serves one client until it disconnects.
///
/// # Errors
/// The transport's error if reading or writing fails.
pub async fn serve(
    device: &mut dyn Device,
    mut stream: impl AsyncRead + AsyncWrite + Unpin + Send,
    clock: &Clock,
) -> io::Result<()> {
    let mut framer = ProgramFramer::new(device.terminator(), LONGEST_MESSAGE);
    device.connected(clock.now_s());
    let mut buffer = [0_u8; READ_BYTES];
    loop {
        let count = stream.read(&mut buffer).await?;
        let Some(bytes) = buffer.get(..count).filter(|bytes| !bytes.is_empty()) else {
            return Ok(());
        };
        framer.push(bytes);
        while let Some(message) = framer.pull() {
            let message = match message {
                Ok(message) => message,
                Err(error) => {
                    tracing::warn!(%error, "message dropped");
                    continue;
                }
            };
            while let Some(absence) = device.absence(clock.now_s()) {
                match absence {
                    Absence::Silent { until_s } => clock.sleep_s(until_s - clock.now_s()).await,
                    Absence::Closed => return Ok(()),
                }
            }
            let (steps, then) = answer(device, clock.now_s(), &message);
            for step in steps {
                match step {
                    Step::Wait(seconds) => clock.sleep_s(seconds).await,
                    Step::Put { bytes, .. } => {
                        stream.write_all(&bytes).await?;
                        stream.flush().await?;
                    }
                }
            }
            match then {
                Then::Stay => {}
                Then::StopSending => stream.shutdown().await?,
                Then::HangUp => return Ok(()),
            }
        }
    }
}

/// Serves under `name` inside this process until the task is aborted or the hub is gone. The name
/// is taken when this returns.
///
/// # Errors
/// [`TransportError`] when the name is taken already.
pub fn serve_memory(
    device: Box<dyn Device>,
    hub: &MemoryHub,
    name: &str,
    clock: Clock,
) -> Result<JoinHandle<()>, TransportError> {
    let listener = hub.listen(name)?;
    Ok(tokio::spawn(accept_memory(device, listener, clock)))
}

async fn accept_memory(mut device: Box<dyn Device>, mut listener: MemoryListener, clock: Clock) {
    while let Some(stream) = listener.accept().await {
        let mut refuses = device.refuses_second();
        let served = serve(device.as_mut(), stream, &clock);
        tokio::pin!(served);
        let outcome = loop {
            tokio::select! {
                outcome = &mut served => break outcome,
                // Dropped at once: the connection is closed from this side.
                second = listener.accept(), if refuses => refuses = second.is_some(),
            }
        };
        finish(outcome);
    }
}

/// Serves on a TCP port until the task is aborted. Returns the address actually bound, so that port
/// 0 can be requested.
///
/// # Errors
/// The operating system's error if the address cannot be bound.
pub async fn serve_tcp(
    device: Box<dyn Device>,
    address: impl ToSocketAddrs,
    clock: Clock,
) -> io::Result<(SocketAddr, JoinHandle<()>)> {
    let listener = TcpListener::bind(address).await?;
    let bound = listener.local_addr()?;
    Ok((bound, tokio::spawn(accept_tcp(device, listener, clock))))
}

async fn accept_tcp(mut device: Box<dyn Device>, listener: TcpListener, clock: Clock) {
    loop {
        let stream = accept(&listener, &clock).await;
        let refuses = device.refuses_second();
        let served = serve(device.as_mut(), stream, &clock);
        tokio::pin!(served);
        let outcome = loop {
            tokio::select! {
                outcome = &mut served => break outcome,
                // Dropped at once: the connection is closed from this side.
                _ = accept(&listener, &clock), if refuses => {}
            }
        };
        finish(outcome);
    }
}

/// Waits for the next client.
async fn accept(listener: &TcpListener, clock: &Clock) -> TcpStream {
    loop {
        // Every reply is one small packet whose receiver is waiting.
        match listener
            .accept()
            .await
            .and_then(|(stream, _)| stream.set_nodelay(true).map(|()| stream))
        {
            Ok(stream) => return stream,
            // Such as too many open files: the next attempt may succeed, and must not spin.
            Err(error) => {
                tracing::warn!(%error, "cannot accept a client");
                clock.sleep_s(0.1).await;
            }
        }
    }
}

/// Serves every client in a separate task; the tasks end with this one.
async fn accept_all<F: Future<Output = io::Result<()>> + Send + 'static>(
    listener: TcpListener,
    clock: Clock,
    mut client: impl FnMut(TcpStream) -> F + Send + 'static,
) {
    let mut clients = JoinSet::new();
    loop {
        tokio::select! {
            stream = accept(&listener, &clock) => {
                let client = client(stream);
                clients.spawn(async move { finish(client.await) });
            }
            Some(_) = clients.join_next() => {}
        }
    }
}

/// Serves on a new pseudo terminal until the task is aborted. Returns the path that a client opens
/// like a serial port.
///
/// # Errors
/// The operating system's error if it has no pseudo terminal left.
pub fn serve_pty(
    mut device: Box<dyn Device>,
    clock: Clock,
) -> io::Result<(String, JoinHandle<()>)> {
    let pty = Pty::open()?;
    let path = pty.path().to_owned();
    // The terminal outlives its clients: a serial line does not notify the instrument when a client
    // disconnects.
    let task = tokio::spawn(async move { finish(serve(device.as_mut(), pty, &clock).await) });
    Ok((path, task))
}

/// A client that disconnects early is not a fault of the instrument.
fn finish(outcome: io::Result<()>) {
    match outcome {
        Ok(()) => tracing::debug!("client gone"),
        Err(error) => tracing::debug!(%error, "client lost"),
    }
}
