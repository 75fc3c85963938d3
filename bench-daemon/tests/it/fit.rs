//! `eis-bench fit` on the thesis' own sweeps and on spectra in every form that it reads.

use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::support::program;

fn fits(arguments: &[&str]) -> Vec<Value> {
    let report = program(arguments).json();
    report["fits"].as_array().unwrap().clone()
}

fn thesis_sweeps() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../fixtures/data/spectra/p45b_thesis.csv")
}

fn number(value: &Value, key: &str) -> f64 {
    value[key]
        .as_f64()
        .unwrap_or_else(|| panic!("no number {key} in {value}"))
}

/// R, then (R, C) of each branch by rising time constant.
fn parameters(fit: &Value) -> Vec<f64> {
    let mut branches: Vec<(f64, f64)> = fit["branches"]
        .as_array()
        .unwrap()
        .iter()
        .map(|branch| (number(branch, "r_ohm"), number(branch, "c_f")))
        .collect();
    branches.sort_by(|a, b| (a.0 * a.1).total_cmp(&(b.0 * b.1)));
    std::iter::once(number(fit, "r_ohm"))
        .chain(branches.into_iter().flat_map(|(r, c)| [r, c]))
        .collect()
}

#[test]
fn the_pooled_sweeps_of_the_thesis_give_its_appendix_a() {
    let sweeps = thesis_sweeps();
    let found = fits(&[
        "fit",
        sweeps.to_str().unwrap(),
        "--pool",
        "--rc",
        "2,3,4",
        "--objective",
        "sum-abs",
        "--json",
    ]);
    assert_eq!(found.len(), 3);
    for (fit, (rc, objective, tolerance)) in found.iter().zip([
        (2, 0.072_555, 1.0e-3),
        (3, 0.046_394, 2.5e-3),
        (4, 0.033_027, 5.0e-3),
    ]) {
        assert_eq!(number(fit, "rc"), f64::from(rc));
        assert!(
            (number(fit, "objective") - objective).abs() < 1.0e-4,
            "{rc} RC: {}",
            number(fit, "objective")
        );
        let appendix = &fixtures::data::appendix_a()[usize::try_from(rc).unwrap() - 1];
        let mut branches: Vec<_> = appendix.branches.iter().collect();
        branches.sort_by(|a, b| (a.r_ohm * a.c_f).total_cmp(&(b.r_ohm * b.c_f)));
        let expected = std::iter::once(appendix.r_ohm).chain(
            branches
                .iter()
                .flat_map(|branch| [branch.r_ohm, branch.c_f]),
        );
        for (met, expected) in parameters(fit).into_iter().zip(expected) {
            assert!(
                (met / expected - 1.0).abs() < tolerance,
                "{rc} RC: {met}, appendix A {expected}"
            );
        }
        let dc: f64 = number(fit, "r_ohm")
            + fit["branches"]
                .as_array()
                .unwrap()
                .iter()
                .map(|branch| number(branch, "r_ohm"))
                .sum::<f64>();
        assert!((number(fit, "dc_resistance_ohm") / dc - 1.0).abs() < 1.0e-12);
    }
}

#[test]
fn one_rc_finds_the_global_optimum_below_the_one_of_the_thesis() {
    let sweeps = thesis_sweeps();
    let found = fits(&[
        "fit",
        sweeps.to_str().unwrap(),
        "--pool",
        "--rc",
        "1",
        "--objective",
        "sum-abs",
        "--json",
    ]);
    assert!(
        (number(&found[0], "objective") - 0.1932).abs() < 1.0e-4,
        "{}",
        found[0]
    );
}

/// Writes a small spectrum of 10 mΩ with 5 mΩ ∥ 2 F, in the three forms.
fn forms(folder: &Path) -> [PathBuf; 3] {
    let mut own = "freq_hz,z_re_ohm,z_im_ohm\n".to_owned();
    let mut plain = String::new();
    let mut thesis = "freq,offset,resistance,theta\n".to_owned();
    for k in 0..20 {
        let freq_hz = 0.1 * 3000.0_f64.powf(f64::from(k) / 20.0);
        let x = std::f64::consts::TAU * freq_hz * 0.005 * 2.0;
        let (re, im) = (0.010 + 0.005 / (1.0 + x * x), -0.005 * x / (1.0 + x * x));
        own += &format!("{freq_hz},{re},{im}\n");
        plain += &format!("{freq_hz},{re},{im}\n");
        thesis += &format!("{freq_hz},0,{},{}\n", re.hypot(im), im.atan2(re));
    }
    let files = ["own.csv", "plain.csv", "thesis.csv"].map(|name| folder.join(name));
    for (file, text) in files.iter().zip([own, plain, thesis]) {
        std::fs::write(file, text).unwrap();
    }
    files
}

