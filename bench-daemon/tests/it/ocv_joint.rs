//! `eis-bench ocv` and `joint` on files made here: a cell of one resistance and one branch, by its
//! own formulas.

use std::path::Path;

use serde_json::Value;

use crate::support::program;

const R: f64 = 0.010;
const BRANCH: (f64, f64) = (0.005, 8.0);

/// Returns a cell of 1 Ah whose OCV is 3 V + SOC · 1 V.
fn series(folder: &Path, name: &str, pulses: bool) -> String {
    let mut text = "Test Time / s,Current / A,Voltage / V\n".to_owned();
    let (mut v, mut drawn) = (BRANCH.0, 0.0);
    let mut noise = 0u64;
    for k in 0..18_000u32 {
        let t = 0.2 * f64::from(k);
        let i = if pulses && (400.0..410.0).contains(&(t % 600.0)) {
            2.0
        } else {
            1.0
        };
        noise = noise
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        let jitter = 1e-4 * ((noise >> 40) as f64 / 16_777_216.0 - 0.5);
        text.push_str(&format!(
            "{t:.1},{},{:.6}\n",
            -i,
            4.0 - drawn / 3600.0 - i * R - v + jitter
        ));
        // The current holds until the next sample: an exact step.
        v = BRANCH.0 * i + (v - BRANCH.0 * i) * (-0.2f64 / BRANCH.1).exp();
        drawn += 0.2 * i;
        if drawn > 3590.0 {
            break;
        }
    }
    let path = folder.join(name);
    std::fs::write(&path, text).unwrap();
    path.to_str().unwrap().to_owned()
}

fn spectrum(folder: &Path, repeat: u32) -> String {
    let mut text = "freq_hz,z_re_ohm,z_im_ohm\n".to_owned();
    for k in 0..16 {
        let freq_hz = 0.05 * 2f64.powi(k);
        let wt = std::f64::consts::TAU * freq_hz * BRANCH.1;
        let shift =
            1.0 + 0.001 * f64::from((repeat * 7 + u32::try_from(k).unwrap() * 5) % 11) / 11.0;
        let (re, im) = (
            R + BRANCH.0 / (1.0 + wt * wt),
            -BRANCH.0 * wt / (1.0 + wt * wt),
        );
        text.push_str(&format!("{freq_hz},{},{}\n", re * shift, im * shift));
    }
    let path = folder.join(format!("cell0_{repeat}.csv"));
    std::fs::write(&path, text).unwrap();
    path.to_str().unwrap().to_owned()
}

#[test]
fn a_slow_discharge_gives_curve_table_and_picture() {
    let folder = tempfile::tempdir().unwrap();
    let discharge = series(folder.path(), "slow.bdf.csv", false);
    let out = folder.path().join("out");
    let found = program(&[
        "ocv",
        &discharge,
        "--poly",
        "3",
        "--low-v",
        "2.9",
        "--high-v",
        "4.0",
        "--json",
        "--out",
        out.to_str().unwrap(),
    ])
    .json();
    assert!(
        (found["capacity_ah"].as_f64().unwrap() - 3590.0 / 3600.0).abs() < 1e-3,
        "{}",
        found["capacity_ah"]
    );
    for file in ["ocv.csv", "ocv.json", "ocv.svg", "ocv.png"] {
        assert!(out.join(file).is_file(), "{file}");
    }
    let table = std::fs::read_to_string(out.join("ocv.csv")).unwrap();
    let middle: Vec<f64> = table
        .lines()
        .nth(101)
        .unwrap()
        .split(',')
        .map(|f| f.parse().unwrap())
        .collect();
    assert!(
        middle[0] == 0.5 && (middle[1] - 3.5014).abs() < 1e-3 && (middle[2] - 0.997).abs() < 0.02,
        "{middle:?}"
    );
}

#[test]
fn spectra_and_pulses_give_one_model_file() {
    let folder = tempfile::tempdir().unwrap();
    let (slow, pulsed) = (
        series(folder.path(), "slow.bdf.csv", false),
        series(folder.path(), "pulsed.bdf.csv", true),
    );
    let spectra: Vec<String> = (0..4)
        .map(|repeat| spectrum(folder.path(), repeat))
        .collect();
    let out = folder.path().join("out");
    let mut arguments = vec![
        "joint",
        "--series",
        &pulsed,
        "--ocv-from",
        &slow,
        "--rc",
        "1",
        "--at-v",
        "3.5",
        "--within-v",
        "0.45",
    ];
    arguments.extend(["--out", out.to_str().unwrap(), "--spectra"]);
    arguments.extend(spectra.iter().map(String::as_str));
    let output = program(&arguments);
    output.expect_code(0);
    let text = output.stdout;
    assert!(
        text.contains("held out") && text.contains("joint model, 1 RC"),
        "{text}"
    );
    let model: Value =
        serde_json::from_str(&std::fs::read_to_string(out.join("model.json")).unwrap()).unwrap();
    let erm = &model["fit"]["erm"];
    assert!(
        (erm["r_ohm"].as_f64().unwrap() / R - 1.0).abs() < 0.01,
        "{erm}"
    );
    assert!(
        (erm["branches"][0]["r_ohm"].as_f64().unwrap() / BRANCH.0 - 1.0).abs() < 0.02,
        "{erm}"
    );
    assert!(
        model["ocv"]["capacity_ah"].is_f64()
            && model["joint"]["series"] == "pulsed.bdf.csv"
            && model["joint"]["held_out"].is_array()
    );
    for file in ["pulses.svg", "gaps.png", "orders.svg"] {
        assert!(out.join(file).is_file(), "{file}");
    }
}

#[test]
fn what_cannot_be_used_is_said_and_ends_with_2() {
    let folder = tempfile::tempdir().unwrap();
    let slow = series(folder.path(), "slow.bdf.csv", false);
    let sweep = spectrum(folder.path(), 0);
    for (arguments, text) in [
        (
            vec![
                "joint",
                "--spectra",
                &sweep,
                "--series",
                &slow,
                "--ocv-from",
                &slow,
            ],
            "slow.bdf.csv: expected a pulse of 1 to 60 s at 3.520 to 3.920 V OCV",
        ),
        (
            vec![
                "joint",
                "--spectra",
                &sweep,
                "--series",
                &slow,
                "--ocv-from",
                &slow,
                "--rc",
                "0",
            ],
            "--rc: expected `auto` or a number from 1 to 8, found \"0\"",
        ),
        (
            vec!["ocv", &sweep],
            "expected columns of a time, a voltage and a current",
        ),
        (
            vec!["ocv", &slow, "--positive", "discharge"],
            "slow.bdf.csv: expected a discharge of at least 100 samples, met 0",
        ),
    ] {
        let message = program(&arguments).refused();
        assert!(message.contains(text), "{message}");
    }
}
