//! Behaviour of a link if a reply is missing or invalid, or if the peer is absent: in virtual time
//! over in-process pipes.

use std::time::Duration;

use instruments::{
    clock::{Clock, TimeMode},
    link::{Grammar, LinkError, LinkProfile},
    transcript::Tap,
    transport::MemoryHub,
};

use crate::{
    device::{Reply, later, now, open, plain},
    link::with_link,
};

#[test]
fn after_a_timeout_no_query_gets_the_previous_answer() {
    // The reply to SLOW? arrives long after its deadline, regardless of the connection on which it
    // was sent.
    let script = |message: &str| match message {
        "SLOW?" => later(1.5, "slow\n"),
        "FAST?" => now("fast\n"),
        _ => now("ready\n"),
    };
    with_link(plain(), script, async |mut link, text, _| {
        link.query("READY?").await.unwrap();
        let timeout = link.query("SLOW?").await.unwrap_err();
        assert_eq!(
            timeout.to_string(),
            "dev: expected an answer to `SLOW?` within 1s, found none"
        );
        assert!(link.is_dropped() && timeout.drops_link());
        link.clock().sleep_s(1.0).await;
        let dropped = link.query("FAST?").await.unwrap_err();
        assert_eq!(
            dropped.to_string(),
            format!("dev: the link is dropped ({timeout}); nothing was sent")
        );
        link.reconnect().await.unwrap();
        assert_eq!(link.query("FAST?").await.unwrap(), "fast");
        link.clock().sleep_s(5.0).await;
        assert_eq!(link.query("FAST?").await.unwrap(), "fast");
        assert!(text.lines().contains(&format!("dev * dropped: {timeout}")));
        assert!(
            !text.text().contains("slow"),
            "the late answer reached the new connection: {}",
            text.text()
        );
    });
}

#[test]
fn an_abandoned_exchange_drops_the_link_too() {
    with_link(
        plain(),
        |_| later(0.2, "late\n"),
        async |mut link, _, _| {
            let clock = link.clock().clone();
            clock
                .deadline(Duration::from_millis(100), link.query("A?"))
                .await
                .unwrap_err();
            clock.sleep_s(1.0).await;
            let error = link.query("B?").await.unwrap_err();
            assert_eq!(
                error.to_string(),
                "dev: the link is dropped (`A?` was abandoned before it was done); nothing was sent"
            );
        },
    );
}

#[test]
fn broken_conversations_drop_the_link_with_their_reason() {
    let table: [(&str, Reply, &str); 5] = [
        (
            "GONE?",
            Reply::Hangup(b"half an ans".to_vec()),
            "dev: the connection was closed from the other side at `GONE?`",
        ),
        (
            "NOISE?",
            now(b"\x00\xfe\x03\n".to_vec()),
            "dev: answer to `NOISE?`: expected a line of text, found `\\u{0}þ\\u{3}`",
        ),
        (
            "HALF?",
            now(b"1.5".to_vec()),
            "dev: expected an answer to `HALF?` within 3s, found none",
        ),
        (
            "BLOCK?",
            now(b"-113,\"no\"\n".to_vec()),
            "at most 64 bytes of text), found `-113,\"no\"\\n`",
        ),
        (
            "BLOCK?",
            now(b"#210012345".to_vec()),
            "dev: expected an answer to `BLOCK?` within 5s, found none",
        ),
    ];
    for (message, reply, text) in table {
        with_link(
            plain(),
            move |_| reply.clone(),
            async |mut link, _, _| {
                let error = match message {
                    "BLOCK?" => link.query_block(message).await.unwrap_err(),
                    _ => link.query(message).await.unwrap_err(),
                };
                assert!(error.to_string().contains(text), "{error}");
                assert!(error.drops_link() && link.is_dropped());
                assert!(matches!(
                    link.send_unchecked("X").await,
                    Err(LinkError::Dropped { .. })
                ));
            },
        );
    }
}