#[test]
fn every_form_of_a_spectrum_gives_its_circuit_under_every_objective() {
    let folder = tempfile::tempdir().unwrap();
    let files = forms(folder.path());
    let names: Vec<&str> = files.iter().map(|file| file.to_str().unwrap()).collect();
    for objective in ["sum-abs", "modulus", "complex"] {
        let mut arguments = vec!["fit"];
        arguments.extend(&names);
        arguments.extend(["--rc", "1", "--objective", objective, "--json"]);
        let found = fits(&arguments);
        assert_eq!(found.len(), 3);
        for fit in &found {
            for (met, expected) in parameters(fit).into_iter().zip([0.010, 0.005, 2.0]) {
                assert!(
                    (met / expected - 1.0).abs() < 1.0e-4,
                    "{objective}: {met}, expected {expected}"
                );
            }
        }
    }
}

#[test]
fn an_impedance_of_another_size_is_fitted_too() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("ohms.csv");
    let mut text = String::new();
    for k in 0..30 {
        let freq_hz = 0.1 * 10.0_f64.powf(f64::from(k) / 6.0);
        let x = std::f64::consts::TAU * freq_hz * 50.0 * 100.0e-6;
        text += &format!(
            "{freq_hz},{},{}\n",
            10.0 + 50.0 / (1.0 + x * x),
            -50.0 * x / (1.0 + x * x)
        );
    }
    std::fs::write(&file, text).unwrap();
    let found = fits(&["fit", file.to_str().unwrap(), "--rc", "1", "--json"]);
    for (met, expected) in parameters(&found[0])
        .into_iter()
        .zip([10.0, 50.0, 100.0e-6])
    {
        assert!(
            (met / expected - 1.0).abs() < 1.0e-6,
            "{met}, expected {expected}"
        );
    }
}

#[test]
fn a_folder_of_models_plots_and_a_report_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let sweeps = thesis_sweeps();
    let output = program(&[
        "fit",
        sweeps.to_str().unwrap(),
        "--pool",
        "--rc",
        "2",
        "--objective",
        "sum-abs",
        "--out",
        out.to_str().unwrap(),
    ]);
    output.expect_code(0);
    let model: Value =
        serde_json::from_slice(&std::fs::read(out.join("model_2rc.json")).unwrap()).unwrap();
    assert_eq!(number(&model, "rc"), 2.0);
    let cell = number(&model["fit"]["erm"], "r_ohm");
    assert!((number(&model["pack"]["erm"], "r_ohm") / cell - 16.0 / 3.0).abs() < 1.0e-12);
    for name in [
        "nyquist-sweeps",
        "nyquist-controls",
        "nyquist-fit-2rc",
        "bode",
    ] {
        let svg = std::fs::read_to_string(out.join(format!("{name}.svg"))).unwrap();
        assert!(svg.starts_with("<svg") && svg.contains("</svg>"), "{name}");
        let png = std::fs::read(out.join(format!("{name}.png"))).unwrap();
        assert!(png.starts_with(b"\x89PNG") && png.len() > 10_000, "{name}");
    }
    let html = std::fs::read_to_string(out.join("report.html")).unwrap();
    assert!(html.contains("<svg") && html.contains("0.072555"));
    for loading in ["<script", "src=", "@import", "url(http", "<link"] {
        assert!(
            !html.contains(loading),
            "the report must open by itself: {loading}"
        );
    }
}

