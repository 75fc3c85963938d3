//! `eis-bench pack simulate` with a map, and the temperatures of its cells.

use std::{fs, path::Path};

use serde_json::{Value, json};

use crate::support::{json as read_json, program_in, project};

/// A folder with the map of the Panasonic cell, once as it is and once with a heat capacity, and a
/// load of ten minutes on four groups of three cells.
fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let of_cell = |name: &str| project(&format!("fixtures/data/cells/panasonic_18650pf_{name}"));
    let (warm, cold) = (of_cell("25C/pulses.bdf.csv"), of_cell("10C/pulses.bdf.csv"));
    let words = ["map", &warm, &cold, "--ocv", &of_cell("25C/ocv.json")];
    let words = [&words[..], &["--out", "map"]].concat();
    assert_eq!(program_in(folder.path(), &words).code, Some(0));
    let mut map = read_json(&folder.path().join("map/map.json"));
    map["map"]["thermal"] = json!({"capacity_j_per_k": 45.0, "resistance_k_per_w": 8.0});
    fs::write(folder.path().join("warming.json"), map.to_string()).unwrap();
    let load = "time_s,power_w\n0,160\n200,30\n300,160\n600,160\n";
    fs::write(folder.path().join("load.csv"), load).unwrap();
    let one = "time_s,power_w\n0,13\n200,2\n300,13\n600,13\n";
    fs::write(folder.path().join("one.csv"), one).unwrap();
    folder
}

const PACK: [&str; 14] = [
    "pack",
    "simulate",
    "--profile",
    "load.csv",
    "--series",
    "4",
    "--parallel",
    "3",
    "--soc",
    "0.8",
    "--draws",
    "20",
    "--max-step-s",
    "0.5",
];

fn answer(folder: &Path, words: &[&str]) -> Value {
    let (code, text, error) = program_in(folder, &[words, &["--json"]].concat()).parts();
    assert_eq!(code, 0, "{error}");
    serde_json::from_str(&text).unwrap()
}

fn refused(folder: &Path, words: &[&str]) -> String {
    let (code, _, error) = program_in(folder, words).parts();
    assert_eq!(code, 2, "{error}");
    error
}

#[test]
fn a_pack_of_one_cell_with_a_map_is_what_simulate_says() {
    let folder = folder();
    let one = [
        "--profile",
        "one.csv",
        "--model",
        "warming.json",
        "--soc",
        "0.8",
        "--ambient-degc",
        "15",
    ];
    let single = answer(folder.path(), &[&["simulate"][..], &one].concat());
    let pack = ["pack", "simulate", "--series", "1", "--parallel", "1"];
    let words = [&pack[..], &one, &["--draws", "1", "--max-step-s", "0.05"]].concat();
    let packed = answer(folder.path(), &words);
    let identical = &packed["identical"];
    let apart = identical["min_cell_v"].as_f64().unwrap() - single["min_ccv_v"].as_f64().unwrap();
    assert!(apart.abs() < 1e-7, "{apart}");
    let note = single["notes"].to_string();
    let degc = identical["temperatures"]["hottest_degc"].as_f64().unwrap();
    assert!(
        note.contains(&format!("the cells end at {degc:.1} °C")),
        "{degc}: {note}"
    );
    assert!(packed["step_error_v"].as_f64().unwrap() < 1e-5);
}