#[test]
fn a_hangup_between_two_exchanges_is_found_before_the_next_is_sent() {
    with_link(
        plain(),
        |_| Reply::Hangup(b"1\n".to_vec()),
        async |mut link, text, _| {
            link.query("A?").await.unwrap();
            link.clock().sleep_s(0.1).await;
            let error = link.send_unchecked("OUTP ON").await.unwrap_err();
            assert_eq!(
                error.to_string(),
                "dev: the connection was closed from the other side at `OUTP ON`"
            );
            assert!(
                !text.lines().iter().any(|line| line.contains("> OUTP ON")),
                "{}",
                text.text()
            );
        },
    );
}

#[test]
fn an_instrument_that_takes_nothing_meets_a_deadline() {
    Clock::runtime(TimeMode::Virtual).unwrap().block_on(async {
        let (clock, hub) = (Clock::start(TimeMode::Virtual), MemoryHub::new());
        let mut listener = hub.listen("device").unwrap();
        let profile = LinkProfile {
            grammar: Grammar::Plain,
            ..plain()
        };
        let mut link = open("memory:device", profile, &clock, &hub, Tap::none())
            .await
            .unwrap();
        let _nobody_reads = listener.accept().await.unwrap();
        let long = "X".repeat(40_000);
        link.send_unchecked(&long).await.unwrap();
        let error = link.send_unchecked(&long).await.unwrap_err();
        assert!(
            matches!(&error, LinkError::WriteTimeout { .. })
                && error
                    .to_string()
                    .ends_with("to be taken within 1s, it was not"),
            "{error}"
        );
        assert!(link.is_dropped());
    });
}

#[test]
fn addresses_without_an_answer_are_named() {
    Clock::runtime(TimeMode::Virtual).unwrap().block_on(async {
        let (clock, hub) = (Clock::start(TimeMode::Virtual), MemoryHub::new());
        let table = [
            (
                "memory:device",
                "dev: cannot open memory:device: no simulated instrument has this name in this \
                process",
            ),
            (
                "tcp://127.0.0.1:5025",
                "dev: expected a memory: address in virtual time, found tcp://127.0.0.1:5025",
            ),
        ];
        for (address, text) in table {
            assert_eq!(
                open(address, plain(), &clock, &hub, Tap::none())
                    .await
                    .unwrap_err()
                    .to_string(),
                text
            );
        }
        drop(hub.listen("device").unwrap());
        let error = open("memory:device", plain(), &clock, &hub, Tap::none())
            .await
            .unwrap_err();
        assert!(
            error
                .to_string()
                .contains("no simulated instrument has this name"),
            "a dropped listener frees its name: {error}"
        );
        let _listener = hub.listen("device").unwrap();
        assert_eq!(
            hub.listen("device").unwrap_err().to_string(),
            "cannot listen on memory:device: somebody does already"
        );
        let mut waiting = Vec::new();
        let busy = loop {
            match open("memory:device", plain(), &clock, &hub, Tap::none()).await {
                Ok(link) => waiting.push(link),
                Err(error) => break error.to_string(),
            }
        };
        assert_eq!(
            (waiting.len(), busy.as_str()),
            (
                8,
                "dev: cannot open memory:device: its listener takes in no connections"
            )
        );
    });
}

#[test]
fn an_answer_that_stays_away_does_not_keep_the_output_on() {
    use instruments::exchange::{Exchange, play_all};
    let script = |message: &str| match message {
        "OUTP?" => now("0\n"),
        _ => Reply::Silence,
    };
    with_link(plain(), script, async |mut link, _, heard| {
        let script = [
            Exchange::word("OUTP:MODE BATTERY", "OUTP:MODE?", &["BATTERY"]),
            Exchange::switch("OUTP", false),
        ];
        let error = play_all(&mut link, &[], &script).await.unwrap_err();
        assert!(error.to_string().contains("OUTP:MODE?"), "{error}");
        let heard: Vec<String> = heard().into_iter().map(|(_, message)| message).collect();
        assert_eq!(
            heard,
            ["OUTP:MODE BATTERY", "OUTP:MODE?", "OUTP OFF", "OUTP?"]
        );
        assert!(!link.is_dropped());
    });
}
