//! Lease of a bench with real processes on real ports: its holder, its state after a crash, and
//! run control requests from another terminal.

use std::{ffi::OsStr, fs, path::PathBuf};

use instruments::mock::plant::{Action, LoadState, SupplyState};
use nix::sys::signal::Signal;

use crate::{
    guardian::{on_bench, pid, report, signal, state},
    kill::{end, start, wait_for_points},
    resume::{clear, resume},
    support::{BENCH, EXPERIMENT, Ended, Files, Ports, Running, command, json, poll, program},
};

const FACTOR: f64 = 10.0;

/// Kills the guardian first, so that no process remains that could switch off.
fn kill_both(files: &Files, child: &mut Running) {
    let guardian = i32::try_from(report(files, "watching")["pid"].as_i64().unwrap()).unwrap();
    signal(guardian, Signal::SIGSTOP);
    child.0.kill().unwrap();
    child.0.wait().unwrap();
    signal(guardian, Signal::SIGKILL);
}

#[test]
#[ignore = "drill"]
fn where_both_processes_died_under_current_the_next_start_says_what_it_finds_switches_off_and_latches()
 {
    let files = Files::short(6);
    let ports = Ports::serve(&files, FACTOR, 1);
    let run = files.path("killed");
    let mut child = start(&files, &run, &[]);
    wait_for_points(&mut child, &run, ("spectrum.csv", 2));
    kill_both(&files, &mut child);
    assert_eq!(ports.ask("supply4q", "OUTP?"), "1");

    for command in ["pause", "abort", "go-on"] {
        let unheard = program(&[command.as_ref(), run.as_os_str()]);
        unheard.expect_code(2);
        for text in [
            "the run cannot receive requests: its process ended at ",
            "outputs not read since a run began at ",
            "`eis-bench safe ",
        ] {
            assert!(
                unheard.message().contains(text),
                "{command}: {}",
                unheard.message()
            );
        }
        assert!(
            unheard.message().ends_with(&format!(
                "`eis-bench resume {}` continues it",
                run.display()
            )),
            "{}",
            unheard.message()
        );
        assert!(!run.join("wishes.json").exists());
    }

    let latched = files.run("again");
    latched.expect_code(7);
    for text in [
        format!("process {} on ", pid(&child)),
        "died, and so did its guardian: whether they switched off is not known; found supply4q ON, "
            .to_owned(),
        "found load off, ".to_owned(),
        "now outputs read off at ".to_owned(),
        ": a current may have flowed unwatched in step \"point ".to_owned(),
    ] {
        assert!(
            latched.message().contains(&text),
            "{text}: {}",
            latched.message()
        );
    }
    assert!(!files.path("again").exists());
    ports.assert_outputs_off();
    assert_eq!(ports.world.lock().unwrap().witness().abuse, []);
    files.run("again").expect_code(7);
    clear(&files);
    resume(&run, &[]).expect_code(0);
    ports.assert_outputs_off();
}

#[test]
#[ignore = "drill"]
fn who_switches_off_after_both_died_settles_what_they_left_and_somebody_has_to_look() {
    let files = Files::short(6);
    let ports = Ports::serve(&files, FACTOR, 1);
    let run = files.path("killed");
    let mut child = start(&files, &run, &[]);
    wait_for_points(&mut child, &run, ("spectrum.csv", 2));
    kill_both(&files, &mut child);
    let safe = program(&["safe".as_ref(), files.path(BENCH).as_os_str()]);
    safe.expect_code(0);
    let words = "and so did its guardian: whether they switched off is not known; now outputs read \
    off at ";
    assert!(safe.stderr.contains(words), "{}", safe.stderr);
    assert!(
        safe.stdout.contains("demo: outputs read off at "),
        "{}",
        safe.stdout
    );
    ports.assert_outputs_off();
    assert!(!state(&files, "open.json").exists());
    let trip = fs::read_to_string(state(&files, "trip.json")).unwrap();
    assert!(trip.contains(words), "{trip}");
    files.run("again").expect_code(7);
    // A bench without an open run is switched off without a message.
    clear(&files);
    let again = program(&["safe".as_ref(), files.path(BENCH).as_os_str()]);
    again.expect_code(0);
    assert!(!state(&files, "trip.json").exists(), "{}", again.stderr);
}

