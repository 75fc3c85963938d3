//! Campaigns over cells and benches, with the program itself: simulated benches whose controls
//! differ from their certificates, and cells that are the same on each of them.

use std::{
    fmt::Write,
    fs,
    path::{Path, PathBuf},
};

use serde_json::{Value, json};

use crate::support::{EXPERIMENT, Ended, Files, program};

/// Standard deviation of the errors of the certificates.
const TRUTH: f64 = 0.004;

/// Benches whose controls are all off by a share, so that all results on them are too high by it.
struct Lab {
    files: Files,
}

impl Lab {
    fn new(offsets: &[f64]) -> Self {
        let files = Files::short(8)
            .edit(EXPERIMENT, "rc = [1]", "rc = [2]")
            .edit(EXPERIMENT, "start = \"100 Hz\"", "start = \"0.5 Hz\"");
        let bench = files.text("benches/demo.toml");
        for (at, offset) in offsets.iter().enumerate() {
            let (shunt, fake) = (9.96e-3 * (1.0 - offset), 3.75e-3 * (1.0 - offset));
            let scenario = format!(
                "bench_seed = {at}\n[cell]\ninitial_soc = 0.60\n[specimens]\nstore = 5\n[controls]\n\
                shunt_ohm = {shunt}\nshunt_sigma_rel = 0.0\nfake_cell_ohm = {fake}\n\
                fake_cell_sigma_rel = 0.0\n"
            );
            fs::write(files.path(&format!("scenarios/b{at}.toml")), scenario).unwrap();
            let named = bench.replace("name = \"demo\"", &format!("name = \"b{at}\""));
            let own = named.replace("p45b.toml", &format!("b{at}.toml"));
            fs::write(files.path(&format!("benches/b{at}.toml")), own).unwrap();
        }
        Self { files }
    }

    /// Plans a campaign, runs its experiments, and reports.
    fn campaign(&self, head: &str, benches: usize) -> Value {
        let mut text = format!("name = \"batch\"\nexperiment = \"{EXPERIMENT}\"\n{head}\n");
        for at in 0..benches {
            write!(
                text,
                "[[benches]]\nname = \"b{at}\"\nfile = \"benches/b{at}.toml\"\n"
            )
            .unwrap();
        }
        fs::write(self.files.path("batch.toml"), text).unwrap();
        let path = |name: &str| self.files.path(name).into_os_string();
        let words = |words: &[&str]| words.iter().map(Into::into).collect::<Vec<_>>();
        let ask = |words: Vec<std::ffi::OsString>| {
            let words: Vec<&std::ffi::OsStr> = words.iter().map(AsRef::as_ref).collect();
            program(&words)
        };
        let mut plan = words(&["campaign", "plan"]);
        plan.extend([path("batch.toml"), "--out".into(), path("todo")]);
        ask(plan).expect_code(0);
        for bench in 0..benches {
            let folder = self.files.path(&format!("todo/b{bench}"));
            for experiment in fs::read_dir(folder).unwrap() {
                let experiment = experiment.unwrap().path();
                let name = experiment.file_stem().unwrap().to_str().unwrap();
                let mut run = words(&["run"]);
                let out = path(&format!("runs/b{bench}_{name}"));
                run.extend([experiment.clone().into(), "--out".into(), out]);
                ask(run).expect_code(0);
            }
        }
        let mut scan = words(&["catalog", "scan"]);
        scan.extend([path("db.sqlite"), path("runs")]);
        ask(scan).expect_code(0);
        let mut report = words(&["campaign", "report"]);
        report.extend([path("db.sqlite"), "batch".into(), "--json".into()]);
        report.extend(["--out".into(), path("report")]);
        serde_json::from_str(&ask(report).expect_code(0).stdout).unwrap()
    }
}

impl Lab {
    /// Runs the program; `AT/…` in the arguments is a path of this place.
    fn ask(&self, words: &[&str]) -> Ended {
        let words = words.iter().map(|word| match word.strip_prefix("AT/") {
            Some(name) => self.files.path(name).into_os_string(),
            None => (*word).into(),
        });
        let words: Vec<std::ffi::OsString> = words.collect();
        let words: Vec<&std::ffi::OsStr> = words.iter().map(AsRef::as_ref).collect();
        program(&words)
    }

    /// Copies a run folder beside the others.
    fn copy(&self, run: &Path, to: &str) -> PathBuf {
        let to = self.files.path(to);
        fs::create_dir_all(&to).unwrap();
        for entry in fs::read_dir(run).unwrap().flatten() {
            if entry.path().is_file() {
                fs::copy(entry.path(), to.join(entry.file_name())).unwrap();
            }
        }
        to
    }
}

fn named<'a>(list: &'a Value, key: &str, name: &str) -> &'a Value {
    let mut all = list.as_array().unwrap().iter();
    all.find(|one| one[key] == name).unwrap()
}

fn offsets(quantity: &Value) -> Vec<f64> {
    let benches = quantity["benches"].as_array().unwrap().iter();
    let mut all: Vec<(&str, f64)> = benches
        .map(|bench| {
            let name = bench["bench"].as_str().unwrap();
            (name, bench["offset"].as_f64().unwrap())
        })
        .collect();
    all.sort_by_key(|(name, _)| *name);
    all.into_iter().map(|(_, offset)| offset).collect()
}

