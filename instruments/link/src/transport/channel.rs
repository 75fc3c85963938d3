//! A connection to one instrument, whatever carries it: whole messages out, pieces of answers in.

mod arrival;

use std::{io, time::Duration};

use tokio::io::AsyncWriteExt;

use super::{
    Address, MemoryHub, Stream, TransportError, gpib::Gpib, hislip::HiSlip, open, usbtmc::UsbTmc,
    vxi11::Vxi11,
};
pub use arrival::Arrival;

/// An open connection.
#[derive(Debug)]
pub enum Channel {
    /// Bytes without ends of messages; nothing but dropping it gets rid of an answer that is on its
    /// way.
    Stream(Stream),
    /// VXI-11.
    Vxi11(Box<Vxi11>),
    /// HiSLIP.
    HiSlip(Box<HiSlip>),
    /// USBTMC through the kernel.
    UsbTmc(UsbTmc),
    /// GPIB through an adapter.
    Gpib(Box<Gpib>),
}

/// Opens the channel that `address` names; `hub` is where memory names are looked up. Waits as long
/// as the operating system and the instrument do: callers put a deadline around it.
///
/// # Errors
/// [`TransportError`] with the address and the reason.
pub async fn connect(address: &Address, hub: &MemoryHub) -> Result<Channel, TransportError> {
    let failed = |source| TransportError::Open {
        address: address.clone(),
        source,
    };
    match address {
        Address::Vxi11 { host, port, device } => Vxi11::open(host, *port, device)
            .await
            .map(|client| Channel::Vxi11(Box::new(client)))
            .map_err(failed),
        Address::HiSlip { socket, device } => HiSlip::open(socket, device)
            .await
            .map(|client| Channel::HiSlip(Box::new(client)))
            .map_err(failed),
        Address::UsbTmc { path } => UsbTmc::open(path).map(Channel::UsbTmc).map_err(failed),
        Address::Gpib { address: gpib, .. } => {
            let stream = open(address, hub).await?;
            Gpib::open(stream, *gpib)
                .await
                .map(|client| Channel::Gpib(Box::new(client)))
                .map_err(failed)
        }
        Address::Tcp(_) | Address::Serial(_) | Address::Memory { .. } => {
            open(address, hub).await.map(Channel::Stream)
        }
    }
}

impl Channel {
    /// Answers come with their end.
    pub fn carries_end(&self) -> bool {
        !matches!(self, Self::Stream(_))
    }

    /// Returns whether every reply has an end to wait for. A USBTMC device that exactly fills the
    /// last page sends none.
    pub fn insists_on_end(&self) -> bool {
        self.carries_end() && !matches!(self, Self::UsbTmc(_))
    }

    /// Sends one message with its terminator, and its end mark if the transport has one. A stream
    /// sends it in one write, since some instruments treat every packet as a message.
    ///
    /// # Errors
    /// The error of the operating system or the instrument.
    pub async fn send(&mut self, message: &[u8]) -> io::Result<()> {
        match self {
            Self::Stream(stream) => {
                stream.write_all(message).await?;
                stream.flush().await
            }
            Self::Vxi11(client) => client.send(message).await,
            Self::HiSlip(client) => client.send(message).await,
            Self::UsbTmc(client) => client.send(message).await,
            Self::Gpib(client) => client.send(message).await,
        }
    }

    /// Waits for a part of the reply on a channel that marks message ends. The caller gives up
    /// after `patience`; the server receives this time as its timeout.
    ///
    /// # Errors
    /// Error of the operating system or the instrument.
    pub async fn receive(&mut self, patience: Duration) -> io::Result<Arrival> {
        match self {
            Self::Stream(_) => Err(io::Error::new(
                io::ErrorKind::Unsupported,
                "a stream has no ends of messages",
            )),
            Self::Vxi11(client) => client.receive(patience).await,
            Self::HiSlip(client) => client.receive().await,
            Self::UsbTmc(client) => client.receive().await,
            Self::Gpib(client) => client.receive().await,
        }
    }

    /// Makes the instrument discard its pending queries, and discards the replies. USBTMC sends
    /// nothing to the instrument and only waits for the operations under way.
    ///
    /// # Errors
    /// The error of the operating system or the instrument; on a stream always.
    pub async fn clear(&mut self) -> io::Result<()> {
        match self {
            Self::Stream(_) => Err(io::Error::new(
                io::ErrorKind::Unsupported,
                "a stream has no device clear",
            )),
            Self::Vxi11(client) => client.clear().await,
            Self::HiSlip(client) => client.clear().await,
            Self::UsbTmc(client) => client.settle().await,
            Self::Gpib(client) => client.clear().await,
        }
    }

    /// Returns the status byte by the transport's serial poll, or `None` if the transport has none.
    ///
    /// # Errors
    /// The error of the operating system or the instrument.
    pub async fn status_byte(&mut self) -> io::Result<Option<u8>> {
        match self {
            Self::Stream(_) | Self::UsbTmc(_) => Ok(None),
            Self::Vxi11(client) => client.status_byte().await.map(Some),
            Self::HiSlip(client) => client.status_byte().await.map(Some),
            Self::Gpib(client) => client.status_byte().await.map(Some),
        }
    }
}
