//! Random and mutated bytes in whole sessions: to the servers of the mocks, from a client that
//! keeps to no order, and to our clients, from a server that does not. Sockets are slow: a
//! two-hundredth of the inputs of `fuzz` in each category.

use std::{
    sync::atomic::{AtomicUsize, Ordering},
    time::Duration,
};

use instruments::{
    clock::{Clock, TimeMode},
    link::{Grammar, LinkProfile},
    mock::{self, MockOptions},
    transcript::Tap,
    transport::{Address, MemoryHub},
    wire::{
        hislip::{FIRST_ID, Kind as Hi, Message},
        prologix::escaped,
        rpc::{self, Call, Reply, Verdict, Writer},
        vxi11::{CORE, Request, Response, Simple, Status},
    },
};
use tokio::{
    io::{AsyncReadExt, AsyncWriteExt},
    net::{TcpListener, TcpStream},
};

use crate::{
    device,
    fuzz::{Random, SHARE, from_environment},
    mocks_plant::Recorder,
    transports::{Kind, serve},
};

/// One session runs per this number of inputs of `fuzz`.
pub(crate) const SCARCITY: u64 = 200;
/// How long either side is listened to.
pub(crate) const MOMENT: Duration = Duration::from_millis(2);

/// Panics on this test's thread, those in tasks included.
pub(crate) static PANICS: AtomicUsize = AtomicUsize::new(0);

pub(crate) fn count_panics() {
    let thread = std::thread::current().id();
    let usual = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |info| {
        if std::thread::current().id() == thread {
            PANICS.fetch_add(1, Ordering::Relaxed);
        }
        usual(info);
    }));
}

fn call(request: &Request) -> Vec<u8> {
    let (procedure, arguments) = request.encode();
    rpc::marked(
        &Call {
            id: 1,
            program: CORE,
            procedure,
            arguments: &arguments,
        }
        .encode(),
    )
}

fn reply(response: &Response) -> Vec<u8> {
    rpc::marked(
        &Reply {
            id: 1,
            verdict: Verdict::Success,
            results: &response.encode(),
        }
        .encode(),
    )
}

/// First messages of a client, on its first connection and on its second, and those with which it
/// may go on.
fn client_of(kind: Kind) -> ([Vec<u8>; 2], Vec<Vec<u8>>) {
    match kind {
        Kind::Vxi11 => {
            let write = |data: &[u8], flags| Request::Write {
                link: 1,
                io_timeout_ms: 1,
                flags,
                data: data.to_vec(),
            };
            let requests = [
                write(b"*IDN?\n", 8),
                write(b"VOLT 1", 0),
                Request::Read {
                    link: 1,
                    size: 100,
                    io_timeout_ms: 1,
                    term_char: None,
                },
                Request::Read {
                    link: 1,
                    size: 3,
                    io_timeout_ms: 1,
                    term_char: Some(b'\n'),
                },
                Request::ReadStatus { link: 1 },
                Request::Clear { link: 1 },
                Request::Simple {
                    procedure: Simple::Lock,
                    link: 1,
                },
                Request::Command { link: 1 },
                Request::DestroyLink { link: 1 },
                Request::CreateLink {
                    device: "inst0".to_owned(),
                },
            ];
            (
                [
                    call(&Request::CreateLink {
                        device: "inst0".to_owned(),
                    }),
                    Vec::new(),
                ],
                requests.iter().map(call).collect(),
            )
        }
        Kind::HiSlip => {
            let messages = [
                Message::new(Hi::DataEnd, 1, FIRST_ID).with(*b"*IDN?\n"),
                Message::new(Hi::Data, 0, FIRST_ID).with(*b"VOLT 1"),
                Message::new(Hi::DeviceClearComplete, 0, 0),
                Message::new(Hi::Trigger, 0, FIRST_ID),
                Message::new(Hi::AsyncDeviceClear, 0, 0),
                Message::new(Hi::AsyncStatusQuery, 1, FIRST_ID),
                Message::new(Hi::AsyncMaxMsgSize, 0, 0).with(20_u64.to_be_bytes()),
                Message::new(Hi::AsyncLock, 1, 0),
                Message::new(Hi::AsyncLockInfo, 0, 0),
            ];
            let opening = [
                Message::new(Hi::Initialize, 0, 0x0100_7878).with(*b"hislip0"),
                Message::new(Hi::AsyncInitialize, 0, 1),
            ];
            (
                opening.map(|message| message.encode()),
                messages.iter().map(Message::encode).collect(),
            )
        }
        Kind::Tcp => {
            let lines: [&[u8]; 8] = [
                b"*IDN?\n",
                b"FUNC:MODE CURR;CURR 1.5\r\n",
                b"CURR?;VOLT?\n",
                b"LIST:CURR 1,2,3\n",
                b"OUTP ON;*OPC?\n",
                b"SYST:ERR?\nSYST:ERR?\n",
                b"#H1F \"a\" (@1,2:3)\n",
                b"#15ab\ncd\n",
            ];
            (
                [b"*IDN?\n".to_vec(), Vec::new()],
                lines.map(<[u8]>::to_vec).into(),
            )
        }
        _ => {
            let lines: [&[u8]; 9] = [
                b"++read eoi\n",
                b"++read 10\n",
                b"++spoll\n",
                b"++clr\n++ver\n",
                b"++addr 10\n",
                b"++eos 0\n++eoi 0\n",
                b"++eot_enable 1\n++eot_char 42\n",
                b"++auto 1\n",
                b"++read_tmo_ms 1\n",
            ];
            let mut lines: Vec<Vec<u8>> = lines.map(<[u8]>::to_vec).into();
            lines.push(escaped(b"*IDN?\n"));
            ([b"++read_tmo_ms 1\n++addr 9\n".to_vec(), Vec::new()], lines)
        }
    }
}

