//! Two handles on one connection: they take turns, and one can keep the other out.

use instruments::link::LinkError;

use crate::{
    device::{Reply, later, now, plain},
    link::with_link,
};

fn script(message: &str) -> Reply {
    match message {
        "SLOW?" => later(0.8, "slow\n"),
        "NEVER?" => Reply::Silence,
        "CURR?" => now("0.25\n"),
        _ => Reply::Silence,
    }
}

#[test]
fn handles_take_turns_and_wait_for_one_exchange_at_most() {
    with_link(plain(), script, async |mut procedure, _, heard| {
        let mut watch = procedure.share(procedure.clock());
        let clock = procedure.clock().clone();
        let long = async {
            for _ in 0..3 {
                assert_eq!(procedure.query("SLOW?").await.unwrap(), "slow");
            }
        };
        let short = async {
            clock.sleep_s(0.1).await;
            assert_eq!(watch.query("CURR?").await.unwrap(), "0.25");
            clock.now_s()
        };
        let ((), read_s) = tokio::join!(long, short);
        assert_eq!(read_s, 0.8);
        let messages: Vec<String> = heard().into_iter().map(|(_, message)| message).collect();
        assert_eq!(messages, ["SLOW?", "CURR?", "SLOW?", "SLOW?"]);
    });
}

#[test]
fn a_handle_that_takes_over_ends_an_exchange_and_keeps_others_out() {
    with_link(plain(), script, async |mut procedure, _, _| {
        let mut watch = procedure.share(procedure.clock());
        let clock = procedure.clock().clone();
        let hangs = async {
            let error = procedure.query("NEVER?").await.unwrap_err();
            (error, clock.now_s())
        };
        let taking = async {
            clock.sleep_s(0.2).await;
            watch.take_over();
            // The exchange that was given up has dropped the connection.
            clock.sleep_s(0.4).await;
            assert!(watch.is_dropped());
            watch.reconnect().await.unwrap();
            watch.query("CURR?").await.unwrap()
        };
        let ((error, ended_s), answer) = tokio::join!(hangs, taking);
        assert!(matches!(error, LinkError::TakenOver { .. }), "{error}");
        assert_eq!((ended_s, answer.as_str()), (0.5, "0.25"));
        let kept_out = procedure.query("CURR?").await.unwrap_err();
        assert_eq!(
            kept_out.to_string(),
            "dev: another task has taken over the connection, to switch the instrument off"
        );
        watch.release();
        assert_eq!(procedure.query("CURR?").await.unwrap(), "0.25");
    });
}

#[test]
fn an_answer_that_is_on_its_way_is_taken_before_a_handle_is_kept_out() {
    with_link(
        plain(),
        |_| later(0.1, "late\n"),
        async |mut procedure, _, _| {
            let watch = procedure.share(procedure.clock());
            let (answer, ()) = tokio::join!(procedure.query("A?"), async { watch.take_over() });
            assert_eq!(answer.unwrap(), "late");
            assert!(!watch.is_dropped());
        },
    );
}

#[test]
fn the_answer_time_is_the_shorter_of_the_last_two_without_the_turn_of_another_handle() {
    with_link(plain(), script, async |mut procedure, _, _| {
        let mut watch = procedure.share(procedure.clock());
        let (slow, short) = tokio::join!(procedure.query("SLOW?"), watch.query("CURR?"));
        assert_eq!(
            (slow.unwrap(), short.unwrap()),
            ("slow".into(), "0.25".into())
        );
        // The second question waited for the first one, and was answered at once.
        assert!(watch.answer_time_s() < 0.1, "{}", watch.answer_time_s());
        procedure.query("SLOW?").await.unwrap();
        assert!(watch.answer_time_s() < 0.1);
        procedure.query("SLOW?").await.unwrap();
        assert!(
            (watch.answer_time_s() - 0.8).abs() < 0.05,
            "{}",
            watch.answer_time_s()
        );
        procedure.query("NEVER?").await.unwrap_err();
        // No answer counts with its deadline.
        let deadline_s = plain().timeout.as_secs_f64();
        assert!((watch.answer_time_s() - deadline_s.min(0.8)).abs() < 0.05);
    });
}
