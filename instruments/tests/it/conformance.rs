//! Requirements on every transport, our client against our server, over real sockets, terminals and
//! files: one list for all.

use std::{
    sync::{Arc, Mutex},
    time::Duration,
};

use instruments::{
    clock::{Clock, TimeMode},
    generator,
    instrument::{Instrument, Model},
    link::{Grammar, LinkError, LinkProfile},
    mock::{self, MockOptions},
    supply4q,
    transcript::Tap,
    transport::{Address, MemoryHub, connect},
};
use tokio::{io::AsyncWriteExt, net::TcpListener};

use crate::{
    device::{self, SharedText},
    drivers_common::dialect,
    mocks_plant::Recorder,
    transports::{Bench, IDENTITY, Kind, kinds, over, patient, payload, serve, socket_file, text},
};

#[test]
fn questions_and_commands_go_to_and_fro() {
    over(&Kind::ALL, async |bench| {
        let mut link = bench.patient().await;
        for _ in 0..20 {
            assert_eq!(
                link.query("*IDN?").await.unwrap(),
                IDENTITY,
                "{:?}",
                bench.kind
            );
            link.send("++mode 0").await.unwrap();
            assert_eq!(
                link.query("FAST?").await.unwrap(),
                "fast",
                "{:?}",
                bench.kind
            );
        }
        let heard = bench.script.heard();
        assert_eq!(heard.len(), 60, "{:?}: {heard:?}", bench.kind);
        assert_eq!(heard[..3], ["*IDN?", "++mode 0", "FAST?"]);
    });
}

#[test]
fn blocks_hold_any_bytes_and_any_number_of_them() {
    // Above the greatest page, the greatest message and the greatest transfer of every transport,
    // to the byte, and 1 MiB.
    let lengths = [
        0,
        1,
        10,
        4095,
        4096,
        32_768 - 8,
        65_536,
        262_144 - 9,
        300_001,
        1 << 20,
    ];
    over(&Kind::ALL, async |bench| {
        let mut link = bench.patient().await;
        for length in lengths {
            for message in [format!("BLOCK? {length}"), format!("TAIL? {length}")] {
                let block = link
                    .query_block(&message)
                    .await
                    .unwrap_or_else(|error| panic!("{:?}: {error}", bench.kind));
                assert!(
                    block == payload(length),
                    "{:?} {message}: {} bytes",
                    bench.kind,
                    block.len()
                );
                assert_eq!(
                    link.query("FAST?").await.unwrap(),
                    "fast",
                    "{:?} after {message}",
                    bench.kind
                );
            }
        }
    });
}

#[test]
fn a_text_of_a_mebibyte_and_a_message_beyond_every_page() {
    over(&Kind::ALL, async |bench| {
        let mut link = bench
            .link(
                LinkProfile {
                    max_line: 2 << 20,
                    ..patient()
                },
                Tap::none(),
            )
            .await
            .unwrap();
        for length in [4096, 65_535, 1 << 20] {
            assert!(
                link.query(&format!("TEXT? {length}")).await.unwrap() == text(length),
                "{:?} {length}",
                bench.kind
            );
        }
        for length in [32_767, 65_536, 300_000] {
            let message = format!("LENGTH? {}", "x".repeat(length - 8));
            assert_eq!(
                link.query(&message).await.unwrap(),
                length.to_string(),
                "{:?}",
                bench.kind
            );
        }
    });
}

#[test]
#[ignore = "drill"]
fn late_and_split_answers_are_whole() {
    over(&Kind::ALL, async |bench| {
        let mut link = bench.patient().await;
        for _ in 0..3 {
            assert_eq!(
                link.query("SPLIT?").await.unwrap(),
                "1.2345",
                "{:?}",
                bench.kind
            );
            assert_eq!(
                link.query("LATE? 0.3").await.unwrap(),
                "late",
                "{:?}",
                bench.kind
            );
        }
        // Longer than an adapter or a driver waits for a byte.
        assert_eq!(
            link.query("LATE? 1.3").await.unwrap(),
            "late",
            "{:?}",
            bench.kind
        );
        assert_eq!(
            link.query("FAST?").await.unwrap(),
            "fast",
            "{:?}",
            bench.kind
        );
    });
}

#[test]
fn where_a_message_has_an_end_the_end_counts() {
    over(&kinds(|kind| !kind.is_stream()), async |bench| {
        let mut link = bench.patient().await;
        for length in [1, 5000, 100_000] {
            let block = link
                .query_block(&format!("ENDLESS? {length}"))
                .await
                .unwrap();
            assert!(
                block == payload(length),
                "{:?} {length}: {}",
                bench.kind,
                block.len()
            );
        }
        assert_eq!(
            link.query("BARE?").await.unwrap(),
            "without a line end",
            "{:?}",
            bench.kind
        );
        assert_eq!(
            link.query("FAST?").await.unwrap(),
            "fast",
            "{:?}",
            bench.kind
        );
    });
}

