//! A device on VXI-11: core and abort channel on one port each, and optionally a port mapper of its
//! own (TCP and UDP).

use std::{
    io,
    net::SocketAddr,
    sync::{
        Arc,
        atomic::{AtomicU32, Ordering},
    },
    time::Duration,
};

use instruments_link::{
    clock::Clock,
    wire::{
        rpc::{self, Call, Reader, Records, Reply, Verdict, Writer},
        vxi11::{
            ABORT, CORE, DEVICE_ABORT, FLAG_END, REASON_CHAR, REASON_COUNT, REASON_END, Request,
            Response, Status,
        },
    },
};
use instruments_scpi::decode::ProgramFramer;
use tokio::{
    io::{AsyncReadExt, AsyncWriteExt},
    net::{TcpListener, TcpStream, ToSocketAddrs, UdpSocket},
    sync::{Notify, OwnedMutexGuard},
    task::{JoinHandle, JoinSet},
};

use super::{accept_all, backplane::Backplane};
use crate::Device;

/// Maximum number of bytes in one write, as announced to the client.
const MOST_BYTES: u32 = 64 << 10;
/// Most bytes in one answer to a read.
const PAGE: usize = 1 << 20;
/// Space for the fields around the data of a call.
const SLACK: usize = 1 << 10;
const READ_BYTES: usize = 16 << 10;

/// Addresses of a device on VXI-11.
#[derive(Debug, Clone, Copy)]
pub struct Vxi11Ports {
    /// The core channel.
    pub core: SocketAddr,
    /// The port mapper, if there is one.
    pub port_mapper: Option<SocketAddr>,
}

/// Serves VXI-11 until the task is aborted: the core channel at `address`, and a port mapper at
/// `port_mapper` that returns its port. Returns the addresses actually bound, so that port 0 can be
/// requested.
///
/// # Errors
/// The operating system's error if an address cannot be bound.
pub async fn serve_vxi11<A: ToSocketAddrs>(
    device: Box<dyn Device>,
    address: A,
    port_mapper: Option<A>,
    clock: Clock,
) -> io::Result<(Vxi11Ports, JoinHandle<()>)> {
    let core = TcpListener::bind(address).await?;
    let bound = core.local_addr()?;
    let abort = TcpListener::bind((bound.ip(), 0)).await?;
    let (plane, work) = Backplane::start(device, clock.clone());
    let server = Arc::new(Server {
        plane,
        clock: clock.clone(),
        abort_port: abort.local_addr()?.port(),
        aborted: Notify::new(),
        links: AtomicU32::new(1),
    });
    let mut tasks = JoinSet::new();
    let mut ports = Vxi11Ports {
        core: bound,
        port_mapper: None,
    };
    if let Some(address) = port_mapper {
        let mapper = TcpListener::bind(address).await?;
        let mapper_address = mapper.local_addr()?;
        let datagrams = UdpSocket::bind(mapper_address).await?;
        ports.port_mapper = Some(mapper_address);
        tasks.spawn(accept_all(mapper, clock.clone(), move |stream| {
            calls(stream, move |call| map_port(call, bound.port()))
        }));
        tasks.spawn(async move { map_datagrams(&datagrams, bound.port()).await });
    }
    let aborter = server.clone();
    tasks.spawn(accept_all(abort, clock.clone(), move |stream| {
        let server = aborter.clone();
        calls(stream, move |call| server.abort(call))
    }));
    tasks.spawn(accept_all(core, clock, move |stream| {
        Client::new(server.clone(), stream).serve()
    }));
    let task = tokio::spawn(async move {
        let _ = work.await;
        drop(tasks);
    });
    Ok((ports, task))
}

struct Server {
    plane: Backplane,
    clock: Clock,
    abort_port: u16,
    aborted: Notify,
    /// Number of the next link.
    links: AtomicU32,
}

impl Server {
    fn abort(&self, call: &Call) -> (Verdict, Vec<u8>) {
        match (call.program, call.procedure) {
            (ABORT, DEVICE_ABORT) => {
                self.aborted.notify_waiters();
                (Verdict::Success, Writer::default().words(&[0]).done())
            }
            (ABORT, 0) => (Verdict::Success, Vec::new()),
            _ => (refusal(call, ABORT), Vec::new()),
        }
    }
}

/// One connection to the core channel.
struct Client {
    server: Arc<Server>,
    stream: TcpStream,
    records: Records,
    link: Option<Link>,
    /// The instrument has stopped sending.
    is_silent: bool,
}

struct Link {
    id: u32,
    framer: ProgramFramer,
    _seat: OwnedMutexGuard<()>,
}

