//! `eis-bench simulate` on a model of the thesis' sweeps: names of the fields, the table over the
//! robot's profiles, and what is refused.

use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::support::{program_in, project};

fn number(value: &Value, key: &str) -> f64 {
    value[key]
        .as_f64()
        .unwrap_or_else(|| panic!("no number {key} in {value}"))
}

/// Returns the thesis' 4-RC model in a separate folder.
fn fitted() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let sweeps = project("fixtures/data/spectra/p45b_thesis.csv");
    let fit = [
        "fit",
        &sweeps,
        "--pool",
        "--rc",
        "4",
        "--objective",
        "sum-abs",
        "--out",
        "p45b",
    ];
    program_in(folder.path(), &fit).ok();
    folder
}

/// A pulse of 30 A over 100 s on the pack.
const PULSE: [&str; 11] = [
    "simulate",
    "--model",
    "p45b/model_4rc.json",
    "--profile",
    "pulse.csv",
    "--series",
    "16",
    "--parallel",
    "3",
    "--ocv-v",
    "3.72",
];

/// Returns the folder of [`fitted`] with the pulse of [`PULSE`].
fn with_pulse() -> tempfile::TempDir {
    let folder = fitted();
    std::fs::write(
        folder.path().join("pulse.csv"),
        "time_s,current_a\n0,30\n100,0\n101,0\n",
    )
    .unwrap();
    folder
}

fn robot_profiles() -> Option<PathBuf> {
    let near = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared");
    let shared = std::env::var_os("EIS_BENCH_SHARED").map_or(near, PathBuf::from);
    let folder = shared.join("data/robot_profiles");
    folder.is_dir().then_some(folder)
}

#[test]
fn a_pulse_on_the_pack_has_the_fixed_fields_and_the_voltage_of_its_resistances() {
    let folder = with_pulse();
    let found = program_in(
        folder.path(),
        &[&PULSE[..], &["--interconnect-ohm", "0.01", "--json"]].concat(),
    )
    .json();
    // 10 A per cell for 20 of the longest time constants: the whole DC resistance of appendix
    // A, 13.78 mΩ.
    let cell_v = 3.72 - 10.0 * 0.013_78;
    assert!(
        (number(&found, "min_ccv_v") - (16.0 * cell_v - 0.3)).abs() < 0.02,
        "{found}"
    );
    assert!(
        (number(&found, "margin_low_v") - (cell_v - 2.5)).abs() < 1e-3,
        "{found}"
    );
    assert!(
        (number(&found, "max_ccv_v") - 16.0 * 3.72).abs() < 1.5
            && number(&found, "margin_high_v") > 0.47,
        "{found}"
    );
    assert!(
        (number(&found, "charge_c") - 3000.0).abs() < 1e-6
            && number(&found, "energy_j") > 3000.0 * 16.0 * cell_v - 1e3
    );
    assert_eq!(found["feasible"], Value::Bool(true));
    assert_eq!(found["trace"], Value::Null);
    assert!(!folder.path().join("pulse.trace.parquet").exists());
}

#[test]
fn the_band_of_a_run_counts_all_parameters_and_scattering_cells() {
    let folder = with_pulse();
    let with = |more: &[&str]| program_in(folder.path(), &[&PULSE[..], more].concat());
    // Half width at the lowest voltage, where the pulse ends.
    let half_v =
        |found: &Value| number(found, "margin_low_v") + 2.5 - number(&found["band"], "lowest_v");
    // √χ²₉ of 95 % is 4.113.
    let alone = with(&["--json"]).json();
    let sigma_v = number(&alone, "min_ccv_sigma_v") / 16.0;
    assert!((half_v(&alone) / sigma_v - 4.113).abs() < 0.02, "{alone}");
    assert!(number(&alone["band"], "most_half_v") >= half_v(&alone) - 1e-9);
    // Cells with 2 % more or less: 10 A on 13.78 mΩ.
    let scattered = with(&["--sigma-r", "0.02", "--json"]).json();
    let expected_v = 4.113 * sigma_v.hypot(0.02 * 10.0 * 0.013_78);
    assert!(
        (half_v(&scattered) / expected_v - 1.0).abs() < 0.01,
        "{scattered}"
    );
    let text = with(&["--sigma-r", "0.02"]).ok();
    assert!(
        text.contains(
            "pulse: with a probability of 95 % the voltage of a cell stays over the whole run"
        ) && text.contains("by the uncertainty of the fitted parameters and the scatter"),
        "{text}"
    );
    let refused = with(&["--sigma-r", "2"]);
    assert_eq!(refused.code, Some(2));
    assert!(
        refused
            .stderr
            .contains("expected a share from 0 to below 1"),
        "{}",
        refused.stderr
    );
}

