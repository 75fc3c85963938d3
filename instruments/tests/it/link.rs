//! The rules of the link, in virtual time over in-process pipes.

use std::{cell::Cell, future::Future, time::Duration};

use instruments::{
    clock::{Clock, TimeMode},
    link::{Link, LinkError, LinkProfile},
    scpi::block::encode_definite,
    transcript::Tap,
    transport::MemoryHub,
};

use crate::device::{Reply, SharedText, later, now, open, plain, serve_memory};

/// Runs `test` in virtual time with a link to a scripted device, its tap, and the messages that the
/// device received.
pub(crate) fn with_link<F: Future<Output = ()>>(
    profile: LinkProfile,
    reply: impl FnMut(&str) -> Reply + Send + Clone + 'static,
    test: impl FnOnce(Link, SharedText, Box<dyn Fn() -> Vec<(f64, String)>>) -> F,
) {
    Clock::runtime(TimeMode::Virtual).unwrap().block_on(async {
        let (clock, hub, text) = (
            Clock::start(TimeMode::Virtual),
            MemoryHub::new(),
            SharedText::default(),
        );
        let heard = serve_memory(&hub, &clock, reply);
        let link = open(
            "memory:device",
            profile,
            &clock,
            &hub,
            Tap::new(text.clone()),
        )
        .await
        .unwrap();
        let heard = Box::new(move || heard.lock().unwrap().clone());
        test(link, text, heard).await;
    });
}

#[test]
fn opening_sends_nothing_and_every_message_is_on_the_tap() {
    let script = |message: &str| match message {
        "*IDN?" => later(0.25, "KEPCO,BOP1KW 50-20 ,E156884, 2.01\r\n"),
        "CURV?" => now(b"C1:WF ALL,#13a\nb\n\n".to_vec()),
        _ => Reply::Silence,
    };
    with_link(plain(), script, async |mut link, text, heard| {
        tokio::task::yield_now().await;
        assert_eq!(heard(), []);
        assert_eq!(
            link.query("*IDN?").await.unwrap(),
            "KEPCO,BOP1KW 50-20 ,E156884, 2.01"
        );
        assert_eq!(link.query_block("CURV?").await.unwrap(), b"a\nb");
        link.send("OUTP OFF").await.unwrap();
        let expected = [
            "0.000000 dev * connected to memory:device",
            "0.000000 dev > *IDN?",
            "0.250000 dev < KEPCO,BOP1KW 50-20 ,E156884, 2.01",
            "0.250000 dev > CURV?",
            "0.250000 dev <# 3 fnv1a64=e5beb1190415e670 hex=610a62 prefix=C1:WF ALL,",
            "0.250000 dev > OUTP OFF",
        ];
        assert_eq!(text.text().lines().collect::<Vec<_>>(), expected);
    });
}

#[test]
fn what_comes_unasked_is_thrown_away_and_recorded() {
    let script = |message: &str| match message {
        "FIRST?" => Reply::Pieces(vec![
            (0.0, b"1\n\r\n".to_vec()),
            (0.1, b"and\xb5 more\n".to_vec()),
        ]),
        _ => now("2\n"),
    };
    with_link(plain(), script, async |mut link, text, _| {
        assert_eq!(link.query("FIRST?").await.unwrap(), "1");
        link.clock().sleep_s(0.5).await;
        assert_eq!(link.query("SECOND?").await.unwrap(), "2");
        assert_eq!(
            text.lines()[3..],
            ["dev ! andµ more\\n", "dev > SECOND?", "dev < 2"]
        );
    });
}

#[test]
fn the_final_line_end_of_a_block_may_come_late_and_twice() {
    let script = |message: &str| match message {
        "BLOCK?" => Reply::Pieces(vec![
            (0.0, b"#13\n\n\n".to_vec()),
            (0.1, b"\n".to_vec()),
            (0.1, b"\n".to_vec()),
        ]),
        _ => later(0.15, "2\n"),
    };
    with_link(plain(), script, async |mut link, text, _| {
        for _ in 0..3 {
            assert_eq!(link.query_block("BLOCK?").await.unwrap(), b"\n\n\n");
            assert_eq!(link.query("NEXT?").await.unwrap(), "2");
        }
        assert!(
            !text.text().contains(" ! "),
            "line ends are not unexpected bytes: {}",
            text.text()
        );
    });
}

