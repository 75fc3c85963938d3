//! Serial ports through tokio-serial; the client's end of a pseudo terminal is one too.

use std::{
    io,
    pin::Pin,
    task::{Context, Poll},
};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio_serial::{ClearBuffer, SerialPort, SerialPortBuilderExt, SerialStream};

use super::{DataBits, Flow, Parity, SerialSettings, StopBits};

/// An open serial port. It is opened exclusively.
#[derive(Debug)]
pub struct SerialConnection {
    port: SerialStream,
}

impl SerialConnection {
    /// Opens the port with its settings and discards data that arrived before. The control lines
    /// stay as the operating system sets them: pseudo terminals have none.
    pub(super) fn open(settings: &SerialSettings) -> io::Result<Self> {
        let port = tokio_serial::new(settings.path.as_str(), settings.baud)
            .data_bits(match settings.data_bits {
                DataBits::Seven => tokio_serial::DataBits::Seven,
                DataBits::Eight => tokio_serial::DataBits::Eight,
            })
            .parity(match settings.parity {
                Parity::None => tokio_serial::Parity::None,
                Parity::Even => tokio_serial::Parity::Even,
                Parity::Odd => tokio_serial::Parity::Odd,
            })
            .stop_bits(match settings.stop_bits {
                StopBits::One => tokio_serial::StopBits::One,
                StopBits::Two => tokio_serial::StopBits::Two,
            })
            .flow_control(match settings.flow {
                Flow::None => tokio_serial::FlowControl::None,
                Flow::RtsCts => tokio_serial::FlowControl::Hardware,
                Flow::XonXoff => tokio_serial::FlowControl::Software,
            })
            .open_native_async()?;
        port.clear(ClearBuffer::All)?;
        Ok(Self { port })
    }
}

impl Drop for SerialConnection {
    /// The lock of a terminal outlives its descriptor while another process or a simulated
    /// instrument holds the terminal.
    fn drop(&mut self) {
        let _ = self.port.set_exclusive(false);
    }
}

impl AsyncRead for SerialConnection {
    fn poll_read(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buf: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        Pin::new(&mut self.port).poll_read(cx, buf)
    }
}

impl AsyncWrite for SerialConnection {
    fn poll_write(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buf: &[u8],
    ) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.port).poll_write(cx, buf)
    }

    fn poll_flush(self: Pin<&mut Self>, _cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        // Flushing a terminal waits in the kernel for the last bit on the wire and would block the
        // thread; written bytes are sent without it.
        Poll::Ready(Ok(()))
    }

    fn poll_shutdown(self: Pin<&mut Self>, _cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }
}