#[test]
#[ignore = "drill"]
fn where_both_processes_died_while_nothing_was_on_it_is_said_and_no_person_has_to_look() {
    let files = Files::short(6).without(EXPERIMENT, "fixture_check");
    let ports = Ports::serve(&files, FACTOR, 1);
    let run = files.path("killed");
    let mut child = start(&files, &run, &[]);
    wait_for_points(&mut child, &run, ("spectrum.csv", 1));
    program(&["pause".as_ref(), run.as_os_str()]).expect_code(0);
    wait_for_journal(&run, "\"entry\":\"paused\"");
    kill_both(&files, &mut child);
    let resumed = resume(&run, &[]);
    resumed.expect_code(0);
    assert!(
        resumed
            .stderr
            .contains("whether they switched off is not known; found supply4q off, "),
        "{}",
        resumed.stderr
    );
    assert!(!state(&files, "trip.json").exists() && !state(&files, "open.json").exists());
    ports.assert_outputs_off();
}

fn wait_for_journal(run: &std::path::Path, text: &str) {
    poll(text, || {
        fs::read_to_string(run.join("journal.jsonl"))
            .ok()
            .filter(|journal| journal.contains(text))
    });
}

#[test]
#[ignore = "drill"]
fn a_bench_is_switched_off_beside_a_daemon_that_ends_on_request() {
    let files = Files::short(6);
    let ports = Ports::serve(&files, FACTOR, 1);
    let run = files.path("run");
    let mut child = start(&files, &run, &[]);
    wait_for_points(&mut child, &run, ("raw_shunt.csv", 2));
    let safe = on_bench(&files, &["safe"]);
    safe.expect_code(0);
    assert!(
        safe.stderr.contains(&format!(
            "process {} was asked to end its run and to switch off",
            pid(&child)
        )),
        "{}",
        safe.stderr
    );
    for role in ["supply4q", "generator", "load", "supply"] {
        assert!(
            safe.stdout
                .lines()
                .any(|line| line.starts_with(role) && line.contains("off, read back")),
            "{}",
            safe.stdout
        );
    }
    assert_eq!(end(child).0, Some(130));
    ports.assert_outputs_off();
    assert!(!state(&files, "trip.json").exists() && !state(&files, "open.json").exists());
    resume(&run, &[]).expect_code(0);
}

#[test]
fn a_load_that_draws_during_a_pause_trips() {
    paused(
        Action::Load(LoadState {
            input_on: true,
            current_a: 1.0,
            min_voltage_v: 0.0,
            power_w: None,
        }),
        "interlock: current of the load ",
    );
}

#[test]
fn a_charger_that_feeds_during_a_pause_trips() {
    paused(
        Action::Supply(SupplyState {
            output_on: true,
            voltage_v: 4.2,
            current_a: 1.0,
        }),
        "interlock: current of the charger ",
    );
}

/// A person uses the panel of an instrument while a run is paused.
fn paused(hand: Action, trip: &str) {
    use instruments::mock::plant::Plant;
    let files = Files::short(6).without(EXPERIMENT, "fixture_check");
    let ports = Ports::serve(&files, FACTOR, 1);
    let run = files.path("run");
    let mut child = start(&files, &run, &[]);
    wait_for_points(&mut child, &run, ("spectrum.csv", 1));
    program(&["pause".as_ref(), run.as_os_str()]).expect_code(0);
    wait_for_journal(&run, "\"entry\":\"paused\"");
    ports.world.lock().unwrap().act(0.0, hand);
    let (code, text) = end(child);
    assert_eq!(code, Some(5), "{text}");
    assert!(text.contains(trip), "{text}");
    assert_eq!(ports.world.lock().unwrap().truth_current_a(), 0.0);
    assert!(state(&files, "trip.json").exists());
}

/// A bench that the program does not recognise as simulated, and where its instruments' state is
/// kept.
struct Metal {
    files: Files,
    ports: Ports,
}

impl Metal {
    fn new() -> Self {
        let files = Files::short(2).without(EXPERIMENT, "fixture_check").edit(
            BENCH,
            "command_trim = 1.0",
            "command_trim = 8.0",
        );
        let files = files.append(BENCH, "[guardian]\nlease = \"300 s\"");
        let ports = Ports::serve(&files, 1.0, 1);
        let files = files.without(BENCH, "simulation");
        Self { files, ports }
    }

    /// Copies the bench file with another name, to another place, with other spellings of its
    /// addresses.
    fn copy(&self, name: &str) -> PathBuf {
        let path = self.files.path("elsewhere").join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        let text = self
            .files
            .text(BENCH)
            .replace("name = \"demo\"", "name = \"other\"")
            .replace("tcp://127.0.0.1:", "tcp://localhost:");
        fs::write(&path, text).unwrap();
        path
    }

