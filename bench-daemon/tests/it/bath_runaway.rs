//! A bath that runs away, or whose temperature cannot be read: daemon, guardian and `safe` stop
//! it, read this back, and report only what was read. A bath that approaches its set-point
//! continues.

use std::{
    fs,
    io::{Read, Write},
    net::TcpStream,
    time::Duration,
};

use bench_evaluate::run::Session;

use crate::{
    guardian::{on_bench, report, state},
    kill::start,
    support::{BENCH, EXPERIMENT, Files, Ports, SCENARIO, json, poll},
};

/// Makes the bath of the bench run away from a bench time on.
fn runs_away(from: &str) -> String {
    format!(
        "[simulation.faults]\nseed = 1\nper_message = 1.0\nmost = 1\nkinds = [\"bath_runs_away\"]\n\
        role = \"chiller\"\nfrom = \"{from}\""
    )
}

/// Sends commands and one query to a Julabo.
fn converse(ports: &Ports, commands: &str, question: &str) -> String {
    let mut stream = TcpStream::connect(ports.address("chiller")).unwrap();
    let patience = Some(Duration::from_secs(20));
    stream.set_read_timeout(patience).unwrap();
    stream
        .write_all(format!("{commands}{question}\r").as_bytes())
        .unwrap();
    let (mut answer, mut byte) = (Vec::new(), [0_u8]);
    while byte[0] != b'\n' {
        assert_eq!(stream.read(&mut byte).unwrap(), 1, "{question}");
        answer.push(byte[0]);
    }
    String::from_utf8(answer).unwrap().trim().to_owned()
}

fn sensor_degc(ports: &Ports) -> f64 {
    converse(ports, "", "IN_PV_00").parse().unwrap()
}

/// Returns the last answer of the bath to the query whether it runs.
fn last_control(files: &Files, run: &str) -> String {
    let transcript = files.text(&format!("{run}/transcripts/chiller.txt"));
    let lines: Vec<&str> = transcript.lines().collect();
    let asked = lines
        .iter()
        .rposition(|line| line.ends_with("> IN_MODE_05"));
    lines[asked.unwrap() + 1].to_owned()
}

#[test]
fn the_daemon_ends_the_run_and_stops_a_bath_that_runs_away_or_whose_cell_gets_hot() {
    let thermal = |bath_s: f64| {
        format!("[thermal]\nambient_c = 25.0\nbath_s = {bath_s}\n[meters]\noffset_k = 0.0")
    };
    let heater = "[faults.heater]\nfrom_s = 900.0\nwatts = 60.0";
    for (bench, scenario, cause) in [
        (
            runs_away("600 s"),
            thermal(1500.0),
            "interlock: bath: its sensor reads ",
        ),
        (runs_away("600 s"), thermal(150.0), "temperature"),
        (
            String::new(),
            format!("{}\n{heater}", thermal(150.0)),
            "temperature",
        ),
    ] {
        let files = Files::demo()
            .without(EXPERIMENT, "fixture_check")
            .append(BENCH, &bench)
            .append(SCENARIO, &scenario);
        let experiment = files.load();
        let mut session = Session::new(&experiment.bench).unwrap();
        let failure = session.run(&experiment, &files.path("run")).err().unwrap();
        let text = failure.to_string();
        assert!(text.contains(cause), "{text}");
        // A disagreement of meters does not exceed a limit of the cell.
        let code = if text.starts_with("interlock: ") {
            5
        } else {
            3
        };
        assert_eq!(failure.exit_code(), code, "{text}");
        let events = files.text("run/events.csv");
        assert!(
            events.contains(&format!(
                "the bath was stopped, read back, for {}",
                text.replace('"', "\"\"")
            )),
            "{events}"
        );
        let control = last_control(&files, "run");
        assert!(control.ends_with("< 0"), "{text}: {control}");
        let world = session.simulation().unwrap().world();
        let hottest_degc = world.lock().unwrap().witness().greatest_degc;
        assert!(hottest_degc < 60.0, "{text}: {hottest_degc} °C");
    }
}