impl Client {
    fn new(server: Arc<Server>, stream: TcpStream) -> Self {
        Self {
            server,
            stream,
            records: Records::new(MOST_BYTES as usize + SLACK),
            link: None,
            is_silent: false,
        }
    }

    async fn serve(mut self) -> io::Result<()> {
        let mut breaks = self.server.plane.breaks();
        tokio::select! {
            outcome = self.answer_calls() => outcome,
            _ = breaks.changed() => Ok(()),
        }
    }

    async fn answer_calls(&mut self) -> io::Result<()> {
        loop {
            while let Some(record) = self.records.pull()? {
                let call = Call::parse(&record)?;
                let was_silent = self.is_silent;
                let (verdict, results) = self.answer(&call).await?;
                let reply = Reply {
                    id: call.id,
                    verdict,
                    results: &results,
                };
                if !was_silent {
                    self.stream.write_all(&rpc::marked(&reply.encode())).await?;
                    if self.is_silent {
                        self.stream.shutdown().await?;
                    }
                }
            }
            if !read_more(&mut self.stream, &mut self.records).await? {
                return Ok(());
            }
        }
    }

    async fn answer(&mut self, call: &Call<'_>) -> io::Result<(Verdict, Vec<u8>)> {
        if call.program != CORE {
            return Ok((refusal(call, CORE), Vec::new()));
        }
        if call.procedure == 0 {
            return Ok((Verdict::Success, Vec::new()));
        }
        Ok(
            match Request::parse(call.procedure, call.arguments, MOST_BYTES as usize) {
                Ok(Some(request)) => (Verdict::Success, self.execute(request).await?.encode()),
                Ok(None) => (Verdict::ProcedureUnavailable, Vec::new()),
                Err(_) => (Verdict::GarbageArguments, Vec::new()),
            },
        )
    }

    async fn execute(&mut self, request: Request) -> io::Result<Response> {
        let link_of = |id: u32| {
            if self.link.as_ref().is_some_and(|link| link.id == id) {
                Status::OK
            } else {
                Status::INVALID_LINK
            }
        };
        Ok(match request {
            Request::CreateLink { device } => self.create_link(&device).await,
            Request::Write {
                link, flags, data, ..
            } => self.write(link, flags & FLAG_END != 0, &data).await,
            Request::Read {
                link,
                size,
                io_timeout_ms,
                term_char,
            } => {
                if link_of(link) == Status::OK {
                    self.read(
                        size as usize,
                        Duration::from_millis(io_timeout_ms.into()),
                        term_char,
                    )
                    .await?
                } else {
                    Response::Data {
                        status: Status::INVALID_LINK,
                        reason: 0,
                        data: Vec::new(),
                    }
                }
            }
            Request::ReadStatus { link } => Response::StatusByte {
                status: link_of(link),
                byte: self.server.plane.status_byte(),
            },
            Request::Clear { link } => {
                let status = link_of(link);
                if let Some(link) = self.link.as_mut().filter(|_| status == Status::OK) {
                    link.framer.clear();
                    self.server.plane.clear();
                }
                Response::Done { status }
            }
            // With one client at a time a lock is always free; the mocks have no trigger input, no
            // panel and no service requests.
            Request::Simple { link, .. } => Response::Done {
                status: link_of(link),
            },
            Request::Command { .. } => Response::CommandData {
                status: Status::NOT_SUPPORTED,
            },
            Request::Interrupts { .. } => Response::Done {
                status: Status::NOT_SUPPORTED,
            },
            Request::DestroyLink { link } => {
                let status = link_of(link);
                if status == Status::OK {
                    self.link = None;
                }
                Response::Done { status }
            }
        })
    }

    async fn create_link(&mut self, device: &str) -> Response {
        let refused = |status| Response::Link {
            status,
            link: 0,
            abort_port: 0,
            most_bytes: 0,
        };
        // The names under which instruments of one device are reached; the standard's is the first.
        if !["inst0", "instr", "instr0"].contains(&device.to_ascii_lowercase().as_str()) {
            return refused(Status::NOT_ACCESSIBLE);
        }
        let Some(seat) = self
            .server
            .plane
            .sit_down(&self.server.clock)
            .await
            .filter(|_| self.link.is_none())
        else {
            return refused(Status::OUT_OF_RESOURCES);
        };
        let id = self.server.links.fetch_add(1, Ordering::Relaxed);
        self.link = Some(Link {
            id,
            framer: self.server.plane.framer(),
            _seat: seat,
        });
        Response::Link {
            status: Status::OK,
            link: id,
            abort_port: self.server.abort_port,
            most_bytes: MOST_BYTES,
        }
    }