#[test]
fn too_much_power_is_a_result_and_the_tangent_goes_on() {
    let folder = fitted();
    std::fs::write(
        folder.path().join("jump.txt"),
        "0 100\n0.5 600\n0.5005 100\n1 0\n",
    )
    .unwrap();
    let base = [
        "simulate",
        "--model",
        "p45b/model_4rc.json",
        "--profile",
        "jump.txt",
        "--ocv-v",
        "3.72",
        "--json",
    ];
    let stopped = program_in(folder.path(), &base).json();
    assert_eq!(stopped["feasible"], Value::Bool(false));
    let first = &stopped["first_infeasible"];
    assert!(
        (number(first, "time_s") - 0.5).abs() < 1e-9 && number(first, "power_w") == 600.0,
        "{first}"
    );
    // At most 3.72²/(4·6.43 mΩ) = 538 W, minus the voltage drop of the branches.
    assert!(
        (480.0..538.0).contains(&number(first, "available_w")),
        "{first}"
    );
    let on = program_in(
        folder.path(),
        &[&base[..], &["--beyond", "extrapolate", "--out", "plots"]].concat(),
    )
    .json();
    assert!(
        (number(&on, "simulated_s") - 1.0).abs() < 1e-9 && on["feasible"] == Value::Bool(false)
    );
    for file in ["trace.parquet", "simulation.png", "simulation.svg"] {
        assert!(folder.path().join("plots").join(file).is_file(), "{file}");
    }
}

#[test]
fn the_share_at_which_the_tangent_begins_is_an_option() {
    let folder = fitted();
    let jump = "0 100\n0.5 600\n0.500001 100\n1 0\n";
    std::fs::write(folder.path().join("jump.txt"), jump).unwrap();
    let base = [
        "simulate",
        "--model",
        "p45b/model_4rc.json",
        "--profile",
        "jump.txt",
        "--ocv-v",
        "3.72",
        "--json",
        "--beyond",
        "extrapolate",
    ];
    let with = |share: &[&str]| program_in(folder.path(), &[&base[..], share].concat()).json();
    let default = with(&[]);
    assert_eq!(
        default["min_ccv_v"],
        with(&["--p0-share", "0.95"])["min_ccv_v"]
    );
    for (share, found) in [(0.95, &default), (0.7, &with(&["--p0-share", "0.7"]))] {
        // E²/4R is the available power; R is that of appendix A.
        let most_w = number(&found["first_infeasible"], "available_w");
        let e_v = (4.0 * 6.4286e-3 * most_w).sqrt();
        let c = (1.0_f64 - share).sqrt();
        let ccv_v = 0.5 * e_v * (1.0 + c - (600.0 / most_w - share) / (2.0 * c));
        assert!(
            (number(found, "min_ccv_v") - ccv_v).abs() < 2e-3,
            "{share}: {found}"
        );
    }
    for (beyond, share, reason) in [
        ("extrapolate", "1", "above 0 and below 1, met 1"),
        ("extrapolate", "-0.2", "above 0 and below 1, met -0.2"),
        ("stop", "0.9", "met --beyond stop"),
    ] {
        let call = [&base[..9], &[beyond, "--p0-share", share]].concat();
        let error = program_in(folder.path(), &call).refused();
        assert!(error.contains(reason), "{error}");
    }
}

