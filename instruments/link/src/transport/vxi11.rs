//! The client of VXI-11: one link on the core channel; the abort channel is opened when it is
//! needed.

use std::{io, time::Duration};

use tokio::{
    io::{AsyncReadExt, AsyncWriteExt},
    net::TcpStream,
};

use super::{Arrival, Vxi11Port, cut_off, tcp};
use crate::wire::{
    rpc::{self, Call, Reader, Records, Reply, Verdict, Writer},
    vxi11::{ABORT, CORE, DEVICE_ABORT, FLAG_END, REASON_END, Request, Response, Status},
};

/// Number of bytes requested at once.
const PAGE: u32 = 256 << 10;
/// Space for the fields around the data of a reply.
const SLACK: usize = 1 << 10;
const READ_BYTES: usize = 64 << 10;
/// How long a write may take on the instrument, ms: callers give up before.
const WRITE_TIMEOUT_MS: u32 = 10_000;

/// A link to a device.
#[derive(Debug)]
pub struct Vxi11 {
    core: Rpc,
    host: String,
    link: u32,
    abort_port: u16,
    /// Most bytes in one write.
    most_bytes: usize,
}

impl Vxi11 {
    pub(super) async fn open(host: &str, port: Vxi11Port, device: &str) -> io::Result<Self> {
        let port = match port {
            Vxi11Port::Fixed(port) => port,
            Vxi11Port::Mapped(mapper) => mapped_port(host, mapper).await?,
        };
        let mut core = Rpc::connect(host, port).await?;
        let request = Request::CreateLink {
            device: device.to_owned(),
        };
        let Response::Link {
            link,
            abort_port,
            most_bytes,
            ..
        } = execute(&mut core, &request).await?
        else {
            return Err(other_result());
        };
        // Zero would never send anything; some instruments mean no limit by it.
        let most_bytes = if most_bytes == 0 {
            PAGE
        } else {
            most_bytes.min(PAGE)
        } as usize;
        Ok(Self {
            core,
            host: host.to_owned(),
            link,
            abort_port,
            most_bytes,
        })
    }

    pub(super) async fn send(&mut self, message: &[u8]) -> io::Result<()> {
        let mut rest = message;
        while !rest.is_empty() {
            let (piece, after) = rest
                .split_at_checked(self.most_bytes)
                .unwrap_or((rest, &[]));
            let flags = if after.is_empty() { FLAG_END } else { 0 };
            let request = Request::Write {
                link: self.link,
                io_timeout_ms: WRITE_TIMEOUT_MS,
                flags,
                data: piece.to_vec(),
            };
            let Response::Written { size, .. } = execute(&mut self.core, &request).await? else {
                return Err(other_result());
            };
            rest = rest
                .get(size as usize..)
                .filter(|_| size > 0)
                .ok_or_else(|| {
                    io::Error::new(
                        io::ErrorKind::WriteZero,
                        format!("device_write took {size} of {} bytes", piece.len()),
                    )
                })?;
        }
        Ok(())
    }

    pub(super) async fn receive(&mut self, patience: Duration) -> io::Result<Arrival> {
        let io_timeout_ms = u32::try_from(patience.as_millis()).unwrap_or(u32::MAX);
        let request = Request::Read {
            link: self.link,
            size: PAGE,
            io_timeout_ms,
            term_char: None,
        };
        loop {
            let response = self.core.execute(&request).await?;
            match response {
                // The caller has its own deadline, which may be a little later.
                Response::Data {
                    status: Status::TIMEOUT,
                    ref data,
                    ..
                } if data.is_empty() => {}
                Response::Data {
                    status: Status::OK | Status::TIMEOUT,
                    reason,
                    data,
                } => {
                    return Ok(Arrival {
                        bytes: data,
                        end: reason & REASON_END != 0,
                    });
                }
                _ => return Err(refused(&request, response.status())),
            }
        }
    }

    pub(super) async fn clear(&mut self) -> io::Result<()> {
        if self.core.pending {
            // An instrument without an abort channel ends the call when its timeout has passed.
            if let Err(error) = self.abort().await {
                tracing::debug!(%error, "no abort channel");
            }
        }
        execute(&mut self.core, &Request::Clear { link: self.link })
            .await
            .map(drop)
    }

