//! One open stream with its decoder. Knows neither deadlines nor order.

use std::{future::poll_fn, io, pin::Pin, task::Poll};

use tokio::io::{AsyncRead, AsyncReadExt, AsyncWriteExt, ReadBuf};

use crate::{
    scpi::decode::{DecodeError, DecoderOptions, Expect, Response, ResponseDecoder},
    transport::Stream,
};

/// Bytes asked of the stream at once.
const CHUNK: usize = 64 << 10;
/// Unasked bytes after which an instrument is taken to talk without end.
const MAX_UNASKED: usize = 1 << 20;

/// Why a stream is of no more use.
#[derive(Debug)]
pub(super) enum Broken {
    Closed,
    Io(io::Error),
    Garbage(DecodeError),
    Noise(usize),
}

#[derive(Debug)]
pub(super) struct Connection {
    stream: Stream,
    decoder: ResponseDecoder,
    chunk: Vec<u8>,
    /// An answer came on this connection.
    pub(super) has_answered: bool,
}

impl Connection {
    pub(super) fn new(stream: Stream, options: DecoderOptions) -> Self {
        Self { stream, decoder: ResponseDecoder::new(options), chunk: vec![0; CHUNK], has_answered: false }
    }

    pub(super) fn is_serial(&self) -> bool {
        matches!(self.stream, Stream::Serial(_))
    }

    /// Hands `bytes` over in one write, since some instruments take every packet for a message.
    pub(super) async fn write(&mut self, bytes: &[u8]) -> Result<(), Broken> {
        self.stream.write_all(bytes).await.map_err(broken)?;
        self.stream.flush().await.map_err(broken)
    }

    /// Waits for one complete answer.
    pub(super) async fn read(&mut self, expect: Expect) -> Result<Response, Broken> {
        loop {
            if let Some(answer) = self.decoder.pull(expect).map_err(Broken::Garbage)? {
                self.has_answered = true;
                return Ok(answer);
            }
            self.read_more().await?;
        }
    }

    /// Waits until something arrives.
    pub(super) async fn read_more(&mut self) -> Result<(), Broken> {
        let count = self.stream.read(&mut self.chunk).await.map_err(broken)?;
        if count == 0 {
            return Err(Broken::Closed);
        }
        self.decoder.push(self.chunk.get(..count).unwrap_or_default());
        Ok(())
    }

    /// Takes out what arrived without being asked for, line ends left out, and does not wait for more.
    pub(super) async fn drain(&mut self) -> Result<Vec<u8>, Broken> {
        // Lets the runtime look at its sockets; without it, bytes that are there already would not be seen.
        tokio::task::yield_now().await;
        let mut unasked = self.decoder.take_rest();
        let mut total = unasked.len();
        loop {
            let Some(count) = self.read_at_once().await.map_err(broken)? else { return Ok(unasked) };
            if count == 0 {
                return Err(Broken::Closed);
            }
            self.decoder.push(self.chunk.get(..count).unwrap_or_default());
            unasked.extend(self.decoder.take_rest());
            total += count;
            if total > MAX_UNASKED {
                return Err(Broken::Noise(total));
            }
        }
    }

    /// What can be read without waiting; `None` if nothing can.
    async fn read_at_once(&mut self) -> io::Result<Option<usize>> {
        poll_fn(|cx| {
            let mut buffer = ReadBuf::new(&mut self.chunk);
            Poll::Ready(match Pin::new(&mut self.stream).poll_read(cx, &mut buffer) {
                Poll::Ready(read) => read.map(|()| Some(buffer.filled().len())),
                Poll::Pending => Ok(None),
            })
        })
        .await
    }
}

/// A pulled plug shows as an error on some systems and as the end of the stream on others.
fn broken(error: io::Error) -> Broken {
    match error.kind() {
        io::ErrorKind::BrokenPipe | io::ErrorKind::ConnectionReset | io::ErrorKind::ConnectionAborted | io::ErrorKind::UnexpectedEof => {
            Broken::Closed
        }
        _ => Broken::Io(error),
    }
}
