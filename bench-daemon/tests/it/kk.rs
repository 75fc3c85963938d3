//! `eis-bench kk`.

use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::support::{Ended, program};

/// The thesis' sweeps: five cells with five repeats, three at a bias, the shunt and the fake cell.
const TABLE: &str = concat!(
    env!("CARGO_MANIFEST_DIR"),
    "/../fixtures/data/spectra/p45b_thesis.csv"
);

fn kk(file: &Path, arguments: &[&str]) -> Ended {
    program(&[&["kk", file.to_str().unwrap()], arguments].concat())
}

fn judged(file: &Path, arguments: &[&str]) -> Value {
    kk(file, &[&["--json"], arguments].concat()).json()
}

fn refusal(file: &Path, arguments: &[&str]) -> String {
    let output = kk(file, arguments);
    output.expect_code(2);
    assert!(output.stdout.is_empty(), "{output:?}");
    output.stderr
}

/// Writes one sweep of the table, with its phase times a factor, to a separate file.
fn sweep(folder: &Path, start: &str, phase: f64) -> PathBuf {
    let table = std::fs::read_to_string(TABLE).unwrap();
    let mut text = String::new();
    for line in table.lines().filter(|line| line.starts_with(start)) {
        let fields: Vec<&str> = line.split(',').collect();
        let (magnitude, turn): (f64, f64) = (
            fields[5].parse().unwrap(),
            phase * fields[6].parse::<f64>().unwrap(),
        );
        text += &format!(
            "{},{},{}\n",
            fields[4],
            magnitude * turn.cos(),
            magnitude * turn.sin()
        );
    }
    assert_eq!(text.lines().count(), 20, "{start}");
    let file = folder.join("sweep.csv");
    std::fs::write(&file, text).unwrap();
    file
}

fn spectra(groups: &Value) -> Vec<&Value> {
    groups
        .as_array()
        .unwrap()
        .iter()
        .flat_map(|group| group["spectra"].as_array().unwrap())
        .collect()
}

#[test]
fn the_thesis_sweeps_are_reported_cell_by_cell() {
    let groups = judged(Path::new(TABLE), &[]);
    let cells: Vec<&str> = groups
        .as_array()
        .unwrap()
        .iter()
        .map(|group| group["cell"].as_str().unwrap())
        .collect();
    let expected = [
        "cell 0",
        "cell 1",
        "cell 2",
        "cell 3",
        "cell 4",
        "cell, -2 A",
        "cell, +2 A",
        "cell, +5 A",
        "shunt",
        "fake_cell",
    ];
    assert_eq!(cells, expected);
    let spectra = spectra(&groups);
    assert_eq!(spectra.len(), 30);
    for spectrum in &spectra {
        let (verdict, kk) = (&spectrum["verdict"], &spectrum["kramers_kronig"]);
        // There may be remarks, but none of the sweeps at rest is wrong, and each is usable over
        // the whole band. The one at +5 A charged the cell throughout, so the cell cannot have
        // stayed unchanged.
        let charged = spectrum["name"].as_str().unwrap().contains("+5A");
        assert!(
            charged || ["good", "doubtful"].contains(&verdict["grade"].as_str().unwrap()),
            "{spectrum}"
        );
        let band: Vec<f64> = verdict["valid_band_hz"]
            .as_array()
            .unwrap()
            .iter()
            .map(|f| f.as_f64().unwrap())
            .collect();
        let slow_end = (band[0] - 0.1).abs() < 1.0e-9 || (charged && band[0] < 0.3);
        assert!(slow_end && (band[1] / 201.0 - 1.0).abs() < 0.01, "{band:?}");
        for points in [
            &verdict["points"],
            &kk["points"],
            &spectrum["z_hit"]["points"],
        ] {
            assert_eq!(points.as_array().unwrap().len(), 20);
        }
        assert!(
            kk["order"].as_u64().unwrap() >= 3 && kk["mu"].as_f64().unwrap() <= 1.0,
            "{kk}"
        );
        assert!(
            (0.01..1.0).contains(&kk["noise_percent"].as_f64().unwrap()),
            "{kk}"
        );
    }
    let good = spectra
        .iter()
        .filter(|spectrum| spectrum["verdict"]["grade"] == "good")
        .count();
    assert!(good >= 20, "{good} of 30");
    for group in &groups.as_array().unwrap()[..5] {
        assert_eq!(
            group["stationarity"]["repeats"].as_array().unwrap().len(),
            5
        );
        assert!(group["linearity"].is_null(), "one amplitude");
    }
}

