//! A run that is killed in the middle: its finished part is on disk, its guardian switches off,
//! and the next run can use the bench.

use std::{fs, path::Path};

use analysis::dataset::{read_capture, read_spectrum_csv};

use crate::support::{
    BENCH, Files, MockProcess, Ports, Running, command, files_below, poll, transcript,
};

const FACTOR: f64 = 10.0;

#[test]
#[ignore = "long drill"]
fn every_finished_point_survives_a_kill_and_the_bench_can_be_used_again() {
    for (watched, count) in [("raw_shunt.csv", 3), ("spectrum.csv", 2)] {
        let files = Files::short(6);
        let ports = Ports::serve(&files, FACTOR, 1);
        let run = files.path("killed");
        kill_after(&files, &run, (watched, count));
        // The killed process switched nothing off; the guardian did.
        let report = crate::guardian::report(&files, "verified");
        assert_eq!(
            (&report["cause"], &report["verified"]),
            (&"the daemon died".into(), &serde_json::json!(true)),
            "{report}"
        );
        ports.assert_outputs_off();
        assert_readable(&run, watched, count);

        let again = files.run("again");
        again.expect_code(0);
        assert_eq!(
            read_spectrum_csv(&files.path("again/spectrum.csv"))
                .unwrap()
                .len(),
            6
        );
        ports.assert_outputs_off();
        let witness = ports.world.lock().unwrap().witness();
        assert_eq!(
            witness.abuse,
            [],
            "the output must be off before anything is clamped"
        );
    }
}

/// Starts a run and kills it (SIGKILL) once a table has this number of points.
fn kill_after(files: &Files, run: &Path, (watched, count): (&str, usize)) {
    let mut child = start(files, run, &[]);
    wait_for_points(&mut child, run, (watched, count));
    child.0.kill().unwrap();
    let status = child.0.wait().unwrap();
    assert_eq!(
        std::os::unix::process::ExitStatusExt::signal(&status),
        Some(9)
    );
}

/// Asserts that every existing row and capture is complete, that every point has its capture, and
/// that the manifest does not record an end.
fn assert_readable(run: &Path, watched: &str, count: usize) {
    for fixture in ["shunt", "fake_cell", "cell"] {
        let table = run.join(format!("raw_{fixture}.csv"));
        if !table.exists() {
            continue;
        }
        let rows = read_spectrum_csv(&table).unwrap();
        let folder = run.join("captures").join(fixture);
        let captures: Vec<_> = files_below(&folder)
            .into_iter()
            // A file that was being written has not got its name yet.
            .filter(|name| {
                name.extension()
                    .is_some_and(|extension| extension == "parquet")
            })
            .map(|name| {
                read_capture(&folder.join(&name))
                    .unwrap_or_else(|error| panic!("{}: {error}", name.display()))
            })
            .collect();
        for row in &rows {
            let capture = captures
                .iter()
                .find(|capture| capture.meta.freq_hz == row.freq_hz);
            let capture =
                capture.unwrap_or_else(|| panic!("{fixture}: no capture of {} Hz", row.freq_hz));
            assert!(capture.codes.iter().all(|codes| codes.len() == 10_000));
        }
    }
    assert!(read_spectrum_csv(&run.join(watched)).unwrap().len() >= count);
    let manifest = crate::support::json(&run.join("manifest.json"));
    assert_eq!(manifest["status"], "running");
    for role in ["supply4q", "generator", "scope", "jig"] {
        assert!(!transcript(run, role).records.is_empty(), "{role}");
    }
}

/// Waits until a table of a running run has this number of points.
pub(crate) fn wait_for_points(child: &mut Running, run: &Path, (watched, count): (&str, usize)) {
    poll(watched, || {
        assert!(
            child.0.try_wait().unwrap().is_none(),
            "the run ended before it was disturbed"
        );
        let lines = fs::read_to_string(run.join(watched))
            .ok()?
            .matches('\n')
            .count();
        (lines > count).then_some(())
    });
}

/// Starts a run of the experiment.
pub(crate) fn start(files: &Files, run: &Path, more: &[&std::ffi::OsStr]) -> Running {
    let experiment = files.experiment();
    let mut arguments = vec![
        "run".as_ref(),
        experiment.as_os_str(),
        "--out".as_ref(),
        run.as_os_str(),
    ];
    arguments.extend(more);
    Running(command(&arguments).spawn().unwrap())
}

pub(crate) fn end(mut child: Running) -> (Option<i32>, String) {
    let code = child.0.wait().unwrap().code();
    let mut text = String::new();
    std::io::Read::read_to_string(child.0.stderr.as_mut().unwrap(), &mut text).unwrap();
    (code, text)
}

#[test]
#[ignore = "drill"]
fn ctrl_c_ends_in_safe_state_and_keeps_what_was_measured() {
    let files = Files::short(6);
    let ports = Ports::serve(&files, FACTOR, 1);
    let run = files.path("stopped");
    let mut child = start(&files, &run, &[]);
    wait_for_points(&mut child, &run, ("spectrum.csv", 2));
    let process = nix::unistd::Pid::from_raw(i32::try_from(child.0.id()).unwrap());
    nix::sys::signal::kill(process, nix::sys::signal::Signal::SIGINT).unwrap();
    let (code, text) = end(child);
    assert_eq!(code, Some(130), "{text}");
    assert!(
        text.contains("stopped on request; the bench is in safe state, finished points are in ")
            && text.contains(&run.display().to_string()),
        "{text}"
    );
    assert!(read_spectrum_csv(&run.join("spectrum.csv")).unwrap().len() >= 2);
    let status = crate::support::json(&run.join("manifest.json"))["status"].clone();
    assert!(
        status
            .as_str()
            .unwrap()
            .starts_with("ended early: stopped on request"),
        "{status}"
    );
    ports.assert_outputs_off();
    assert_eq!(ports.world.lock().unwrap().witness().abuse, []);
}

#[test]
fn instruments_that_vanish_while_they_are_on_are_not_reported_as_safe() {
    let files = Files::short(6);
    let written = files.path("benches/served.toml");
    let mock = MockProcess::start(&files.path(BENCH), &written, ("scaled:10", 1));
    let run = files.path("lost");
    let mut child = start(&files, &run, &["--bench".as_ref(), written.as_os_str()]);
    wait_for_points(&mut child, &run, ("raw_shunt.csv", 2));
    drop(mock);
    let (code, text) = end(child);
    assert_eq!(code, Some(6), "{text}");
    assert!(
        text.contains("LOOK AT THE BENCH: whether a current flows is not known: "),
        "{text}"
    );
    for role in [
        "bipolar supply (kepco-bop-mg)",
        "generator (siglent-sdg1000x)",
        "load (siglent-sdl1000x)",
        "charger (siglent-spd3303x)",
    ] {
        assert!(text.contains(role), "{role}: {text}");
    }
    assert!(read_spectrum_csv(&run.join("raw_shunt.csv")).unwrap().len() >= 2);
}