#[test]
fn cells_of_a_map_warm_and_the_middle_is_the_hottest() {
    let folder = folder();
    let model = ["--model", "warming.json", "--ambient-degc", "15"];
    let base = [&PACK[..], &model].concat();
    let alone = answer(folder.path(), &base);
    let network = [
        "--neighbour-w-per-k",
        "0.2",
        "--busbar-w-per-k",
        "0.5",
        "--side-share",
        "0.7",
        "--interconnect-ohm",
        "0.004",
        "--out",
        "out",
    ];
    let together = answer(folder.path(), &[&base[..], &network].concat());
    let of = |report: &Value, name: &str| report["identical"]["temperatures"][name].clone();
    // Cells that do not conduct are as warm as each other.
    assert!(of(&alone, "spread_k").as_f64().unwrap() < 1e-9);
    assert!(alone["hottest_degc"]["p50"].as_f64().unwrap() > 20.0);
    assert!(of(&together, "spread_k").as_f64().unwrap() > 0.2);
    let hottest = of(&together, "hottest");
    assert!(hottest["place"] == 2 && (hottest["group"] == 2 || hottest["group"] == 3));
    assert!(of(&together, "coldest")["place"] != 2, "{together}");
    assert!(together["interconnect_heat_j"]["p50"].as_f64().unwrap() > 100.0);
    for name in ["hottest_degc", "lowest_peak_degc", "temperature_spread_k"] {
        let p = &together[name];
        assert!(p["p5"].as_f64().unwrap() <= p["p95"].as_f64().unwrap());
    }
    let out = folder.path().join("out");
    assert!(out.join("bands.svg").is_file() && out.join("draws.parquet").is_file());
    let svg = fs::read_to_string(out.join("bands.svg")).unwrap();
    assert!(svg.contains("Temperature / °C") && svg.contains("hottest cell"));
    let text = program_in(folder.path(), &[&base[..], &network].concat()).ok();
    for part in [
        "hottest cell / °C",
        "cells apart / K",
        "hottest draw ",
        "interconnect heat / J",
    ] {
        assert!(text.contains(part), "{text}");
    }
}

#[test]
fn a_map_that_is_left_is_reported_with_the_cell() {
    let folder = folder();
    let words = ["--model", "map/map.json", "--ambient-degc", "-20"];
    let report = answer(folder.path(), &[&PACK[..], &words].concat());
    let outside = &report["outside_map"];
    // The colder node lies at 11 °C.
    let kelvin = outside["temperature_k"].as_f64().unwrap();
    assert!((kelvin - 31.0).abs() < 0.5, "{kelvin}");
    assert!(outside["temperature_cell"]["group"].is_u64());
    let notes = report["notes"].to_string();
    for part in [
        "leaves the range in which the map was measured by up to",
        "in temperature draw 1, group 1, place 1",
        "the map has no heat capacity: the cells keep the temperature of their surroundings",
    ] {
        assert!(notes.contains(part), "{notes}");
    }
    assert_eq!(report["hottest_degc"]["p95"], -20.0);
    // A capacity by the arguments lets them warm.
    let warms = [&PACK[..], &words, &["--path-k-per-w", "8"]].concat();
    let report = answer(folder.path(), &warms);
    assert!(report["hottest_degc"]["p95"].as_f64().unwrap() > -18.0);
    assert!(
        report["notes"]
            .to_string()
            .contains("66.5 J/K are the default of a P45B (70 g, 950 J/(kg·K))")
    );
}

#[test]
fn a_size_takes_the_resistance_of_the_map_where_the_voltage_has_it() {
    let folder = folder();
    let map = read_json(&folder.path().join("warming.json"));
    let size = [
        "pack",
        "size",
        "--series",
        "4",
        "--parallel",
        "3",
        "--model",
        "warming.json",
    ];
    let of = |ocv_v: &str, degc: &str| {
        let words = ["--ocv-v", ocv_v, "--ambient-degc", degc];
        let report = answer(folder.path(), &[&size[..], &words].concat());
        (
            report["dcir_ohm"].as_f64().unwrap(),
            report["model_notes"].to_string(),
        )
    };
    let (warm, note) = of("3.7", "25");
    assert!(
        note.contains("the DC resistance is that of the map at SOC 0."),
        "{note}"
    );
    assert!(note.contains(" and 25.0 °C"), "{note}");
    let (cold, _) = of("3.7", "11");
    let (low, _) = of("3.3", "25");
    assert!(
        cold > 1.1 * warm && (low / warm - 1.0).abs() > 0.05,
        "{warm} {cold} {low}"
    );
    // Before, the point of the file was taken, whatever the voltage.
    let branches = map["branches"].as_array().unwrap().iter();
    let of_file: f64 = branches
        .map(|branch| branch["r_ohm"].as_f64().unwrap())
        .sum();
    assert!((low / (of_file + map["r_ohm"].as_f64().unwrap()) - 1.0).abs() > 0.02);
    let (_, note) = of("3.7", "-20");
    assert!(
        note.contains("there the resistances are extrapolated"),
        "{note}"
    );
    let words = ["--ocv-v", "4.9"];
    let error = refused(folder.path(), &[&size[..], &words].concat());
    assert!(error.contains("--ocv-v: "), "{error}");
}

