//! Runs whose process died and that are resumed in their folders.

use std::{fs, path::Path};

use instruments::mock::plant::{Action, LoadState, Plant};

use crate::support::{
    BENCH, EXPERIMENT, Ended, Files, Ports, command, files_below, json, program, sent,
};

/// Runs the experiment with a crash drill; it must die by SIGKILL.
pub(crate) fn die(files: &Files, run: &Path, drill: &str) {
    let experiment = files.experiment();
    let mut command = command(&[
        "run".as_ref(),
        experiment.as_os_str(),
        "--out".as_ref(),
        run.as_os_str(),
    ]);
    let output = command.env("EIS_BENCH_DRILL", drill).output().unwrap();
    let signal = std::os::unix::process::ExitStatusExt::signal(&output.status);
    assert_eq!(
        signal,
        Some(9),
        "{drill}: {}",
        String::from_utf8_lossy(&output.stderr)
    );
}

pub(crate) fn resume(run: &Path, more: &[&str]) -> Ended {
    let mut arguments = vec!["resume".as_ref(), run.as_os_str()];
    arguments.extend(
        more.iter()
            .map(|argument| <str as AsRef<std::ffi::OsStr>>::as_ref(argument)),
    );
    program(&arguments)
}

/// A person has inspected the bench.
pub(crate) fn clear(files: &Files) {
    program(&[
        "clear".as_ref(),
        files.path(BENCH).as_os_str(),
        "--yes".as_ref(),
    ])
    .expect_code(0);
}

#[track_caller]
fn assert_same_files(left: &Path, right: &Path) {
    assert_eq!(files_below(left), files_below(right));
    for name in files_below(left) {
        assert!(
            fs::read(left.join(&name)).unwrap() == fs::read(right.join(&name)).unwrap(),
            "{} differs",
            name.display()
        );
    }
}

#[test]
#[ignore = "long drill"]
fn a_run_in_virtual_time_that_died_anywhere_ends_with_the_same_files() {
    let files = Files::short(3);
    let whole = files.path("whole");
    files.run("whole").expect_code(0);
    let lines = fs::read_to_string(whole.join("journal.jsonl"))
        .unwrap()
        .lines()
        .count();
    for (index, drill) in [
        "journal:3".to_owned(),
        "journal:24".to_owned(),
        "exchange:400".to_owned(),
        format!("journal:{}", 2 * lines - 1),
    ]
    .into_iter()
    .enumerate()
    {
        let run = files.path(&format!("died{index}"));
        die(&files, &run, &drill);
        // A line that was being written.
        let mut journal = fs::read(run.join("journal.jsonl")).unwrap();
        journal.extend(b"{\"number\":99");
        fs::write(run.join("journal.jsonl"), journal).unwrap();
        let ended = resume(&run, &[]);
        ended.expect_code(0);
        assert!(
            ended
                .stdout
                .contains(&format!("run folder: {}\n", run.display())),
            "{}",
            ended.stdout
        );
        assert_same_files(&run, &whole);
        assert!(!files.path(&format!("died{index}.again")).exists());
    }
    let ended = resume(&whole, &[]);
    ended.expect_code(2);
    assert!(
        ended
            .message()
            .ends_with("expected a run that was interrupted, found one that is finished"),
        "{}",
        ended.message()
    );
}

