//! The quality gate of a sweep on the simulated bench: each criterion detects its own fault, a
//! clean bench passes, and a later record that passes is kept.

use std::fs;

use analysis::dataset::RunIndex;
use bench_daemon::command::run::run_experiment;
use bench_evaluate::run::Finished;

use crate::support::{BENCH, EXPERIMENT, Files, SCENARIO, program};

/// Returns files with a sweep of the cell alone with the gate.
fn gated(start_hz: f64, points: usize, gate: &str) -> Files {
    Files::short(points)
        .without(EXPERIMENT, "fixture_check")
        .edit(
            EXPERIMENT,
            "start = \"100 Hz\"",
            &format!("start = \"{start_hz} Hz\""),
        )
        .append(EXPERIMENT, &format!("[eis.quality]\n{gate}"))
}

fn run(files: &Files) -> (Finished, RunIndex, String) {
    let finished = run_experiment(&files.load(), &files.path("run")).unwrap();
    let read = |name: &str| fs::read_to_string(files.path("run").join(name)).unwrap();
    (
        finished,
        serde_json::from_str(&read("traces.json")).unwrap(),
        read("events.csv"),
    )
}

#[test]
fn a_clean_bench_passes_the_gate_at_once() {
    let (finished, index, events) = run(&gated(0.5, 8, ""));
    assert_eq!(index.sweeps[0].flagged, [], "{}", finished.summary);
    assert!(
        !events.contains("measured again") && !finished.summary.contains("quality gate"),
        "{}",
        finished.summary
    );
    assert!(
        events.contains(
            "measure again what the quality gate refuses: at most 10.0 min and 720 C in all"
        ),
        "{events}"
    );
}

/// Returns a small cell that leaks, whose open-circuit voltage rises by `rise_v` over the state of
/// charge.
fn leaking(files: Files, rise_v: f64) -> Files {
    let curve = format!(
        "capacity_ah = 0.5\nocv = [{{ soc = 0.0, ocv_v = 3.5 }}, {{ soc = 1.0, ocv_v = {} }}]",
        3.5 + rise_v
    );
    files
        .edit(
            SCENARIO,
            "initial_soc = 0.60",
            &format!("initial_soc = 0.60\n{curve}"),
        )
        .append(SCENARIO, "[effects.self_discharge]\ncurrent_a = 10.0")
}

/// Records of two periods: too short for relaxations to be fitted beside the sinusoid.
fn brief(files: Files) -> Files {
    files.edit(
        EXPERIMENT,
        "periods = 11",
        "periods = 11\nperiods_on_screen = 2",
    )
}

/// Its resistances fall with the state of charge: by one per cent in a second.
fn falling(files: Files) -> Files {
    leaking(files, 0.05).append(
        SCENARIO,
        "[effects.soc_resistance]\nslope = 2.0\nreference_soc = 0.5",
    )
}

#[test]
#[ignore = "drill"]
fn every_criterion_fires_on_its_own_fault_and_the_point_is_flagged() {
    let loose = "repeatability = \"50 %\"\ndrift = \"50 %\"";
    let cases = [
        (
            "noise",
            gated(100.0, 2, "").append(SCENARIO, "[harness]\nnoise_fraction = 0.05"),
        ),
        // The supply cannot reach the crest of the sinusoid.
        (
            "distortion",
            gated(100.0, 2, "").append(SCENARIO, "[drives.bipolar]\ngreatest_a = 0.9"),
        ),
        (
            "drift",
            leaking(brief(gated(1.0, 2, "drift = \"0.1 %\"")), 0.8),
        ),
        ("difference of the halves", falling(gated(1.0, 2, ""))),
        ("Kramers–Kronig residual", falling(gated(1.0, 8, loose))),
    ];
    for (criterion, files) in cases {
        let (finished, index, events) = run(&files);
        let flagged = &index.sweeps[0].flagged;
        let named =
            |reason: &String| reason.starts_with(&format!("{criterion}: expected at most "));
        assert!(
            flagged.iter().any(|point| point.reasons.iter().any(named)),
            "{criterion}: {flagged:#?}\n{events}"
        );
        assert!(events.contains("measured again: "), "{criterion}: {events}");
        let summary = &finished.summary;
        assert!(
            summary.contains("flagged by the quality gate after") && summary.contains(criterion),
            "{summary}"
        );
    }
}