/// Late replies: they arrive long after the client has stopped waiting for them. Each later query
/// must still get its own reply.
async fn stays_in_step(bench: &Bench, profile: LinkProfile, overdue: &[&str]) {
    let log = SharedText::default();
    let mut link = bench.link(profile, Tap::new(log.clone())).await.unwrap();
    let mut answered = 0;
    for question in overdue {
        let timeout = link.query(question).await.unwrap_err();
        assert!(
            matches!(timeout, LinkError::Timeout { .. }),
            "{:?} {question}: {timeout}",
            bench.kind
        );
        for pause_s in [0.0, 0.0, 1.0, 0.0] {
            // A machine that is busy may cause further timeouts, but never a wrong answer.
            if link.is_dropped() && link.reconnect().await.is_err() {
                continue;
            }
            bench.clock.sleep_s(pause_s).await;
            match link.query("FAST?").await {
                Ok(answer) => assert_eq!(
                    answer,
                    "fast",
                    "{:?} after {question}:\n{}",
                    bench.kind,
                    log.text()
                ),
                Err(LinkError::Timeout { .. }) => continue,
                Err(error) => panic!("{:?} after {question}: {error}\n{}", bench.kind, log.text()),
            }
            answered += 1;
        }
    }
    assert!(
        answered >= 3 * overdue.len(),
        "{:?}: {answered} answers\n{}",
        bench.kind,
        log.text()
    );
}

fn impatient(grammar: Grammar) -> LinkProfile {
    LinkProfile {
        grammar,
        error_query: (grammar == Grammar::Scpi).then_some("SYST:ERR?"),
        first_timeout: Duration::from_secs(10),
        timeout: Duration::from_secs(1),
        block_timeout: Duration::from_secs(1),
        ..patient()
    }
}

#[test]
#[ignore = "drill"]
fn after_a_timeout_no_question_gets_the_previous_answer() {
    over(&Kind::ALL, async |bench| {
        let mut link = bench.patient().await;
        // The first answer may take longer than the others: past that.
        assert_eq!(link.query("FAST?").await.unwrap(), "fast");
        drop(link);
        let profile = LinkProfile {
            first_timeout: Duration::from_secs(10),
            ..impatient(Grammar::Scpi)
        };
        let log = SharedText::default();
        let mut first = bench.link(profile, Tap::new(log)).await.unwrap();
        first.query("*IDN?").await.unwrap();
        drop(first);
        stays_in_step(
            bench,
            LinkProfile {
                first_timeout: Duration::from_secs(1),
                ..profile
            },
            &["LATE? 1.5", "LATEBLOCK? 1.8"],
        )
        .await;
    });
}

#[test]
fn what_a_client_left_behind_is_not_the_answer_to_the_first_question_of_the_next() {
    over(
        &kinds(|kind| {
            matches!(
                kind,
                Kind::Vxi11 | Kind::Vxi11Mapped | Kind::HiSlip | Kind::Gpib | Kind::GpibSerial
            )
        }),
        async |bench| {
            let mut channel = bench.channel().await;
            channel.send(b"LATE? 0\n").await.unwrap();
            while channel.status_byte().await.unwrap() != Some(0x10) {}
            drop(channel);
            let mut link = bench.patient().await;
            assert_eq!(
                link.query("FAST?").await.unwrap(),
                "fast",
                "{:?}",
                bench.kind
            );
        },
    );
}

/// USBTMC has no status byte here: an unexpected identity shows that a reply was left unread, with
/// and without an error queue.
#[test]
fn over_usbtmc_the_identity_brings_the_link_into_step_with_what_a_client_left_behind() {
    Clock::runtime(TimeMode::Real).unwrap().block_on(async {
        for (model, left, identity) in [
            ("kepco-bop-mg", "CURR?", "KEPCO"),
            ("siglent-sdg1000x", "C1:OUTP?", "Siglent Technologies"),
        ] {
            let (clock, hub) = (Clock::start(TimeMode::Real), MemoryHub::new());
            let device = mock::make(
                model,
                Arc::new(Mutex::new(Recorder::default())),
                &MockOptions::quirk("first_answer", 1.0),
            )
            .unwrap();
            let address = serve(Kind::UsbTmc, device, &clock, &hub).await;
            let mut earlier = connect(&address, &hub).await.unwrap();
            earlier.send(format!("{left}\n").as_bytes()).await.unwrap();
            drop(earlier);
            let models: [&'static dyn Model; 2] = [
                dialect!(supply4q, "kepco-bop-mg"),
                dialect!(generator, "siglent-sdg1000x"),
            ];
            let dialect = models
                .into_iter()
                .find(|dialect| dialect.key() == model)
                .unwrap();
            let profile = LinkProfile {
                first_timeout: patient().first_timeout,
                timeout: patient().timeout,
                ..dialect.profile()
            };
            let link = device::open(&address.to_string(), profile, &clock, &hub, Tap::none())
                .await
                .unwrap();
            let mut instrument = Instrument::new(link, dialect);
            assert_eq!(instrument.identify().await.unwrap().maker, identity);
            let answer = instrument.link_mut().query(left).await.unwrap();
            assert!(!answer.contains(identity), "{model}: {answer}");
        }
    });
}

