//! `dataset init` on the tables of the Panasonic cell: it writes what a person wrote, and
//! `diagnose` accepts it.

use std::path::{Path, PathBuf};

use analysis::diagnosis::{DataSet, Role, RunData, Start};
use bench_evaluate::investigate::dataset::read_dataset;
use serde_json::Value;

use crate::support::{Ended, program};

fn project(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(path)
}

fn tables(cell: &str) -> PathBuf {
    project("fixtures/data/cells").join(cell)
}

/// Runs `dataset init` on the tables of a cell, with the conditions of its spectrum.
fn init(cell: &str, at: &str, out: &Path, more: &[&str]) -> Ended {
    let file = |name: &str| tables(cell).join(name).to_str().unwrap().to_owned();
    let curve = tables("panasonic_18650pf_25C").join("ocv.json");
    let words = [
        "dataset",
        "init",
        &file("pulses.bdf.csv"),
        &file("eis_07.csv"),
        "--cell",
        "NCR18650PF",
        "--ocv",
        curve.to_str().unwrap(),
        "--at",
        at,
        "--from-hz",
        "0.1",
        "--to-hz",
        "300",
        "--out",
        out.to_str().unwrap(),
    ];
    program(&[&words, more].concat())
}

fn ocv_v(set: &DataSet, run: usize) -> f64 {
    match set.runs[run].start {
        Start::Ocv(ocv_v) => ocv_v,
        Start::Soc(_) => panic!("{}", set.runs[run].name),
    }
}

/// Compares with the data set of a person: the same rows, except for one at an end, and the same
/// split.
fn assert_as_by_hand(made: &DataSet, by_hand: &str) {
    let hand = read_dataset(&project("configs/datasets").join(by_hand)).unwrap();
    let hand = hand.set;
    assert_eq!(made.runs.len(), hand.runs.len());
    // The spectrum comes first there, and last here.
    let moved = |k: usize| (k + 1) % made.runs.len();
    for k in 0..made.runs.len() {
        let (run, other) = (&made.runs[k], &hand.runs[moved(k)]);
        assert_eq!(
            (run.role, run.order, &run.fixture),
            (other.role, other.order, &other.fixture)
        );
        match (&run.data, &other.data) {
            (RunData::Time(run), RunData::Time(other)) => {
                let rows = run.series.len();
                assert!(rows.abs_diff(other.series.len()) <= 1, "{rows}");
                assert_eq!(run.series.voltage_v[..150], other.series.voltage_v[..150]);
            }
            (run, other) => assert!(run == other),
        }
        assert!((ocv_v(made, k) - ocv_v(&hand, moved(k))).abs() < 1e-4);
        assert!((run.temperature_degc - other.temperature_degc).abs() < 0.5);
    }
}

/// Tables in the project, and the data set that a person made from them.
struct Known {
    cell: &'static str,
    at: &'static str,
    by_hand: &'static str,
    /// Gaps of the model file on the two held-out runs, mV.
    gaps_mv: [f64; 2],
}

const KNOWN: [Known; 2] = [
    Known {
        cell: "panasonic_18650pf_25C",
        at: "eis_07:ocv_v=3.6635,temperature_c=26.8",
        by_hand: "panasonic_50soc",
        gaps_mv: [14.71, 35.23],
    },
    Known {
        cell: "panasonic_18650pf_10C",
        at: "eis_07:ocv_v=3.657,temperature_c=12.41",
        by_hand: "panasonic_10c",
        gaps_mv: [21.67, 46.66],
    },
];

#[test]
fn the_tables_of_panasonic_become_the_data_sets_that_a_person_made() {
    for known in KNOWN {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("data");
        let output = init(known.cell, known.at, &out, &[]);
        output.expect_code(0);
        let read = read_dataset(&out).unwrap();
        assert!(read.problems.is_empty());
        assert_as_by_hand(&read.set, known.by_hand);
        let history = read.set.history.unwrap();
        assert!((history.voltage_resolution_v - 6.4e-4).abs() < 1e-5);
        // Not contained in the data: the default applies.
        assert_eq!(history.voltage_offset_v, 1e-3);
    }
}

#[test]
#[ignore = "long drill"]
fn a_diagnosis_of_proposed_data_sets_is_that_of_the_data_sets_of_a_person() {
    for known in KNOWN {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("data");
        let output = init(known.cell, known.at, &out, &[]);
        output.expect_code(0);
        let model = tables(known.cell).join("model_3rc.json");
        let diagnosis = program(&[
            "diagnose",
            out.to_str().unwrap(),
            "--model",
            model.to_str().unwrap(),
            "--json",
        ]);
        diagnosis.expect_code(0);
        let report: Value = serde_json::from_str(&diagnosis.stdout).unwrap();
        assert_eq!(report["verdict"], "unexplained");
        // The gaps of the model file equal those with the data set of a person.
        for (gap, expected_mv) in report["gap"].as_array().unwrap().iter().zip(known.gaps_mv) {
            let met_mv = gap["eis_only_with_edges_mv"].as_f64().unwrap();
            assert!((met_mv / expected_mv - 1.0).abs() < 0.03, "{gap}");
        }
        assert_eq!(report["gap"].as_array().unwrap().len(), 2);
    }
}