#[test]
fn a_sign_that_is_swapped_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let right = judged(&sweep(folder.path(), "cell,1,1,0,", 1.0), &[]);
    assert_eq!(spectra(&right)[0]["verdict"]["grade"], "good");
    let file = sweep(folder.path(), "cell,1,1,0,", -1.0);
    let swapped = judged(&file, &[]);
    let spectrum = spectra(&swapped)[0];
    assert_eq!(spectrum["kramers_kronig"]["outcome"], "sign-swapped");
    assert_eq!(
        (
            spectrum["verdict"]["grade"].as_str(),
            spectrum["verdict"]["valid_band_hz"].is_null()
        ),
        (Some("bad"), true)
    );
    let text = kk(&file, &[]).stdout;
    assert!(
        text.contains("sweep: bad: not valid: the imaginary part has the wrong sign"),
        "{text}"
    );
}

#[test]
fn a_record_speaks_for_its_point() {
    let folder = tempfile::tempdir().unwrap();
    let file = sweep(folder.path(), "cell,1,1,0,", 1.0);
    let records = folder.path().join("records.csv");
    std::fs::write(&records, "freq_hz,h3,sigma_h3\n0.1,0.005,0.0001\n").unwrap();
    let judged = judged(&file, &["--records", records.to_str().unwrap()]);
    let point = &spectra(&judged)[0]["verdict"]["points"][0];
    assert_eq!(point["grade"], "bad");
    // Three times the third harmonic.
    assert_eq!(
        point["reasons"][0],
        "harmonic 3 of 0.50 %: not linear, Z may be off by 1.5 %"
    );
}

#[test]
fn pictures_are_drawn() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let output = kk(
        &sweep(folder.path(), "cell,1,1,0,", 1.0),
        &["--drt", "--out", out.to_str().unwrap()],
    );
    output.expect_code(0);
    for name in [
        "kk.json",
        "kk_sweep.svg",
        "kk_sweep.png",
        "zhit_sweep.svg",
        "zhit_sweep.png",
        "drt_sweep.svg",
        "drt_sweep.png",
    ] {
        assert!(out.join(name).metadata().unwrap().len() > 100, "{name}");
    }
}

#[test]
fn what_cannot_be_judged_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let missing = folder.path().join("missing.csv");
    let message = refusal(&missing, &[]);
    assert!(
        message.contains("missing.csv") && message.contains("No such file"),
        "{message}"
    );
    let file = sweep(folder.path(), "cell,1,1,0,", 1.0);
    let records = folder.path().join("records.csv");
    let table = |text: &str| {
        std::fs::write(&records, text).unwrap();
        refusal(&file, &["--records", records.to_str().unwrap()])
    };
    assert!(
        table("f,h3\n").contains("records.csv: expected a header with freq_hz, found \"f,h3\"")
    );
    assert!(
        table("freq_hz,h3\n0.1,0.005\n")
            .contains("records.csv, column h3: expected a column sigma_h3 with it")
    );
    assert!(
        table("freq_hz,thd\n0.1,0.005\n")
            .contains("records.csv, column thd: expected freq_hz, periods")
    );
    let message = table("freq_hz,h3,sigma_h3\n0.1,0.005,0.0001\n0.11,0.005,0.0001\n");
    assert!(
        message.contains(
            "records.csv, line 3, freq_hz: expected a frequency of the spectra to \
    0.1 %, found 0.11 Hz"
        ),
        "{message}"
    );
    assert!(
        table("freq_hz,h3,sigma_h3\n1,a,1\n")
            .contains("records.csv, line 2, h3: expected a number, found \"a\"")
    );
}