#[test]
fn a_block_arrives_whole_however_it_is_cut() {
    let payload = b"\n#3\r\n\"\x00\xff\n".to_vec();
    let reply = [
        b"C1:WF ALL,".to_vec(),
        encode_definite(&payload).unwrap(),
        b"\n\n".to_vec(),
    ]
    .concat();
    let cuts = reply.len();
    let script = {
        let (reply, next) = (reply, Cell::new(0));
        move |message: &str| match message {
            "BLOCK?" => {
                let (left, right) = reply.split_at(next.get());
                next.set(next.get() + 1);
                Reply::Pieces(vec![(0.0, left.to_vec()), (0.01, right.to_vec())])
            }
            _ => now("ok\n"),
        }
    };
    with_link(plain(), script, async |mut link, _, _| {
        for cut in 0..=cuts {
            assert_eq!(
                link.query_block("BLOCK?").await.unwrap(),
                payload,
                "cut at {cut}"
            );
            assert_eq!(
                link.query("NEXT?").await.unwrap(),
                "ok",
                "after the cut at {cut}"
            );
        }
    });
}

#[test]
fn a_queued_error_refuses_the_message_and_the_queue_is_emptied() {
    let script = {
        let queue = Cell::new(0);
        move |message: &str| match message {
            "BAD 1" => {
                queue.set(2);
                Reply::Silence
            }
            "SYST:ERR?" => {
                let left = queue.replace(queue.get().max(1) - 1);
                now(match left {
                    2 => "-222,\"Data out of range;BAD\"\n",
                    1 => "201,\"DEVICE TURNED OFF\"\n",
                    _ => "+0,\"No error\"\n",
                })
            }
            _ => Reply::Silence,
        }
    };
    with_link(
        LinkProfile {
            error_query: Some("SYST:ERR?"),
            ..plain()
        },
        script,
        async |mut link, text, _| {
            link.send("GOOD 1").await.unwrap();
            let refused = link.send("BAD 1").await.unwrap_err();
            assert_eq!(
                refused.to_string(),
                "dev: `BAD 1` was refused: -222, Data out of range;BAD; 201,\"DEVICE TURNED OFF\""
            );
            assert!(!link.is_dropped() && !refused.drops_link());
            link.send("GOOD 2").await.unwrap();
            let asked = text
                .lines()
                .iter()
                .filter(|line| line.ends_with("> SYST:ERR?"))
                .count();
            assert_eq!(asked, 1 + 3 + 1);
        },
    );
}

#[test]
fn a_queue_that_never_empties_does_not_hold_the_link() {
    let script = |message: &str| {
        if message == "SYST:ERR?" {
            now("-350,\"Queue overflow\"\n")
        } else {
            Reply::Silence
        }
    };
    with_link(
        LinkProfile {
            error_query: Some("SYST:ERR?"),
            ..plain()
        },
        script,
        async |mut link, _, heard| {
            let refused = link.send("X").await.unwrap_err();
            assert!(
                matches!(&refused, LinkError::Refused { code: -350, further, .. } if further.len() == 19),
                "{refused}"
            );
            assert_eq!(heard().len(), 21);
        },
    );
}

#[test]
fn an_answer_that_is_not_a_queue_entry_drops_the_link() {
    let script = |message: &str| {
        if message == "SYST:ERR?" {
            now("CURRENT\n")
        } else {
            Reply::Silence
        }
    };
    with_link(
        LinkProfile {
            error_query: Some("SYST:ERR?"),
            ..plain()
        },
        script,
        async |mut link, _, _| {
            let error = link.send("X").await.unwrap_err();
            assert_eq!(
                error.to_string(),
                "dev: answer to `SYST:ERR?`: expected an error-queue entry such as `0,\"No \
                error\"`, found `CURRENT`"
            );
            assert!(link.is_dropped());
        },
    );
}

#[test]
fn what_was_set_is_read_back() {
    let script = |message: &str| {
        if message == "CURR?" {
            now("-2.0E0\n")
        } else {
            Reply::Silence
        }
    };
    with_link(plain(), script, async |mut link, _, _| {
        let is = |wanted: &'static str| {
            move |answer: &str| {
                if answer == wanted {
                    Ok(())
                } else {
                    Err(wanted.to_owned())
                }
            }
        };
        link.set("CURR -2", "CURR?", is("-2.0E0")).await.unwrap();
        let error = link
            .set("CURR -2.5", "CURR?", is("-2.5E0"))
            .await
            .unwrap_err();
        assert_eq!(
            error.to_string(),
            "dev: after `CURR -2.5`, `CURR?` answered `-2.0E0`: expected -2.5E0"
        );
        assert!(!link.is_dropped());
    });
}

