//! Recorded runs through the present pipeline, and run folders that have changed.

use std::{fs, path::PathBuf};

use analysis::dataset;
use bench_plan::support::sums;

use crate::support::{Files, files_below, program, program_in};

/// Executes a small run: controls, and a sweep of five points.
fn small_run(files: &Files) -> PathBuf {
    files.run("run").expect_code(0);
    files.path("run")
}

#[test]
fn a_run_comes_out_the_same_and_a_flipped_bit_in_any_file_is_found() {
    let files = Files::short(5);
    let run = small_run(&files);
    let (code, text) = program(&["verify", run.to_str().unwrap()]).outcome();
    assert!(
        code == 0 && text.contains("all as they were") && text.contains("every number as stored"),
        "{code} {text}"
    );
    let out = files.path("again");
    let (code, text) = program(&[
        "replay",
        "--out",
        out.to_str().unwrap(),
        run.to_str().unwrap(),
    ])
    .outcome();
    assert_eq!(code, 0, "{text}");
    assert!(
        text.contains("bit by bit: 15 of 15") && text.contains("spectra bit-identical: 1 of 1"),
        "{text}"
    );
    for name in [
        "spectrum.csv",
        "raw_shunt.csv",
        "correction.json",
        "model_1rc.json",
        "report.html",
    ] {
        assert_eq!(
            fs::read(run.join(name)).unwrap(),
            fs::read(out.join(name)).unwrap(),
            "{name}"
        );
    }
    assert!(!out.join("journal.jsonl").exists() && !out.join("captures").exists());
    // Existing files are never overwritten.
    let (code, text) = program(&[
        "replay",
        "--out",
        out.to_str().unwrap(),
        run.to_str().unwrap(),
    ])
    .outcome();
    assert!(
        code == 2 && text.contains("expected a new or empty folder"),
        "{code} {text}"
    );

    let names = files_below(&run);
    assert!(names.len() > 40, "{}", names.len());
    let mut state = 7_u64;
    for path in names.iter().map(|name| run.join(name)) {
        let bytes = fs::read(&path).unwrap();
        for _ in 0..3 {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            // A file without a byte, as a log of which nothing was worth a line, gets one.
            let mut flipped = if bytes.is_empty() {
                vec![0]
            } else {
                bytes.clone()
            };
            let bit = (state >> 17) as usize % (8 * flipped.len());
            flipped[bit / 8] ^= 1 << (bit % 8);
            fs::write(&path, &flipped).unwrap();
            assert!(
                !sums::check(&run).unwrap().altered.is_empty(),
                "{}, bit {bit}",
                path.display()
            );
        }
        fs::write(&path, &bytes).unwrap();
    }
    assert_eq!(sums::check(&run).unwrap().altered, []);
}

#[test]
#[ignore = "drill"]
fn what_does_not_follow_from_the_captures_is_named_even_with_right_hashes() {
    let files = Files::short(5);
    let run = small_run(&files);
    // One number of one result, and the hashes made to fit.
    let path = run.join("spectrum.csv");
    let text = fs::read_to_string(&path).unwrap();
    let points = dataset::read_spectrum_csv(&path).unwrap();
    let number = format!("{:?}", points[2].z_ohm.re);
    fs::write(
        &path,
        text.replacen(&number, &format!("{:?}", points[2].z_ohm.re * 1.001), 1),
    )
    .unwrap();
    sums::write(&run).unwrap();
    let (code, message) = program(&["verify", run.to_str().unwrap()]).outcome();
    assert_eq!(code, 10, "{message}");
    assert!(
        message.contains(&format!(
            "spectrum.csv: line 4, z_re_ohm: stored {:?}, recomputed {number}",
            points[2].z_ohm.re * 1.001
        )),
        "{message}"
    );
    let (code, message) = program(&["replay", run.to_str().unwrap()]).outcome();
    assert_eq!(code, 0, "{message}");
    assert!(
        message.contains("spectrum.csv: changed; 5 points stored, 5 now; |ΔZ|/σ at most "),
        "{message}"
    );
    fs::write(&path, &text).unwrap();

    // Another capture: the contents of journal and tables no longer follow from it.
    let captures: Vec<PathBuf> = files_below(&run.join("captures/cell"))
        .iter()
        .map(|name| run.join("captures/cell").join(name))
        .collect();
    let mut capture = dataset::read_capture(&captures[0]).unwrap();
    capture.meta.channels[3].scale.volts_per_code *= 1.01;
    dataset::write_capture(&captures[0], &capture).unwrap();
    sums::write(&run).unwrap();
    let (code, message) = program(&["verify", run.to_str().unwrap()]).outcome();
    assert!(
        code == 10
            && message
                .contains("the journal's point at 100 Hz differs from what this capture gives"),
        "{code} {message}"
    );
    assert!(
        message.contains("spectrum.csv: line 2, z_re_ohm: stored ")
            && message.contains("model_1rc.json: "),
        "{message}"
    );
    let (_, message) = program(&["replay", run.to_str().unwrap()]).outcome();
    assert!(
        message.contains("bit by bit: 14 of 15")
            && message.contains("spectra bit-identical: 0 of 1"),
        "{message}"
    );
}

#[test]
fn a_folder_without_a_run_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let (code, message) = program(&["replay", folder.path().to_str().unwrap()]).outcome();
    assert!(
        code == 2
            && message.contains(
                "expected a run folder, or a folder of them, found no journal.jsonl in or below it"
            ),
        "{message}"
    );
}

