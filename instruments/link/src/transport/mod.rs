//! Transports to an instrument. [`Stream`] carries bytes without messages. [`Channel`] covers
//! streams and the transports that carry the ends of messages, can be cleared and give a status
//! byte. The text of an [`Address`] selects one.
//!
//! This module does not interpret text: [`instruments_scpi::decode`] splits the bytes,
//! [`crate::link`] handles deadlines and order. Opening sends nothing to an instrument; messages
//! that start a session go to the server or the adapter in front of it.

mod address;
mod channel;
mod error;
mod gpib;
mod hislip;
mod memory;
mod pty;
mod serial;
mod tcp;
mod usb;
mod usbtmc;
mod vxi11;

use std::{
    io,
    pin::Pin,
    task::{Context, Poll},
};

use tokio::{
    io::{AsyncRead, AsyncWrite, DuplexStream, ReadBuf},
    net::TcpStream,
};

pub use address::{
    Adapter, Address, AddressError, DataBits, Flow, Parity, SerialSettings, Socket, StopBits,
    Vxi11Port,
};
pub use channel::{Arrival, Channel, connect};
pub use error::TransportError;
pub use memory::{MemoryHub, MemoryListener};
pub use pty::Pty;
pub use serial::SerialConnection;
pub use usb::{UsbDevice, UsbName, may_open, usb_devices, usb_file};
pub use usbtmc::TRANSFER;

/// An open connection.
#[derive(Debug)]
pub enum Stream {
    /// A raw TCP socket.
    Tcp(TcpStream),
    /// A serial port or the client's end of a pseudo terminal.
    Serial(Box<SerialConnection>),
    /// A pipe inside this process.
    Memory(DuplexStream),
}

/// Opens the stream that `address` names, or the one on which a GPIB adapter is; `hub` is where
/// memory names are looked up. Waits as long as the operating system does: callers put a deadline
/// around it.
///
/// # Errors
/// [`TransportError`] with the address and the reason, such as that it names no stream.
pub async fn open(address: &Address, hub: &MemoryHub) -> Result<Stream, TransportError> {
    let failed = |source| TransportError::Open {
        address: address.clone(),
        source,
    };
    match address {
        Address::Tcp(socket)
        | Address::Gpib {
            adapter: Adapter::Tcp(socket),
            ..
        } => tcp::open(&socket.host, socket.port)
            .await
            .map(Stream::Tcp)
            .map_err(failed),
        Address::Serial(settings)
        | Address::Gpib {
            adapter: Adapter::Serial(settings),
            ..
        } => SerialConnection::open(settings)
            .map(|port| Stream::Serial(Box::new(port)))
            .map_err(failed),
        Address::Memory { name } => hub.connect(name).map(Stream::Memory),
        Address::Vxi11 { .. } | Address::HiSlip { .. } | Address::UsbTmc { .. } => {
            Err(failed(io::Error::new(
                io::ErrorKind::Unsupported,
                "it carries messages and not a stream of bytes",
            )))
        }
    }
}

impl AsyncRead for Stream {
    fn poll_read(
        self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buf: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        match self.get_mut() {
            Self::Tcp(stream) => Pin::new(stream).poll_read(cx, buf),
            Self::Serial(stream) => Pin::new(stream.as_mut()).poll_read(cx, buf),
            Self::Memory(stream) => Pin::new(stream).poll_read(cx, buf),
        }
    }
}

impl AsyncWrite for Stream {
    fn poll_write(
        self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buf: &[u8],
    ) -> Poll<io::Result<usize>> {
        match self.get_mut() {
            Self::Tcp(stream) => Pin::new(stream).poll_write(cx, buf),
            Self::Serial(stream) => Pin::new(stream.as_mut()).poll_write(cx, buf),
            Self::Memory(stream) => Pin::new(stream).poll_write(cx, buf),
        }
    }

    fn poll_flush(self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        match self.get_mut() {
            Self::Tcp(stream) => Pin::new(stream).poll_flush(cx),
            Self::Serial(stream) => Pin::new(stream.as_mut()).poll_flush(cx),
            Self::Memory(stream) => Pin::new(stream).poll_flush(cx),
        }
    }

    fn poll_shutdown(self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        match self.get_mut() {
            Self::Tcp(stream) => Pin::new(stream).poll_shutdown(cx),
            Self::Serial(stream) => Pin::new(stream.as_mut()).poll_shutdown(cx),
            Self::Memory(stream) => Pin::new(stream).poll_shutdown(cx),
        }
    }
}

/// Creates the error of a channel on which a message was cut off while it was sent.
fn cut_off() -> io::Error {
    io::Error::new(
        io::ErrorKind::BrokenPipe,
        "a message was cut off while it was sent",
    )
}