#[test]
fn a_folder_that_is_not_what_it_was_is_refused_and_says_what_differs() {
    let files = Files::short(3);
    let run = files.path("died");
    die(&files, &run, "journal:40");
    let refused = |name: &str, from: &str, to: &str, expected: &str| {
        let path = run.join(name);
        let text = fs::read_to_string(&path).unwrap();
        assert!(text.contains(from), "{name}: {from}");
        fs::write(&path, text.replacen(from, to, 1)).unwrap();
        let ended = resume(&run, &[]);
        ended.expect_code(2);
        assert!(ended.message().contains(expected), "{}", ended.message());
        fs::write(&path, text).unwrap();
    };
    refused(
        "config/experiments_demo.toml",
        "1 A",
        "2 A",
        "experiments_demo.toml: expected the file that the run began with (SHA-256 ",
    );
    refused(
        "journal.jsonl",
        "\"stage\":0",
        "\"stage\":1",
        "journal.jsonl:3: expected a line with the checksum ",
    );
    refused(
        "events.csv",
        "mount shunt",
        "mount short",
        "events.csv: expected the run played again from its seed to give the same",
    );
    fs::remove_file(run.join("journal.jsonl")).unwrap();
    assert!(
        resume(&run, &[])
            .expect_code(2)
            .message()
            .contains("journal.jsonl: cannot be read: ")
    );
}

#[test]
fn a_run_whose_process_lives_is_not_gone_on_with_and_one_whose_process_is_gone_hears_nothing() {
    let files = Files::short(3);
    let run = files.path("died");
    die(&files, &run, "journal:24");
    let journal = fs::File::open(run.join("journal.jsonl")).unwrap();
    journal.try_lock().unwrap();
    let refused = resume(&run, &[]);
    refused.expect_code(8);
    assert!(
        refused
            .message()
            .contains("expected a run that was interrupted, found one that is going on"),
        "{}",
        refused.message()
    );
    drop(journal);
    resume(&run, &[]).expect_code(0);
}

/// Writes that fail on a full disk: each kind of file, and the number of the write from which on
/// the disk is full.
const FULL: [&str; 17] = [
    "journal.jsonl:30",
    "events.csv:20",
    "readings.csv:20",
    "readings.parquet:1",
    "transcripts/supply4q.txt:60",
    "captures/shunt:2",
    "captures/trace_pulse_1:2",
    "raw_shunt.csv:2",
    "raw_cell.csv:1",
    "spectrum.csv:1",
    "correction.json:1",
    "controls.json:1",
    "traces.json:1",
    "series_pulse_1.bdf.csv:1",
    "manifest.json:2",
    "config/:2",
    "model_1rc.json:1",
];

#[test]
#[ignore = "long drill"]
fn a_full_disk_ends_the_run_in_safe_state_whatever_cannot_be_written_and_nothing_is_lost() {
    let files = Files::short(2).append(EXPERIMENT, TRACE);
    let whole = files.path("whole");
    files.run("whole").expect_code(0);
    let experiment = files.experiment();
    for (index, full) in FULL.into_iter().enumerate() {
        let run = files.path(&format!("full{index}"));
        let mut command = command(&[
            "run".as_ref(),
            experiment.as_os_str(),
            "--out".as_ref(),
            run.as_os_str(),
        ]);
        let output = command
            .env("EIS_BENCH_DRILL", format!("full:{full}"))
            .output()
            .unwrap();
        let text = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1), "{full}: {text}");
        let message = text
            .lines()
            .rev()
            .find_map(|line| line.strip_prefix("eis-bench: "))
            .unwrap_or_default();
        let (name, _) = full.split_once(':').unwrap();
        assert!(
            message.contains(name.trim_end_matches('/'))
                && message.contains("No space left on device"),
            "{full}: {message}"
        );
        if run.join("transcripts/supply4q.txt").exists()
            && let Some(last) = sent(&run, "supply4q")
                .into_iter()
                .rev()
                .find(|message| message.starts_with("OUTP O"))
        {
            assert_eq!(last, "OUTP OFF", "{full}");
        }
        // With room again, nothing is missing.
        if name == "config/" {
            assert!(
                resume(&run, &[])
                    .expect_code(2)
                    .message()
                    .contains("nothing was done yet")
            );
        } else if index % 3 == 0 {
            resume(&run, &[]).expect_code(0);
            assert_same_files(&run, &whole);
        }
    }
}

