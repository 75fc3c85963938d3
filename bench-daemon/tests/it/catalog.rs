//! The catalogue on the command line and in the server: real run folders of the demo.

use std::{ffi::OsStr, fs, path::PathBuf};

use serde_json::{Value, json};

use crate::{
    serve_support::{Served, config, submit},
    support::{EXPERIMENT, Ended, Files, poll, program},
};

/// Two runs of one cell, one of which was stopped before its end, and a catalogue of them.
struct Cataloged {
    files: Files,
}

impl Cataloged {
    fn new() -> Self {
        let files = Files::short(3);
        files.run("runs/first").expect_code(0);
        files.run("runs/second").expect_code(0);
        let cataloged = Self { files };
        cataloged.ask(&["scan", "DB", "RUNS"]).expect_code(0);
        cataloged
    }

    fn path(&self, name: &str) -> PathBuf {
        self.files.path(name)
    }

    /// Runs `eis-bench catalog`; `DB` and `RUNS` stand for the catalogue and the folder of the
    /// runs.
    fn ask(&self, words: &[&str]) -> Ended {
        let words: Vec<PathBuf> = words
            .iter()
            .map(|word| match *word {
                "DB" => self.path("catalog.sqlite"),
                "RUNS" => self.path("runs"),
                word if word.starts_with("OUT/") => self.path(&word[4..]),
                word => PathBuf::from(word),
            })
            .collect();
        let words = words.iter().map(|word| word.as_os_str());
        let words: Vec<&OsStr> = [OsStr::new("catalog")].into_iter().chain(words).collect();
        program(&words)
    }

    fn json(&self, words: &[&str]) -> Value {
        let ended = self.ask(&[words, &["--json"]].concat());
        serde_json::from_str(&ended.expect_code(0).stdout).unwrap()
    }
}

#[test]
fn a_run_of_a_certain_cell_tells_which_it_was() {
    let files = Files::short(3).edit(
        EXPERIMENT,
        "[fit]",
        "[specimen]\nname = \"A-17\"\nserial = \"P45B-17\"\nbatch = \"2026-03\"\n\
        barcode = \"0417 8821\"\n\n[fit]",
    );
    let cell = files.text("cells/p45b.toml");
    let identity = "\n[identity]\nmaker = \"Molicel\"\nchemistry = \"NCA / graphite-silicon\"\n\
        batch = \"of many\"\nterm = \"https://vocabulary.example/battery#cylindrical\"\n";
    files.write("cells/p45b.toml", &format!("{cell}{identity}"));
    files.run("runs/first").expect_code(0);
    let at = Cataloged { files };
    at.ask(&["scan", "DB", "RUNS"]).expect_code(0);
    for key in ["A-17", "P45B-17", "0417 8821"] {
        let found = at.json(&["find", "DB", "--cell", key, "--batch", "2026-03"]);
        let cell = &found["runs"][0]["cells"][0];
        assert_eq!(cell["name"], "A-17", "{key}: {found}");
        assert_eq!(cell["model"], "Molicel P45B");
        assert_eq!(cell["serial"], "P45B-17");
        assert_eq!(cell["chemistry"], "NCA / graphite-silicon");
    }
    assert_eq!(
        at.json(&["find", "DB", "--batch", "of many"])["runs"],
        Value::Array(Vec::new())
    );
    let cells = at.json(&["cells", "DB"]);
    assert_eq!(cells["cells"][0]["maker"], "Molicel");
    let cells = at.json(&["cells", "DB", "--cell", "0417 8821"]);
    assert_eq!(cells["cells"][0]["cell"], "A-17");
    let none = at.json(&["cells", "DB", "--verdict", "failed"]);
    assert_eq!(none["cells"], json!([]));
    let words = at
        .ask(&["show", "DB", "first"])
        .expect_code(0)
        .stdout
        .clone();
    for expected in [
        "cell        A-17 (P45B-17); type Molicel P45B; batch 2026-03; barcode 0417 8821; maker Molicel",
        "; chemistry NCA / graphite-silicon; term https://vocabulary.example/battery#cylindrical\n",
        "\nseed        1\n",
        "\nconfig      ",
        "\ninstrument  scope  ",
    ] {
        assert!(words.contains(expected), "{expected}: {words}");
    }
    let refused = at
        .files
        .edit(EXPERIMENT, "0417 8821", "  ")
        .run("runs/second");
    let expected = "specimen.barcode: expected 1 to 200 characters in one line";
    assert!(refused.stderr.contains(expected), "{}", refused.stderr);
}

