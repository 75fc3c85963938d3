//! The same link over real sockets and pseudo terminals, in real time.

use std::time::Duration;

use instruments::{
    clock::{Clock, TimeMode},
    link::{Grammar, LinkError, LinkProfile},
    scpi::{block::encode_definite, decode::Terminator},
    transcript::Tap,
    transport::{MemoryHub, Pty},
};
use tokio::{
    io::{AsyncReadExt, AsyncWriteExt},
    net::TcpListener,
};

use crate::device::{Reply, SharedText, later, now, open, plain, serve};

fn in_real_time(test: impl AsyncFnOnce(Clock)) {
    Clock::runtime(TimeMode::Real)
        .unwrap()
        .block_on(async { test(Clock::start(TimeMode::Real)).await });
}

/// Replies like a chiller: CR in, CR LF out with flow bytes in between. A message that is not a
/// query gets no reply.
fn chiller(message: &str) -> Reply {
    match message {
        "IN_PV_00" => now(b"\x1323.5\x110\r\n".to_vec()),
        "STATUS" => now(b"02 REMOTE STOP\r\n".to_vec()),
        "SLOW" => later(0.8, b"slow\r\n".to_vec()),
        _ => Reply::Silence,
    }
}

/// Deadlines that a busy machine does not miss.
fn patient() -> LinkProfile {
    LinkProfile {
        first_timeout: Duration::from_secs(20),
        timeout: Duration::from_secs(20),
        block_timeout: Duration::from_secs(20),
        ..plain()
    }
}

fn chiller_profile() -> LinkProfile {
    LinkProfile {
        grammar: Grammar::Plain,
        terminator: Terminator::Cr,
        quiet: Duration::from_millis(20),
        strip_flow_bytes: true,
        ..patient()
    }
}

#[test]
fn a_socket_carries_lines_and_blocks_in_any_pieces() {
    in_real_time(async |clock| {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = format!("tcp://{}", listener.local_addr().unwrap());
        let payload: Vec<u8> = (0..300_000_u32).map(|index| (index % 251) as u8).collect();
        let block = [encode_definite(&payload).unwrap(), b"\n\n".to_vec()].concat();
        let (device_clock, pieces) = (
            clock.clone(),
            block
                .chunks(7000)
                .map(|piece| (0.0, piece.to_vec()))
                .collect::<Vec<_>>(),
        );
        tokio::spawn(async move {
            let (stream, _) = listener.accept().await.unwrap();
            let script = move |message: &str| match message {
                "CURV?" => Reply::Pieces(pieces.clone()),
                "SYST:ERR?" => now("+0,\"No error\"\n"),
                _ => Reply::Silence,
            };
            serve(stream, Terminator::Lf, device_clock, script).await;
        });
        let profile = LinkProfile {
            error_query: Some("SYST:ERR?"),
            ..patient()
        };
        let mut link = open(&address, profile, &clock, &MemoryHub::new(), Tap::none())
            .await
            .unwrap();
        for _ in 0..3 {
            link.send("VOLT 1").await.unwrap();
            assert!(link.query_block("CURV?").await.unwrap() == payload);
        }
    });
}

#[test]
fn bytes_that_came_unasked_over_a_socket_are_seen_before_the_next_query() {
    in_real_time(async |clock| {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = format!("tcp://{}", listener.local_addr().unwrap());
        let text = SharedText::default();
        let mut link = open(
            &address,
            patient(),
            &clock,
            &MemoryHub::new(),
            Tap::new(text.clone()),
        )
        .await
        .unwrap();
        let (mut device, _) = listener.accept().await.unwrap();
        device.write_all(b"Welcome to the shell\n").await.unwrap();
        let answer = tokio::join!(link.query("*IDN?"), async {
            let mut message = [0; 6];
            device.read_exact(&mut message).await.unwrap();
            device.write_all(b"KEPCO\n").await.unwrap();
        });
        assert_eq!(answer.0.unwrap(), "KEPCO");
        assert_eq!(
            text.lines()[1..],
            [
                "dev ! Welcome to the shell\\n",
                "dev > *IDN?",
                "dev < KEPCO"
            ]
        );
    });
}

