//! `eis-bench fit --circuit`.

use std::path::{Path, PathBuf};

use crate::support::{Ended, program};

fn fit(file: &Path, arguments: &[&str]) -> Ended {
    program(&[&["fit", file.to_str().unwrap()], arguments].concat())
}

fn refusal(file: &Path, arguments: &[&str]) -> String {
    fit(file, arguments).refused()
}

/// 10 mΩ + (5 mΩ ∥ CPE of 3 Ω⁻¹s^0.8), by real arithmetic.
fn spectrum(folder: &Path) -> PathBuf {
    let mut text = String::new();
    for k in 0..30 {
        let freq_hz = 0.01 * 1.0e6_f64.powf(f64::from(k) / 29.0);
        let admittance = 3.0 * (std::f64::consts::TAU * freq_hz).powf(0.8);
        let (g, b) = (
            200.0 + admittance * (0.4 * std::f64::consts::PI).cos(),
            admittance * (0.4 * std::f64::consts::PI).sin(),
        );
        text += &format!(
            "{freq_hz},{},{}\n",
            0.010 + g / (g * g + b * b),
            -b / (g * g + b * b)
        );
    }
    let file = folder.join("cell.csv");
    std::fs::write(&file, text).unwrap();
    file
}

#[test]
fn a_circuit_is_fitted_printed_and_drawn() {
    let folder = tempfile::tempdir().unwrap();
    let file = spectrum(folder.path());
    let circuit = "R0 - p(R1, CPE1)";
    let report = fit(&file, &["--circuit", circuit, "--json"]).json();
    let met = &report["fits"][0];
    assert_eq!(met["circuit"], "R0-p(R1,CPE1)");
    assert_eq!(
        met["names"],
        serde_json::json!(["R0", "R1", "CPE1_0", "CPE1_1"])
    );
    assert_eq!(met["units"], serde_json::json!(["Ω", "Ω", "Ω^-1 s^α", ""]));
    for (value, expected) in met["values"]
        .as_array()
        .unwrap()
        .iter()
        .zip([0.010, 0.005, 3.0, 0.8])
    {
        assert!(
            (value.as_f64().unwrap() / expected - 1.0).abs() < 1.0e-6,
            "{value}, expected {expected}"
        );
    }
    assert_eq!(
        (met["weight"].as_str(), met["objective_kind"].as_str()),
        (Some("modulus"), Some("complex"))
    );
    for list in ["sigmas", "covariance", "states", "bounds"] {
        assert_eq!(met[list].as_array().unwrap().len(), 4, "{list}");
    }
    let out = folder.path().join("out");
    let output = fit(
        &file,
        &[
            "--circuit",
            circuit,
            "--constants",
            "CPE1_1=0.8",
            "--out",
            out.to_str().unwrap(),
        ],
    );
    let text = output.stdout;
    for expected in [
        "R0-p(R1,CPE1)",
        "10.000 ±",
        "mΩ",
        "Ω^-1 s^α",
        "0.80000",
        "held",
    ] {
        assert!(text.contains(expected), "{text}");
    }
    for name in [
        "circuit.json",
        "nyquist.svg",
        "nyquist.png",
        "bode.svg",
        "bode.png",
        "report.html",
    ] {
        assert!(out.join(name).metadata().unwrap().len() > 100, "{name}");
    }
    assert!(
        std::fs::read_to_string(out.join("report.html"))
            .unwrap()
            .contains("CPE1_1")
    );
}

/// 10 mΩ + (5 mΩ ∥ 100 F) with −j·(dU/dQ)/ω of 200 µV/C: a circuit without a capacitor in series
/// fits it only without that share.
#[test]
fn a_known_slope_of_the_open_circuit_voltage_is_taken_out_before_a_circuit_is_fitted() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("cell.csv");
    let line = |k: u32| {
        let freq_hz = 0.01 * 1.0e4_f64.powf(f64::from(k) / 29.0);
        let omega = std::f64::consts::TAU * freq_hz;
        let (x, d) = (omega * 0.5, 0.005 / (1.0 + (omega * 0.5).powi(2)));
        format!("{freq_hz},{},{}\n", 0.010 + d, -d * x - 200.0e-6 / omega)
    };
    std::fs::write(&file, (0..30).map(line).collect::<String>()).unwrap();
    let values = |arguments: &[&str]| {
        let report = fit(
            &file,
            &[&["--circuit", "R0-p(R1,C1)", "--json"], arguments].concat(),
        )
        .json();
        let met = report["fits"][0].clone();
        let values: Vec<f64> = met["values"]
            .as_array()
            .unwrap()
            .iter()
            .map(|v| v.as_f64().unwrap())
            .collect();
        (values, met["warnings"].to_string())
    };
    let off = |values: &[f64]| {
        values
            .iter()
            .zip([0.010, 0.005, 100.0])
            .map(|(v, e)| (v / e - 1.0).abs())
            .fold(0.0, f64::max)
    };
    let (taken_out, warnings) = values(&["--ocv-slope", "2e-4"]);
    assert!(off(&taken_out) < 1e-6, "{taken_out:?}");
    assert!(warnings.contains("dU/dQ 200 ± 6.00 µV/C"), "{warnings}");
    let (left, warnings) = values(&[]);
    assert!(
        off(&left) > 0.02 && !warnings.contains("dU/dQ"),
        "{left:?} {warnings}"
    );
    assert!(
        refusal(&file, &["--circuit", "R0-p(R1,C1)", "--ocv-slope", "fit"])
            .contains("a capacitor in series is a slope that is fitted")
    );
}

#[test]
fn what_is_not_a_circuit_is_refused_with_the_place() {
    let folder = tempfile::tempdir().unwrap();
    let file = spectrum(folder.path());
    let refused = |arguments: &[&str]| refusal(&file, arguments);
    assert!(
        refused(&["--circuit", "R0-p(R1,Q1)"])
            .contains("met \"Q\" (did you mean CPE?)\n  R0-p(R1,Q1)\n          ^")
    );
    assert!(
        refused(&["--circuit", "R0", "--guess", "R1=1"])
            .contains("--guess, character 1: expected one of the parameters R0, met \"R1\"")
    );
    assert!(
        refused(&["--circuit", "R0", "--weight", "x"])
            .contains("--weight: expected unit, modulus or covariance, met \"x\"")
    );
    assert!(
        refused(&["--circuit", "R0", "--search", "x"])
            .contains("expected starts or evolution, met \"x\"")
    );
    assert!(
        refused(&["--circuit", "R0", "--weight", "covariance"])
            .contains("cell: weight covariance: expected a covariance at every point")
    );
    assert!(
        refused(&["--circuit", "R0", "--guess", "R0=1", "--constants", "R0=1"])
            .contains("met R0 in both")
    );
    assert!(refused(&["--circuit", "R0", "--rc", "2"]).contains("cannot be used with"));
    assert!(refused(&["--weight", "unit"]).contains("--circuit"));
}
