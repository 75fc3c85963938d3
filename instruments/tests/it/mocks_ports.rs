//! Mocks behind real ports: in process, TCP, pseudo terminal; raw bytes, without this crate's own
//! link.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail as tests do")]

use std::{sync::Arc, time::Duration};

use instruments::{
    clock::{Clock, TimeMode},
    mock::{self, Device, MockOptions, plant::Action},
    transport::{self, Address, MemoryHub, Stream},
};
use tokio::io::{AsyncReadExt, AsyncWriteExt};

use crate::mocks_plant::Recorder;

type Plant = Arc<std::sync::Mutex<Recorder>>;

fn device(model: &str) -> (Box<dyn Device>, Plant) {
    let plant: Plant = Plant::default();
    (
        mock::make(model, plant.clone(), &MockOptions::default()).unwrap(),
        plant,
    )
}

async fn open(address: &str, hub: &MemoryHub) -> Stream {
    transport::open(&address.parse::<Address>().unwrap(), hub)
        .await
        .unwrap()
}

/// Sends bytes and reads until the received data end with `end`.
async fn ask(stream: &mut Stream, message: &[u8], end: &[u8]) -> String {
    stream.write_all(message).await.unwrap();
    let mut reply = Vec::new();
    while !reply.ends_with(end) {
        reply.push(stream.read_u8().await.unwrap());
    }
    String::from_utf8_lossy(&reply).into_owned()
}

#[test]
fn in_process_a_mock_keeps_its_settings_from_client_to_client() {
    Clock::runtime(TimeMode::Virtual).unwrap().block_on(async {
        let (hub, clock) = (MemoryHub::new(), Clock::start(TimeMode::Virtual));
        let (device, _) = device("kepco-bop-mg");
        let task = mock::serve_memory(device, &hub, "supply4q", clock).unwrap();
        let mut first = open("memory:supply4q", &hub).await;
        assert_eq!(
            ask(&mut first, b"VOLT 4.2;:VOLT?;FUNC:MODE?\n", b"\n").await,
            "4.2E0;0\n"
        );
        // The second client is not answered until the first has gone.
        let mut second = open("memory:supply4q", &hub).await;
        second.write_all(b"VOLT?\n").await.unwrap();
        let clock = Clock::start(TimeMode::Virtual);
        assert!(
            clock
                .deadline(Duration::from_secs(5), second.read_u8())
                .await
                .is_err()
        );
        drop(first);
        assert_eq!(ask(&mut second, b"", b"\n").await, "4.2E0\n");
        task.abort();
    });
}

#[test]
fn the_time_of_a_message_is_bench_time() {
    Clock::runtime(TimeMode::Virtual).unwrap().block_on(async {
        let (hub, clock) = (MemoryHub::new(), Clock::start(TimeMode::Virtual));
        let (device, plant) = device("siglent-sdg1000x");
        mock::serve_memory(device, &hub, "generator", clock.clone()).unwrap();
        let mut stream = open("memory:generator", &hub).await;
        clock.sleep_s(36_000.0).await;
        ask(&mut stream, b"C1:OUTP ON\n*OPC?\n", b"1\n").await;
        let (t_s, action) = *plant.lock().unwrap().actions.last().unwrap();
        assert_eq!(t_s, 36_000.0);
        assert!(
            matches!(action, Action::Generator(state) if state.since_s == 36_000.0),
            "{action:?}"
        );
    });
}

#[test]
fn over_tcp_messages_may_come_in_pieces_and_clients_one_after_the_other() {
    Clock::runtime(TimeMode::Real).unwrap().block_on(async {
        let (device, _) = device("siglent-sds800x-hd");
        let (bound, task) = mock::serve_tcp(device, "127.0.0.1:0", Clock::start(TimeMode::Real))
            .await
            .unwrap();
        let (hub, address) = (MemoryHub::new(), format!("tcp://{bound}"));
        let mut stream = open(&address, &hub).await;
        stream.write_all(b":WAVeform:INT").await.unwrap();
        stream.flush().await.unwrap();
        tokio::task::yield_now().await;
        assert_eq!(
            ask(&mut stream, b"erval 5\r\n\n*IDN?\n", b"\n").await,
            "Siglent Technologies,SDS824X HD,SIM00001,4.8.12.1.1.6.5\n"
        );
        assert_eq!(
            ask(&mut stream, b":NONSENSE?\n:WAV:INT?\n", b"\n").await,
            "5\n"
        );
        drop(stream);
        let mut next = open(&address, &hub).await;
        assert_eq!(ask(&mut next, b":WAV:INT?\n", b"\n").await, "5\n");
        let preamble = ask(&mut next, b":WAV:PRE?\n", b"\n\n").await;
        assert!(preamble.starts_with("#9000000346"), "{preamble:?}");
        task.abort();
    });
}

#[test]
fn over_a_pseudo_terminal_the_chiller_answers() {
    Clock::runtime(TimeMode::Real).unwrap().block_on(async {
        let (device, _) = device("julabo");
        let (path, task) = mock::serve_pty(device, Clock::start(TimeMode::Real)).unwrap();
        let (hub, address) = (
            MemoryHub::new(),
            format!("serial:{path}?baud=4800&parity=even&data=7"),
        );
        let mut stream = open(&address, &hub).await;
        assert_eq!(
            ask(&mut stream, b"OUT_SP_00 12.50\rIN_SP_00\r", b"\r\n").await,
            "12.50\r\n"
        );
        assert_eq!(
            ask(&mut stream, b"STATUS\r", b"\r\n").await,
            "02 REMOTE STOP\r\n"
        );
        drop(stream);
        let mut next = open(&address, &hub).await;
        assert_eq!(ask(&mut next, b"IN_SP_00\r", b"\r\n").await, "12.50\r\n");
        task.abort();
    });
}