#[test]
fn nothing_is_written_over_and_a_dry_run_writes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("data");
    let (cell, at) = ("panasonic_18650pf_25C", "eis_07:temperature_c=25");
    let dry = init(cell, at, &out, &["--dry-run"]);
    let printed = dry.stdout;
    assert!(
        !out.exists() && printed.contains("role = \"held_out\""),
        "{printed}"
    );
    std::fs::create_dir(&out).unwrap();
    std::fs::write(out.join("dataset.toml"), "name = \"mine\"\n").unwrap();
    let refused = init(cell, at, &out, &[]);
    assert!(refused.code == Some(2) && refused.stderr.contains("nothing is written over"));
    let kept = std::fs::read_to_string(out.join("dataset.toml")).unwrap();
    assert_eq!(kept, "name = \"mine\"\n");
}

#[test]
fn files_that_cannot_be_read_are_reported_and_a_spectrum_elsewhere_is_a_comment() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("data");
    let repeats = folder.path().join("repeats.bdf.csv");
    let text = "Test Time / s,Current / A,Voltage / V\n1,0,3.7\n0,0,3.7\n";
    std::fs::write(&repeats, text).unwrap();
    let notes = folder.path().join("notes.txt");
    std::fs::write(&notes, "cell 7, new fixture\n").unwrap();
    let more = [repeats.to_str().unwrap(), notes.to_str().unwrap(), "--json"];
    let (cell, at) = ("panasonic_18650pf_25C", "eis_07:ocv_v=3.9,temperature_c=25");
    let found = init(cell, at, &out, &more).json();
    let kinds: Vec<&Value> = found["files"]
        .as_array()
        .unwrap()
        .iter()
        .map(|file| &file["kind"])
        .collect();
    assert_eq!(
        kinds,
        ["log", "spectra", "", ""]
            .map(|kind| match kind {
                "" => Value::Null,
                kind => Value::from(kind),
            })
            .iter()
            .collect::<Vec<_>>()
    );
    let text = |file: usize| found["files"][file]["text"].as_str().unwrap();
    assert!(text(2).contains("reader of logs") && text(2).contains("times in s that rise"));
    assert!(text(3).contains("no reader knows it"), "{}", text(3));
    let set = read_dataset(&out).unwrap().set;
    assert!(
        set.runs
            .iter()
            .all(|run| matches!(run.data, RunData::Time(_)))
    );
    assert_eq!(
        set.runs
            .iter()
            .filter(|run| run.role == Role::HeldOut)
            .count(),
        2
    );
    let written = std::fs::read_to_string(out.join("dataset.toml")).unwrap();
    assert!(
        written.contains("# Left out: it was taken at 3.9000 V"),
        "{written}"
    );
}

/// Rows of a log: for so long this current and a voltage that falls by 2 mΩ, each a second.
fn rows(text: &mut String, lasting_s: u32, current_a: f64, from_s: &mut u32) {
    for _ in 0..lasting_s {
        *from_s += 1;
        let volts = 3.7 + 2e-3 * current_a;
        *text += &format!("{from_s},{current_a},{volts:.5}\n");
    }
}

/// A log of two pulses, with a rest after each; charge is positive.
fn two_pulses(folder: &Path, head: &str) -> PathBuf {
    let (mut text, mut at_s) = (format!("{head}Test Time / s,Current / A,Voltage / V\n"), 0);
    for current_a in [0.0, -5.0, 0.0, -10.0, 0.0] {
        let lasting_s = if current_a == 0.0 { 60 } else { 10 };
        rows(&mut text, lasting_s, current_a, &mut at_s);
    }
    let path = folder.join("pulses.csv");
    std::fs::write(&path, text).unwrap();
    path
}

#[test]
fn a_log_without_a_temperature_is_written_with_the_key_as_a_comment() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("data");
    let log = two_pulses(folder.path(), "");
    let (log, target) = (log.to_str().unwrap(), out.to_str().unwrap());
    let words = ["dataset", "init", log, "--out", target];
    let lacking = program(&words);
    let message = lacking.stderr;
    assert_eq!(lacking.code, Some(2), "{message}");
    assert!(
        message.contains("`temperature_c` of 2 runs (--temperature-c C)"),
        "{message}"
    );
    let text = std::fs::read_to_string(out.join("dataset.toml")).unwrap();
    assert_eq!(
        text.matches("# temperature_c =  # FILL IN").count(),
        2,
        "{text}"
    );
    assert!(text.contains("# ocv =  # FILL IN"), "{text}");
    assert!(text.contains("model = \"model_start.json\""), "{text}");
    // What reads it names the key.
    let file = |name: &str| tables("panasonic_18650pf_25C").join(name);
    let (model, curve) = (file("model_3rc.json"), file("ocv.json"));
    let given = [
        "--model",
        model.to_str().unwrap(),
        "--ocv",
        curve.to_str().unwrap(),
    ];
    let diagnose = [&["diagnose", target][..], &given].concat();
    for command in [vec!["dataset", "check", target], diagnose] {
        let refused = program(&command);
        let message = refused.stderr;
        assert_eq!(refused.code, Some(2), "{message}");
        assert!(message.contains("temperature_c"), "{command:?}: {message}");
    }
    // The unchanged file is written over.
    let stated = program(&[&words[..], &["--temperature-c", "25"]].concat());
    stated.expect_code(0);
    let checked = program(&["dataset", "check", target]);
    let summary = checked.stdout;
    assert!(
        summary.contains("2 runs: 2 in time, 0 spectra"),
        "{summary}{}",
        checked.stderr
    );
}