#[test]
fn the_robot_profiles_run_and_the_transient_model_frees_power() {
    let Some(profiles) = robot_profiles() else {
        eprintln!("skipped: no shared data");
        return;
    };
    let folder = fitted();
    let paths = ["spin_jump", "lateral_jump", "2.0m_gap", "walking"]
        .map(|name| profiles.join(format!("{name}.txt")));
    let mut arguments = vec![
        "simulate",
        "--model",
        "p45b/model_4rc.json",
        "--series",
        "16",
        "--parallel",
        "3",
        "--ocv-v",
        "3.72",
        "--json",
    ];
    paths
        .iter()
        .for_each(|path| arguments.extend(["--profile", path.to_str().unwrap()]));
    let found = program_in(folder.path(), &arguments).json();
    let list = found.as_array().unwrap();
    assert_eq!(list.len(), 4);
    for (case, path) in list.iter().zip(&paths) {
        let rows: Vec<(f64, f64)> = std::fs::read_to_string(path)
            .unwrap()
            .lines()
            .map(|line| {
                line.split_whitespace()
                    .map(|f| f.parse::<f64>().unwrap())
                    .collect::<Vec<_>>()
            })
            .filter(|row| row.len() == 2)
            .map(|row| (row[0], row[1]))
            .collect();
        let asked: f64 = rows.windows(2).map(|w| (w[1].0 - w[0].0) * w[0].1).sum();
        assert!(
            (number(case, "energy_j") - asked).abs() < 1e-4 * asked,
            "{case}"
        );
        // Simple IR by hand: 59.52 V behind 73.46 mΩ reach 40 V at 10.63 kW.
        assert!(
            (number(&case["simple_ir"], "largest_peak_power_w") - 10_629.0).abs() < 15.0,
            "{case}"
        );
        assert!(
            number(case, "freed_peak_power_w") > 5_000.0 && number(case, "min_ccv_v") > 50.0,
            "{case}"
        );
    }
}

#[test]
fn says_what_is_missing() {
    let folder = fitted();
    std::fs::write(folder.path().join("ok.csv"), "0,1\n1,2\n").unwrap();
    std::fs::write(folder.path().join("bad.csv"), "0,1\n1,x\n").unwrap();
    let run = |more: &[&str]| {
        let output = program_in(
            folder.path(),
            &[&["simulate", "--model", "p45b/model_4rc.json"], more].concat(),
        );
        assert_eq!(output.code, Some(2));
        output.stderr
    };
    let text = run(&["--profile", "ok.csv", "--soc", "0.5"]);
    assert!(
        text.contains(
            "--soc: expected a model with an OCV curve, p45b/model_4rc.json has \
    none; give --ocv-v instead"
        ),
        "{text}"
    );
    let text = run(&["--profile", "bad.csv", "--ocv-v", "3.7"]);
    assert!(
        text.contains("bad.csv, line 2: expected a finite demand, met \"x\""),
        "{text}"
    );
    let text = run(&["--profile", "ok.csv", "--ocv-v", "3.7", "--series", "0"]);
    assert!(
        text.contains("pack: expected at least 1 cell in series and 1 in parallel, met 0S1P"),
        "{text}"
    );
    let text = run(&["--profile", "ok.csv"]);
    assert!(
        text.contains("expected --soc or --ocv-v, found neither"),
        "{text}"
    );
}

#[test]
fn the_last_row_is_not_a_peak_and_charging_has_one_and_the_thesis_method_runs() {
    let folder = fitted();
    std::fs::write(folder.path().join("last.csv"), "0,100\n1,500\n").unwrap();
    std::fs::write(
        folder.path().join("charge.csv"),
        "time_s,charge_power_w\n0,20\n1,0\n",
    )
    .unwrap();
    std::fs::write(
        folder.path().join("steps.csv"),
        "0,100\n0.002,50\n0.004,100\n0.006,0\n",
    )
    .unwrap();
    let run = |profile: &str, more: &[&str]| {
        let base = [
            "simulate",
            "--model",
            "p45b/model_4rc.json",
            "--profile",
            profile,
            "--ocv-v",
            "3.72",
            "--json",
        ];
        program_in(folder.path(), &[&base[..], more].concat())
    };
    let found = |profile: &str| run(profile, &[]).json();
    // The DC resistance of 13.78 mΩ holds 2.5 V at 2.5·1.22/0.013 78 = 221 W and 4.2 V at
    // −4.2·0.48/0.013 78 = −146 W.
    let last = found("last.csv");
    assert!(
        (number(&last["simple_ir"], "largest_peak_power_w") - 221.3).abs() < 1.0,
        "{last}"
    );
    assert!(number(&last, "largest_peak_power_w") < 400.0, "{last}");
    let charge = found("charge.csv");
    assert!(
        (number(&charge["simple_ir"], "largest_peak_power_w") + 146.3).abs() < 1.0,
        "{charge}"
    );
    assert!(
        number(&charge, "freed_peak_power_w") > 0.0 && number(&charge, "lowest_power_w") < -19.0,
        "{charge}"
    );
    assert!(run("steps.csv", &["--method", "thesis"]).code == Some(0));
    let refused = run("steps.csv", &["--method", "thesis", "--step-s", "0.002"]);
    let text = refused.stderr;
    assert!(
        refused.code == Some(2)
            && text.contains("--step-s: explicit Euler: expected steps below 1.66"),
        "{text}"
    );
}