#[test]
fn a_run_with_a_map_is_found_by_it() {
    let files = crate::map_next::start();
    files.run("runs/map").expect_code(0);
    let at = Cataloged { files };
    let other = at.path("runs/other");
    Files::short(3).run(other.to_str().unwrap()).expect_code(0);
    at.ask(&["scan", "DB", "RUNS"]).expect_code(0);
    assert_eq!(
        at.json(&["find", "DB"])["runs"].as_array().unwrap().len(),
        2
    );
    let found = at.json(&["find", "DB", "--map"]);
    let [run] = &found["runs"].as_array().unwrap()[..] else {
        panic!("{found}")
    };
    let map = &run["map"];
    let number = |name: &str| map[name].as_f64().unwrap();
    assert!(
        number("soc_low") <= 0.2 && number("soc_high") >= 0.9,
        "{map}"
    );
    assert!((number("temperature_low_c") - 25.0).abs() < 1.0, "{map}");
    // That of the worst log of the table.
    let table = fs::read_to_string(at.path("runs/map/map_logs.csv")).unwrap();
    let place = |line: &str| line.split(',').position(|name| name == "left_out_rms_mv");
    let place = table.lines().next().and_then(place).unwrap();
    let rows = table.lines().skip(1);
    let errors_mv = rows.map(|row| row.split(',').nth(place).unwrap().parse::<f64>().unwrap());
    assert_eq!(
        Some(number("left_out_mv")),
        errors_mv.reduce(f64::max),
        "{table}"
    );
    let words = at.ask(&["show", "DB", "map"]).expect_code(0).stdout.clone();
    assert!(
        words.contains("fit         map.json  map of SOC 0."),
        "{words}"
    );
    let csv = at
        .ask(&["find", "DB", "--csv"])
        .expect_code(0)
        .stdout
        .clone();
    assert!(csv.contains(",map_soc_low,map_soc_high,"), "{csv}");
    let none = at.json(&["find", "DB", "--map", "--cell", "another"]);
    assert_eq!(none["runs"], json!([]));
}

#[test]
fn runs_of_a_cell_are_found_shown_and_exported() {
    let at = Cataloged::new();
    let found = at.json(&["find", "DB", "--cell", "Molicel P45B", "--verdict", "good"]);
    let runs = found["runs"].as_array().unwrap();
    assert_eq!((runs.len(), &found["after"]), (2, &Value::Null));
    assert_eq!(runs[0]["time_source"], "file");
    assert_eq!(runs[0]["spectra"], 1);
    assert_eq!(runs[0]["content_sha256"].as_str().unwrap().len(), 64);
    let page = at.json(&["find", "DB", "--most", "1"]);
    let after = page["after"].as_str().unwrap();
    let rest = at.json(&["find", "DB", "--after", after]);
    assert_eq!(rest["runs"].as_array().unwrap(), &runs[1..]);
    let none = at.json(&["find", "DB", "--text", "swollen"]);
    assert!(none["runs"].as_array().unwrap().is_empty());
    let csv = at.ask(&["find", "DB", "--csv"]);
    assert!(
        csv.expect_code(0)
            .stdout
            .starts_with("run,name,cells,serials")
    );
    let shown = at.json(&["show", "DB", "second"]);
    assert_eq!(shown["run"]["name"], "second");
    assert_eq!(shown["fits"][0]["rc"], 1);
    assert!(shown["fits"][0]["r_sigma_ohm"].as_f64().unwrap() > 0.0);
    let words = at.ask(&["show", "DB", "second"]);
    assert!(
        words.expect_code(0).stdout.contains("verdict     good"),
        "{}",
        words.stdout
    );
    let exported = at.json(&["export", "DB", "--out", "OUT/spectra.parquet"]);
    assert_eq!(exported["rows"], 6);
    let ageing = at.json(&[
        "ageing",
        "DB",
        "--cell",
        "Molicel P45B",
        "--out",
        "OUT/ageing",
    ]);
    assert_eq!(ageing["points"].as_array().unwrap().len(), 2);
    let svg = fs::read_to_string(at.path("ageing/ageing.svg")).unwrap();
    assert!(svg.contains("DC resistance / mΩ"));
    assert!(at.path("ageing/ageing.csv").is_file());
}