#[test]
fn many_spectra_are_one_table_with_uncertainties_and_a_recommendation() {
    let folder = tempfile::tempdir().unwrap();
    let all = std::fs::read_to_string(thesis_sweeps()).unwrap();
    let is_kept = |line: &str| {
        let cells: Vec<&str> = line.split(',').collect();
        cells[0] == "fixture" || (cells[0] == "cell" && cells[2] == "0" && cells[3] == "0")
    };
    let lines: Vec<&str> = all.lines().filter(|line| is_kept(line)).collect();
    let file = folder.path().join("five.csv");
    std::fs::write(&file, lines.join("\n")).unwrap();
    let output = program(&["fit", file.to_str().unwrap()]);
    let text = output.stdout;
    assert!(output.code == Some(0), "{text}");
    let table: Vec<&str> = text.lines().take(7).collect();
    assert!(
        table[0].starts_with("5 groups of spectra, objective complex"),
        "{text}"
    );
    assert!(
        table[1].contains("R / mΩ") && table[1].contains("DC resistance / mΩ"),
        "{text}"
    );
    assert!(table[2..].iter().all(|row| row.contains(" ± ")), "{text}");
    assert_eq!(text.matches("recommended for all: ").count(), 1, "{text}");
    assert!(!text.contains("given"), "{text}");
    assert!(text.lines().count() < 25, "{text}");
    // One of them is printed in full, with the choice and what was not given.
    let is_first = |line: &&str| !line.starts_with("cell,") || line.starts_with("cell,0,");
    let one: Vec<&str> = lines.into_iter().filter(is_first).collect();
    std::fs::write(&file, one.join("\n")).unwrap();
    let output = program(&["fit", file.to_str().unwrap()]);
    let text = output.stdout;
    assert!(
        text.contains("no slope was given: prior ") && !text.contains("(given "),
        "{text}"
    );
    assert!(text.contains("recommended: "), "{text}");
    let fit = text
        .lines()
        .find(|line| line.contains(" RC: objective "))
        .unwrap();
    assert_eq!(fit.matches(" ± ").count(), 2, "{fit}");
}

#[test]
fn bad_input_is_refused_with_exit_code_2_and_a_reason() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("broken.csv");
    std::fs::write(
        &file,
        "freq_hz,z_re_ohm,z_im_ohm\n0.1,0.01,-0.001\n0.2,x,-0.001\n",
    )
    .unwrap();
    let broken = file.to_str().unwrap();
    let sweeps = thesis_sweeps();
    let good = sweeps.to_str().unwrap();
    for (arguments, reason) in [
        (vec!["fit", broken], "broken.csv"),
        (vec!["fit", "/nonexistent.csv"], "/nonexistent.csv"),
        (
            vec!["fit", good, "--rc", "0"],
            "--rc: expected `all` or different numbers from 1 to 8",
        ),
        (vec!["fit", good, "--objective", "best"], "--objective: "),
    ] {
        let message = program(&arguments).refused();
        assert!(message.contains(reason), "{message}");
    }
    let message = program(&["fit", broken]).stderr;
    assert!(
        message.contains("line 3") || message.contains(":3"),
        "{message}"
    );
}

#[test]
fn sweeps_of_the_thesis_under_current_change_less_than_its_cells_differ() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().to_str().unwrap();
    let sweeps = thesis_sweeps();
    let text = program(&[
        "fit",
        sweeps.to_str().unwrap(),
        "--under-current",
        "--same-cell",
        "--out",
        out,
    ])
    .ok();
    let page = std::fs::read_to_string(folder.path().join("report.html")).unwrap();
    let json = std::fs::read(folder.path().join("under_current.json")).unwrap();
    let found: Value = serde_json::from_slice(&json).unwrap();
    assert!(page.contains("Change of each resistance") && page.contains("Kramers–Kronig of"));
    let changes = found["changes"].as_array().unwrap();
    let currents: Vec<f64> = changes
        .iter()
        .map(|change| number(change, "bias_a"))
        .collect();
    assert_eq!(currents, [-2.0, 2.0, 5.0]);
    // Between cells nothing is certain, because the cell of the three is not known.
    assert_eq!(
        text.matches("no change that is certain").count(),
        4,
        "{text}"
    );
    // The record under +5 A drifts: its lowest points are no impedance.
    let left_out = |change: &Value| {
        let points = change["flagged"].as_array().cloned().unwrap_or_default();
        points
            .iter()
            .map(|point| number(point, "freq_hz"))
            .collect::<Vec<_>>()
    };
    assert_eq!(left_out(&changes[0]), [0.0; 0]);
    assert_eq!(left_out(&changes[1]), [0.1]);
    assert_eq!(left_out(&changes[2]).len(), 3);
    // Taken as one cell, series resistance and arc fall with the sign of the current.
    let plus_minus = &found["pairs"][0]["branches"];
    for (index, share, sigma) in [(0, -0.023, 0.0035), (1, -0.057, 0.014)] {
        let branch = &plus_minus[index];
        assert!((number(branch, "share") - share).abs() < 0.002, "{branch}");
        assert!((number(branch, "sigma") - sigma).abs() < 0.002, "{branch}");
        assert!(number(branch, "p_adjusted") < 0.05, "{branch}");
    }
    let plus_plus = &found["pairs"][2]["branches"];
    assert!(number(&plus_plus[0], "p_adjusted") > 0.3, "{plus_plus}");
}

