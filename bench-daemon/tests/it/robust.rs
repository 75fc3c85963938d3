//! Strange data that once ended a run or were passed over in silence: a quiet scope, a long
//! spectrum, spectra with a wrong point, sign or σ.

use std::{
    path::{Path, PathBuf},
    process::Command,
};

use bench_daemon::command::run::run_experiment;
use num_complex::Complex64;

use crate::support::{Ended, Files, SCENARIO, program, truth};

/// Standard uncertainty of the made spectra, Ω.
const SIGMA_OHM: f64 = 1e-5;

/// Returns a number of spread 1 and mean 0, from a counter.
fn noise(seed: u64) -> f64 {
    let mix = |seed: u64| {
        let mut x = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15);
        x = (x ^ (x >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        x = (x ^ (x >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((x ^ (x >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    };
    // The sum of twelve even draws is normal enough here.
    (0..12).map(|k| mix(12 * seed + k)).sum::<f64>() - 6.0
}

/// Impedance of a cell with three RC branches and an inductance, Ω.
fn cell(freq_hz: f64, inductance_h: f64) -> Complex64 {
    let jw = Complex64::new(0.0, std::f64::consts::TAU * freq_hz);
    let branches = [(2e-3, 2.0), (3e-3, 30.0), (2.5e-3, 400.0)];
    6.4e-3
        + inductance_h * jw
        + branches
            .iter()
            .map(|(r, c)| *r / (1.0 + jw * r * c))
            .sum::<Complex64>()
}

/// Returns points of the cell over a band, with noise.
fn points(band_hz: (f64, f64), count: usize, inductance_h: f64) -> Vec<(f64, Complex64)> {
    let at = |k: usize| {
        let freq_hz = band_hz.0 * (band_hz.1 / band_hz.0).powf(k as f64 / (count - 1) as f64);
        let error = Complex64::new(noise(2 * k as u64), noise(2 * k as u64 + 1)) * SIGMA_OHM;
        (freq_hz, cell(freq_hz, inductance_h) + error)
    };
    (0..count).map(at).collect()
}

/// Writes a spectrum, with one σ for all parts of all points if given.
fn write(folder: &Path, points: &[(f64, Complex64)], sigma_ohm: Option<f64>) -> PathBuf {
    let mut text = format!(
        "freq_hz,z_re_ohm,z_im_ohm{}\n",
        if sigma_ohm.is_some() {
            ",sigma_re_ohm,sigma_im_ohm"
        } else {
            ""
        }
    );
    for (freq_hz, z) in points {
        let sigma = sigma_ohm.map_or_else(String::new, |sigma| format!(",{sigma},{sigma}"));
        text += &format!("{freq_hz},{},{}{sigma}\n", z.re, z.im);
    }
    let file = folder.join("spectrum.csv");
    std::fs::write(&file, text).unwrap();
    file
}

#[test]
#[ignore = "long drill"]
fn the_demo_runs_behind_a_scope_of_10_and_of_1_microvolt_noise() {
    for noise_v in ["10.0e-6", "1.0e-6"] {
        let files = Files::demo()
            .edit("experiments/demo.toml", "rc = [1, 2, 3, 4]", "rc = [4]")
            .append(
                SCENARIO,
                &format!("[harness]\nnoise_floor_v = {noise_v}\nnoise_fraction = 0.0"),
            );
        let finished = run_experiment(&files.load(), &files.path("run")).unwrap();
        let spectrum =
            analysis::dataset::read_spectrum_csv(&files.path("run/spectrum.csv")).unwrap();
        let truth = truth(finished.simulation.unwrap().world(), &spectrum);
        for (point, truth) in spectrum.iter().zip(&truth) {
            // The demo's own uncertainty: gains and skews known from its controls.
            let off = (point.z_ohm - truth).norm() / truth.norm();
            assert!(off < 0.005, "{noise_v} V, {} Hz: {off}", point.freq_hz);
        }
    }
}

#[test]
fn a_spectrum_of_100_000_points_is_judged_within_memory_and_says_by_how_many() {
    let folder = tempfile::tempdir().unwrap();
    let file = write(folder.path(), &points((0.01, 1e4), 100_000, 0.0), None);
    // 80 GB were asked for; 4 GB of addresses are enough for the program's threads and the file.
    let command = format!(
        "ulimit -v 4000000; exec '{}' kk '{}' --drt",
        env!("CARGO_BIN_EXE_eis-bench"),
        file.display()
    );
    let output = Ended::of(Command::new("sh").args(["-c", &command]).output().unwrap());
    output.expect_code(0);
    let text = output.stdout;
    assert!(
        text.contains("spectrum: good: valid from 0.01 Hz to 10000 Hz"),
        "{text}"
    );
    assert!(
        text.contains("judged by 500 of its 100000 points, evenly spaced over ln f"),
        "{text}"
    );
}

#[test]
fn one_wrong_sign_is_not_noise_and_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let mut wrong = points((0.05, 1000.0), 20, 0.0);
    wrong[9].1.re = -wrong[9].1.re;
    for sigma_ohm in [Some(SIGMA_OHM), None] {
        let file = write(folder.path(), &wrong, sigma_ohm);
        let text = program(&[
            "fit",
            file.to_str().unwrap(),
            "--rc",
            "auto",
            "--objective",
            "complex",
        ])
        .ok();
        assert!(!text.contains("residuals look like noise"), "{text}");
        assert!(text.contains("the point at 5.45 Hz lies"), "{text}");
        assert!(text.contains("σ off the fit to the others"), "{text}");
    }
    // A correct model is reported as such, and nothing is named.
    let file = write(
        folder.path(),
        &points((0.05, 1000.0), 20, 0.0),
        Some(SIGMA_OHM),
    );
    let text = program(&[
        "fit",
        file.to_str().unwrap(),
        "--rc",
        "auto",
        "--objective",
        "complex",
    ])
    .ok();
    assert!(
        text.contains("residuals look like noise") && !text.contains("off the fit to the others"),
        "{text}"
    );
}

#[test]
fn a_sigma_of_zero_is_said_to_be_zero() {
    let folder = tempfile::tempdir().unwrap();
    let file = write(folder.path(), &points((0.05, 1000.0), 20, 0.0), Some(0.0));
    let text = program(&[
        "fit",
        file.to_str().unwrap(),
        "--rc",
        "3",
        "--objective",
        "complex",
    ])
    .ok();
    assert!(
        text.contains(
            "σ is zero at all 20 points: expected a positive σ, or nothing where it is not known"
        ),
        "{text}"
    );
    assert!(!text.contains("only 20 of 20"), "{text}");
}

#[test]
fn a_conjugated_spectrum_is_reported_by_fit_as_by_kk() {
    let folder = tempfile::tempdir().unwrap();
    let conjugated: Vec<(f64, Complex64)> = points((0.05, 1000.0), 20, 0.0)
        .into_iter()
        .map(|(f, z)| (f, z.conj()))
        .collect();
    let file = write(folder.path(), &conjugated, Some(SIGMA_OHM));
    let words =
        "the imaginary part has the wrong sign; with the other sign it agrees with Kramers–Kronig";
    for arguments in [
        vec!["kk"],
        vec!["fit", "--rc", "3", "--objective", "complex"],
        vec!["fit", "--rc", "3"],
    ] {
        let text = program(&[&arguments[..], &[file.to_str().unwrap()]].concat()).ok();
        assert!(text.contains(words), "{arguments:?}: {text}");
    }
    let file = write(
        folder.path(),
        &points((0.05, 1000.0), 20, 0.0),
        Some(SIGMA_OHM),
    );
    assert!(
        !program(&["fit", "--rc", "3", file.to_str().unwrap()])
            .ok()
            .contains("wrong sign")
    );
}

#[test]
fn an_inductive_band_is_reported_by_fit_and_by_kk() {
    let folder = tempfile::tempdir().unwrap();
    let file = write(
        folder.path(),
        &points((0.05, 5000.0), 30, 3e-7),
        Some(SIGMA_OHM),
    );
    // At 209 Hz the branches absorb ωL, 0.394 mΩ; at the next point, 310.5 Hz, it is 0.31 mΩ more.
    for arguments in [
        vec!["kk"],
        vec!["fit", "--rc", "3", "--objective", "complex"],
    ] {
        let text = program(&[&arguments[..], &[file.to_str().unwrap()]].concat()).ok();
        assert!(
            text.contains("is inductive from 311 Hz on (Im Z > 0)"),
            "{arguments:?}: {text}"
        );
    }
    let file = write(
        folder.path(),
        &points((0.05, 1000.0), 20, 0.0),
        Some(SIGMA_OHM),
    );
    assert!(
        !program(&["fit", "--rc", "3", file.to_str().unwrap()])
            .ok()
            .contains("inductive")
    );
    assert!(
        !program(&["kk", file.to_str().unwrap()])
            .ok()
            .contains("inductive")
    );
}