#[test]
#[ignore = "drill"]
fn a_small_disk_that_is_really_full_ends_the_run_and_with_room_it_goes_on() {
    let files = Files::short(2);
    files.run("whole").expect_code(0);
    // A disk of its own needs a name space of its own, which not every machine gives.
    let disk = files.path("disk");
    fs::create_dir_all(&disk).unwrap();
    let script = "mount -t tmpfs -o size=$3 tmpfs $2/disk || exit 77; \"$1\" run \
    $2/experiments/demo.toml --out $2/disk/run; ended=$?; \
                  mount -o remount,size=64m $2/disk; if [ $ended -ne 0 ]; then \"$1\" resume \
                  $2/disk/run || exit 78; fi; \
                  cp -r $2/disk/run $2/copy$3; exit $ended";
    for size in ["100k", "250k", "400k"] {
        let mut command = std::process::Command::new("unshare");
        let command = command
            .args([
                "-rm",
                "sh",
                "-c",
                script,
                "sh",
                env!("CARGO_BIN_EXE_eis-bench"),
            ])
            .arg(files.path(""))
            .arg(size);
        let Ok(output) = command.output() else { return };
        let (code, text) = (
            output.status.code(),
            String::from_utf8_lossy(&output.stderr).into_owned(),
        );
        if code == Some(77) || text.starts_with("unshare: ") {
            return;
        }
        assert_eq!(code, Some(1), "{size}: {text}");
        assert!(text.contains("No space left on device"), "{size}: {text}");
        assert_same_files(&files.path(&format!("copy{size}")), &files.path("whole"));
    }
}

#[test]
fn a_drill_is_for_simulated_benches_only() {
    let files = Files::short(3).without(BENCH, "simulation");
    let experiment = files.experiment();
    let out = files.path("run");
    let mut command = command(&[
        "run".as_ref(),
        experiment.as_os_str(),
        "--out".as_ref(),
        out.as_os_str(),
    ]);
    let output = command
        .env("EIS_BENCH_DRILL", "journal:1")
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(2));
    let text = String::from_utf8(output.stderr).unwrap();
    assert!(
        text.contains("EIS_BENCH_DRILL: expected a bench with a section [simulation]"),
        "{text}"
    );
}

#[test]
#[ignore = "drill"]
fn a_folder_that_cannot_be_written_stops_the_run_in_safe_state_and_nothing_finished_is_lost() {
    let files = Files::short(4);
    let ports = Ports::serve(&files, 20.0, 1);
    let run = files.path("blocked");
    // The captures of the cell cannot be written: a file has the name of their folder.
    fs::create_dir_all(&run).unwrap();
    let child = std::thread::scope(|scope| {
        let ended = scope.spawn(|| files.run("blocked"));
        crate::support::poll("the shunt's first point", || {
            run.join("raw_shunt.csv").exists().then_some(())
        });
        fs::write(run.join("captures/cell"), "").unwrap();
        ended.join().unwrap()
    });
    child.expect_code(1);
    assert!(
        child.message().contains("captures/cell: cannot be made: "),
        "{}",
        child.message()
    );
    ports.assert_outputs_off();
    let kept = fs::read(run.join("raw_fake_cell.csv")).unwrap();
    let status = json(&run.join("manifest.json"))["status"].clone();
    assert!(
        status.as_str().unwrap().starts_with("ended early: "),
        "{status}"
    );

    fs::remove_file(run.join("captures/cell")).unwrap();
    resume(&run, &[]).expect_code(0);
    assert_eq!(fs::read(run.join("raw_fake_cell.csv")).unwrap(), kept);
    assert_eq!(
        analysis::dataset::read_spectrum_csv(&run.join("spectrum.csv"))
            .unwrap()
            .len(),
        4
    );
    ports.assert_outputs_off();
    assert_eq!(ports.world.lock().unwrap().witness().abuse, []);
}

/// A trace alone, on sockets: its journal is started, safe, stage, then two lines for each step.
const TRACE: &str = r#"
[[traces]]
name = "pulse"
rest_first = "2 s"
start_voltage = ["3.7 V", "3.9 V"]
resistance_max = "30 mΩ"
segments = [{ current = "-3 A", duration = "4 s" }, { current = "0 A", duration = "4 s" }]
"#;

