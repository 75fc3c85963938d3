//! Real processes on real ports: a daemon that dies, hangs or loses an instrument; the reaction of
//! its guardian, and what a person must do afterwards.

use std::{
    fs,
    io::{Read, Write},
    net::{Shutdown, TcpStream},
    path::PathBuf,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
};

use nix::{
    sys::signal::{Signal, kill},
    unistd::Pid,
};

use instruments::clock::unix_time_s;

use crate::{
    kill::{end, start, wait_for_points},
    support::{BENCH, EXPERIMENT, Ended, Files, Ports, Running, files_below, json, poll, program},
};

const FACTOR: f64 = 10.0;

/// Returns the path of a file in the state folder of the bench.
pub(crate) fn state(files: &Files, name: &str) -> PathBuf {
    files.path("benches/.eis-bench/demo").join(name)
}

/// Waits until the guardian's report has this status and returns it.
pub(crate) fn report(files: &Files, status: &str) -> serde_json::Value {
    poll(&format!("a guardian's report of {status:?}"), || {
        let report: serde_json::Value =
            serde_json::from_str(&fs::read_to_string(state(files, "guardian.json")).ok()?).ok()?;
        (report["status"] == status).then_some(report)
    })
}

/// Returns the current of an instrument after the guardian had switched it off, A.
pub(crate) fn amps(report: &serde_json::Value, role: &str) -> f64 {
    let outputs = report["outputs"].as_array().unwrap();
    outputs
        .iter()
        .find(|output| output["role"] == role)
        .unwrap()["amps"]
        .as_f64()
        .unwrap()
}

pub(crate) fn signal(process: i32, signal: Signal) {
    kill(Pid::from_raw(process), signal).unwrap();
}

pub(crate) fn pid(child: &Running) -> i32 {
    i32::try_from(child.0.id()).unwrap()
}

/// Runs a command on the bench file.
pub(crate) fn on_bench(files: &Files, words: &[&str]) -> Ended {
    let bench = files.path(BENCH);
    let arguments: Vec<&std::ffi::OsStr> = words[..1]
        .iter()
        .map(AsRef::as_ref)
        .chain([bench.as_os_str()])
        .chain(words[1..].iter().map(AsRef::as_ref))
        .collect();
    program(&arguments)
}

#[test]
#[ignore = "drill"]
fn a_daemon_that_is_killed_leaves_a_bench_that_is_off_within_five_seconds() {
    let files = Files::short(6);
    let ports = Ports::serve(&files, 1.0, 1);
    let run = files.path("killed");
    let mut child = start(&files, &run, &[]);
    wait_for_points(&mut child, &run, ("raw_shunt.csv", 1));
    let watching = report(&files, "watching");
    assert_eq!(watching["daemon"], pid(&child));
    child.0.kill().unwrap();
    let report = report(&files, "verified");
    let took_s = report["took_s"].as_f64().unwrap();
    assert!(
        took_s < 5.0 && report["attempts"] == 1 && report["cause"] == "the daemon died",
        "{report}"
    );
    assert!(
        report["step"].as_str().unwrap().starts_with("point"),
        "{report}"
    );
    for role in ["supply4q", "load", "supply"] {
        assert!(amps(&report, role).abs() < 0.1, "{report}");
    }
    ports.assert_outputs_off();
    assert_eq!(ports.world.lock().unwrap().witness().abuse, []);
    // No person has to inspect anything: there was no fault of the cell.
    assert!(!state(&files, "trip.json").exists());
}