#[test]
fn cells_of_one_name_and_several_serial_numbers_have_no_ageing_together() {
    let one = "[specimen]\nname = \"A\"\nserial = \"S-1\"\n\n[fit]";
    let files = Files::short(3).edit(EXPERIMENT, "[fit]", one);
    files.run("runs/first").expect_code(0);
    let files = files.edit(EXPERIMENT, "S-1", "S-2");
    files.run("runs/second").expect_code(0);
    let at = Cataloged { files };
    at.ask(&["scan", "DB", "RUNS"]).expect_code(0);
    let words = ["ageing", "DB", "--cell", "A"];
    let message = at.ask(&words).expect_code(2).message().to_owned();
    let expected = "--serial: expected one of \"S-1\", \"S-2\", for these cells have the same name";
    assert!(message.contains(expected), "{message}");
    let ageing = at.json(&[&words[..], &["--serial", "S-2"]].concat());
    assert_eq!(ageing["points"][0]["name"], "second");
    assert_eq!(ageing["points"].as_array().unwrap().len(), 1);
}

#[test]
fn a_catalogue_that_is_deleted_and_built_again_says_the_same() {
    let at = Cataloged::new();
    let all = |at: &Cataloged| {
        let found = at.json(&["find", "DB"]);
        let runs = found["runs"].as_array().unwrap().clone();
        let shown = runs.iter().map(|run| {
            let run = run["run"].as_str().unwrap();
            at.json(&["show", "DB", run])
        });
        let shown: Vec<Value> = shown.collect();
        (found, shown)
    };
    let before = all(&at);
    let again = at.json(&["scan", "DB"]);
    assert_eq!((&again["runs"], &again["read"]), (&2.into(), &0.into()));
    fs::remove_file(at.path("catalog.sqlite")).unwrap();
    at.ask(&["scan", "DB", "RUNS"]).expect_code(0);
    assert_eq!(all(&at), before);
}

#[test]
fn what_is_wrong_is_reported_with_what_was_expected() {
    let at = Cataloged::new();
    let message = |words: &[&str]| at.ask(words).expect_code(2).message().to_owned();
    let error = message(&["find", "OUT/none.sqlite"]);
    assert!(
        error.contains("none.sqlite: expected a catalogue, found no file"),
        "{error}"
    );
    let error = message(&["show", "DB", "third"]);
    assert!(error.contains("run: expected the identity"), "{error}");
    let error = message(&["find", "DB", "--after", "x"]);
    assert!(
        error.contains("after: expected the `after` of an answer before"),
        "{error}"
    );
    let error = message(&["ageing", "DB", "--cell", "none"]);
    assert!(
        error.contains("--cell: expected a cell with fitted models"),
        "{error}"
    );
    let error = message(&["ageing", "DB", "--cell", "Molicel P45B", "--rc", "7"]);
    assert!(
        error.contains("--rc: expected a number of RC pairs"),
        "{error}"
    );
    let words = [
        "ageing",
        "DB",
        "--cell",
        "Molicel P45B",
        "--verdict",
        "failed",
    ];
    let error = message(&words);
    assert!(error.contains("--cell: expected a cell with"), "{error}");
    let error = message(&["scan", "DB", "OUT/nowhere"]);
    assert!(
        error.contains("nowhere: expected a folder to scan"),
        "{error}"
    );
    fs::write(
        at.path("catalog.sqlite"),
        "no catalogue, but long enough for a head",
    )
    .unwrap();
    at.ask(&["find", "DB"]).expect_code(2);
    at.ask(&["scan", "DB", "RUNS"]).expect_code(2);
    let kept = fs::read_to_string(at.path("catalog.sqlite")).unwrap();
    assert!(kept.starts_with("no catalogue"), "{kept}");
}

