//! A device in place of `/dev/usbtmcN` on machines without the kernel device: a datagram socket in
//! the file system. One datagram is one transfer, and a transfer shorter than [`TRANSFER`] ends a
//! message, as on USB. It has no control pipe, and therefore no device clear.

use std::{
    io,
    path::{Path, PathBuf},
};

use instruments_link::{clock::Clock, transport::TRANSFER};
use tokio::{net::UnixDatagram, task::JoinHandle};

use super::backplane::Backplane;
use crate::Device;

/// Serves at a socket file until the task is aborted; the file is then removed.
///
/// # Errors
/// The operating system's error if the file cannot be created, for example because it exists
/// already.
pub fn serve_usbtmc(
    device: Box<dyn Device>,
    path: &Path,
    clock: Clock,
) -> io::Result<JoinHandle<()>> {
    let socket = UnixDatagram::bind(path)?;
    let file = SocketFile(path.to_owned());
    let (plane, _work) = Backplane::start(device, clock);
    Ok(tokio::spawn(async move {
        let _file = file;
        if let Err(error) = transfer(&socket, &plane).await {
            tracing::warn!(%error, "the socket failed");
        }
    }))
}

struct SocketFile(PathBuf);

impl Drop for SocketFile {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}

async fn transfer(socket: &UnixDatagram, plane: &Backplane) -> io::Result<()> {
    let mut framer = plane.framer();
    let mut client: Option<PathBuf> = None;
    let mut answer = Vec::new();
    let mut buffer = vec![0; TRANSFER];
    loop {
        tokio::select! {
            received = socket.recv_from(&mut buffer) => {
                let (count, sender) = received?;
                client = sender.as_pathname().map(Path::to_owned);
                // The rest of a reply without an end is discarded.
                answer.clear();
                framer.push(buffer.get(..count).unwrap_or_default());
                if count < TRANSFER {
                    framer.end();
                }
                plane.hand_over(&mut framer, 0).await;
            }
            taken = plane.take(TRANSFER, None) => {
                answer.extend(taken.bytes);
                while answer.len() >= TRANSFER || taken.end {
                    let rest = answer.split_off(answer.len().min(TRANSFER));
                    if let Some(client) = &client {
                        // A client that has gone loses its answer.
                        let _ = socket.send_to(&answer, client).await;
                    }
                    if std::mem::replace(&mut answer, rest).len() < TRANSFER {
                        break;
                    }
                }
            }
        }
    }
}
