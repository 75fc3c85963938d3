//! Multisines under a direct current on the simulated bench, at one charge and along a discharge: the
//! impedance at each charge against the truth, the charge, and the files.

use std::{fs, path::Path};

use analysis::{dataset::RunIndex, run_folder::OPERANDO_COLUMNS};
use bench_daemon::command::run::run_experiment;
use bench_evaluate::run::Finished;
use bench_plan::{config::load_experiment, procedure};

use crate::{
    resume::{die, resume},
    support::{EXPERIMENT, Files, SCENARIO, files_below, program},
};

const BANDS: &str = r#"
[[multisine.bands]]
base = "1 Hz"
stop = "13 Hz"
lines = 5
periods = 10
settle = "5 s"

[[multisine.bands]]
base = "5 Hz"
start = "15 Hz"
stop = "300 Hz"
lines = 8
periods = 10
settle = "5 s"
"#;

/// Files with a multisine of the cell, which is not swept, and its keys.
fn files(keys: &str) -> Files {
    Files::short(6)
        .edit(EXPERIMENT, "start = \"100 Hz\"", "start = \"1 Hz\"")
        .edit(
            EXPERIMENT,
            "amplitude = \"1 A\"",
            "amplitude = \"2 A\"\nrepeat = 0",
        )
        .append(
            EXPERIMENT,
            &format!("[multisine]\npeak = \"2 A\"\n{keys}\n{BANDS}"),
        )
}

fn run(files: &Files) -> (Finished, RunIndex) {
    let finished = run_experiment(&files.load(), &files.path("run")).unwrap();
    let text = fs::read_to_string(files.path("run").join("traces.json")).unwrap();
    (finished, serde_json::from_str(&text).unwrap())
}

/// Shares of the points that lie within 95 % intervals, and whose magnitude lies within 1 %, of the truth
/// at the charge of each.
fn shares(finished: &Finished) -> (f64, f64) {
    let world = finished.simulation.as_ref().unwrap().world();
    let world = world.lock().unwrap();
    let (mut inside, mut near, mut all) = (0.0, 0.0, 0.0);
    for run in &finished.measured.multisines {
        for (point, at) in run.spectrum.points.iter().zip(&run.conditions) {
            let soc = 0.6 + at.charge_coulomb / (4.5 * 3600.0);
            let truth = world.truth_impedance_under(point.freq_hz, at.bias_a, soc);
            let off = point.z_ohm - truth;
            for (off, variance) in [
                (off.re, point.covariance.re_re),
                (off.im, point.covariance.im_im),
            ] {
                inside += f64::from(u8::from(off.abs() < 1.96 * variance.sqrt()));
                all += 1.0;
            }
            near += f64::from(u8::from(
                (point.z_ohm.norm() / truth.norm() - 1.0).abs() < 0.01,
            ));
        }
    }
    (inside / all, 2.0 * near / all)
}

fn soc(finished: &Finished) -> f64 {
    let world = finished.simulation.as_ref().unwrap().world();
    world.lock().unwrap().truth_soc()
}

#[test]
fn multisines_under_direct_currents_meet_the_cell_and_bring_the_charge_back() {
    let files = files("bias = [\"0 A\", \"-3 A\", \"3 A\"]\nresistance_max = \"30 mΩ\"").append(
        SCENARIO,
        "[drives.bipolar]\ngain_error = -0.02\nzero_error_a = 0.1",
    );
    let (finished, index) = run(&files);
    let biases: Vec<f64> = index.sweeps.iter().map(|sweep| sweep.bias_a).collect();
    assert_eq!(biases, [0.0, -3.0, 3.0]);
    let groups: Vec<&str> = index
        .sweeps
        .iter()
        .map(|sweep| sweep.repeat_group.as_str())
        .collect();
    assert_eq!(
        groups,
        ["multisine", "multisine_bias-3A", "multisine_bias+3A"]
    );
    for entry in &index.sweeps[1..] {
        assert_eq!(entry.conditions.len(), 13);
        for point in &entry.conditions {
            let off_a = point.bias_measured_a - 0.98 * entry.bias_a;
            assert!(
                off_a.abs() < 3.0 * point.sigma_bias_a,
                "{point:?}: off by {off_a} A"
            );
        }
        let text = fs::read_to_string(files.path("run").join(&entry.file)).unwrap();
        assert!(
            text.contains(",bias_a,bias_measured_a,sigma_bias_a,charge_c,temperature_c"),
            "{text}"
        );
    }
    let (_, near) = shares(&finished);
    assert!(
        near > 0.99,
        "{near} of the impedances of the biased ones lie within 1 %"
    );
    assert!((soc(&finished) - 0.6).abs() < 1.0e-3, "{}", soc(&finished));
    assert!(
        finished.summary.contains("multisine under -3 A at -"),
        "{}",
        finished.summary
    );
}