fn traced() -> Files {
    Files::short(2)
        .without(EXPERIMENT, "fixture_check")
        .without(EXPERIMENT, "eis")
        .append(EXPERIMENT, TRACE)
}

#[test]
#[ignore = "drill"]
fn an_unknown_charge_is_not_moved_again_by_itself() {
    let files = traced();
    let ports = Ports::serve(&files, 4.0, 1);
    let run = files.path("run");
    let experiment = files.experiment();
    let arguments = [
        "run".as_ref(),
        experiment.as_os_str(),
        "--out".as_ref(),
        run.as_os_str(),
    ];
    let mut child = crate::support::Running(command(&arguments).spawn().unwrap());
    let drawn = || ports.world.lock().unwrap().truth_current_a() < -2.0;
    crate::support::poll("the pulse", || drawn().then_some(()));
    // The guardian dies with it: the output stays on.
    let guardian = crate::guardian::report(&files, "watching")["pid"]
        .as_i64()
        .unwrap();
    let signal = |signal| {
        nix::sys::signal::kill(
            nix::unistd::Pid::from_raw(i32::try_from(guardian).unwrap()),
            signal,
        )
        .unwrap();
    };
    signal(nix::sys::signal::Signal::SIGSTOP);
    child.0.kill().unwrap();
    child.0.wait().unwrap();
    signal(nix::sys::signal::Signal::SIGKILL);
    assert_eq!(ports.ask("supply4q", "OUTP?"), "1");
    // In every case, outputs that the run left on are first queried, recorded and switched off.
    let latched = resume(&run, &[]);
    latched.expect_code(7);
    for text in [
        "and so did its guardian: whether they switched off is not known; found supply4q ON, ",
        " in step \"trace pulse, repeat 1: ",
    ] {
        assert!(
            latched.message().contains(text),
            "{text}: {}",
            latched.message()
        );
    }
    ports.assert_outputs_off();
    clear(&files);
    let refused = resume(&run, &[]);
    refused.expect_code(2);
    assert!(
        refused
            .message()
            .contains("stage 1, step 4 (trace pulse, repeat 1: "),
        "{}",
        refused.message()
    );
    assert!(
        refused.message().contains("continue with --accept-charge"),
        "{}",
        refused.message()
    );
    resume(&run, &["--accept-charge"]).expect_code(0);
    let journal = fs::read_to_string(run.join("journal.jsonl")).unwrap();
    let (before, after) = journal.split_once("\"entry\":{\"resumed\"").unwrap();
    assert!(!before.contains("\"found\""));
    let (found, _) = after.split_once("\"entry\":\"safe\"").unwrap();
    assert_eq!(
        found.matches("\"entry\":{\"found\"").count(),
        5,
        "everything that can move charge, and the bath, is looked at before it is switched off"
    );
    assert!(
        found.contains("\"role\":\"supply4q\",\"off\":true"),
        "{found}"
    );
    assert_eq!(journal.matches("\"text\":\"trace pulse").count(), 2);
    assert_eq!(
        json(&run.join("traces.json"))["traces"]
            .as_array()
            .unwrap()
            .len(),
        1
    );
    ports.assert_outputs_off();
}

