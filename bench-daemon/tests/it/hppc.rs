//! `eis-bench hppc`: pulse resistances of measured and constructed logs.

use std::path::PathBuf;

use serde_json::Value;

use crate::support::{Ended, program, project, shared_data};

/// A file of the measured data; `None` if it is not there.
fn measured(name: &str) -> Option<String> {
    let path = shared_data(name)?;
    Some(path.to_str().unwrap().to_owned())
}

fn hppc(words: &[&str]) -> Ended {
    program(&[&["hppc"], words].concat())
}

/// The table of one log.
fn table(words: &[&str]) -> Value {
    let made = hppc(&[words, &["--json"]].concat());
    made.expect_code(0);
    let mut all: Vec<Value> = serde_json::from_str(&made.stdout).unwrap();
    assert_eq!(all.len(), 1);
    all.remove(0)
}

const PULSES: &str = "fixtures/data/cells/panasonic_18650pf_25C/pulses.bdf.csv";
const LIMITS: [&str; 4] = ["--v-min", "2.5", "--v-max", "4.2"];

fn written(name: &str, text: &str) -> (tempfile::TempDir, String) {
    let folder = tempfile::tempdir().unwrap();
    let path: PathBuf = folder.path().join(name);
    std::fs::write(&path, text).unwrap();
    let path = path.to_str().unwrap().to_owned();
    (folder, path)
}

#[test]
fn an_hppc_with_one_row_a_second_has_the_resistance_after_a_second() {
    let Some(log) = measured("cases/hppc_40s_rest.csv") else {
        return;
    };
    let known = ["--soc-start", "0.9", "--capacity-ah", "30"];
    let found = table(&[&[log.as_str()], &LIMITS[..], &known[..]].concat());
    let pulses = found["pulses"].as_array().unwrap();
    let directions: Vec<&str> = pulses
        .iter()
        .filter_map(|pulse| pulse["direction"].as_str())
        .collect();
    assert_eq!(directions, ["discharge", "charge", "discharge"]);
    let first = &pulses[0];
    let ohm = |at: usize| first["resistances"][at]["found"]["ohm"].as_f64();
    // (3.90000 − 3.83831) V / 30 A.
    assert!((1e3 * ohm(1).unwrap() - 2.0563).abs() < 1e-3, "{first}");
    assert_eq!(
        first["resistances"][0]["reason"],
        "first row of the pulse at 1.00 s"
    );
    // The pulse is followed by a rest of 40 s, and the charge by the discharge to the next state.
    assert!((pulses[1]["state"]["soc"]["value"].as_f64().unwrap() - 0.897).abs() < 1e-3);
    assert_eq!(found["axis"], "soc");
    let reason = "its constant current lasts longer than 300 s";
    assert_eq!(found["left_out"][0]["reason"], reason);
}