#[test]
#[ignore = "drill"]
fn a_large_sinusoid_through_butler_and_volmer_is_flagged_as_distorted_a_small_one_and_a_linear_cell_are_not()
 {
    let law = "[effects.butler_volmer]\nbranch = 1\nalpha = 0.5";
    for (amplitude, more, distorted) in [
        ("3 A", law, true),
        ("0.2 A", law, false),
        ("3 A", "", false),
    ] {
        let files = gated(1.0, 2, "again = 1")
            .edit(
                EXPERIMENT,
                "amplitude = \"1 A\"",
                &format!("amplitude = \"{amplitude}\""),
            )
            .edit(
                SCENARIO,
                "initial_soc = 0.60",
                "initial_soc = 0.60\nbranches = [{ r_ohm = 0.02, c_f = 0.05 }]",
            )
            .append(SCENARIO, more);
        let (finished, index, _) = run(&files);
        let flagged = &index.sweeps[0].flagged;
        let reasons: Vec<&String> = flagged.iter().flat_map(|point| &point.reasons).collect();
        let met = reasons
            .iter()
            .any(|reason| reason.starts_with("distortion: expected at most 1.0 %, found "));
        assert_eq!(met, distorted, "{amplitude} {more}: {flagged:#?}");
        assert_eq!(
            finished
                .summary
                .contains("flagged by the quality gate after 2 records: distortion"),
            distorted,
            "{}",
            finished.summary
        );
    }
}

#[test]
fn a_channel_that_still_clips_after_every_change_of_range_is_flagged_or_measured_again() {
    // Eighteen times too fine; four changes of range double it each.
    let fine = |gate: &str| {
        gated(100.0, 2, gate)
            .edit(EXPERIMENT, "amplitude = \"1 A\"", "amplitude = \"3 A\"")
            .edit(BENCH, "\"40 mV\"", "\"0.4 mV\"")
    };
    let (_, index, _) = run(&fine("again = 0"));
    assert!(
        index.sweeps[0].flagged[0].reasons[0]
            .starts_with("clipped samples: expected at most 0 %, found "),
        "{index:?}"
    );
    let (_, index, events) = run(&fine(""));
    assert!(
        index.sweeps[0].flagged.is_empty() && events.contains("measured again: clipped samples"),
        "{index:?}\n{events}"
    );
}

#[test]
#[ignore = "drill"]
fn no_budget_means_no_further_record_and_the_flag_all_the_same() {
    for budget in ["time = \"0 s\"", "charge = \"0 C\"", "again = 0"] {
        let (_, index, events) =
            run(&gated(100.0, 2, budget).append(SCENARIO, "[harness]\nnoise_fraction = 0.05"));
        assert!(
            !index.sweeps[0].flagged.is_empty() && !events.contains(": measured again: "),
            "{budget}: {events}"
        );
    }
}

#[test]
fn a_cell_that_comes_to_rest_meanwhile_is_measured_again_and_passes() {
    let reset = "\n[soc_reset]\ndischarge_current = \"5 A\"\ndischarge_until = \"3.84 V\"\n\
    charge_current = \"3 A\"\ncharge_voltage = \"4.2 V\"\n\
                 charge_until = \"4.0 V\"\nrest_min = \"1 s\"\nrest_max = \"2 s\"\n\
                 rest_slope = \"0.2 mV/min\"\nmax_duration = \"2 h\"";
    let files = brief(gated(1.0, 2, "again = 8\ndrift = \"0.1 %\""))
        .append(EXPERIMENT, reset)
        .append(SCENARIO, "[effects.slow_rc]\nr_ohm = 0.3\ntau_s = 60.0");
    let (finished, index, events) = run(&files);
    assert!(
        events.contains("measured again: drift: expected at most 0.10 %"),
        "{events}"
    );
    assert_eq!(index.sweeps[0].flagged, [], "{}", finished.summary);
    assert!(
        files
            .path("run/captures/cell/point01_1.000000Hz_again1.parquet")
            .exists()
    );
}

#[test]
#[ignore = "drill"]
fn what_the_gate_refuses_has_an_exit_code_a_column_and_no_model_unless_asked() {
    let noisy = |fit: &str| {
        let files =
            gated(100.0, 4, "again = 0").append(SCENARIO, "[harness]\nnoise_fraction = 0.05");
        let text = files
            .text(EXPERIMENT)
            .replace("rc = [1]", &format!("rc = [1]{fit}"));
        files.write(EXPERIMENT, &text);
        files
    };
    let files = noisy("");
    let ended = files.run("run");
    ended.expect_code(11);
    let refused = ended.message().to_owned();
    assert!(
        refused.starts_with("the quality gate refused 4 points"),
        "{refused}"
    );
    let table = files.text("run/spectrum.csv");
    let mut lines = table.lines();
    assert!(lines.next().unwrap().ends_with(",flags"), "{table}");
    assert!(
        lines.all(|line| line
            .rsplit(',')
            .next()
            .unwrap()
            .starts_with("noise: expected at most ")),
        "{table}"
    );
    // The numbers are read as ever.
    assert_eq!(
        analysis::dataset::read_spectrum_csv(&files.path("run/spectrum.csv"))
            .unwrap()
            .len(),
        4
    );
    assert!(!files.path("run/model_1rc.json").exists());
    assert!(
        files
            .text("run/report.html")
            .contains("no model: the quality gate has refused every point")
    );
    // An investigation makes no model of them either.
    let out = files.path("investigation");
    let arguments: [std::ffi::OsString; 5] = [
        "investigate".into(),
        files.path(EXPERIMENT).into_os_string(),
        "--yes".into(),
        "--out".into(),
        out.clone().into_os_string(),
    ];
    let ended = program(&arguments.each_ref().map(|argument| argument.as_os_str()));
    ended.expect_code(11);
    assert!(
        ended
            .message()
            .starts_with("the quality gate refused 4 points")
            && !out.join("model.json").exists(),
        "{}",
        ended.message()
    );

    let files = noisy("\nrefused_points = true");
    files.run("run").expect_code(11);
    let model = crate::support::json(&files.path("run/model_1rc.json"));
    let points = model["refused"].as_array().unwrap();
    assert_eq!(
        (points.len(), &points[0]["fitted"]),
        (4, &true.into()),
        "{model}"
    );
}