#[test]
#[ignore = "long drill"]
fn the_drive_ends_by_itself_if_no_process_is_left_to_end_it() {
    for (generator, ends) in [
        ("bursts", true),
        ("bursts, but not this instrument", false),
        ("no bursts", false),
    ] {
        let mut files = Files::short(6)
            .edit(EXPERIMENT, "start = \"100 Hz\"", "start = \"2 Hz\"")
            .without(EXPERIMENT, "fixture_check");
        if generator == "no bursts" {
            files = files.edit(BENCH, "[wiring]", "[wiring]\nbursts = false");
        } else if !ends {
            files = files.append(BENCH, "[simulation.quirks.generator]\nbursts = false");
        }
        let ports = Ports::serve(&files, FACTOR, 1);
        let run = files.path("killed");
        let mut child = start(&files, &run, &[]);
        let flows = || ports.world.lock().unwrap().truth_current_a().abs() > 0.3;
        let watching = report(&files, "watching");
        let both = [
            i32::try_from(watching["pid"].as_i64().unwrap()).unwrap(),
            pid(&child),
        ];
        // Both are stopped before the current is queried: on a slow machine a point may end
        // between the two.
        poll("a current that neither can end", || {
            poll("a current", || flows().then_some(()));
            both.into_iter()
                .for_each(|process| signal(process, Signal::SIGSTOP));
            let caught = flows();
            both.into_iter().for_each(|process| {
                signal(
                    process,
                    if caught {
                        Signal::SIGKILL
                    } else {
                        Signal::SIGCONT
                    },
                );
            });
            caught.then_some(())
        });
        let _ = child.0.wait();
        // 60 s of the bench: more than any burst of this sweep.
        let killed_s = unix_time_s();
        poll("the time that a burst takes", || {
            (unix_time_s() > killed_s + 60.0 / FACTOR).then_some(())
        });
        let silent = (0..30).all(|_| {
            ports
                .ask("supply4q", "MEAS:CURR?")
                .trim()
                .parse::<f64>()
                .unwrap()
                .abs()
                < 0.1
        });
        assert_eq!(silent, ends, "{generator}");
        let events = fs::read_to_string(run.join("events.csv")).unwrap();
        assert_eq!(
            events.contains("generator: takes no bursts"),
            generator == "bursts, but not this instrument",
            "{events}"
        );
        on_bench(&files, &["safe"]).expect_code(0);
        ports.assert_outputs_off();
    }
}

#[test]
#[ignore = "long drill"]
fn a_run_that_waits_to_go_on_by_itself_is_ended_by_safe_and_holds_its_bench_meanwhile() {
    let faults = "[simulation.faults]\nseed = 1\nper_message = 1.0\nmost = 1\n\
    kinds = [\"reset\"]\nrole = \"scope\"\nfrom = \"6 s\"";
    let files = Files::short(6)
        .without(EXPERIMENT, "fixture_check")
        .append(BENCH, faults);
    let ports = Ports::serve(&files, 1.0, 1);
    let run = files.path("run");
    let child = start(&files, &run, &[]);
    let journal = || fs::read_to_string(run.join("journal.jsonl")).unwrap_or_default();
    poll("the end of the first part", || {
        journal().contains("ended early").then_some(())
    });
    let second = files.run("second");
    second.expect_code(8);
    let safe = on_bench(&files, &["safe"]);
    safe.expect_code(0);
    assert!(
        safe.stderr.contains("was asked to end its run"),
        "{}",
        safe.stderr
    );
    let (code, wording) = end(child);
    assert!(
        code == Some(3) && wording.contains("going on by itself in 5 s"),
        "{code:?}: {wording}"
    );
    assert!(!journal().contains("the run goes on"), "{}", journal());
    ports.assert_outputs_off();
    files.run("again").expect_code(0);
}

#[test]
#[ignore = "long drill"]
fn a_daemon_that_is_stopped_loses_its_lease_and_its_life() {
    let files = Files::short(6).append(BENCH, "[guardian]\nlease = \"1.5 s\"");
    let ports = Ports::serve(&files, FACTOR, 1);
    let run = files.path("stopped");
    let mut child = start(&files, &run, &[]);
    wait_for_points(&mut child, &run, ("spectrum.csv", 2));
    signal(pid(&child), Signal::SIGSTOP);
    let report = report(&files, "verified");
    assert!(
        report["cause"] == "the daemon hung or was stopped" && report["verified"] == true,
        "{report}"
    );
    let status = child.0.wait().unwrap();
    assert_eq!(
        std::os::unix::process::ExitStatusExt::signal(&status),
        Some(9)
    );
    ports.assert_outputs_off();
    assert_eq!(ports.world.lock().unwrap().witness().abuse, []);
    files.run("again").expect_code(0);
}