#[test]
fn the_guardian_stops_a_bath_that_runs_away_when_the_daemon_is_killed() {
    let files = Files::demo()
        .without(EXPERIMENT, "fixture_check")
        .append(BENCH, &runs_away("30 s"));
    let ports = Ports::serve(&files, 5.0, 1);
    let run = files.path("killed");
    let mut child = start(&files, &run, &[]);
    // The daemon would stop the bath one minute after it has left its band.
    poll("a bath that has left its band", || {
        let rows = fs::read_to_string(run.join("bath.csv")).unwrap_or_default();
        let warm = |row: &str| row.split(',').nth(1)?.parse::<f64>().ok();
        rows.lines()
            .filter_map(warm)
            .any(|c| c > 29.0)
            .then_some(())
    });
    child.0.kill().unwrap();
    let _ = child.0.wait();
    let report = report(&files, "verified");
    let ended = report["bath_ended"].as_str().unwrap_or_default();
    assert!(
        ended.starts_with("the bath was stopped, read back, for its sensor reads ")
            && ended.contains("moves away from the set-point of 25.0 °C"),
        "{report}"
    );
    assert_eq!(converse(&ports, "", "IN_MODE_05"), "0");
    ports.assert_outputs_off();
    let safe = on_bench(&files, &["safe"]);
    safe.expect_code(0);
    assert!(
        safe.stdout
            .ends_with("stands still; its set-point is 25 °C\n"),
        "{}",
        safe.stdout
    );
}

#[test]
fn safe_stops_a_bath_that_runs_away_and_leaves_one_that_approaches_its_set_point() {
    for (fault, setpoint, cell_degc, at_least_degc, words) in [
        (
            true,
            "25.00",
            "",
            40.0,
            "moves away from the set-point of 25.0 °C",
        ),
        (
            true,
            "25.00",
            "[0.0, 35.0]",
            40.0,
            "and the cell bears 0 °C to 35 °C",
        ),
        (
            false,
            "60.00",
            "[0.0, 60.0]",
            30.0,
            "the bath (julabo) goes on: set to 60.0 °C, its sensor reads ",
        ),
        (
            false,
            "5.00",
            "[0.0, 60.0]",
            0.0,
            "the bath (julabo) goes on: set to 5.0 °C, its sensor reads ",
        ),
        (
            false,
            "25.00",
            "[0.0, 60.0]",
            24.0,
            "the bath (julabo) goes on: set to 25.0 °C, its sensor reads 2",
        ),
    ] {
        let mut files = Files::demo();
        if fault {
            files = files.append(BENCH, &runs_away("0 s"));
        }
        let ports = Ports::serve(&files, 10.0, 1);
        let begin = format!("OUT_SP_00 {setpoint}\rOUT_MODE_05 1\r");
        converse(&ports, &begin, "IN_SP_00");
        poll("a warm bath", || {
            (sensor_degc(&ports) >= at_least_degc).then_some(())
        });
        if !cell_degc.is_empty() {
            fs::create_dir_all(state(&files, "")).unwrap();
            fs::write(
                state(&files, "guardian.json"),
                format!("{{\"cell_c\": {cell_degc}}}"),
            )
            .unwrap();
        }
        let safe = on_bench(&files, &["safe"]);
        safe.expect_code(0);
        assert!(safe.stdout.contains(words), "{words}: {}", safe.stdout);
        assert_eq!(
            safe.stdout
                .contains("the bath was stopped, read back, for its sensor reads "),
            fault,
            "{}",
            safe.stdout
        );
        assert_eq!(
            converse(&ports, "", "IN_MODE_05"),
            if fault { "0" } else { "1" },
            "{words}"
        );
    }
}

#[test]
fn a_bath_whose_temperature_was_not_read_is_never_said_to_hold_one() {
    let files = Files::demo()
        .edit(BENCH, "model = \"julabo\"", "model = \"huber-pb\"")
        .append(
            BENCH,
            "[simulation.quirks.chiller]\nbath_sensor = \"absent\"",
        );
    let ports = Ports::serve(&files, 10.0, 1);
    let reply = crate::support::ask(ports.address("chiller"), "{M140001\r");
    assert_eq!(reply, "{S140001");
    let safe = on_bench(&files, &["safe", "--json"]);
    safe.expect_code(6);
    let last: serde_json::Value = serde_json::from_str(&safe.stdout).unwrap();
    assert_eq!(
        (&last["message"], &last["verified"]),
        (
            &"LOOK AT THE BATH: set to 25.0 °C; its temperature was not read".into(),
            &false.into()
        ),
        "{last}"
    );
    assert!(
        json(&state(&files, "trip.json"))["cause"]
            .as_str()
            .unwrap()
            .contains("its temperature was not read")
    );
}