/// Nothing but noise is refused.
const LOOSE: &str =
    "kramers_kronig = \"50 %\"\nrepeatability = \"50 %\"\ndistortion = \"50 %\"\ndrift = \"50 %\"";

/// Returns files with three sweeps of which the gate refuses some points and accepts others.
fn partly_refused() -> Files {
    gated(100.0, 6, &format!("noise = \"8 %\"\nagain = 0\n{LOOSE}"))
        .edit(EXPERIMENT, "points = 6", "points = 6\nrepeat = 3")
        .append(SCENARIO, "[harness]\nnoise_fraction = 0.05")
}

/// Returns the table with a flag at these rows.
fn flagged_table(plain: &str, rows: &[usize]) -> String {
    let mut lines = plain.lines();
    let mut text = format!("{},flags\n", lines.next().unwrap());
    for (row, line) in lines.enumerate() {
        let flag = if rows.contains(&row) {
            "noise: expected at most 0.5 %  found 3 %; drift: much"
        } else {
            ""
        };
        text.push_str(&format!("{line},{flag}\n"));
    }
    text
}

#[test]
fn a_fit_of_a_file_leaves_out_what_the_file_says_was_refused_unless_asked() {
    let files = gated(100.0, 6, "");
    files.run("run").expect_code(0);
    let plain = files.text("run/spectrum.csv");
    assert!(
        !plain.lines().next().unwrap().contains("flags"),
        "a run without refused points is as before: {plain}"
    );
    let fit = |rows: &[usize], more: &[&str], out: &str| {
        files.write("part.csv", &flagged_table(&plain, rows));
        let (file, out) = (files.path("part.csv"), files.path(out));
        let mut words: Vec<&std::ffi::OsStr> = vec![
            "fit".as_ref(),
            file.as_os_str(),
            "--rc".as_ref(),
            "1".as_ref(),
        ];
        words.extend(["--out".as_ref(), out.as_os_str()]);
        words.extend(more.iter().map(|word| std::ffi::OsStr::new(*word)));
        program(&words)
    };
    let ended = fit(&[1, 4], &[], "left_out");
    ended.expect_code(0);
    assert!(
        ended
            .stderr
            .contains("part: 2 of 6 points are left out: the quality gate refused them: "),
        "{}",
        ended.stderr
    );
    assert!(
        ended
            .stderr
            .contains("(noise: expected at most 0.5 %  found 3 %; drift: much)"),
        "{}",
        ended.stderr
    );
    let model = crate::support::json(&files.path("left_out/model_1rc.json"));
    let refused = model["refused"].as_array().unwrap();
    assert_eq!(
        (
            refused.len(),
            &refused[0]["fitted"],
            &model["fit"]["points"]
        ),
        (2, &false.into(), &4.into()),
        "{model}"
    );
    fit(&[1, 4], &["--refused-points"], "kept").expect_code(0);
    let model = crate::support::json(&files.path("kept/model_1rc.json"));
    assert_eq!(
        (&model["refused"][1]["fitted"], &model["fit"]["points"]),
        (&true.into(), &6.into()),
        "{model}"
    );
    let all = fit(&[0, 1, 2, 3, 4, 5], &[], "none");
    all.expect_code(11);
    assert!(!files.path("none/model_1rc.json").exists());
}