#[test]
fn what_the_heat_of_a_pack_cannot_be_is_refused_by_name() {
    let folder = folder();
    let base = [&PACK[..], &["--model", "warming.json"]].concat();
    for (words, text) in [
        (
            ["--neighbour-w-per-k", "-1"],
            "--neighbour-w-per-k: expected zero or more in W/K, found -1",
        ),
        (
            ["--busbar-w-per-k", "inf"],
            "--busbar-w-per-k: expected zero or more in W/K, found inf",
        ),
        (
            ["--side-share", "1.2"],
            "--side-share: expected a number from 0 to 1, found 1.2",
        ),
        (
            ["--path-k-per-w", "0"],
            "--path-k-per-w: expected a number above 0 in K/W, found 0",
        ),
        (
            ["--ambient-degc", "300"],
            "--ambient-degc: expected -60 to 120 °C, found 300",
        ),
        (
            ["--cell-mass-kg", "-1"],
            "mass of a cell in kg: expected a number above 0, met -1",
        ),
        (
            ["--cell-mass-kg", "0.05"],
            "--specific-heat: expected both --cell-mass-kg and --specific-heat, or neither",
        ),
        (
            ["--specific-heat", "900"],
            "--cell-mass-kg: expected both --cell-mass-kg and --specific-heat, or neither: together \
            they replace the 45.0 J/K of the map",
        ),
    ] {
        let error = refused(folder.path(), &[&base[..], &words].concat());
        assert!(error.contains(text), "{error}");
    }
    let words = ["--model", "map/map.json", "--side-share", "0.5"];
    let error = refused(folder.path(), &[&PACK[..], &words].concat());
    assert!(
        error.contains("--side-share: expected a path to the surroundings"),
        "{error}"
    );
    let table = "group,place,model\n1,1,warming.json\n";
    fs::write(folder.path().join("cells.csv"), table).unwrap();
    let draws = PACK.iter().position(|word| *word == "--draws").unwrap();
    let words: Vec<&str> = base[..draws]
        .iter()
        .chain(&base[draws + 2..])
        .copied()
        .chain(["--cells", "cells.csv"])
        .collect();
    let error = refused(folder.path(), &words);
    assert!(
        error.contains("expected no model of a cell of its own: all cells follow the map"),
        "{error}"
    );
}

#[test]
fn a_model_of_one_point_says_that_it_keeps_its_resistances() {
    let folder = folder();
    let model = project("fixtures/data/cells/panasonic_18650pf_25C/model_3rc.json");
    let ocv = project("fixtures/data/cells/panasonic_18650pf_25C/ocv.json");
    let words = ["--model", &model, "--ocv", &ocv];
    let text = "it keeps its resistances at every charge and temperature";
    for call in [&PACK[..], &["sop", "--soc", "0.5", "--duration-s", "1"]] {
        let report = answer(folder.path(), &[call, &words].concat());
        let notes = report["notes"].to_string();
        assert_eq!(notes.matches(text).count(), 1, "{notes}");
    }
    let size = ["pack", "size", "--series", "4", "--parallel", "3"];
    let size = [&size[..], &["--ocv-v", "3.7", "--model", &model]].concat();
    let report = answer(folder.path(), &size);
    assert!(report["model_notes"].to_string().contains(text), "{report}");
    // Temperatures do not change the resistances, but they are known.
    let report = answer(folder.path(), &[&PACK[..], &words].concat());
    let (rise, degc) = (
        report["identical"]["hottest_rise_k"].as_f64().unwrap(),
        report["identical"]["temperatures"]["hottest_degc"]
            .as_f64()
            .unwrap(),
    );
    assert!((25.0 + rise - degc).abs() < 1e-9, "{rise} {degc}");
}