#[test]
fn pulses_of_five_currents_at_one_state_are_five_rows_with_table_and_picture() {
    let folder = tempfile::tempdir().unwrap();
    let (csv, svg) = (folder.path().join("r.csv"), folder.path().join("r.svg"));
    let log = project(PULSES);
    let files = [
        "--out",
        csv.to_str().unwrap(),
        "--plot",
        svg.to_str().unwrap(),
    ];
    let found = table(&[&[log.as_str()], &LIMITS[..], &files[..]].concat());
    let pulses = found["pulses"].as_array().unwrap();
    let currents: Vec<f64> = pulses
        .iter()
        .filter_map(|pulse| pulse["current_a"].as_f64())
        .collect();
    let expected = [1.45, 2.9, 5.8, 11.6, 17.4];
    assert_eq!(currents.len(), expected.len());
    for (met, expected) in currents.iter().zip(expected) {
        assert!((met / expected - 1.0).abs() < 1e-3, "{currents:?}");
    }
    // 3.66348 V less the row at 1.01 s over its current: 29.8 mΩ to the code step of the voltage.
    let one = &pulses[0]["resistances"][1]["found"];
    let (ohm, sigma) = (
        one["ohm"].as_f64().unwrap(),
        one["sigma_ohm"].as_f64().unwrap(),
    );
    assert!((ohm - 29.85e-3).abs() < 1e-4, "{one}");
    // Two errors of a code of 0.64 mV over 1.45 A.
    let of_codes = 0.64e-3 / 12.0_f64.sqrt() * 2.0_f64.sqrt() / 1.45;
    assert!(sigma > 0.9 * of_codes && sigma < 2.0 * of_codes, "{one}");
    // The logged current is not yet there at 0.1 s.
    let reason = pulses[0]["resistances"][0]["reason"].as_str().unwrap();
    assert!(
        reason.starts_with("its current is not constant: 1.384 A"),
        "{reason}"
    );
    let power_w = pulses[0]["least_power"]["w"].as_f64().unwrap();
    let last = pulses[0]["resistances"][4]["found"]["ohm"]
        .as_f64()
        .unwrap();
    assert!((power_w * last / (2.5 * (3.66348 - 2.5)) - 1.0).abs() < 1e-3);
    let text = std::fs::read_to_string(csv).unwrap();
    assert_eq!(text.lines().count(), 26);
    assert!(text.starts_with("file,start_s,direction,current_a,base_a,duration_s,soc,drawn_ah"));
    assert!(std::fs::read_to_string(svg).unwrap().contains("<svg"));
}

#[test]
fn the_limits_come_from_the_file_of_the_cell_or_are_asked_for() {
    let log = project(PULSES);
    let cell = project("configs/cells/p45b.toml");
    let found = table(&[&log, "--cell", &cell, "--soc-start", "0.5"]);
    assert_eq!(found["limits"]["min_v"], 2.5);
    // The table lacks the rests between the pulses: charge may have moved in them.
    assert_eq!(found["axis"], "rest_voltage");
    let states = |found: &Value| -> Vec<Value> {
        let pulses = found["pulses"].as_array().unwrap();
        pulses
            .iter()
            .map(|one| one["state"]["soc"].clone())
            .collect()
    };
    assert!((states(&found)[0]["value"].as_f64().unwrap() - 0.5).abs() < 1e-4);
    assert!(states(&found)[1].is_null());
    let curve = project("fixtures/data/cells/panasonic_18650pf_25C/ocv.json");
    let found = table(&[&log, "--cell", &cell, "--ocv", &curve]);
    assert_eq!(found["axis"], "soc");
    assert_eq!(states(&found)[1]["from"], "rest_voltage");
    let refused = |words: &[&str]| {
        let made = hppc(words);
        assert_eq!(made.code, Some(2));
        made.stderr
    };
    let met = refused(&[&log]);
    let expected = "expected the voltage limits of the cell for its power, by --v-min and --v-max or by \
                    --cell FILE; found neither; --no-power leaves the power out";
    assert!(met.contains(expected), "{met}");
    let met = refused(&[&log, "--v-min", "2.5"]);
    assert!(met.contains("found no --v-max"), "{met}");
    let met = refused(&[&log, "--v-min", "4.2", "--v-max", "2.5"]);
    assert!(met.contains("found 4.2 V and 2.5 V"), "{met}");
    let met = refused(&[&log, "--no-power", "--at", "5,1"]);
    assert!(
        met.contains("expected rising times above 0 s, found [5.0, 1.0]"),
        "{met}"
    );
    let met = refused(&[&log, "--no-power", "--soc-start", "50"]);
    assert!(
        met.contains("expected a state of charge from 0 to 1, found 50"),
        "{met}"
    );
    assert!(table(&[&log, "--no-power"])["limits"].is_null());
}