#[test]
fn a_comparison_under_current_refuses_what_it_does_not_do() {
    let sweeps = thesis_sweeps();
    for (more, expected) in [
        (
            &["--pool"][..],
            "--pool: expected no --under-current beside it",
        ),
        (
            &["--rc", "1,2"],
            "--rc: expected `auto` or one number from 1 to 8",
        ),
    ] {
        let words = [&["fit", sweeps.to_str().unwrap(), "--under-current"], more].concat();
        let output = program(&words);
        let error = output.stderr;
        assert!(
            output.code != Some(0) && error.contains(expected),
            "{error}"
        );
    }
}

/// A log of six cells under steps of a load, the fourth with 8 % more resistance.
fn string_log() -> String {
    let cells = 6;
    let names: Vec<String> = (1..=cells).map(|cell| format!("c{cell}_v")).collect();
    let mut text = format!("time_s,current_a,{}\n", names.join(","));
    let (mut slow, mut level_a) = (0.0, 0.0);
    for row in 0..8000_u32 {
        // A stride that is not periodic replaces chance.
        let chance = |k: u32| (f64::from(k) * 0.618_034).fract();
        if row % 37 == 0 {
            level_a = 30.0 * chance(row / 37 * 7);
        }
        slow += 0.02 * (0.003 * level_a - slow);
        text += &format!(
            "{:.4},{level_a:.3}",
            0.01 * f64::from(row) + 0.001 * chance(row)
        );
        for cell in 0..cells {
            let factor = if cell == 3 {
                1.08
            } else {
                1.0 + 0.002 * f64::from(cell % 3)
            };
            let noise_v = 0.001 * (chance(row * 13 + cell) - 0.5);
            let volts = 3.7 - factor * (0.008 * level_a + slow) - 1e-6 * f64::from(row) + noise_v;
            text += &format!(",{volts:.3}");
        }
        text.push('\n');
    }
    text
}

#[test]
fn a_log_of_a_string_gives_impedances_and_names_the_weak_cell() {
    let folder = tempfile::tempdir().unwrap();
    let (log, out) = (folder.path().join("robot.csv"), folder.path().join("out"));
    std::fs::write(&log, string_log()).unwrap();
    let (log, folder) = (log.to_str().unwrap(), out.to_str().unwrap());
    let text = program(&["fit", log, "--usage", "--out", folder]).ok();
    assert!(
        text.contains("c4 is weak: it answers the current"),
        "{text}"
    );
    assert_eq!(text.matches("is weak").count(), 1, "{text}");
    let found: Value =
        serde_json::from_slice(&std::fs::read(out.join("usage.json")).unwrap()).unwrap();
    let excess = number(&found["string"][3], "excess");
    assert!((0.05..0.08).contains(&excess), "{excess}");
    // 8 mΩ, and 3 mΩ that follow in half a second.
    let dc_ohm = number(&found["cells"][0]["model"]["erm"], "r_ohm");
    assert!((0.007..0.010).contains(&dc_ohm), "{dc_ohm}");
    assert!(out.join("report.html").exists() && out.join("c1.csv").exists());
    // A row without a number is named.
    let broken = string_log().replacen("\n0.01", "\nno", 1);
    std::fs::write(log, broken).unwrap();
    let error = program(&["fit", log, "--usage"]).stderr;
    assert!(
        error.contains("column time_s: expected a number, found \"no"),
        "{error}"
    );
}
