//! Replies that a USBTMC device sends in pieces, late or without a NL.

use instruments::{
    clock::{Clock, TimeMode},
    link::{Grammar, LinkProfile},
    transcript::Tap,
    transport::MemoryHub,
};
use tokio::net::UnixDatagram;

use crate::{
    device,
    fuzz_sessions::MOMENT,
    transports::{IDENTITY, socket_file},
};

/// Bytes of a transfer of instruments with small buffers.
const PIECE: usize = 48;

fn answer(message: &str) -> Option<Vec<u8>> {
    match message {
        "*IDN?" => Some(format!("{IDENTITY},{}\n", "x".repeat(3 * PIECE)).into_bytes()),
        "FIRST?" => Some(format!("first {}\n", "a".repeat(2 * PIECE)).into_bytes()),
        // The last piece is full.
        "FULL?" => Some(format!("{}\n", "f".repeat(PIECE - 1)).into_bytes()),
        "BLOCK?" => Some([b"#3200".to_vec(), vec![b'\n'; 200], b"\n".to_vec()].concat()),
        "SECOND?" => Some(b"second\n".to_vec()),
        // No NL: the time of the driver shows the end.
        "BARE?" => Some(b"bare".to_vec()),
        _ => None,
    }
}

#[test]
fn a_reply_in_pieces_is_whole_and_the_next_question_gets_its_own() {
    let profile = LinkProfile {
        grammar: Grammar::Plain,
        first_timeout: 500 * MOMENT,
        timeout: 500 * MOMENT,
        ..device::plain()
    };
    Clock::runtime(TimeMode::Real).unwrap().block_on(async {
        let (clock, hub) = (Clock::start(TimeMode::Real), MemoryHub::new());
        let path = socket_file();
        let socket = UnixDatagram::bind(&path).unwrap();
        let address = format!("usbtmc:{}", path.display());
        let pause = clock.clone();
        let instrument = tokio::spawn(async move {
            let mut buffer = [0; 4096];
            loop {
                let (count, sender) = socket.recv_from(&mut buffer).await.unwrap();
                let message = String::from_utf8_lossy(&buffer[..count]).trim().to_owned();
                for (number, piece) in answer(&message)
                    .unwrap_or_default()
                    .chunks(PIECE)
                    .enumerate()
                {
                    if number == 1 {
                        pause.sleep(MOMENT).await;
                    }
                    let _ = socket.send_to(piece, sender.as_pathname().unwrap()).await;
                }
            }
        });
        let mut link = device::open(&address, profile, &clock, &hub, Tap::none())
            .await
            .unwrap();
        for _ in 0..4 {
            let first = link.query("FIRST?").await.unwrap();
            assert_eq!(first, format!("first {}", "a".repeat(2 * PIECE)));
            assert_eq!(link.query("SECOND?").await.unwrap(), "second");
            assert_eq!(link.query("FULL?").await.unwrap(), "f".repeat(PIECE - 1));
            assert_eq!(link.query_block("BLOCK?").await.unwrap(), vec![b'\n'; 200]);
            assert_eq!(link.query("SECOND?").await.unwrap(), "second");
        }
        assert_eq!(link.query("BARE?").await.unwrap(), "bare");
        assert_eq!(link.query("SECOND?").await.unwrap(), "second");
        instrument.abort();
        let _ = std::fs::remove_file(path);
    });
}