#[test]
fn a_changed_file_that_lacks_something_is_kept() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("data");
    let log = two_pulses(folder.path(), "");
    let words = [
        "dataset",
        "init",
        log.to_str().unwrap(),
        "--out",
        out.to_str().unwrap(),
    ];
    assert_eq!(program(&words).code, Some(2));
    let file = out.join("dataset.toml");
    let changed = std::fs::read_to_string(&file).unwrap() + "# mine\n";
    std::fs::write(&file, &changed).unwrap();
    assert!(program(&words).stderr.contains("nothing is written over"));
    assert_eq!(std::fs::read_to_string(&file).unwrap(), changed);
}

#[test]
fn the_head_gives_capacity_and_temperature_and_an_option_overrides_them() {
    let folder = tempfile::tempdir().unwrap();
    let log = two_pulses(
        folder.path(),
        "Nominal Capacity,2.5\nAmbient Temperature,10\n",
    );
    let out = folder.path().join("data");
    let words = [
        "dataset",
        "init",
        log.to_str().unwrap(),
        "--out",
        out.to_str().unwrap(),
    ];
    let made = program(&[&words[..], &["--soc-start", "0.5", "--json"]].concat());
    made.expect_code(0);
    let found: Value = serde_json::from_str(&made.stdout).unwrap();
    let loads = found["logs"][0]["loads"].as_array().unwrap();
    // 5 A for 10 s out of 2.5 Ah; the first row of a pulse counts half a step of it.
    let soc = |k: usize| loads[k]["soc"]["value"].as_f64().unwrap();
    assert!((soc(0) - soc(1) - 50.0 / 9000.0).abs() < 5e-4, "{loads:?}");
    let ohm = loads[1]["resistance_1s_ohm"].as_f64().unwrap();
    assert!((ohm - 2e-3).abs() < 1e-9, "{ohm}");
    let set = read_dataset(&out).unwrap().set;
    assert!(set.runs.iter().all(|run| run.temperature_degc == 10.0));
    let other = folder.path().join("other");
    let words = [
        "dataset",
        "init",
        log.to_str().unwrap(),
        "--out",
        other.to_str().unwrap(),
    ];
    let more = [
        "--capacity-ah",
        "5",
        "--soc-start",
        "0.5",
        "--temperature-c",
        "25",
    ];
    let made = program(&[&words[..], &more].concat());
    let summary = made.stdout;
    assert!(
        summary.contains("the capacity 5 Ah is used, and the head of the file has 2.5 Ah"),
        "{summary}"
    );
    let set = read_dataset(&other).unwrap().set;
    assert!(set.runs.iter().all(|run| run.temperature_degc == 25.0));
}

#[test]
fn an_hppc_with_forty_seconds_of_rest_gives_its_pulses() {
    let log = project("../shared/data/cases/hppc_40s_rest.csv");
    if !log.exists() {
        println!("skipped: {} is not there", log.display());
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("data");
    let words = [
        "dataset",
        "init",
        log.to_str().unwrap(),
        "--soc-start",
        "0.9",
        "--capacity-ah",
        "30",
        "--temperature-c",
        "25",
        "--json",
        "--out",
        out.to_str().unwrap(),
    ];
    let made = program(&words);
    made.expect_code(0);
    let found: Value = serde_json::from_str(&made.stdout).unwrap();
    let loads = found["logs"][0]["loads"].as_array().unwrap();
    let first = &loads[0];
    assert!(first["refusal"].is_null(), "{first}");
    let of = |key: &str| first[key].as_f64().unwrap();
    assert_eq!(
        (first["kind"].as_str(), of("current_a")),
        (Some("pulse"), 30.0)
    );
    assert_eq!((of("start_s"), of("duration_s")), (31.0, 10.0));
    // The truth without the change of the open-circuit voltage within the second.
    let milliohms = 1e3 * of("resistance_1s_ohm");
    assert!((milliohms - 2.05).abs() < 0.01, "{milliohms}");
    let kinds: Vec<&str> = loads
        .iter()
        .filter_map(|load| load["kind"].as_str())
        .collect();
    assert_eq!(kinds, ["pulse", "pulse", "discharge", "pulse"]);
    let set = read_dataset(&out).unwrap().set;
    assert_eq!(set.runs.len(), 2);
    // It names its own curve and model, so that a verdict needs nothing else.
    let diagnosis = program(&["diagnose", out.to_str().unwrap(), "--json"]);
    diagnosis.expect_code(0);
    let report: Value = serde_json::from_str(&diagnosis.stdout).unwrap();
    assert!(report["verdict"].is_string(), "{report}");
}