#[test]
fn a_refused_and_a_reset_socket_are_named() {
    in_real_time(async |clock| {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = format!("tcp://{}", listener.local_addr().unwrap());
        let mut link = open(&address, patient(), &clock, &MemoryHub::new(), Tap::none())
            .await
            .unwrap();
        drop(listener.accept().await.unwrap());
        drop(listener);
        let closed = link.query("*IDN?").await.unwrap_err();
        assert_eq!(
            closed.to_string(),
            "dev: the connection was closed from the other side at `*IDN?`"
        );
        let refused = link.reconnect().await.unwrap_err();
        assert!(
            matches!(refused, LinkError::Connect { .. })
                && refused
                    .to_string()
                    .contains(&format!("cannot open {address}: ")),
            "{refused}"
        );
        assert!(link.is_dropped());
    });
}

#[test]
fn a_serial_dialect_works_on_a_pseudo_terminal() {
    in_real_time(async |clock| {
        let pty = Pty::open().unwrap();
        let address = format!(
            "serial:{}?baud=4800&parity=even&data=7&flow=rtscts",
            pty.path()
        );
        tokio::spawn(serve(pty, Terminator::Cr, clock.clone(), chiller));
        let text = SharedText::default();
        let mut link = open(
            &address,
            chiller_profile(),
            &clock,
            &MemoryHub::new(),
            Tap::new(text.clone()),
        )
        .await
        .unwrap();
        for _ in 0..50 {
            assert_eq!(link.query("IN_PV_00").await.unwrap(), "23.50");
            link.send("OUT_SP_00 12.50").await.unwrap();
            assert_eq!(link.query("STATUS").await.unwrap(), "02 REMOTE STOP");
        }
        assert!(
            !text.text().contains(" ! "),
            "an echo or a stray byte: {}",
            text.text()
        );
    });
}

#[test]
fn a_late_answer_on_a_serial_line_does_not_outlive_the_reconnect() {
    in_real_time(async |clock| {
        let pty = Pty::open().unwrap();
        let address = format!("serial:{}", pty.path());
        tokio::spawn(serve(pty, Terminator::Cr, clock.clone(), chiller));
        let text = SharedText::default();
        let profile = LinkProfile {
            timeout: Duration::from_millis(500),
            ..chiller_profile()
        };
        let mut link = open(
            &address,
            profile,
            &clock,
            &MemoryHub::new(),
            Tap::new(text.clone()),
        )
        .await
        .unwrap();
        assert_eq!(link.query("STATUS").await.unwrap(), "02 REMOTE STOP");
        assert!(matches!(
            link.query("SLOW").await,
            Err(LinkError::Timeout { .. })
        ));
        // The same line again: unlike a socket it still carries the replies to earlier queries.
        link.reconnect().await.unwrap();
        assert_eq!(link.query("IN_PV_00").await.unwrap(), "23.50");
        assert!(
            text.lines().contains(&"dev ! slow\\r\\n".to_owned()),
            "{}",
            text.text()
        );
    });
}

#[test]
fn a_pulled_plug_is_a_closed_connection() {
    in_real_time(async |clock| {
        let pty = Pty::open().unwrap();
        let address = format!("serial:{}", pty.path());
        let mut link = open(
            &address,
            chiller_profile(),
            &clock,
            &MemoryHub::new(),
            Tap::none(),
        )
        .await
        .unwrap();
        let (answer, ()) = tokio::join!(link.query("STATUS"), async { drop(pty) });
        let error = answer.unwrap_err();
        assert!(matches!(error, LinkError::Closed { .. }), "{error}");
        assert!(link.is_dropped());
        assert!(matches!(
            link.reconnect().await,
            Err(LinkError::Connect { .. })
        ));
    });
}