    fn command(&self, arguments: &[&OsStr]) -> std::process::Command {
        let mut command = command(arguments);
        command.env("EIS_BENCH_STATE", self.files.path("state"));
        command
    }

    fn program(&self, arguments: &[&OsStr]) -> Ended {
        let output = self.command(arguments).output().unwrap();
        let text = |bytes| String::from_utf8(bytes).unwrap();
        Ended {
            code: output.status.code(),
            stdout: text(output.stdout),
            stderr: text(output.stderr),
        }
    }
}

#[test]
#[ignore = "drill"]
fn lock_and_latch_belong_to_the_instruments_whatever_the_bench_file_is_called() {
    let metal = Metal::new();
    let experiment = metal.files.experiment();
    let (out, again, copy) = (
        metal.files.path("run"),
        metal.files.path("again"),
        metal.copy("renamed.toml"),
    );
    let run = ["run".as_ref(), experiment.as_os_str(), "--out".as_ref()];
    let mut child = Running(
        metal
            .command(&[&run[..], &[out.as_os_str()]].concat())
            .spawn()
            .unwrap(),
    );
    poll("the guardian", || {
        state(&metal.files, "open.json").exists().then_some(())
    });
    let other = [
        &run[..],
        &[again.as_os_str(), "--bench".as_ref(), copy.as_os_str()],
    ]
    .concat();
    // Hold it as long as the other one queries.
    signal(pid(&child), Signal::SIGSTOP);
    let busy = metal.program(&other);
    signal(pid(&child), Signal::SIGCONT);
    busy.expect_code(8);
    let words = format!(
        "process {} runs demo ({}), which shares an instrument with other, for ",
        pid(&child),
        metal.files.path(BENCH).display()
    );
    assert!(busy.message().contains(&words), "{}", busy.message());
    // Eight times the command.
    assert_eq!(child.0.wait().unwrap().code(), Some(5));
    assert_eq!(json(&state(&metal.files, "trip.json"))["by"], "daemon");

    let latched = metal.program(&other);
    latched.expect_code(7);
    let words = format!(
        "other, for it shares an instrument with {}, which is latched: interlock: ",
        metal.files.path(BENCH).display()
    );
    assert!(
        latched.message().starts_with(&words),
        "{}",
        latched.message()
    );
    assert!(!again.exists());
    // One shared instrument is enough, and clearing the latch through either bench clears it for
    // all.
    let logger = metal.files.text(BENCH);
    let logger = logger
        .lines()
        .skip_while(|line| *line != "[instruments.logger]")
        .take_while(|line| !line.is_empty());
    let wiring: String = metal
        .files
        .text(BENCH)
        .split_once("[wiring]")
        .unwrap()
        .1
        .to_owned();
    let text = format!(
        "name = \"logger\"\n{}\n[wiring]{wiring}",
        logger.collect::<Vec<_>>().join("\n")
    );
    let sharing = metal.files.path("elsewhere/logger.toml");
    fs::write(&sharing, text).unwrap();
    let cleared = metal.program(&["clear".as_ref(), sharing.as_os_str(), "--yes".as_ref()]);
    cleared.expect_code(0);
    assert!(
        cleared
            .stdout
            .starts_with("logger is latched by the daemon: interlock: "),
        "{}",
        cleared.stdout
    );
    assert_eq!(
        metal.program(&["clear".as_ref(), copy.as_os_str()]).stdout,
        "other is not latched\n"
    );
    let original = metal.files.path(BENCH);
    assert_eq!(
        metal
            .program(&["clear".as_ref(), original.as_os_str()])
            .stdout,
        "demo is not latched\n"
    );
    metal.ports.assert_outputs_off();
}

#[test]
fn simulated_benches_stay_apart_whatever_ports_they_have() {
    let files = Files::short(2).edit(BENCH, "command_trim = 1.0", "command_trim = 8.0");
    let ports = Ports::serve(&files, FACTOR, 1);
    files.run("run").expect_code(5);
    let copy = files.path("benches/copy.toml");
    fs::write(
        &copy,
        files
            .text(BENCH)
            .replace("name = \"demo\"", "name = \"copy\""),
    )
    .unwrap();
    assert_eq!(
        program(&["clear".as_ref(), copy.as_os_str()])
            .expect_code(0)
            .stdout,
        "copy is not latched\n"
    );
    on_bench(&files, &["clear"]).expect_code(2);
    ports.assert_outputs_off();
}
