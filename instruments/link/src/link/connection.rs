//! Open channel with its decoder, for the link. Knows neither deadlines nor order.

use std::{future::poll_fn, io, os::fd::AsFd, pin::Pin, task::Poll, time::Duration};

use instruments_scpi::decode::{DecodeError, DecoderOptions, Expect, Response, ResponseDecoder};
use nix::errno::Errno;
use tokio::{
    io::{AsyncRead, AsyncReadExt, ReadBuf},
    net::TcpStream,
};

use crate::transport::{Channel, Stream};

/// Number of bytes requested from the stream at once.
const CHUNK: usize = 64 << 10;
/// Unasked bytes after which an instrument is taken to talk without end.
const MAX_UNASKED: usize = 1 << 20;

/// Bytes of a message that are kept when it is read whole, whatever it is.
const MOST_KEPT: usize = 4096;

/// Reason why a channel is unusable.
#[derive(Debug)]
pub(super) enum Broken {
    Closed,
    Io(io::Error),
    Garbage(DecodeError),
    Noise(usize),
}

#[derive(Debug)]
pub(super) struct Connection {
    channel: Channel,
    decoder: ResponseDecoder,
    chunk: Vec<u8>,
    /// An answer came on this connection.
    pub(super) has_answered: bool,
    /// The end of the answer came, on a channel that carries it.
    ended: bool,
}

impl Connection {
    pub(super) fn new(channel: Channel, options: DecoderOptions) -> Self {
        let options = DecoderOptions {
            has_end_flag: channel.carries_end(),
            ..options
        };
        let chunk = if channel.carries_end() {
            Vec::new()
        } else {
            vec![0; CHUNK]
        };
        Self {
            channel,
            decoder: ResponseDecoder::new(options),
            chunk,
            has_answered: false,
            ended: true,
        }
    }

    pub(super) fn is_serial(&self) -> bool {
        matches!(self.channel, Channel::Stream(Stream::Serial(_)))
    }

    /// Returns whether the instrument can discard its pending queries, and whether replies to
    /// earlier queries can be distinguished from later ones on this connection.
    pub(super) fn can_be_cleared(&self) -> bool {
        self.channel.carries_end()
    }

    /// Hands one message over.
    pub(super) async fn write(&mut self, bytes: &[u8]) -> Result<(), Broken> {
        self.channel.send(bytes).await.map_err(broken)
    }

    /// Waits for one complete answer, at most for `patience`.
    pub(super) async fn read(
        &mut self,
        expect: Expect,
        patience: Duration,
    ) -> Result<Response, Broken> {
        self.ended = false;
        loop {
            if let Some(answer) = self.decoder.pull(expect).map_err(Broken::Garbage)? {
                self.has_answered = true;
                // An instrument takes the next message for an interruption while the end of its
                // answer, such as a second NL, has not been fetched.
                while self.channel.insists_on_end() && !self.ended {
                    self.read_more(patience).await?;
                }
                return Ok(answer);
            }
            self.read_more(patience).await?;
        }
    }

    /// Waits until something arrives.
    pub(super) async fn read_more(&mut self, patience: Duration) -> Result<(), Broken> {
        if let Channel::Stream(stream) = &mut self.channel {
            let count = stream.read(&mut self.chunk).await.map_err(broken)?;
            if count == 0 {
                return Err(Broken::Closed);
            }
            self.decoder
                .push(self.chunk.get(..count).unwrap_or_default());
        } else {
            let arrival = self.channel.receive(patience).await.map_err(broken)?;
            self.decoder.push(&arrival.bytes);
            if arrival.end {
                self.decoder.end();
                self.ended = true;
            }
        }
        Ok(())
    }

    /// Sends a device clear. Afterwards no earlier query is answered, as far as the transport can
    /// detect.
    pub(super) async fn clear(&mut self) -> Result<(), Broken> {
        self.decoder.clear();
        self.channel.clear().await.map_err(broken)
    }

    /// Returns the status byte, if the transport has one.
    pub(super) async fn status_byte(&mut self) -> Result<Option<u8>, Broken> {
        self.channel.status_byte().await.map_err(broken)
    }