#[test]
#[ignore = "drill"]
fn a_bench_is_run_by_one_daemon_and_switched_off_beside_one_that_hangs() {
    let files = Files::short(6).append(BENCH, "[guardian]\nlease = \"300 s\"");
    let ports = Ports::serve(&files, FACTOR, 1);
    let run = files.path("stopped");
    let mut child = start(&files, &run, &[]);
    wait_for_points(&mut child, &run, ("spectrum.csv", 2));
    let second = files.run("second");
    second.expect_code(8);
    let words = format!(
        "expected a bench that is not in use: process {} runs demo for {}",
        pid(&child),
        run.display()
    );
    assert_eq!(second.message(), words);
    assert!(!files.path("second").exists());

    signal(pid(&child), Signal::SIGSTOP);
    assert!(ports.world.lock().unwrap().witness().throughput_coulomb > 0.0);
    let safe = on_bench(&files, &["safe", "--kill"]);
    safe.expect_code(0);
    assert!(
        safe.stderr.contains(&format!(
            "process {} runs this bench for {}",
            pid(&child),
            run.display()
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
    report(&files, "verified");
    ports.assert_outputs_off();
    assert_eq!(ports.world.lock().unwrap().witness().abuse, []);
    // Twice does no harm.
    on_bench(&files, &["safe"]).expect_code(0);
}

#[test]
fn a_guardian_that_dies_ends_the_run_in_safe_state() {
    let files = Files::short(6);
    let ports = Ports::serve(&files, FACTOR, 1);
    let run = files.path("alone");
    let mut child = start(&files, &run, &[]);
    wait_for_points(&mut child, &run, ("raw_shunt.csv", 2));
    signal(
        i32::try_from(report(&files, "watching")["pid"].as_i64().unwrap()).unwrap(),
        Signal::SIGKILL,
    );
    let (code, text) = end(child);
    assert_eq!(code, Some(9), "{text}");
    assert!(
        text.contains("the guardian ended or stopped while it was needed: its process has ended"),
        "{text}"
    );
    ports.assert_outputs_off();
    assert!(!state(&files, "trip.json").exists());
}

#[test]
#[ignore = "drill"]
fn a_trip_latches_until_a_person_clears_it() {
    // Eight times the command.
    let files = Files::short(2).edit(BENCH, "command_trim = 1.0", "command_trim = 8.0");
    let ports = Ports::serve(&files, FACTOR, 1);
    let tripped = files.run("run");
    tripped.expect_code(5);
    let trip = json(&state(&files, "trip.json"));
    assert_eq!(
        (&trip["by"], &trip["quantity"], &trip["unit"]),
        (&"daemon".into(), &"cell current".into(), &"A".into()),
        "{trip}"
    );
    assert!(
        trip["step"].as_str().unwrap().starts_with("point  1")
            && trip["run"] == files.path("run").display().to_string(),
        "{trip}"
    );

    files.write(
        BENCH,
        &files
            .text(BENCH)
            .replace("command_trim = 8.0", "command_trim = 1.0"),
    );
    let refused = files.run("again");
    refused.expect_code(7);
    let cause = tripped.message();
    assert!(
        refused
            .message()
            .starts_with(&format!("demo is latched: {cause} in step \"point  1")),
        "{}",
        refused.message()
    );
    assert!(
        refused.message().contains("`eis-bench clear ")
            && refused.message().ends_with("/benches/demo.toml`"),
        "{}",
        refused.message()
    );
    assert!(!files.path("again").exists());

    let shown = on_bench(&files, &["clear"]);
    shown.expect_code(2);
    assert!(
        shown
            .stdout
            .starts_with(&format!("demo is latched by the daemon: {cause}")),
        "{}",
        shown.stdout
    );
    files.run("again").expect_code(7);
    on_bench(&files, &["clear", "--yes"]).expect_code(0);
    assert_eq!(
        on_bench(&files, &["clear"]).expect_code(0).stdout,
        "demo is not latched\n"
    );
    files.run("again").expect_code(0);
    let history = fs::read_to_string(state(&files, "trips.jsonl")).unwrap();
    assert_eq!(
        (
            history.matches("\"what\":\"latched\"").count(),
            history.matches("\"what\":\"cleared\"").count()
        ),
        (1, 1),
        "{history}"
    );
    ports.assert_outputs_off();
}

#[test]
fn a_bench_in_this_process_leaves_nothing_behind() {
    let files = Files::short(2);
    files.run("run").expect_code(0);
    assert!(
        !files_below(&files.path("benches"))
            .iter()
            .any(|file| file.starts_with(".eis-bench"))
    );
    for words in [&["safe"][..], &["clear"]] {
        assert!(
            on_bench(&files, words)
                .expect_code(0)
                .stdout
                .starts_with("demo is simulated in the process that runs it")
        );
    }
    let wording = on_bench(&files, &["safe", "--json"])
        .expect_code(0)
        .stdout
        .clone();
    let report: serde_json::Value = serde_json::from_str(wording.trim()).unwrap();
    assert!(
        report["verified"] == false && report["simulated"] == true,
        "nothing was read back: {report}"
    );
}

#[test]
fn a_state_folder_that_cannot_be_written_is_refused_before_anything_is_touched() {
    let files = Files::short(2).edit(
        BENCH,
        "name = \"demo\"",
        "name = \"demo\"\nstate_folder = \"/proc/eis-bench\"",
    );
    let ports = Ports::serve(&files, FACTOR, 1);
    let ended = files.run("run");
    ended.expect_code(2);
    assert!(
        ended.message().starts_with(
            "/proc/eis-bench: the state of the bench has no folder, and none can be made: "
        ),
        "{}",
        ended.message()
    );
    assert!(!files.path("run").exists());
    // The process that runs it is then unknown: the bench is switched off anyway, and the message
    // does not claim that this lasts.
    let safe = on_bench(&files, &["safe"]);
    safe.expect_code(6);
    assert!(
        safe.stdout
            .lines()
            .any(|line| line.starts_with("supply4q") && line.contains("off, read back")),
        "{}",
        safe.stdout
    );
    assert!(
        safe.message()
            .contains("everything was off, but whether a process runs the bench is not known"),
        "{}",
        safe.message()
    );
    ports.assert_outputs_off();
}

#[test]
#[ignore = "long drill"]
fn with_the_network_to_the_supply_cut_the_generator_ends_the_current_and_the_guardian_goes_on_until_it_is_back()
 {
    lose(
        "supply4q",
        "the bipolar supply (kepco-bop-mg)",
        ["the generator (", "the load (", "the charger ("],
    );
}

#[test]
#[ignore = "long drill"]
fn with_the_network_to_the_generator_cut_the_supply_ends_the_current_and_the_guardian_goes_on_until_it_is_back()
 {
    lose(
        "generator",
        "the generator (siglent-sdg1000x)",
        ["the bipolar supply (", "the load (", "the charger ("],
    );
}

/// Loses one instrument in the middle of a sweep; the others are reached.
fn lose(role: &str, lost: &str, reached: [&str; 3]) {
    let files = Files::short(6);
    let ports = Ports::serve(&files, FACTOR, 1);
    let cable = Cable::plug_in(&files, role);
    let run = files.path("cut");
    let mut child = start(&files, &run, &[]);
    wait_for_points(&mut child, &run, ("spectrum.csv", 2));
    cable.cut.store(true, Ordering::SeqCst);
    let (code, text) = end(child);
    assert_eq!(code, Some(6), "{text}");
    // Instruments that cannot be verified are named, and those that were reached are not.
    let wording = text
        .lines()
        .rev()
        .find_map(|line| line.strip_prefix("eis-bench: LOOK AT THE BENCH: "))
        .unwrap();
    assert!(
        wording.contains(lost) && !wording.contains("safe state"),
        "{wording}"
    );
    for role in reached {
        assert!(!wording.contains(role), "{role}: {wording}");
    }
    // Under the generator's least sine the supply drives milliamperes, and its own zero error.
    assert!(ports.world.lock().unwrap().truth_current_a().abs() < 0.1);
    files.run("refused").expect_code(7);

    cable.cut.store(false, Ordering::SeqCst);
    let report = report(&files, "verified");
    assert_eq!(report["cause"], "the daemon could not verify safe state");
    ports.assert_outputs_off();
    assert_eq!(ports.world.lock().unwrap().witness().abuse, []);
    on_bench(&files, &["clear", "--yes"]).expect_code(0);
    files.run("again").expect_code(0);
}

/// A cable between all clients and one instrument, which can be cut: data in transit are lost, and
/// no new connection is established.
struct Cable {
    cut: Arc<AtomicBool>,
}

impl Cable {
    fn plug_in(files: &Files, role: &str) -> Self {
        let (instrument, listener) = files.stand_before(role);
        let cut = Arc::new(AtomicBool::new(false));
        let shared = cut.clone();
        std::thread::spawn(move || {
            for client in listener.incoming().map_while(Result::ok) {
                if !shared.load(Ordering::SeqCst)
                    && let Ok(far) = TcpStream::connect(&instrument)
                {
                    let (near, there) = (client.try_clone().unwrap(), far.try_clone().unwrap());
                    let (one, other) = (shared.clone(), shared.clone());
                    std::thread::spawn(move || carry(client, far, &one));
                    std::thread::spawn(move || carry(there, near, &other));
                }
            }
        });
        Self { cut }
    }
}

fn carry(mut from: TcpStream, mut to: TcpStream, cut: &AtomicBool) {
    let mut bytes = [0_u8; 4096];
    while let Ok(count @ 1..) = from.read(&mut bytes) {
        if !cut.load(Ordering::SeqCst) && to.write_all(&bytes[..count]).is_err() {
            break;
        }
    }
    let _ = to.shutdown(Shutdown::Both);
    let _ = from.shutdown(Shutdown::Both);
}

#[test]
fn a_guardian_that_can_write_nothing_switches_off_all_the_same() {
    let files = Files::short(6);
    let ports = Ports::serve(&files, FACTOR, 1);
    let run = files.path("killed");
    let mut child = start(&files, &run, &[]);
    wait_for_points(&mut child, &run, ("raw_shunt.csv", 1));
    report(&files, "watching");
    // No report can take the place of a folder: as on a full disk.
    fs::remove_file(state(&files, "guardian.json")).unwrap();
    fs::create_dir(state(&files, "guardian.json")).unwrap();
    child.0.kill().unwrap();
    child.0.wait().unwrap();
    poll("outputs off", || {
        (ports.world.lock().unwrap().truth_current_a() == 0.0).then_some(())
    });
    poll("output off", || {
        (ports.ask("supply4q", "OUTP?") == "0").then_some(())
    });
}

#[test]
fn a_bench_file_that_is_another_one_by_now_guards_nothing() {
    let files = Files::short(6);
    let ports = Ports::serve(&files, FACTOR, 1);
    let run = files.path("killed");
    let mut child = start(&files, &run, &[]);
    wait_for_points(&mut child, &run, ("raw_shunt.csv", 1));
    child.0.kill().unwrap();
    child.0.wait().unwrap();
    report(&files, "verified");
    files.write(BENCH, &format!("{}\n# Another one.\n", files.text(BENCH)));
    let refused = program(&["resume".as_ref(), run.as_os_str()]);
    refused.expect_code(3);
    assert!(
        refused
            .message()
            .contains("expected the bench file that the run began with, found another text"),
        "{}",
        refused.message()
    );
    ports.assert_outputs_off();
}