#[test]
fn a_server_keeps_the_catalogue_of_its_own_runs() {
    let files = Files::short(3);
    config(&files, "");
    let served = Served::start(&files);
    let run = submit(&served, r#"{"experiment":"demo"}"#);
    served.ended(&run);
    let found = poll("the run in the catalogue", || {
        let answer = served.ask("GET", "/api/v1/catalog/runs?verdict=good", ("", ""));
        let found = (answer.status == 200).then(|| answer.json())?;
        found["runs"].get(0).cloned()
    });
    assert_eq!(
        (&found["name"], &found["operator"]),
        (&run.as_str().into(), &"local".into())
    );
    assert_eq!(found["folder"], format!("runs/{run}"));
    let spectra = served.get("/catalog/spectra?cell=Molicel%20P45B&bench=demo");
    let spectrum = &spectra["spectra"][0];
    let number = |key: &str| spectrum[key].as_f64().unwrap();
    assert!(number("r_high_ohm") < number("r_low_ohm"), "{spectrum}");
    assert!(number("r_high_hz") > number("low_hz"), "{spectrum}");
    let choices = json!({ "cells": ["Molicel P45B"], "benches": ["demo"], "tags": [] });
    assert_eq!(served.get("/catalog/choices"), choices);
    let ageing = served.get("/catalog/ageing?cell=Molicel%20P45B");
    assert_eq!(
        (&ageing["rc"], &ageing["points"][0]["name"]),
        (&1.into(), &found["name"])
    );
    let other = served.get("/catalog/ageing?cell=Molicel%20P45B&serial=S-9");
    assert_eq!((&other["rc"], &other["points"]), (&Value::Null, &json!([])));
    let shown = served.get(&format!("/catalog/runs/{run}"));
    assert_eq!(shown["run"], found);
    assert_eq!(shown["fits"][0]["file"], "model_1rc.json");
    let reply = served.ask("GET", "/api/v1/catalog/runs/none", ("", ""));
    let message = reply.expect(404).text();
    assert!(message.contains("found 0 for \\\"none\\\""), "{message}");
    let fits = served.get("/catalog/fits?cell=Molicel%20P45B&verdict=good");
    assert_eq!(
        (&fits["fits"], &fits["after"]),
        (&shown["fits"], &Value::Null)
    );
    let none = served.get("/catalog/fits?trip=true");
    assert_eq!(none["fits"], json!([]));
    let none = served.get("/catalog/diagnoses?bench=demo");
    assert_eq!(none["diagnoses"], json!([]));
    let cells = served.get("/catalog/cells");
    assert_eq!(
        (&cells["cells"][0]["cell"], &cells["cells"][0]["runs"]),
        (&"Molicel P45B".into(), &1.into())
    );
    for (query, expected) in [
        ("after=x", "after: expected"),
        ("most=0", "most: expected 1"),
    ] {
        let path = format!("/api/v1/catalog/runs?{query}");
        let message = served.ask("GET", &path, ("", "")).expect(400).text();
        assert!(message.contains(expected), "{message}");
    }
}