fn port_of(address: &Address) -> String {
    let text = address.to_string();
    text.trim_start_matches("tcp://")
        .trim_start_matches("gpib:tcp:")
        .trim_start_matches("vxi11:")
        .trim_start_matches("hislip:")
        .split('/')
        .next()
        .unwrap()
        .to_owned()
}

#[test]
fn no_client_makes_a_server_panic() {
    count_panics();
    let sessions = from_environment("EIS_BENCH_FUZZ", SHARE) / SCARCITY + 1;
    for kind in [Kind::Tcp, Kind::Vxi11, Kind::HiSlip, Kind::Gpib] {
        let (opening, seeds) = client_of(kind);
        let mut random = Random(from_environment("EIS_BENCH_FUZZ_SEED", 1));
        let mut answered = 0;
        for number in 0..sessions {
            Clock::runtime(TimeMode::Real).unwrap().block_on(async {
                let clock = Clock::start(TimeMode::Real);
                let plant = std::sync::Arc::new(std::sync::Mutex::new(Recorder::default()));
                let device = mock::make("kepco-bop-mg", plant, &MockOptions::default()).unwrap();
                let port = port_of(&serve(kind, device, &clock, &MemoryHub::new()).await);
                let mut first = TcpStream::connect(&port).await.unwrap();
                let mut buffer = [0; 4096];
                first.write_all(&opening[0]).await.unwrap();
                // An adapter does not reply to its settings.
                answered += usize::from(matches!(
                    clock.deadline(20 * MOMENT, first.read(&mut buffer)).await,
                    Ok(Ok(1..))
                ));
                let mut second = TcpStream::connect(&port).await.unwrap();
                second.write_all(&opening[1]).await.unwrap();
                for _ in 0..3 {
                    // The server may have gone.
                    let _ = first.write_all(&random.input(&seeds)).await;
                    let _ = second.write_all(&random.input(&seeds)).await;
                    let _ = clock.deadline(MOMENT, first.read(&mut buffer)).await;
                }
            });
            assert_eq!(
                PANICS.load(Ordering::Relaxed),
                0,
                "{kind:?}: session {number}"
            );
        }
        println!(
            "fuzz server {kind:?}: {sessions} sessions, {answered} of them opened with an answer"
        );
        assert!(
            kind == Kind::Gpib || answered as u64 > sessions / 2,
            "{kind:?}: {answered} of {sessions}"
        );
    }
}

