//! Pseudo terminals: a serial port without a wire. The device's end is here; a client opens
//! [`Pty::path`] like any serial port.

use std::{
    io,
    pin::Pin,
    task::{Context, Poll},
};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio_serial::{SerialPort, SerialStream};

/// The device's end of a pseudo terminal. Clients may come and go; dropping it is pulling the plug.
#[derive(Debug)]
pub struct Pty {
    device_end: SerialStream,
    /// Kept open, since without any client's end reading fails instead of waiting for a client.
    _client_end: SerialStream,
    path: String,
}

impl Pty {
    /// Opens a new pair, in raw mode: in the mode that terminals start in, the device would read
    /// back its own answers as echo. Must be called inside a runtime.
    ///
    /// # Errors
    /// Error of the operating system when it has no pseudo terminals left.
    pub fn open() -> io::Result<Self> {
        let (device_end, client_end) = SerialStream::pair()?;
        let path = client_end
            .name()
            .ok_or_else(|| io::Error::other("a pseudo terminal without a path"))?;
        Ok(Self {
            device_end,
            _client_end: client_end,
            path,
        })
    }

    /// Returns the path that a client opens, such as `/dev/pts/3`.
    pub fn path(&self) -> &str {
        &self.path
    }
}

impl AsyncRead for Pty {
    fn poll_read(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buf: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        Pin::new(&mut self.device_end).poll_read(cx, buf)
    }
}

impl AsyncWrite for Pty {
    fn poll_write(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buf: &[u8],
    ) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.device_end).poll_write(cx, buf)
    }

    fn poll_flush(self: Pin<&mut Self>, _cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        // As in `Stream`: flushing a tty would block the thread until the client has read
        // everything.
        Poll::Ready(Ok(()))
    }

    fn poll_shutdown(self: Pin<&mut Self>, _cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }
}