#[test]
fn benches_that_differ_are_distinguished_from_cells_that_differ() {
    let lab = Lab::new(&[0.006, -0.006]);
    let head = "cells = 3\nbenches_per_cell = 2\nreferences = [\"REF-1\"]";
    let report = lab.campaign(head, 2);
    // Three cells on two benches, and the reference at the beginning and at the end of each.
    assert_eq!(report["values"], 10);
    let of_r = named(&report["quantities"], "name", "R");
    let found = offsets(of_r);
    // Two benches show their difference, not which of them is correct.
    let difference = found[0] - found[1];
    assert!((difference - 0.012).abs() < 0.002, "{difference}");
    let cells = of_r["cells"].as_array().unwrap();
    assert_eq!(cells.len(), 4);
    assert!(lab.files.path("report/campaign.svg").is_file());
    let table = lab.files.text("report/cells.csv");
    assert!(table.contains("\nR,Ω,cell-0001,,2,"), "{table}");
    assert_eq!(report["left_out"], json!([]));
    what_does_not_count_is_left_out(&lab, of_r);
}

/// Catalogues of several machines, with runs that count once or not at all.
fn what_does_not_count_is_left_out(lab: &Lab, of_r: &Value) {
    let run = fs::read_dir(lab.files.path("runs")).unwrap().next();
    let run = run.unwrap().unwrap().path();
    lab.copy(&run, "others/same");
    let stopped = lab.copy(&run, "others/stopped");
    let journal = fs::read_to_string(stopped.join("journal.jsonl")).unwrap();
    let early = journal.replace(r#""how":"finished""#, r#""how":"ended early: aborted""#);
    assert_ne!(early, journal);
    fs::write(stopped.join("journal.jsonl"), early).unwrap();
    fs::write(lab.copy(&run, "others/damaged").join("traces.json"), "{").unwrap();
    lab.ask(&["catalog", "scan", "AT/others.sqlite", "AT/others"])
        .expect_code(0);
    let words = ["campaign", "report", "AT/db.sqlite", "batch"];
    let both = [&words[..], &["--and", "AT/others.sqlite"]].concat();
    let asked = lab.ask(&[&both[..], &["--json"]].concat());
    let report: Value = serde_json::from_str(&asked.expect_code(0).stdout).unwrap();
    let left_out = |why: &str| json!({ "why": why, "runs": 1 });
    let expected = [
        left_out("damaged"),
        left_out("failed"),
        left_out("the same as another one, by their hashes"),
    ];
    assert_eq!(
        (&report["left_out"], &report["values"]),
        (&json!(expected), &json!(10))
    );
    assert_eq!(named(&report["quantities"], "name", "R"), of_r);
    let text = lab.ask(&both).expect_code(0).stdout.clone();
    assert!(text.contains("  left out: 1 runs, failed\n"), "{text}");
    let none = lab.ask(&["campaign", "report", "AT/others.sqlite", "other"]);
    let message = none.expect_code(2).message();
    assert!(
        message.contains("expected finished runs of the experiment \"other\""),
        "{message}"
    );
}

#[test]
fn a_campaign_that_cannot_be_is_refused_with_file_and_field() {
    let lab = Lab::new(&[0.0]);
    let refused = |text: &str, expected: &str| {
        fs::write(lab.files.path("batch.toml"), text).unwrap();
        let file = lab.files.path("batch.toml");
        let ended = program(&["campaign".as_ref(), "plan".as_ref(), file.as_os_str()]);
        assert!(ended.stderr.contains(expected), "{}", ended.stderr);
    };
    let bench = "[[benches]]\nname = \"b0\"\n";
    let head = format!("name = \"batch\"\nexperiment = \"{EXPERIMENT}\"\n");
    refused(
        &format!("{head}{bench}"),
        "cells: expected either `cells`, their number, or `table`",
    );
    refused(
        &format!("{head}cells = 3\nbenches_per_cell = 2\n{bench}"),
        "benches_per_cell: expected 1 to 1, the number of benches, found 2",
    );
    refused(
        &format!("{head}cells = 3\n{bench}[[benches]]\nname = \"south/b0\"\n"),
        "benches.name: expected names that differ, without their sites, found \"b0\" twice",
    );
    refused(
        &format!("{head}cells = 3\n[[benches]]\nname = \"../b0\"\n"),
        "benches.name: expected BENCH or SITE/BENCH",
    );
    refused(&format!("{head}table = \"none.csv\"\n{bench}"), "table: ");
    fs::write(lab.files.path("cells.csv"), "name,serial\nA,1\na,2\n").unwrap();
    refused(
        &format!("{head}table = \"cells.csv\"\n{bench}"),
        "cells: expected names that differ, found \"a\" twice",
    );
}

#[test]
#[ignore = "long drill: 215 runs, four minutes"]
fn a_hundred_cells_on_five_benches_tell_how_much_the_benches_differ() {
    // Taken from a table of normal numbers, times the standard deviation of the truth.
    let drawn = [0.464, 0.137, 2.455, -0.323, -0.068].map(|z| TRUTH * z);
    let report = Lab::new(&drawn).campaign(
        "cells = 100\nbenches_per_cell = 2\nreferences = [\"REF-1\"]\nreference_every = 20",
        5,
    );
    assert_eq!(report["values"], 215);
    for name in ["R", "DC resistance"] {
        let quantity = named(&report["quantities"], "name", name);
        let bench = named(&quantity["spread"], "name", "bench");
        eprintln!("{name}: {bench}");
        assert!(bench["low"].as_f64().unwrap() < TRUTH && TRUTH < bench["high"].as_f64().unwrap());
        let centre = drawn.iter().sum::<f64>() / 5.0;
        let found = offsets(quantity);
        let mean = found.iter().sum::<f64>() / 5.0;
        for (found, truth) in found.iter().zip(drawn) {
            let (found, truth) = (found - mean, truth - centre);
            eprintln!("{:+.3} % for {:+.3} %", 100.0 * found, 100.0 * truth);
            assert!((found - truth).abs() < 0.0008);
        }
    }
}