#[test]
fn along_a_discharge_the_impedance_is_known_at_each_charge() {
    let files = files(
        "operando = true\nbias = [\"-0.9 A\"]\nbias_charge = \"2 %\"\nresistance_max = \"30 mΩ\"",
    )
    .append(
        SCENARIO,
        "[effects.soc_resistance]\nslope = -1.5\nreference_soc = 0.6",
    );
    let (finished, index) = run(&files);
    let screens = finished.measured.multisines.len();
    // 324 C at 0.9 A are 360 s; a screen of both bands takes 30 s, the ramp 36 s.
    assert!((8..=14).contains(&screens), "{screens}");
    assert_eq!(index.sweeps.len(), screens);
    let charges: Vec<f64> = index
        .sweeps
        .iter()
        .map(|sweep| sweep.conditions[0].charge_coulomb)
        .collect();
    assert!(charges.is_sorted_by(|a, b| a > b), "{charges:?}");
    assert!((soc(&finished) - 0.6).abs() < 1.0e-3, "{}", soc(&finished));
    let (inside, near) = shares(&finished);
    eprintln!("{screens} screens, {inside} inside, {near} near");
    assert!(near >= 0.9, "{near} of the impedances lie within 1 %");
    assert!((0.85..=1.0).contains(&inside), "{inside} lie within 95 %");
    // The resistances rise by 3 % over 2 % of the charge, most of it between the first and the last.
    let real = |run: usize| {
        finished.measured.multisines[run].spectrum.points[5]
            .z_ohm
            .re
    };
    let rise = real(screens - 1) / real(0) - 1.0;
    assert!((0.015..0.025).contains(&rise), "{rise}");
    let table = fs::read_to_string(files.path("run").join("operando.csv")).unwrap();
    let mut lines = table.lines();
    assert_eq!(lines.next(), Some(OPERANDO_COLUMNS));
    assert_eq!(lines.count(), 13 * screens);
    let report = fs::read_to_string(files.path("run").join("report.html")).unwrap();
    assert!(
        report.contains("The impedance along the discharge"),
        "the report shows the picture"
    );
    assert!(files.path("run").join("plots/operando.svg").exists());
}

/// Ten benches with their own harness, or as many as `EIS_BENCH_SEEDS`, along C/5 of a cell whose charge
/// transfer falls with the current and whose resistances follow the charge.
#[test]
#[ignore = "drill"]
fn the_uncertainty_along_a_discharge_covers_the_truth() {
    let files = files(
        "operando = true\nbias = [\"-0.9 A\"]\nbias_charge = \"4 %\"\nresistance_max = \"30 mΩ\"",
    )
    .append(
        SCENARIO,
        "[effects.butler_volmer]\nbranch = 1\nalpha = 0.5\n\
        [effects.soc_resistance]\nslope = -1.5\nreference_soc = 0.6",
    );
    let seeds: u64 = std::env::var("EIS_BENCH_SEEDS").map_or(10, |text| text.parse().unwrap());
    let (mut covered, mut close) = (0.0, 0.0);
    for seed in 1..=seeds {
        let mut experiment = files.load();
        experiment.seed = seed;
        let finished = run_experiment(&experiment, &files.path(&format!("run{seed}"))).unwrap();
        let (inside, near) = shares(&finished);
        let screens = finished.measured.multisines.len();
        eprintln!("seed {seed}: {screens} screens, {inside:.3} inside, {near:.3} within 1 %");
        covered += inside / seeds as f64;
        close += near / seeds as f64;
    }
    eprintln!("{seeds} seeds: {covered:.3} inside, {close:.3} within 1 %");
    assert!(close >= 0.9, "{close} of the impedances lie within 1 %");
    assert!((0.9..=0.99).contains(&covered), "{covered} lie within 95 %");
}

#[test]
fn a_run_along_a_discharge_is_verified_and_resumed_to_the_same_files() {
    let files = files(
        "operando = true\nbias = [\"-3 A\"]\nbias_charge = \"2 %\"\nresistance_max = \"30 mΩ\"",
    );
    files.run("whole").expect_code(0);
    let whole = files.path("whole");
    let verified = program(&["verify".as_ref(), whole.as_os_str()]);
    verified.expect_code(0);
    assert!(
        verified.stdout.contains("every number as stored"),
        "{}",
        verified.stdout
    );
    // Before the recharge every line is measured.
    let journal = fs::read_to_string(whole.join("journal.jsonl")).unwrap();
    let line = journal
        .lines()
        .position(|line| line.contains("ramp the direct current to -3 A"))
        .unwrap()
        + 1;
    let run = files.path("died");
    die(&files, &run, &format!("journal:{line}"));
    resume(&run, &[]).expect_code(0);
    for name in files_below(&whole) {
        let read = |folder: &Path| fs::read(folder.join(&name)).unwrap();
        assert!(read(&run) == read(&whole), "{}", name.display());
    }
}

#[test]
fn keys_that_do_not_fit_are_refused_by_name() {
    let ohm = "resistance_max = \"30 mΩ\"";
    for (keys, reason) in [
        (
            "operando = true".to_owned(),
            "multisine.operando: expected one bias other than 0 A beside it",
        ),
        (
            format!("operando = true\nbias = [\"0 A\", \"-1 A\"]\n{ohm}"),
            "multisine.operando: expected one bias other than 0 A beside it",
        ),
        (
            "bias = [\"-1 A\"]".to_owned(),
            "multisine.resistance_max: expected it beside a bias other than 0 A",
        ),
        (
            format!("bias = [\"-1 A\"]\nbias_charge = \"30 %\"\n{ohm}"),
            "multisine.bias_charge: expected 0.001 (share) to 0.2 (share), found 0.3 (share)",
        ),
        (
            format!("bias = [\"12 A\"]\n{ohm}"),
            "multisine.bias: expected 12 A ± 2 A within -45 A to 13.5 A, the limits of the cell",
        ),
        (
            format!("bias = [\"-1 A\"]\n{ohm}\nquality = {{ again = 1 }}"),
            "multisine.quality.again: expected 0 beside a bias",
        ),
    ] {
        let message = load_experiment(&files(&keys).experiment(), None)
            .unwrap_err()
            .to_string();
        assert!(message.contains(reason), "{keys}: {message}");
    }
    // A current of zero alone changes nothing.
    let plan = |keys: &str| format!("{:?}", procedure::plan(&files(keys).load()));
    assert_eq!(plan("bias = [\"0 A\"]"), plan(""));
}
