//! Real processes on real ports: the state of a bath, with relays or with its own control loop,
//! after a daemon has died and after a person has switched everything off.

use std::{
    fs,
    io::{Read, Write},
    net::TcpStream,
    time::Duration,
};

use nix::sys::signal::Signal;

use crate::{
    configuration::configs,
    guardian::{on_bench, pid, report, signal, state},
    kill::start,
    support::{BENCH, EXPERIMENT, Files, Ports, json, poll},
};

/// Returns the demo on a bath with relays, in place of the bench of that name.
fn relays() -> Files {
    let files = Files::demo().without(EXPERIMENT, "fixture_check");
    let bath = fs::read_to_string(configs().join("benches/bath.toml")).unwrap();
    files.write(BENCH, &bath.replace("name = \"bath\"", "name = \"demo\""));
    files
}

/// Sends commands to a Julabo from another client, and reads its set-point.
fn tell_bath(ports: &Ports, messages: &str) -> String {
    let mut stream = TcpStream::connect(ports.address("chiller")).unwrap();
    stream
        .set_read_timeout(Some(Duration::from_secs(20)))
        .unwrap();
    stream
        .write_all(format!("{messages}IN_SP_00\r").as_bytes())
        .unwrap();
    let (mut answer, mut byte) = (Vec::new(), [0_u8]);
    while byte[0] != b'\n' {
        assert_eq!(stream.read(&mut byte).unwrap(), 1);
        answer.push(byte[0]);
    }
    String::from_utf8(answer).unwrap().trim().to_owned()
}

#[test]
fn the_guardian_opens_the_relays_of_a_daemon_that_was_killed_while_it_heated() {
    let files = relays();
    let ports = Ports::serve(&files, 1.0, 1);
    let run = files.path("killed");
    let mut child = start(&files, &run, &[]);
    // The bath is 3 K too cold: full power, 20 s at a time.
    poll("a pulse", || {
        fs::read_to_string(run.join("transcripts/chiller.txt"))
            .unwrap_or_default()
            .contains("< OK HEAT")
            .then_some(())
    });
    child.0.kill().unwrap();
    let report = report(&files, "verified");
    assert_eq!(ports.ask("chiller", "STATE"), "OFF", "{report}");
    assert!(
        report["took_s"].as_f64().unwrap() < 5.0 && report["attempts"] == 1,
        "{report}"
    );
    assert!(
        fs::read_to_string(state(&files, "guardian_chiller.txt"))
            .unwrap()
            .contains("< OK OFF")
    );
    ports.assert_outputs_off();
}

#[test]
fn safe_opens_the_relays_and_says_where_it_does_not_reach_them() {
    let files = relays();
    let ports = Ports::serve(&files, 10.0, 1);
    assert!(ports.ask("chiller", "HEAT 60").starts_with("OK HEAT"));
    let safe = on_bench(&files, &["safe"]);
    safe.expect_code(0);
    assert!(
        safe.stdout
            .lines()
            .any(|line| line.starts_with("chiller") && line.contains("off, read back")),
        "{}",
        safe.stdout
    );
    assert_eq!(ports.ask("chiller", "STATE"), "OFF");
    // No instrument listens there: everything that moves charge is still verified.
    let reached = ports.address("chiller").to_owned();
    files.write(BENCH, &files.text(BENCH).replace(&reached, "127.0.0.1:1"));
    let safe = on_bench(&files, &["safe", "--json"]);
    safe.expect_code(6);
    let words = "the relays of the bath (relay-thermostat) are not known to be open and it was not \
    reached; a pulse ends by itself within a minute: PULL \
                 THE PLUGS OF HEATER AND COOLER";
    let report: serde_json::Value = serde_json::from_str(&safe.stdout).unwrap();
    assert_eq!(
        (&report["message"], &report["verified"]),
        (&words.into(), &false.into()),
        "{report}"
    );
    for output in report["outputs"].as_array().unwrap() {
        assert_eq!(output["off"], output["role"] != "chiller", "{report}");
    }
    ports.assert_outputs_off();
}

#[test]
fn safe_leaves_a_bath_alone_that_the_cell_bears_and_stops_one_that_it_does_not() {
    let files = Files::demo();
    let ports = Ports::serve(&files, 10.0, 1);
    assert_eq!(
        tell_bath(&ports, "OUT_SP_00 70.00\rOUT_MODE_05 1\r"),
        "70.00"
    );
    // The temperature limits of the cell are not known: this bench has never been run.
    let safe = on_bench(&files, &["safe"]);
    safe.expect_code(0);
    assert!(
        safe.stdout
            .contains("the bath (julabo) goes on: set to 70.0 °C, its sensor reads "),
        "{}",
        safe.stdout
    );
    fs::write(state(&files, "guardian.json"), "{\"cell_c\": [0.0, 45.0]}").unwrap();
    let safe = on_bench(&files, &["safe"]);
    safe.expect_code(0);
    assert!(
        safe.stdout.ends_with(
            "the bath was stopped, read back, for its set-point is 70 °C, and the cell bears 0 °C to \
            45 °C\n"
        ),
        "{}",
        safe.stdout
    );
    let safe = on_bench(&files, &["safe", "--json"]);
    safe.expect_code(0);
    let report: serde_json::Value = serde_json::from_str(&safe.stdout).unwrap();
    assert_eq!(
        report["bath"]["words"], "the bath (julabo) stands still; its set-point is 70 °C",
        "{report}"
    );
}

#[test]
fn the_guardian_stops_a_bath_only_where_it_is_no_longer_set_as_the_run_has_set_it() {
    for (other, setpoint) in [("", "25.00"), ("OUT_SP_00 70.00\r", "70.00")] {
        let files = Files::demo().without(EXPERIMENT, "fixture_check");
        let ports = Ports::serve(&files, 10.0, 1);
        let run = files.path("killed");
        let mut child = start(&files, &run, &[]);
        report(&files, "watching");
        poll("a bath that was started", || {
            (json(&state(&files, "guardian.json"))["bath_c"] == 25.0).then_some(())
        });
        let guardian = i32::try_from(
            json(&state(&files, "guardian.json"))["pid"]
                .as_i64()
                .unwrap(),
        )
        .unwrap();
        // The guardian is stopped until another client has changed the bath.
        signal(guardian, Signal::SIGSTOP);
        signal(pid(&child), Signal::SIGKILL);
        let _ = child.0.wait();
        assert_eq!(tell_bath(&ports, other), setpoint);
        signal(guardian, Signal::SIGCONT);
        let report = report(&files, "verified");
        let stopped =
            "the bath was stopped, read back, for its set-point is 70 °C, this run set 25 °C";
        assert_eq!(
            report["bath_ended"],
            if other.is_empty() {
                serde_json::Value::Null
            } else {
                stopped.into()
            },
            "{report}"
        );
        let safe = on_bench(&files, &["safe"]);
        let words = if other.is_empty() {
            "goes on: set to 25.0 °C, its sensor reads 2"
        } else {
            "stands still; its set-point is 70 °C"
        };
        assert!(safe.stdout.contains(words), "{}", safe.stdout);
    }
}