#[test]
#[ignore = "drill"]
fn refused_points_of_repeats_of_one_name_are_distinguished_and_a_replay_ends_with_the_same_code() {
    let files = partly_refused();
    files.run("run").expect_code(11);
    let index: RunIndex = serde_json::from_str(&files.text("run/traces.json")).unwrap();
    let flagged: Vec<usize> = index
        .sweeps
        .iter()
        .map(|sweep| sweep.flagged.len())
        .collect();
    let count: usize = flagged.iter().sum();
    assert!(
        flagged.len() == 3 && count > 0 && count < 18,
        "some and not all: {flagged:?}"
    );
    let model = crate::support::json(&files.path("run/model_1rc.json"));
    let refused = model["refused"].as_array().unwrap();
    assert_eq!(refused.len(), count, "{model}");
    for sweep in &index.sweeps {
        let named = refused
            .iter()
            .filter(|point| point["file"] == sweep.file.as_str())
            .count();
        assert_eq!(named, sweep.flagged.len(), "{}: {model}", sweep.file);
        let (raw, table) = (
            sweep
                .file
                .replace("spectrum.csv", "raw_cell.csv")
                .replace("spectrum_", "raw_cell_"),
            &sweep.file,
        );
        for file in [raw.as_str(), table.as_str()] {
            let table = files.text(&format!("run/{file}"));
            let rows = table
                .lines()
                .filter(|line| line.contains("noise: expected at most"))
                .count();
            assert_eq!(rows, sweep.flagged.len(), "{file}: {table}");
        }
    }
    // Points that one sweep lost are in the others.
    let text =
        format!("note: {count} points that the quality gate refused are left out of the models");
    assert!(
        files
            .text("run/report.html")
            .contains(text.trim_start_matches("note: "))
    );
    assert_eq!(model["fit"]["points"], 18 - count, "{model}");
    let out = files.path("again");
    let ended = program(&[
        "replay".as_ref(),
        files.path("run").as_os_str(),
        "--out".as_ref(),
        out.as_os_str(),
    ]);
    ended.expect_code(11);
    assert_eq!(
        files.text("again/spectrum.csv"),
        files.text("run/spectrum.csv")
    );
    let loaded = bench_evaluate::investigate::dataset::read_dataset(&files.path("run")).unwrap();
    assert_eq!(loaded.refused.len(), count, "{:?}", loaded.notes);
    assert!(
        loaded.refused.iter().all(|point| !point.fitted)
            && loaded
                .notes
                .iter()
                .any(|note| note.contains("the quality gate refused them"))
    );
    let points = |loaded: &bench_evaluate::investigate::dataset::Loaded| -> Vec<usize> {
        let of = |run: &analysis::diagnosis::Run| {
            if let analysis::diagnosis::RunData::Eis(sweep) = &run.data {
                sweep.points.len()
            } else {
                0
            }
        };
        loaded.set.runs.iter().map(of).collect()
    };
    let left = points(&loaded);
    // Repeats stay alike.
    assert!(
        left.len() == 3 && left[0] < 6 && left.iter().all(|points| *points == left[0]),
        "{left:?}"
    );
    let reading = bench_evaluate::investigate::dataset::Reading {
        refused_points: true,
        ..Default::default()
    };
    let wanted =
        bench_evaluate::investigate::dataset::read_as(&files.path("run"), reading).unwrap();
    assert_eq!(points(&wanted), [6, 6, 6]);
}

#[test]
#[ignore = "drill"]
fn refused_points_of_a_control_count_are_named_and_do_not_feed_the_correction() {
    let noisy = |noise: &str| {
        Files::short(8)
            .append(
                EXPERIMENT,
                &format!("[eis.quality]\nnoise = \"{noise}\"\nagain = 0\n{LOOSE}"),
            )
            .append(SCENARIO, "[harness]\nnoise_fraction = 0.0005")
    };
    let files = noisy("0.131 %");
    let ended = files.run("run");
    ended.expect_code(11);
    let controls: usize = ["shunt", "fake_cell"]
        .iter()
        .map(|name| flags_of(&files.text(&format!("run/raw_{name}.csv"))))
        .sum();
    assert!(controls > 0, "{}", ended.stdout);
    for name in ["shunt", "fake_cell"] {
        let (table, words) = (
            files.text(&format!("run/raw_{name}.csv")),
            format!(
                "points of the {name} that the quality gate refused are left out of the \
                correction: "
            ),
        );
        assert_eq!(
            ended.stdout.contains(&words),
            flags_of(&table) > 0,
            "{name}: {}",
            ended.stdout
        );
    }
    assert!(
        ended.message().contains("and of the correction"),
        "{}",
        ended.message()
    );
    // A control without any points left is not a control.
    let files = noisy("0.01 %");
    let ended = files.run("run");
    ended.expect_code(4);
    assert!(
        ended.message().contains(
            "expected points for the correction, the quality gate has refused every one of them"
        ),
        "{}",
        ended.message()
    );
}

/// Returns the number of flagged rows.
fn flags_of(table: &str) -> usize {
    table
        .lines()
        .filter(|line| line.contains("expected at most"))
        .count()
}