#[test]
fn a_log_without_pulses_and_a_folder_without_logs_are_refused_with_what_they_hold() {
    let slow = project("fixtures/data/cells/panasonic_18650pf_25C/c20_ocv.bdf.csv");
    let made = hppc(&[&slow, "--no-power"]);
    let met = made.stderr;
    assert_eq!(made.code, Some(2));
    assert!(
        met.contains("c20_ocv.bdf.csv: expected at least one pulse"),
        "{met}"
    );
    assert!(
        met.contains("found 1 load (") || met.contains("found 2 loads ("),
        "{met}"
    );
    let folder = tempfile::tempdir().unwrap();
    let made = hppc(&[folder.path().to_str().unwrap(), "--no-power"]);
    let met = made.stderr;
    assert!(
        made.code == Some(2) && met.contains("expected a run folder"),
        "{met}"
    );
    let (_kept, path) = written("x.csv", "a,b\n1,2\n");
    let made = hppc(&[&path, "--no-power"]);
    assert!(made.code == Some(2) && made.stderr.contains("x.csv"));
}

#[test]
fn the_text_names_why_cells_are_empty() {
    let log = project(PULSES);
    let made = hppc(&[&log, "--no-power", "--at", "0.1,1,20"]);
    let met = made.stdout;
    for text in [
        "pulses.bdf.csv: 5 pulses; R in mΩ ± one standard uncertainty",
        "no state of charge: the charge drawn since the first row",
        "– at 0.1 s: its current is not constant: 1.384 A at 0.10 s",
        "– at 20 s: the pulse lasts 10.1 s (pulse at 45421.7 s) (and the like for 4 more)",
    ] {
        assert!(met.contains(text), "{met}");
    }
}

#[test]
fn the_logs_of_cyclers_are_read_without_hand_work() {
    for (name, fewest) in [
        ("cells/panasonic_18650pf_25C/five_pulse_hppc.bdf.csv", 50),
        ("cells/panasonic_18650pf_10C/five_pulse_hppc.bdf.csv", 50),
        ("cells/panasonic_18650pf_m10C/five_pulse_hppc.parquet", 30),
        (
            "p42a/cycler_25C/2023_08_01-15_25_35_discharge_4.2A_pulse_8.4A.csv",
            5,
        ),
        (
            "p42a/cycler_25C/2023_08_03-13_56_41_discharge_5A_pulse_10A.csv",
            5,
        ),
        (
            "p45b/cycler_25C/2023_08_29-14_19_21_discharge_1A_pulse_2A.csv",
            5,
        ),
        ("cases/sign_name_hppc_discharge.csv", 2),
        ("cases/sign_noname_hppc.csv", 2),
    ] {
        let Some(log) = measured(name) else { continue };
        let found = table(&[&[log.as_str()], &LIMITS[..]].concat());
        let pulses = found["pulses"].as_array().unwrap();
        assert!(pulses.len() >= fewest, "{name}: {}", pulses.len());
        for one in pulses
            .iter()
            .flat_map(|one| one["resistances"].as_array().unwrap())
        {
            let ohm = one["found"]["ohm"].as_f64();
            assert!(ohm.is_none_or(|ohm| ohm > 0.0), "{name}: {one}");
            assert!(ohm.is_some() != one["reason"].is_string(), "{name}: {one}");
        }
    }
}

#[test]
fn the_net_capacity_of_a_log_counts_where_the_log_has_cuts() {
    let Some(log) = measured("cells/panasonic_18650pf_m10C/five_pulse_hppc.parquet") else {
        return;
    };
    let known = ["--soc-start", "1", "--capacity-ah", "2.9", "--no-power"];
    let found = table(&[&[log.as_str()], &known[..]].concat());
    assert_eq!(found["axis"], "soc");
    let pulses = found["pulses"].as_array().unwrap();
    let drawn = |k: usize| pulses[k]["state"]["drawn_ah"].as_f64().unwrap();
    // The sixth pulse is at 5 % of 2.9 Ah, which were drawn in a cut of the log.
    assert!((drawn(5) - 0.145).abs() < 0.01, "{}", drawn(5));
}