#[test]
fn the_status_byte_tells_that_an_answer_waits_and_a_device_clear_takes_it_away() {
    over(
        &kinds(|kind| !kind.is_stream() && kind != Kind::UsbTmc),
        async |bench| {
            let mut channel = bench.channel().await;
            assert_eq!(
                channel.status_byte().await.unwrap(),
                Some(0),
                "{:?}",
                bench.kind
            );
            for _ in 0..3 {
                channel.send(b"*IDN?\n").await.unwrap();
                while channel.status_byte().await.unwrap() != Some(0x10) {}
                channel.clear().await.unwrap();
                assert_eq!(
                    channel.status_byte().await.unwrap(),
                    Some(0),
                    "{:?}",
                    bench.kind
                );
                channel.send(b"FAST?\n").await.unwrap();
                let mut answer = Vec::new();
                loop {
                    let arrival = channel.receive(Duration::from_secs(30)).await.unwrap();
                    answer.extend(arrival.bytes);
                    if arrival.end {
                        break;
                    }
                }
                assert_eq!(answer, b"fast\n", "{:?}", bench.kind);
                assert_eq!(
                    channel.status_byte().await.unwrap(),
                    Some(0),
                    "{:?}",
                    bench.kind
                );
            }
        },
    );
}

#[test]
#[ignore = "drill"]
fn an_empty_message_is_not_an_answer() {
    over(&Kind::ALL, async |bench| {
        let mut link = bench
            .link(impatient(Grammar::Plain), Tap::none())
            .await
            .unwrap();
        link.query("FAST?").await.unwrap();
        let error = link.query("EMPTY?").await.unwrap_err();
        assert!(
            matches!(error, LinkError::Timeout { .. }),
            "{:?}: {error}",
            bench.kind
        );
    });
}

#[test]
fn a_connection_that_breaks_or_closes_half_is_named_and_can_be_renewed() {
    over(&kinds(Kind::breaks), async |bench| {
        let mut link = bench.patient().await;
        assert_eq!(
            link.query("HALF?").await.unwrap(),
            "1.2345",
            "{:?}",
            bench.kind
        );
        for question in ["FAST?", "HANGUP?"] {
            let error = link.query(question).await.unwrap_err();
            assert!(
                matches!(error, LinkError::Closed { .. }),
                "{:?}: {error}",
                bench.kind
            );
            link.reconnect()
                .await
                .unwrap_or_else(|error| panic!("{:?}: {error}", bench.kind));
            assert_eq!(
                link.query("FAST?").await.unwrap(),
                "fast",
                "{:?}",
                bench.kind
            );
        }
    });
}

#[test]
fn a_second_client_is_refused_or_waits_and_comes_in_when_the_first_has_gone() {
    // The kernel lets several clients open one USBTMC device, but the file belongs to the client
    // that wrote last.
    over(&kinds(|kind| kind != Kind::UsbTmc), async |bench| {
        let mut first = bench.patient().await;
        assert_eq!(first.query("FAST?").await.unwrap(), "fast");
        let short = LinkProfile {
            first_timeout: Duration::from_secs(1),
            timeout: Duration::from_secs(1),
            ..patient()
        };
        let (seen, mut second) = match bench.link(short, Tap::none()).await {
            Ok(mut second) => (
                second.query("FAST?").await.unwrap_err().to_string(),
                Some(second),
            ),
            Err(error) => (error.to_string(), None),
        };
        let expected = match bench.kind {
            Kind::Memory | Kind::Tcp => "expected an answer to `FAST?` within 1s, found none",
            Kind::Serial | Kind::GpibSerial => "cannot open",
            Kind::Vxi11 | Kind::Vxi11Mapped => {
                "procedure 10 of VXI-11 was refused: 9, out of resources"
            }
            Kind::HiSlip => "the server reports FatalError 4: another client is served",
            Kind::Gpib => "to take a connection within 1s, it did not",
            Kind::UsbTmc => unreachable!(),
        };
        assert!(seen.contains(expected), "{:?}: {seen}", bench.kind);
        assert_eq!(
            first.query("FAST?").await.unwrap(),
            "fast",
            "{:?}",
            bench.kind
        );
        drop(first);
        drop(second.take());
        let mut next = bench.patient().await;
        assert_eq!(
            next.query("FAST?").await.unwrap(),
            "fast",
            "{:?}",
            bench.kind
        );
    });
}