#[test]
#[ignore = "drill"]
fn a_sweep_goes_on_at_the_state_of_charge_where_it_began_or_when_a_person_says_so() {
    let files = Files::short(6).without(EXPERIMENT, "fixture_check");
    let ports = Ports::serve(&files, 10.0, 1);
    let run = files.path("run");
    let mut child = crate::kill::start(&files, &run, &[]);
    crate::kill::wait_for_points(&mut child, &run, ("raw_cell.csv", 2));
    child.0.kill().unwrap();
    child.0.wait().unwrap();
    crate::guardian::report(&files, "verified");
    // Lower the cell voltage by 30 mV: the bound is 20 mV.
    let draws = |on: bool| {
        let state = LoadState {
            input_on: on,
            current_a: 15.0,
            min_voltage_v: 0.0,
            power_w: None,
        };
        ports.world.lock().unwrap().act(0.0, Action::Load(state));
    };
    let begun_v = ports.world.lock().unwrap().truth_ocv_v();
    draws(true);
    crate::support::poll("another state of charge", || {
        // The world advances with every query.
        ports.ask("load", ":MEAS:VOLT?");
        (ports.world.lock().unwrap().truth_ocv_v() < begun_v - 0.03).then_some(())
    });
    draws(false);
    let kept = fs::read(run.join("raw_cell.csv")).unwrap();
    let refused = resume(&run, &[]);
    refused.expect_code(2);
    let text = "belong to another state of charge than those that follow; bring the cell to its \
    state by hand, or go on with --accept-charge";
    assert!(
        refused
            .message()
            .contains("stage 1: expected the cell within 0.02 V of the ")
            && refused.message().contains(text),
        "{}",
        refused.message()
    );
    assert!(
        fs::read(run.join("raw_cell.csv")).unwrap() == kept,
        "nothing is measured before somebody has decided"
    );
    ports.assert_outputs_off();
    let accepted = resume(&run, &["--accept-charge"]);
    accepted.expect_code(0);
    assert!(
        accepted
            .stdout
            .contains("belong to another state of charge than those that follow"),
        "{}",
        accepted.stdout
    );
    assert!(
        fs::read_to_string(run.join("report.html"))
            .unwrap()
            .contains("belong to another state of charge")
    );
    assert_eq!(
        analysis::dataset::read_spectrum_csv(&run.join("raw_cell.csv"))
            .unwrap()
            .len(),
        6
    );
    assert!(
        fs::read(run.join("raw_cell.csv"))
            .unwrap()
            .starts_with(&kept),
        "what was finished stays"
    );
    ports.assert_outputs_off();
}

#[test]
#[ignore = "drill"]
fn a_trace_that_is_in_the_index_is_done_whatever_the_journal_says() {
    let files = traced();
    let ports = Ports::serve(&files, 4.0, 1);
    let run = files.path("run");
    // Before the sixteenth line: the trace is done.
    die(&files, &run, "journal:31");
    let journal = fs::read_to_string(run.join("journal.jsonl")).unwrap();
    assert!(
        journal
            .lines()
            .last()
            .unwrap()
            .contains("\"text\":\"trace pulse"),
        "{journal}"
    );
    let file = run.join("series_pulse_1.bdf.csv");
    let kept = fs::read(&file).unwrap();
    resume(&run, &[]).expect_code(0);
    let journal = fs::read_to_string(run.join("journal.jsonl")).unwrap();
    assert_eq!(
        journal.matches("\"text\":\"trace pulse").count(),
        1,
        "it is not played a second time"
    );
    assert!(fs::read(&file).unwrap() == kept);
    ports.assert_outputs_off();
}

#[test]
#[ignore = "drill"]
fn the_charge_that_traces_have_left_is_known_after_a_resume() {
    let files = traced().edit(
        EXPERIMENT,
        "name = \"pulse\"",
        "name = \"pulse\"\nrepeat = 2",
    );
    let ports = Ports::serve(&files, 4.0, 1);
    let run = files.path("run");
    // Fourteen lines for the first trace; the second one's stage has begun.
    die(&files, &run, "journal:33");
    assert_eq!(
        json(&run.join("traces.json"))["traces"]
            .as_array()
            .unwrap()
            .len(),
        1
    );
    resume(&run, &[]).expect_code(0);
    let index = json(&run.join("traces.json"));
    let before_coulomb = index["traces"][1]["charge_before_c"].as_f64().unwrap();
    // 3 A for 4 s out of the cell, the gain of the supply, its zero error, and the time that a
    // message takes.
    assert!((-13.5..-10.5).contains(&before_coulomb), "{before_coulomb}");
    ports.assert_outputs_off();
}