#[test]
fn a_run_that_was_stopped_is_not_a_damaged_one_and_its_finished_points_are_held_against_their_captures()
 {
    let files = Files::short(5);
    let (run, experiment) = (files.path("run"), files.experiment());
    let mut command = crate::support::command(&[
        "run".as_ref(),
        experiment.as_os_str(),
        "--out".as_ref(),
        run.as_os_str(),
    ]);
    assert!(
        !command
            .env("EIS_BENCH_DRILL", "full:captures/cell:3")
            .output()
            .unwrap()
            .status
            .success()
    );
    let (code, message) = program(&["verify", run.to_str().unwrap()]).outcome();
    assert_eq!(code, 0, "{message}");
    for text in [
        "the run was stopped (ended early: ",
        "no report, no SHA256SUMS",
        "12 points recomputed from captures: all as in the journal",
    ] {
        assert!(message.contains(text), "{text}: {message}");
    }
    let (code, message) = program(&["replay", run.to_str().unwrap()]).outcome();
    assert_eq!(code, 0, "{message}");
    assert!(
        message.contains("bit by bit: 12 of 12")
            && message.contains("2 points are of sweeps that were not finished"),
        "{message}"
    );
}

#[test]
#[ignore = "drill"]
fn a_run_of_a_relative_path_with_a_trace_of_load_and_supply_beside_controls_is_verified_from_elsewhere()
 {
    let trace = "[[traces]]\nname = \"jump\"\nrest_first = \"20 s\"\n\
    start_voltage = [\"3.77 V\", \"3.83 V\"]\nresistance_max = \"30 mΩ\"\n\
                 through = \"load_and_supply\"\n\
                 segments = [{ current = \"-6 A\", duration = \"5 s\" }, { current = \"0 A\", \
                 duration = \"5 s\" }]\n";
    let files = Files::short(2).append(crate::support::EXPERIMENT, trace);
    let experiment = files.experiment();
    let (folder, run) = (experiment.parent().unwrap(), files.path("run"));
    let name = experiment.file_name().unwrap();
    let words = ["run".as_ref(), name, "--out".as_ref(), run.as_os_str()];
    program_in(folder, &words).ok();
    let (code, message) = program(&["verify", run.to_str().unwrap()]).outcome();
    assert!(
        code == 0 && message.contains("every number as stored"),
        "{code} {message}"
    );
    assert!(
        message.contains("series_jump_1.bdf.csv: its rows are meter readings"),
        "{message}"
    );
}

#[test]
#[ignore = "long drill"]
fn multisines_and_traces_are_recomputed_from_their_captures_and_what_does_not_follow_from_them_is_named()
 {
    let traces = "[[traces]]\nname = \"steps\"\nrest_first = \"20 s\"\n\
    start_voltage = [\"3.77 V\", \"3.83 V\"]\nresistance_max = \"30 mΩ\"\n\
                  segments = [{ current = \"-5 A\", duration = \"3 s\" }, { current = \"0 A\", \
                  duration = \"6 s\" }]\n\n\
                  [[traces]]\nname = \"wave\"\nrest_first = \"20 s\"\n\
                  start_voltage = [\"3.77 V\", \"3.83 V\"]\nresistance_max = \"30 mΩ\"\n\
                  through = \"wave\"\nsegments = [{ current = \"-5 A\", duration = \"0.1 s\" }, { \
                  current = \"3 A\", duration = \"0.2 s\" }, \
                  { current = \"0 A\", duration = \"0.5 s\" }]\n\n\
                  [multisine]\npeak = \"2 A\"\n\n[[multisine.bands]]\nbase = \"5 Hz\"\n\
                  start = \"15 Hz\"\nstop = \"300 Hz\"\nlines = 8\n\
                  periods = 10\nsettle = \"5 s\"\n";
    let files = Files::short(2).append(crate::support::EXPERIMENT, traces);
    let run = small_run(&files);
    let (code, message) = program(&["verify", run.to_str().unwrap()]).outcome();
    assert!(
        code == 0 && message.contains("every number as stored"),
        "{code} {message}"
    );
    assert!(
        message.contains("6 points, 8 lines of multisines, ")
            && message.contains(" rows of traces, "),
        "{message}"
    );
    assert!(!message.contains("only its hash was checked"), "{message}");
    let (code, message) = program(&["replay", run.to_str().unwrap()]).outcome();
    assert!(
        code == 0
            && message.contains("spectra bit-identical: 2 of 2")
            && message.contains("traces bit-identical: 2 of 2"),
        "{code} {message}"
    );

    // One capture of each kind with other contents, and hashes that match it.
    for (capture, differences) in [
        (
            "multisine_1/band1",
            [
                "multisine.csv: line 2, z_re_ohm: stored ",
                "multisine.json: lines[0].even: stored ",
            ],
        ),
        (
            "trace_steps_1/frame001",
            [
                "series_steps_1.bdf.csv: line ",
                "traces.json: traces[0].sample_sigma_v: stored ",
            ],
        ),
        (
            "trace_wave_1/wave",
            [
                "series_wave_1.bdf.csv: line ",
                "traces.json: traces[1].sample_sigma_v: stored ",
            ],
        ),
    ] {
        let path = run.join(format!("captures/{capture}.parquet"));
        let was = fs::read(&path).unwrap();
        let mut altered = dataset::read_capture(&path).unwrap();
        altered.meta.channels[3].scale.volts_per_code *= 1.001;
        dataset::write_capture(&path, &altered).unwrap();
        sums::write(&run).unwrap();
        let (code, message) = program(&["verify", run.to_str().unwrap()]).outcome();
        assert!(
            code == 10 && differences.iter().all(|one| message.contains(one)),
            "{capture}: {code} {message}"
        );
        fs::write(&path, was).unwrap();
    }
}