#[test]
fn what_cannot_be_reached_says_why() {
    Clock::runtime(TimeMode::Real).unwrap().block_on(async {
        // A port without a listener, a port that speaks neither HiSLIP nor VXI-11 nor an adapter's
        // protocol, and a missing file.
        let closed = TcpListener::bind("127.0.0.1:0")
            .await
            .unwrap()
            .local_addr()
            .unwrap();
        let other = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let talker = other.local_addr().unwrap();
        tokio::spawn(async move {
            while let Ok((mut stream, _)) = other.accept().await {
                tokio::spawn(async move {
                    let greeting =
                        b"220 mail.example.org ESMTP and quite something more than a header\n"
                            .repeat(30_000);
                    let _ = stream.write_all(&greeting).await;
                    std::future::pending::<()>().await;
                });
            }
        });
        let missing = socket_file();
        let table = [
            (format!("tcp://{closed}"), "refused"),
            (format!("vxi11:{closed}/inst0"), "refused"),
            (
                format!("vxi11:127.0.0.1/inst0?portmapper={}", closed.port()),
                "refused",
            ),
            (format!("hislip:{closed}/hislip0"), "refused"),
            (format!("gpib:tcp:{closed}/1"), "refused"),
            (format!("usbtmc:{}", missing.display()), "No such file"),
            (format!("serial:{}", missing.display()), "No such file"),
            (
                format!("hislip:{talker}/hislip0"),
                "expected a HiSLIP message that starts with `HS`, found `22`",
            ),
            (
                format!("vxi11:{talker}/inst0"),
                "expected an RPC record of at most",
            ),
        ];
        let refused = async |address: &str| {
            let address = address.parse::<Address>().unwrap();
            let error = connect(&address, &MemoryHub::new())
                .await
                .unwrap_err()
                .to_string();
            assert!(
                error.starts_with(&format!("cannot open {address}: ")),
                "{error}"
            );
            error
        };
        for (address, expected) in table {
            let error = refused(&address).await;
            assert!(error.contains(expected), "{address}: {error}");
        }
        // Whether its text is taken for the version or thrown away before depends on when it comes.
        let error = refused(&format!("gpib:tcp:{talker}/1")).await;
        let either = [
            "expected a GPIB adapter that takes address 1, found ``",
            "expected a GPIB adapter that reports its version, found `220 mail.example.org ESMTP",
        ];
        assert!(either.iter().any(|text| error.contains(text)), "{error}");
    });
}

#[test]
fn a_device_that_the_server_does_not_have_is_named() {
    over(&[Kind::Vxi11, Kind::HiSlip], async |bench| {
        let wrong = bench
            .address
            .to_string()
            .replace("inst0", "inst7")
            .replace("hislip0", "hislip7");
        let error = device::open(&wrong, patient(), &bench.clock, &bench.hub, Tap::none())
            .await
            .unwrap_err()
            .to_string();
        assert!(
            error.contains("refused: 3, device not accessible")
                || error.contains("no such device: this is hislip0"),
            "{error}"
        );
    });
}

#[test]
fn opening_sends_no_message_and_virtual_time_is_refused() {
    over(&Kind::ALL, async |bench| {
        let link = bench.patient().await;
        assert_eq!(bench.script.heard(), [""; 0], "{:?}", bench.kind);
        drop(link);
    });
    Clock::runtime(TimeMode::Virtual).unwrap().block_on(async {
        let (clock, hub) = (Clock::start(TimeMode::Virtual), MemoryHub::new());
        for address in [
            "vxi11:127.0.0.1:9/inst0",
            "hislip:127.0.0.1",
            "usbtmc:/dev/usbtmc0",
            "gpib:tcp:127.0.0.1:9/1",
        ] {
            let error = device::open(address, patient(), &clock, &hub, Tap::none())
                .await
                .unwrap_err()
                .to_string();
            assert!(
                error.starts_with("dev: expected a memory: address in virtual time, found "),
                "{error}"
            );
        }
    });
}