    pub(super) async fn status_byte(&mut self) -> io::Result<u8> {
        let Response::StatusByte { byte, .. } =
            execute(&mut self.core, &Request::ReadStatus { link: self.link }).await?
        else {
            return Err(other_result());
        };
        Ok(byte)
    }

    async fn abort(&self) -> io::Result<()> {
        let arguments = Writer::default().words(&[self.link]).done();
        let mut channel = Rpc::connect(&self.host, self.abort_port).await?;
        channel
            .call(ABORT, DEVICE_ABORT, &arguments)
            .await
            .map(drop)
    }
}

impl Drop for Vxi11 {
    /// Releases the link at the server if this can be sent at once. The instrument receives
    /// nothing.
    fn drop(&mut self) {
        if !self.core.cut_off {
            let (procedure, arguments) = Request::DestroyLink { link: self.link }.encode();
            let call = Call {
                id: self.core.id.wrapping_add(1),
                program: CORE,
                procedure,
                arguments: &arguments,
            };
            let _ = self.core.stream.try_write(&rpc::marked(&call.encode()));
        }
    }
}

async fn mapped_port(host: &str, mapper: u16) -> io::Result<u16> {
    let rpc::Program { number, version } = CORE;
    let arguments = Writer::default()
        .words(&[number, version, rpc::TCP, 0])
        .done();
    let results = Rpc::connect(host, mapper)
        .await?
        .call(rpc::PORT_MAPPER, rpc::GET_PORT, &arguments)
        .await?;
    match Reader::new(&results).word()? {
        port @ 1..=0xffff => Ok(u16::try_from(port).unwrap_or_default()),
        _ => Err(io::Error::other(
            "the port mapper there knows no VXI-11 device",
        )),
    }
}

async fn execute(core: &mut Rpc, request: &Request) -> io::Result<Response> {
    let response = core.execute(request).await?;
    match response.status() {
        Status::OK => Ok(response),
        status => Err(refused(request, status)),
    }
}

fn refused(request: &Request, status: Status) -> io::Error {
    let (number, _) = request.encode();
    io::Error::other(format!(
        "procedure {number} of VXI-11 was refused: {}, {}",
        status.0,
        status.meaning()
    ))
}

fn other_result() -> io::Error {
    io::Error::new(
        io::ErrorKind::InvalidData,
        "the result of another procedure",
    )
}

/// A connection for procedure calls, one at a time. Late replies to abandoned calls are discarded.
#[derive(Debug)]
struct Rpc {
    stream: TcpStream,
    records: Records,
    id: u32,
    /// A call was given up before its reply came.
    pending: bool,
    /// A call was abandoned while it was sent; the stream is unusable.
    cut_off: bool,
}

impl Rpc {
    async fn connect(host: &str, port: u16) -> io::Result<Self> {
        let stream = tcp::open(host, port).await?;
        Ok(Self {
            stream,
            records: Records::new(PAGE as usize + SLACK),
            id: 0,
            pending: false,
            cut_off: false,
        })
    }

    async fn execute(&mut self, request: &Request) -> io::Result<Response> {
        let (procedure, arguments) = request.encode();
        let results = self.call(CORE, procedure, &arguments).await?;
        Ok(Response::parse(request, &results, PAGE as usize)?)
    }

    async fn call(
        &mut self,
        program: rpc::Program,
        procedure: u32,
        arguments: &[u8],
    ) -> io::Result<Vec<u8>> {
        if std::mem::replace(&mut self.cut_off, true) {
            return Err(cut_off());
        }
        self.id = self.id.wrapping_add(1);
        let call = Call {
            id: self.id,
            program,
            procedure,
            arguments,
        };
        self.stream.write_all(&rpc::marked(&call.encode())).await?;
        (self.cut_off, self.pending) = (false, true);
        let mut buffer = vec![0; READ_BYTES];
        loop {
            while let Some(record) = self.records.pull()? {
                let reply = Reply::parse(&record)?;
                if reply.id == self.id {
                    self.pending = false;
                    return match reply.verdict {
                        Verdict::Success => Ok(reply.results.to_vec()),
                        verdict => Err(io::Error::other(format!(
                            "the server answers procedure {procedure} with {verdict:?}"
                        ))),
                    };
                }
            }
            let count = self.stream.read(&mut buffer).await?;
            if count == 0 {
                return Err(io::ErrorKind::UnexpectedEof.into());
            }
            self.records.push(buffer.get(..count).unwrap_or_default());
        }
    }
}
