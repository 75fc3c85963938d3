//! Random and mutated transfers in whole sessions on the socket in place of `/dev/usbtmcN`: to the
//! mock's side of it, and to our client's. Their number is that of `fuzz_sessions`.

use std::{path::Path, sync::atomic::Ordering};

use instruments::{
    clock::{Clock, TimeMode},
    link::{Grammar, LinkProfile},
    mock::{self, MockOptions},
    transcript::Tap,
    transport::MemoryHub,
};
use tokio::net::UnixDatagram;

use crate::{
    device,
    fuzz::{Random, SHARE, from_environment},
    fuzz_sessions::{MOMENT, PANICS, SCARCITY, count_panics},
    mocks_plant::Recorder,
    transports::{Kind, serve, socket_file},
};

const SEEDS: [&[u8]; 6] = [
    b"*IDN?\n",
    b"CURR?;VOLT?",
    b"FUNC:MODE CURR;CURR 1.5\n",
    b"SYST:ERR?\n",
    b"#15ab\ncd\n",
    b"KEPCO,BOP1KW 50-20 ,E156884, 2.01\n",
];

fn seeds() -> Vec<Vec<u8>> {
    SEEDS.map(<[u8]>::to_vec).into()
}

/// A socket file that is removed with its socket.
struct Here(UnixDatagram, std::path::PathBuf);

impl Here {
    fn new() -> Self {
        let path = socket_file();
        Self(UnixDatagram::bind(&path).unwrap(), path)
    }
}

impl Drop for Here {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.1);
    }
}

#[test]
fn no_transfer_makes_the_usbtmc_server_panic() {
    count_panics();
    let sessions = from_environment("EIS_BENCH_FUZZ", SHARE) / SCARCITY + 1;
    let (seeds, mut random, mut answered) = (
        seeds(),
        Random(from_environment("EIS_BENCH_FUZZ_SEED", 1)),
        0,
    );
    for number in 0..sessions {
        Clock::runtime(TimeMode::Real).unwrap().block_on(async {
            let clock = Clock::start(TimeMode::Real);
            let plant = std::sync::Arc::new(std::sync::Mutex::new(Recorder::default()));
            let device = mock::make("kepco-bop-mg", plant, &MockOptions::default()).unwrap();
            let address = serve(Kind::UsbTmc, device, &clock, &MemoryHub::new())
                .await
                .to_string();
            let path = Path::new(address.trim_start_matches("usbtmc:")).to_owned();
            let (first, second) = (Here::new(), Here::new());
            let mut buffer = [0; 4096];
            first.0.send_to(b"*IDN?\n", &path).await.unwrap();
            answered += usize::from(matches!(
                clock.deadline(20 * MOMENT, first.0.recv(&mut buffer)).await,
                Ok(Ok(1..))
            ));
            for _ in 0..3 {
                // The server may have gone.
                let _ = first.0.send_to(&random.input(&seeds), &path).await;
                let _ = second.0.send_to(&random.input(&seeds), &path).await;
                let _ = clock.deadline(MOMENT, first.0.recv(&mut buffer)).await;
            }
        });
        assert_eq!(PANICS.load(Ordering::Relaxed), 0, "session {number}");
    }
    println!("fuzz server UsbTmc: {sessions} sessions, {answered} of them opened with an answer");
    assert!(answered as u64 > sessions / 2, "{answered} of {sessions}");
}

#[test]
fn no_transfer_makes_the_usbtmc_client_panic() {
    let sessions = from_environment("EIS_BENCH_FUZZ", SHARE) / SCARCITY + 1;
    let profile = LinkProfile {
        grammar: Grammar::Plain,
        first_timeout: 4 * MOMENT,
        timeout: 4 * MOMENT,
        ..device::plain()
    };
    let (seeds, mut random) = (seeds(), Random(from_environment("EIS_BENCH_FUZZ_SEED", 1)));
    let (mut opened, mut answered) = (0, 0);
    for _ in 0..sessions {
        Clock::runtime(TimeMode::Real).unwrap().block_on(async {
            let (clock, hub, here) = (Clock::start(TimeMode::Real), MemoryHub::new(), Here::new());
            let address = format!("usbtmc:{}", here.1.display());
            let inputs: Vec<Vec<u8>> = (0..8).map(|_| random.input(&seeds)).collect();
            let instrument = tokio::spawn(async move {
                let mut buffer = [0; 4096];
                for piece in inputs {
                    let Ok((_, sender)) = here.0.recv_from(&mut buffer).await else {
                        return;
                    };
                    if let Some(sender) = sender.as_pathname() {
                        let _ = here.0.send_to(&piece, sender).await;
                    }
                }
            });
            if let Ok(mut link) = device::open(&address, profile, &clock, &hub, Tap::none()).await {
                opened += 1;
                answered += usize::from(link.query("*IDN?").await.is_ok());
                let _ = link.query_block("BLOCK?").await;
            }
            instrument.abort();
        });
    }
    println!("fuzz client UsbTmc: {sessions} sessions, {opened} opened, {answered} answered");
    assert!(answered > 0, "no session was opened with an answer");
}