#[test]
fn gaps_are_kept_in_bench_time() {
    let profile = LinkProfile {
        min_gap: Duration::from_millis(10),
        write_gap: Duration::from_millis(250),
        ..plain()
    };
    with_link(
        profile,
        |message| {
            if message.ends_with('?') {
                later(0.1, "1\n")
            } else {
                Reply::Silence
            }
        },
        async |mut link, _, heard| {
            link.send("A").await.unwrap();
            link.query("B?").await.unwrap();
            link.query("C?").await.unwrap();
            link.clock().sleep_s(3.0).await;
            link.send("D").await.unwrap();
            tokio::task::yield_now().await;
            let times: Vec<f64> = heard().iter().map(|(time_s, _)| *time_s).collect();
            let expected = [0.0, 0.25, 0.36, 3.46];
            assert!(
                times
                    .iter()
                    .zip(expected)
                    .all(|(time, expected)| (time - expected).abs() < 0.002),
                "{times:?}"
            );
        },
    );
}

#[test]
fn the_first_answer_may_take_longer_than_later_ones() {
    with_link(
        plain(),
        |message| later(if message == "FIRST?" { 2.9 } else { 1.1 }, "1\n"),
        async |mut link, _, _| {
            assert_eq!(link.query("FIRST?").await.unwrap(), "1");
            assert!(matches!(
                link.query("SECOND?").await,
                Err(LinkError::Timeout { deadline, .. }) if deadline == Duration::from_secs(1)
            ));
        },
    );
}

#[test]
fn messages_that_would_break_the_line_are_not_sent() {
    with_link(
        plain(),
        |_| Reply::Silence,
        async |mut link, _, heard| {
            for message in ["", "OUTP OFF\nOUTP ON", "FREQ 1 kΩ", "A\tB"] {
                let error = link.send_unchecked(message).await.unwrap_err();
                assert!(
                    matches!(error, LinkError::Unsendable { .. })
                        && error.to_string().ends_with("; nothing was sent"),
                    "{error}"
                );
            }
            assert!(!link.is_dropped());
            link.clock().sleep_s(1.0).await;
            assert_eq!(heard(), []);
        },
    );
}

#[test]
fn an_exchange_may_run_on_any_task() {
    fn is_send<T: Send>(value: T) -> T {
        value
    }
    with_link(
        plain(),
        |_| now("1\n"),
        async |mut link, _, _| {
            let task = tokio::spawn(is_send(async move {
                link.set("A 1", "A?", |answer| {
                    if answer == "1" {
                        Ok(())
                    } else {
                        Err("1".to_owned())
                    }
                })
                .await
                .unwrap();
                link.reconnect().await.unwrap();
                link.query_block("B?").await.unwrap_err().to_string()
            }));
            assert!(task.await.unwrap().contains("expected a block"));
        },
    );
}

#[test]
fn what_harms_and_what_is_not_a_message_never_reaches_the_wire() {
    with_link(
        plain(),
        |_| Reply::Hangup(b"1\n".to_vec()),
        async |mut link, text, _| {
            for (error, expected) in [
                (
                    link.send_unchecked("OUTP OFF;*RST").await.unwrap_err(),
                    "dev: `OUTP OFF;*RST` holds *RST, which is never sent",
                ),
                (
                    link.query("DIAG:TST?").await.unwrap_err(),
                    "dev: `DIAG:TST?` holds DIAGnostic:TST?, which is never sent",
                ),
                (
                    link.send_unchecked("OUTP?").await.unwrap_err(),
                    "expected a command, found a question",
                ),
                (
                    link.query("OUTP ON").await.unwrap_err(),
                    "expected a question, found a command",
                ),
            ] {
                assert!(error.to_string().contains(expected), "{error}");
                assert!(
                    !error.drops_link() && error.to_string().contains("nothing was sent"),
                    "{error}"
                );
            }
            assert!(
                !text.lines().iter().any(|line| line.contains("> ")),
                "{}",
                text.text()
            );
        },
    );
}

#[test]
fn a_read_back_that_is_not_yet_so_is_asked_again_and_the_command_is_not() {
    use instruments::exchange::{Exchange, play};
    let mut asked = 0;
    let script = move |message: &str| match message {
        "OUTP?" => {
            asked += 1;
            now(if asked < 3 { "0\n" } else { "1\n" })
        }
        _ => Reply::Silence,
    };
    with_link(plain(), script, async |mut link, _, heard| {
        play(&mut link, &[], &[Exchange::switch("OUTP", true)])
            .await
            .unwrap();
        let heard: Vec<String> = heard().into_iter().map(|(_, message)| message).collect();
        assert_eq!(heard, ["OUTP ON", "OUTP?", "OUTP?", "OUTP?"]);
    });
}