    async fn write(&mut self, id: u32, end: bool, data: &[u8]) -> Response {
        let Some(link) = self.link.as_mut().filter(|link| link.id == id) else {
            return Response::Written {
                status: Status::INVALID_LINK,
                size: 0,
            };
        };
        link.framer.push(data);
        if end {
            link.framer.end();
        }
        self.server.plane.hand_over(&mut link.framer, 0).await;
        Response::Written {
            status: Status::OK,
            size: u32::try_from(data.len()).unwrap_or(u32::MAX),
        }
    }

    async fn read(
        &mut self,
        size: usize,
        patience: Duration,
        term_char: Option<u8>,
    ) -> io::Result<Response> {
        let nothing = |status| Response::Data {
            status,
            reason: 0,
            data: Vec::new(),
        };
        let most = size.min(PAGE);
        let taken = tokio::select! {
            taken = self.server.clock.deadline(patience, self.server.plane.take(most, term_char)) => taken,
            () = self.server.aborted.notified() => return Ok(nothing(Status::ABORTED)),
            gone = gone(&mut self.stream, &mut self.records) => return Err(gone),
        };
        let Ok(taken) = taken else {
            return Ok(nothing(Status::TIMEOUT));
        };
        let mut reason = if taken.end { REASON_END } else { 0 };
        if taken.bytes.len() == size {
            reason |= REASON_COUNT;
        }
        if term_char.is_some() && taken.bytes.last().copied() == term_char {
            reason |= REASON_CHAR;
        }
        self.is_silent |= taken.stops;
        Ok(Response::Data {
            status: Status::OK,
            reason,
            data: taken.bytes,
        })
    }
}

/// False at the end of the stream.
async fn read_more(stream: &mut TcpStream, records: &mut Records) -> io::Result<bool> {
    let mut buffer = [0; READ_BYTES];
    let count = stream.read(&mut buffer).await?;
    records.push(buffer.get(..count).unwrap_or_default());
    Ok(count > 0)
}

/// Waits until the client has disconnected; data that it sends in the meantime are kept, up to a
/// bound.
async fn gone(stream: &mut TcpStream, records: &mut Records) -> io::Error {
    loop {
        match read_more(stream, records).await {
            Ok(true) if records.held() < MOST_BYTES as usize => {}
            Ok(true) => return std::future::pending().await,
            Ok(false) => return io::ErrorKind::ConnectionAborted.into(),
            Err(error) => return error,
        }
    }
}

/// Answers the calls of a connection that needs no waiting.
async fn calls(
    mut stream: TcpStream,
    answer: impl Fn(&Call) -> (Verdict, Vec<u8>),
) -> io::Result<()> {
    let mut records = Records::new(SLACK);
    loop {
        while let Some(record) = records.pull()? {
            stream
                .write_all(&rpc::marked(&replied(&record, &answer)?))
                .await?;
        }
        if !read_more(&mut stream, &mut records).await? {
            return Ok(());
        }
    }
}

fn replied(record: &[u8], answer: impl Fn(&Call) -> (Verdict, Vec<u8>)) -> io::Result<Vec<u8>> {
    let call = Call::parse(record)?;
    let (verdict, results) = answer(&call);
    Ok(Reply {
        id: call.id,
        verdict,
        results: &results,
    }
    .encode())
}

fn refusal(call: &Call, known: rpc::Program) -> Verdict {
    let rpc::Program { number, version } = known;
    match call.program {
        found if found.number != number => Verdict::ProgramUnavailable,
        found if found.version != version => Verdict::VersionMismatch {
            low: version,
            high: version,
        },
        _ => Verdict::ProcedureUnavailable,
    }
}

fn map_port(call: &Call, core: u16) -> (Verdict, Vec<u8>) {
    match (call.program, call.procedure) {
        (rpc::PORT_MAPPER, 0) => (Verdict::Success, Vec::new()),
        (rpc::PORT_MAPPER, rpc::GET_PORT) => {
            let mut reader = Reader::new(call.arguments);
            let asked = [(); 3].map(|()| reader.word());
            let [Ok(number), Ok(version), Ok(protocol)] = asked else {
                return (Verdict::GarbageArguments, Vec::new());
            };
            let port = if (rpc::Program { number, version }) == CORE && protocol == rpc::TCP {
                core
            } else {
                0
            };
            (
                Verdict::Success,
                Writer::default().words(&[port.into()]).done(),
            )
        }
        _ => (refusal(call, rpc::PORT_MAPPER), Vec::new()),
    }
}

async fn map_datagrams(socket: &UdpSocket, core: u16) {
    let mut buffer = [0; SLACK];
    while let Ok((count, peer)) = socket.recv_from(&mut buffer).await {
        if let Ok(reply) = replied(buffer.get(..count).unwrap_or_default(), |call| {
            map_port(call, core)
        }) {
            let _ = socket.send_to(&reply, peer).await;
        }
    }
}