/// Messages of a server to a client, in order.
fn server_of(kind: Kind) -> Vec<Vec<u8>> {
    match kind {
        Kind::Vxi11 => {
            let responses = [
                Response::Link {
                    status: Status::OK,
                    link: 1,
                    abort_port: 9,
                    most_bytes: 1024,
                },
                Response::StatusByte {
                    status: Status::OK,
                    byte: 0,
                },
                Response::Written {
                    status: Status::OK,
                    size: 6,
                },
                Response::Data {
                    status: Status::OK,
                    reason: 4,
                    data: b"1.25\n".to_vec(),
                },
            ];
            let mut replies: Vec<Vec<u8>> = responses.iter().map(reply).collect();
            for (index, reply) in replies.iter_mut().enumerate() {
                // The client counts its calls.
                reply[7] = index as u8 + 1;
            }
            replies
        }
        Kind::HiSlip => vec![
            Message::new(Hi::InitializeResponse, 0, 0x0100_0001).encode(),
            Message::new(Hi::AsyncInitializeResponse, 0, 0).encode(),
            Message::new(Hi::AsyncMaxMsgSizeResponse, 0, 0)
                .with(1024_u64.to_be_bytes())
                .encode(),
            Message::new(Hi::AsyncStatusResponse, 0, 0).encode(),
            Message::new(Hi::DataEnd, 0, FIRST_ID)
                .with(*b"1.25\n")
                .encode(),
        ],
        Kind::Tcp => [
            &b"KEPCO,BOP1KW 50-20 ,E156884, 2.01\n"[..],
            b"1.25E0\r\n",
            b"#15ab\ncd\n\n",
            b"0,\"No error\"\n",
        ]
        .map(<[u8]>::to_vec)
        .into(),
        Kind::Vxi11Mapped => {
            vec![rpc::marked(
                &Reply {
                    id: 1,
                    verdict: Verdict::Success,
                    results: &Writer::default().words(&[9]).done(),
                }
                .encode(),
            )]
        }
        _ => [
            &b"Prologix 1.0\r\nPrologix 1.0\r\n"[..],
            b"9\r\nPrologix 1.0\r\n",
            b"0\r\nPrologix 1.0\r\n",
            b"1.25\nPrologix 1.0\r\n",
        ]
        .map(<[u8]>::to_vec)
        .into(),
    }
}

#[test]
fn no_server_makes_a_client_panic() {
    let sessions = from_environment("EIS_BENCH_FUZZ", SHARE) / SCARCITY + 1;
    let profile = LinkProfile {
        grammar: Grammar::Plain,
        first_timeout: 4 * MOMENT,
        timeout: 4 * MOMENT,
        ..device::plain()
    };
    for kind in [
        Kind::Tcp,
        Kind::Vxi11,
        Kind::Vxi11Mapped,
        Kind::HiSlip,
        Kind::Gpib,
    ] {
        let seeds = server_of(kind);
        let mut random = Random(from_environment("EIS_BENCH_FUZZ_SEED", 1));
        let (mut opened, mut answered) = (0, 0);
        for _ in 0..sessions {
            Clock::runtime(TimeMode::Real).unwrap().block_on(async {
                let (clock, hub) = (Clock::start(TimeMode::Real), MemoryHub::new());
                let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
                let port = listener.local_addr().unwrap();
                // Some valid messages in the right order, then anything.
                let right = random.below(seeds.len() + 1);
                let inputs: Vec<Vec<u8>> = (0..8)
                    .map(|index| {
                        if index < right {
                            seeds[index].clone()
                        } else {
                            random.input(&seeds)
                        }
                    })
                    .collect();
                tokio::spawn(async move {
                    let mut streams = Vec::new();
                    for piece in inputs {
                        if let Ok(Ok((stream, _))) = Clock::start(TimeMode::Real)
                            .deadline(MOMENT / 4, listener.accept())
                            .await
                        {
                            streams.push(stream);
                        }
                        for stream in &mut streams {
                            let _ = stream.write_all(&piece).await;
                        }
                    }
                    let _ = Clock::start(TimeMode::Real)
                        .deadline(20 * MOMENT, std::future::pending::<()>())
                        .await;
                });
                let address = match kind {
                    Kind::Tcp => format!("tcp://{port}"),
                    Kind::Vxi11 => format!("vxi11:{port}/inst0"),
                    Kind::Vxi11Mapped => {
                        format!("vxi11:127.0.0.1/inst0?portmapper={}", port.port())
                    }
                    Kind::HiSlip => format!("hislip:{port}/hislip0"),
                    _ => format!("gpib:tcp:{port}/9"),
                };
                if let Ok(mut link) =
                    device::open(&address, profile, &clock, &hub, Tap::none()).await
                {
                    opened += 1;
                    answered += usize::from(link.query("*IDN?").await.is_ok());
                    let _ = link.reconnect().await;
                }
            });
        }
        println!("fuzz client {kind:?}: {sessions} sessions, {opened} opened, {answered} answered");
    }
}