    /// Waits for the next message, whatever it is, on a channel that carries ends; keeps the start
    /// of a long one.
    pub(super) async fn read_whole(&mut self, patience: Duration) -> Result<Vec<u8>, Broken> {
        let mut message = Vec::new();
        loop {
            let arrival = self.channel.receive(patience).await.map_err(broken)?;
            let room = MOST_KEPT.saturating_sub(message.len());
            message.extend_from_slice(arrival.bytes.get(..room).unwrap_or(&arrival.bytes));
            if arrival.end && !message.is_empty() {
                return Ok(message);
            }
        }
    }

    /// Removes data that arrived without a query, without line ends, and does not wait for more.
    pub(super) async fn drain(&mut self) -> Result<Vec<u8>, Broken> {
        if self.channel.carries_end() {
            return Ok(self.decoder.take_rest());
        }
        // Lets the runtime poll its sockets. Otherwise bytes that have already arrived would not be
        // seen.
        tokio::task::yield_now().await;
        let mut unasked = self.decoder.take_rest();
        let mut total = unasked.len();
        loop {
            let Some(count) = self.read_at_once().await.map_err(broken)? else {
                return Ok(unasked);
            };
            if count == 0 {
                return Err(Broken::Closed);
            }
            self.decoder
                .push(self.chunk.get(..count).unwrap_or_default());
            unasked.extend(self.decoder.take_rest());
            total += count;
            if total > MAX_UNASKED {
                return Err(Broken::Noise(total));
            }
        }
    }

    /// Reads without waiting. Returns the number of bytes; `None` if there are none yet.
    async fn read_at_once(&mut self) -> io::Result<Option<usize>> {
        let Channel::Stream(stream) = &mut self.channel else {
            return Ok(None);
        };
        if let Stream::Tcp(socket) = stream {
            return read_socket(socket, &mut self.chunk);
        }
        poll_fn(|cx| {
            let mut buffer = ReadBuf::new(&mut self.chunk);
            Poll::Ready(match Pin::new(&mut *stream).poll_read(cx, &mut buffer) {
                Poll::Ready(read) => read.map(|()| Some(buffer.filled().len())),
                Poll::Pending => Ok(None),
            })
        })
        .await
    }
}

/// Reads from the socket itself. The runtime does not know yet of bytes that arrived while its
/// threads were busy, and those bytes would be mistaken for the next reply.
fn read_socket(socket: &TcpStream, buffer: &mut [u8]) -> io::Result<Option<usize>> {
    let mut socket = std::net::TcpStream::from(socket.as_fd().try_clone_to_owned()?);
    match io::Read::read(&mut socket, buffer) {
        Ok(count) => Ok(Some(count)),
        Err(error) if error.kind() == io::ErrorKind::WouldBlock => Ok(None),
        Err(error) => Err(error),
    }
}

/// Classifies an error. A pulled plug shows as the end of the stream, as a closed connection, or, on
/// a serial port, as an error of the device.
fn broken(error: io::Error) -> Broken {
    let is_unplugged = |code: i32| {
        matches!(
            Errno::from_raw(code),
            Errno::EIO | Errno::ENXIO | Errno::ENODEV
        )
    };
    match error.kind() {
        _ if error.raw_os_error().is_some_and(is_unplugged) => Broken::Closed,
        io::ErrorKind::BrokenPipe
        | io::ErrorKind::ConnectionReset
        | io::ErrorKind::ConnectionAborted
        | io::ErrorKind::UnexpectedEof => Broken::Closed,
        _ => Broken::Io(error),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_unplugged_device_is_a_closed_connection_and_a_full_disk_is_not() {
        for errno in [Errno::EIO, Errno::ENXIO, Errno::ENODEV, Errno::EPIPE] {
            let error = io::Error::from_raw_os_error(errno as i32);
            assert!(matches!(broken(error), Broken::Closed), "{errno}");
        }
        let full = io::Error::from_raw_os_error(Errno::ENOSPC as i32);
        assert!(matches!(broken(full), Broken::Io(_)));
    }
}
