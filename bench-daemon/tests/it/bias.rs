//! Sweeps under a direct current on the simulated bench: impedance, current and charge against the
//! truth, the order of the sweeps, and what ends such a run.

use std::{collections::BTreeMap, fs, path::Path};

use analysis::dataset::{RunIndex, SweepEntry};
use bench_daemon::command::run::run_experiment;
use bench_evaluate::run::Finished;
use bench_plan::{config::load_experiment, procedure};
use num_complex::Complex64;

use crate::{
    resume::{clear, die, resume},
    support::{
        BENCH, EXPERIMENT, Files, Ports, Running, SCENARIO, command, files_below, poll, program,
        sent,
    },
};

/// Starts a run as another process.
fn start(files: &Files, run: &Path) -> Running {
    let experiment = files.experiment();
    let arguments = [
        "run".as_ref(),
        experiment.as_os_str(),
        "--out".as_ref(),
        run.as_os_str(),
    ];
    Running(command(&arguments).spawn().unwrap())
}

/// A cell whose parameters change with the charge-transfer law only.
const BUTLER_VOLMER: &str = "[effects.butler_volmer]\nbranch = 1\nalpha = 0.5";

/// Returns files with sweeps of the cell under direct currents.
fn biased(from_hz: f64, points: usize, bias: &str) -> Files {
    Files::short(points)
        .edit(
            EXPERIMENT,
            "start = \"100 Hz\"",
            &format!("start = \"{from_hz} Hz\""),
        )
        .edit(
            EXPERIMENT,
            "extra_wait = \"1 s\"",
            &format!("extra_wait = \"1 s\"\nrest_first = \"1 min\"\n{bias}"),
        )
}

fn run(files: &Files) -> (Finished, RunIndex, String) {
    let finished = run_experiment(&files.load(), &files.path("run")).unwrap();
    let read = |name: &str| fs::read_to_string(files.path("run").join(name)).unwrap();
    let index = serde_json::from_str(&read("traces.json")).unwrap();
    (finished, index, read("events.csv"))
}

/// Compares a sweep with the truth at the charge of each point.
fn assert_true(finished: &Finished, entry: &SweepEntry, number: usize, start_soc: f64) {
    let world = finished.simulation.as_ref().unwrap().world();
    let world = world.lock().unwrap();
    let spectrum = finished.measured.spectra().nth(number).unwrap();
    for (k, point) in spectrum.points.iter().enumerate() {
        let conditions = entry.conditions.get(k);
        let moved_coulomb = conditions.map_or(0.0, |conditions| conditions.charge_coulomb);
        let truth: Complex64 = world.truth_impedance_under(
            point.freq_hz,
            entry.bias_a,
            start_soc + moved_coulomb / (4.5 * 3600.0),
        );
        let sigma_ohm = (point.covariance.re_re + point.covariance.im_im).sqrt();
        let off_ohm = (point.z_ohm - truth).norm();
        assert!(
            off_ohm <= 4.0 * sigma_ohm,
            "{} A, {:.3} Hz: {} instead of {truth}, σ {sigma_ohm}",
            entry.bias_a,
            point.freq_hz,
            point.z_ohm
        );
    }
}

#[test]
fn a_sweep_under_a_direct_current_meets_the_cell_at_its_charge_and_brings_it_back() {
    let bias =
        "bias = [\"2 A\", \"0 A\", \"-5 A\"]\nbias_charge = \"2 %\"\nresistance_max = \"30 mΩ\"";
    let files = biased(1.0, 5, bias).append(
        SCENARIO,
        "[drives.bipolar]\ngain_error = -0.02\nzero_error_a = 0.12",
    );
    let (finished, index, events) = run(&files);
    let biases: Vec<f64> = index.sweeps.iter().map(|sweep| sweep.bias_a).collect();
    assert_eq!(biases, [0.0, 2.0, -5.0], "the sweep at rest comes first");
    let groups: Vec<&str> = index
        .sweeps
        .iter()
        .map(|sweep| sweep.repeat_group.as_str())
        .collect();
    assert_eq!(groups, ["eis", "eis_bias+2A", "eis_bias-5A"]);
    for (number, entry) in index.sweeps.iter().enumerate() {
        assert_true(&finished, entry, number, 0.6);
        let count = if entry.bias_a == 0.0 { 0 } else { 5 };
        assert_eq!(entry.conditions.len(), count);
        for point in &entry.conditions {
            // The drive is two per cent weak, the zero error is cancelled, and the sinusoid adds none.
            let off_a = point.bias_measured_a - 0.98 * entry.bias_a;
            eprintln!("{point:?}: off by {off_a:.4} A");
            assert!(
                off_a.abs() < 3.0 * point.sigma_bias_a,
                "{point:?}: {off_a} A"
            );
            assert!(point.sigma_bias_a < 0.02 * entry.bias_a.abs());
            assert!(point.charge_coulomb * entry.bias_a > 0.0, "{point:?}");
            assert!(point.temperature_degc.is_some());
        }
    }
    let moved: Vec<f64> = (index.sweeps[2].conditions.iter())
        .map(|point| point.charge_coulomb)
        .collect();
    // The points are listed by frequency and measured from the slowest on. The last one would have
    // moved more than 2 % of the capacity: the charge was brought back before it.
    assert!(moved[..4].is_sorted_by(|a, b| a > b), "{moved:?}");
    assert!(
        moved[4] > moved[0] && moved.iter().all(|coulomb| *coulomb > -324.0),
        "{moved:?}"
    );
    assert_eq!(events.matches("C after its return").count(), 3, "{events}");
    let soc = finished
        .simulation
        .as_ref()
        .unwrap()
        .world()
        .lock()
        .unwrap()
        .truth_soc();
    eprintln!("state of charge {soc}");
    assert!((soc - 0.6).abs() < 1.0e-3, "{soc}");
    for expected in [
        "direct current with the command at zero: +0.1",
        "direct current -5 A: -4.9",
        "C after its return",
    ] {
        assert!(events.contains(expected), "{expected}:\n{events}");
    }
    // Fits and repeats use the sweep at rest only; the file of each sweep states its current.
    let text = fs::read_to_string(files.path("run").join(&index.sweeps[1].file)).unwrap();
    assert!(
        text.starts_with(
            "freq_hz,z_re_ohm,z_im_ohm,sigma_re_ohm,sigma_im_ohm,cov_re_im_ohm2,amplitude_a,bias_a,\
            bias_measured_a,sigma_bias_a,charge_c,temperature_c"
        ),
        "{text}"
    );
    let read = analysis::formats::read_sourced(&files.path("run").join(&index.sweeps[1].file));
    let read = read.unwrap();
    assert_eq!((read.len(), read[0].origin.bias_a), (1, Some(2.0)));
    assert!(!read[0].origin.is_unbiased_cell());
}

#[test]
fn a_run_under_a_direct_current_is_verified_replayed_and_resumed_to_the_same_files() {
    let bias = "bias = [\"0 A\", \"3 A\"]\nresistance_max = \"30 mΩ\"";
    let files = biased(100.0, 3, bias);
    files.run("whole").expect_code(0);
    let whole = files.path("whole");
    let out = files.path("again");
    let verified = program(&["verify".as_ref(), whole.as_os_str()]);
    verified.expect_code(0);
    assert!(
        verified.stdout.contains("every number as stored"),
        "{}",
        verified.stdout
    );
    program(&[
        "replay".as_ref(),
        "--out".as_ref(),
        out.as_os_str(),
        whole.as_os_str(),
    ])
    .expect_code(0);
    let index = fs::read_to_string(whole.join("traces.json")).unwrap();
    let index: RunIndex = serde_json::from_str(&index).unwrap();
    for name in [
        index.sweeps[1].file.as_str(),
        "model_1rc.json",
        "report.html",
    ] {
        let read = |folder: &Path| fs::read(folder.join(name)).unwrap();
        assert!(read(&whole) == read(&out), "{name}");
    }
    // In the ramp, between two points, and in the recharge.
    let journal = fs::read_to_string(whole.join("journal.jsonl")).unwrap();
    let line = |text: &str| {
        let at = journal.lines().position(|line| line.contains(text));
        at.unwrap_or_else(|| panic!("{text}")) + 1
    };
    for (number, text) in ["ramp the direct current to +3 A", "bring back"]
        .into_iter()
        .enumerate()
    {
        let run = files.path(&format!("died{number}"));
        die(&files, &run, &format!("journal:{}", line(text)));
        resume(&run, &[]).expect_code(0);
        for name in files_below(&whole) {
            let read = |folder: &Path| fs::read(folder.join(&name)).unwrap();
            assert!(read(&run) == read(&whole), "{}: {}", text, name.display());
        }
    }
}

/// A direct current beside the commanded one, or a drive that runs away, is found as at rest.
#[test]
fn a_direct_current_that_was_not_commanded_ends_the_sweep() {
    let bias = "bias = [\"3 A\"]\nbias_charge = \"2 %\"\nresistance_max = \"30 mΩ\"";
    let files = || {
        biased(100.0, 8, bias)
            .without(EXPERIMENT, "fixture_check")
            .edit(EXPERIMENT, "amplitude = \"1 A\"", "amplitude = \"3 A\"")
    };
    for (fault, text) in [
        (
            "[faults.offset_with_sine]\nfrom_s = 0.0\namps = 0.34",
            "mean of the cell current since the zero of the channels 0.3",
        ),
        (
            "[faults]\nbipolar_drifts = { from_s = 110.0, a_per_s = 0.05, greatest_a = 12.0 }",
            "current",
        ),
        (
            "[faults]\nbipolar_drifts = { from_s = 0.0, a_per_s = 0.01, greatest_a = 1.0 }",
            "expected",
        ),
    ] {
        let faulty = files().append(SCENARIO, fault);
        let error = run_experiment(&faulty.load(), &faulty.path("run"))
            .err()
            .unwrap();
        let message = error.to_string();
        eprintln!("{fault}: {message}");
        assert!(message.contains(text), "{fault}: {message}");
    }
}

fn message_of(files: &Files) -> String {
    let error = run_experiment(&files.load(), &files.path("run")).err();
    error.unwrap().to_string()
}

#[test]
fn a_drive_that_misses_the_direct_current_is_named_by_shunt_or_meter() {
    for (gain, text) in [
        (
            -0.15,
            "direct current by the shunt: expected 5 A within 0.5",
        ),
        (
            -0.25,
            "direct current by the supply's meter: expected 5.000 A, measured 3.",
        ),
    ] {
        let files = biased(100.0, 2, "bias = [\"5 A\"]\nresistance_max = \"30 mΩ\"")
            .without(EXPERIMENT, "fixture_check")
            .append(
                SCENARIO,
                &format!("[drives.bipolar]\ngain_error = {gain}\n[spread]\ndrive_rel = 0.0"),
            );
        let message = message_of(&files);
        assert!(message.contains(text), "{message}");
    }
}

#[test]
fn a_cell_that_could_leave_its_voltages_is_not_ramped() {
    let files = biased(100.0, 2, "bias = [\"8 A\"]\nresistance_max = \"30 mΩ\"")
        .without(EXPERIMENT, "fixture_check");
    let message = message_of(&files);
    assert!(
        message.starts_with(
            "cell before a direct current of +8 A: expected a voltage at rest from which 2.5 V to \
            4.2 V cannot be left, measured 3.79"
        ),
        "{message}"
    );
    let generator = sent(&files.path("run"), "generator");
    let offsets: Vec<&String> = generator
        .iter()
        .filter(|message| message.contains("OFST,") && !message.contains("OFST,0"))
        .collect();
    assert_eq!(offsets, [&""; 0], "no current was commanded");
}

/// The range of channel 1 holds the direct current, but not the sinusoid about it: the slow point
/// is measured twice.
#[test]
fn a_point_that_is_measured_again_ends_the_run_before_it_moves_too_much_charge() {
    let bias = "bias = [\"5 A\"]\nbias_charge = \"4.7 %\"\nresistance_max = \"30 mΩ\"";
    let files = biased(0.1, 2, bias)
        .without(EXPERIMENT, "fixture_check")
        .edit(BENCH, "[\"20 mV\"", "[\"3.8 mV\"");
    let message = message_of(&files);
    // 1.25 · 4.7 % of 4.5 Ah, and a minute of 5 A.
    assert!(
        message.contains("charge moved by the direct current 125")
            && message.contains("(-1251.75 C to 1251.75 C"),
        "{message}"
    );
    let notes = fs::read_to_string(files.path("run").join("journal.jsonl")).unwrap();
    assert!(
        notes.contains("the direct current of the sweep has moved +125"),
        "what was not brought back is noted"
    );
}

#[test]
#[ignore = "drill"]
fn a_pause_under_a_direct_current_ends_it_and_the_charge_still_comes_back() {
    let bias = "bias = [\"3 A\"]\nbias_settle = \"5 s\"\nresistance_max = \"30 mΩ\"";
    let files = biased(20.0, 6, bias).without(EXPERIMENT, "fixture_check");
    let ports = Ports::serve(&files, 4.0, 1);
    let run = files.path("run");
    let mut child = start(&files, &run);
    let wait_for_journal = |text: &str| {
        poll(text, || {
            fs::read_to_string(run.join("journal.jsonl"))
                .ok()
                .filter(|journal| journal.contains(text))
        })
    };
    wait_for_journal("point  3");
    assert!(ports.world.lock().unwrap().truth_current_a().abs() > 1.0);
    program(&["pause".as_ref(), run.as_os_str()]).expect_code(0);
    wait_for_journal("\"entry\":\"paused\"");
    assert_eq!(ports.world.lock().unwrap().truth_current_a(), 0.0);
    program(&["go-on".as_ref(), run.as_os_str()]).expect_code(0);
    assert_eq!(child.0.wait().unwrap().code(), Some(0));
    let soc = ports.world.lock().unwrap().truth_soc();
    assert!((soc - 0.6).abs() < 1.0e-3, "{soc}");
    let events = fs::read_to_string(run.join("events.csv")).unwrap();
    assert_eq!(
        events.matches("with the command at zero").count(),
        3,
        "{events}"
    );
    ports.assert_outputs_off();
}

#[test]
#[ignore = "drill"]
fn a_run_that_was_killed_under_a_direct_current_goes_on_only_with_an_accepted_charge() {
    let bias = "bias = [\"3 A\"]\nbias_settle = \"5 s\"\nresistance_max = \"30 mΩ\"";
    let files = biased(20.0, 6, bias).without(EXPERIMENT, "fixture_check");
    let ports = Ports::serve(&files, 4.0, 1);
    let run = files.path("run");
    let mut child = start(&files, &run);
    poll("point 3", || {
        fs::read_to_string(run.join("journal.jsonl"))
            .ok()
            .filter(|journal| journal.contains("point  3"))
    });
    child.0.kill().unwrap();
    child.0.wait().unwrap();
    // The burst has ended the sinusoid; the guardian ends the direct current.
    poll("the guardian", || {
        (ports.world.lock().unwrap().truth_current_a() == 0.0).then_some(())
    });
    let mut refused = resume(&run, &[]);
    if refused.message().contains("clear") {
        clear(&files);
        refused = resume(&run, &[]);
    }
    refused.expect_code(2);
    assert!(
        refused
            .message()
            .contains("(ramp the direct current to +3 A")
            && refused.message().contains("--accept-charge"),
        "{}",
        refused.message()
    );
    resume(&run, &["--accept-charge"]).expect_code(0);
    let text = fs::read_to_string(run.join("traces.json")).unwrap();
    let index: RunIndex = serde_json::from_str(&text).unwrap();
    assert_eq!(
        (index.sweeps.len(), index.sweeps[0].conditions.len()),
        (1, 6)
    );
    assert!(index.sweeps[0].conditions.is_sorted_by(|a, b| {
        // Measured from the slowest on, all in the second attempt.
        a.charge_coulomb < b.charge_coulomb
    }));
    ports.assert_outputs_off();
}

#[test]
fn rounds_alternate_and_a_cell_with_charge_transfer_answers_by_the_slope_of_its_law() {
    let bias = "repeat = 2\noverlap = true\nbias = [\"0 A\", \"8 A\"]\nbias_charge = \"3 %\"\n\
        resistance_max = \"30 mΩ\"";
    let files = biased(20.0, 3, bias).append(SCENARIO, BUTLER_VOLMER);
    let (finished, index, _) = run(&files);
    let biases: Vec<f64> = index.sweeps.iter().map(|sweep| sweep.bias_a).collect();
    assert_eq!(biases, [0.0, 8.0, 8.0, 0.0]);
    for (number, entry) in index.sweeps.iter().enumerate() {
        assert_true(&finished, entry, number, 0.6);
    }
    let real = |number: usize| {
        let spectrum = finished.measured.spectra().nth(number).unwrap();
        spectrum.points[0].z_ohm.re
    };
    assert!(real(1) < real(0) - 2.0e-5, "{} {}", real(1), real(0));
    // The fits use the two sweeps at rest.
    assert!(
        finished.summary.contains("sweep 2, +8 A"),
        "{}",
        finished.summary
    );
}

#[test]
fn what_no_bench_or_cell_can_do_under_a_direct_current_is_refused_with_its_key() {
    let ohm = "resistance_max = \"30 mΩ\"";
    for (bias, reason) in [
        (
            "bias = [\"2 A\", \"2 A\"]".to_owned(),
            "eis.bias: expected currents that differ, found [2.0, 2.0] A",
        ),
        (
            "bias = [\"50 mA\"]".to_owned(),
            "eis.bias: expected 0 A, or at least 0.1 A in either direction, found 0.05 A",
        ),
        (
            "bias = [\"2 A\"]".to_owned(),
            "eis.resistance_max: expected it beside a bias other than 0 A",
        ),
        (
            "bias_charge = \"5 %\"".to_owned(),
            "eis.bias_charge: expected eis.bias beside it, with a current other than 0 A",
        ),
        (
            format!("bias = [\"13 A\"]\n{ohm}"),
            "eis.bias: expected 13 A ± 1 A within -45 A to 13.5 A, the limits of the cell",
        ),
        (
            format!("bias = [\"-30 A\"]\n{ohm}"),
            "eis.bias: expected -30 A ± 1 A within ±20.000 A, the limits of the bipolar supply",
        ),
        (
            format!("bias = [\"2 A\"]\nbias_charge = \"30 %\"\n{ohm}"),
            "eis.bias_charge: expected 0.001 (share) to 0.2 (share), found 0.3 (share)",
        ),
        (
            format!("bias = [\"2 A\"]\ncompensate_drift = true\n{ohm}"),
            "eis.compensate_drift: expected false beside a bias",
        ),
        (
            format!("bias = [\"2 A\"]\n{ohm}\nfixture = \"shunt\""),
            "eis.bias: expected a sweep of the cell",
        ),
        (
            format!("bias = [\"2 A\"]\n{ohm}\n[eis.quality]\nagain = 1"),
            "eis.quality.again: expected 0 beside a bias",
        ),
    ] {
        let files = biased(1.0, 2, &bias);
        let message = load_experiment(&files.experiment(), None)
            .unwrap_err()
            .to_string();
        assert!(message.contains(reason), "{bias}: {message}");
    }
    // A current of zero alone is no direct current: the plan is that of a sweep at rest.
    let plan = |bias: &str| format!("{:?}", procedure::plan(&biased(1.0, 2, bias).load()));
    assert_eq!(plan("bias = [\"0 A\"]"), plan(""));
    // A burst does not end the direct current.
    let planned = biased(1.0, 2, &format!("bias = [\"2 A\"]\n{ohm}"));
    let planned = program(&["plan".as_ref(), planned.experiment().as_os_str()]);
    planned.expect_code(0);
    for text in [
        "without a further message the drive goes on (a burst ends a sinusoid, but not the direct \
        current under it): only the daemon and the guardian end it",
        "ramp the direct current to +2 A, settle 30 s: at most 810 C, and 1.2 K of warming",
        "bring back about ",
    ] {
        assert!(planned.stdout.contains(text), "{text}:\n{}", planned.stdout);
    }
    // A point that moves too much is refused by the plan.
    let files = biased(0.1, 2, &format!("bias = [\"10 A\"]\n{ohm}"));
    let ended = files.run("run");
    ended.expect_code(2);
    assert!(
        ended
            .message()
            .contains("expected a direct current to move at most 810 C before a recharge"),
        "{}",
        ended.message()
    );
}

#[test]
fn the_generator_ramps_by_an_ampere_and_ends_its_burst_before() {
    let files = biased(100.0, 2, "bias = [\"-3 A\"]\nresistance_max = \"30 mΩ\"");
    run(&files);
    // 2 A for each volt of the generator.
    let (mut levels_a, mut bursts) = (vec![0.0], false);
    for message in sent(&files.path("run"), "generator") {
        if message.contains("BTWV STATE,O") {
            bursts = message.contains("STATE,ON");
        }
        let Some((_, after)) = message.split_once("OFST,") else {
            continue;
        };
        let volts: f64 = after.split(',').next().unwrap().parse().unwrap();
        let (level_a, before_a) = (2.0 * volts, levels_a[levels_a.len() - 1]);
        if f64::abs(level_a - before_a) > 0.15 {
            assert!(
                !bursts,
                "{message}: the generator may stay at its old offset"
            );
            levels_a.push(level_a.round());
        }
    }
    let ramps = [
        0.0, -1.0, -2.0, -3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0, 2.0, 1.0, 0.0,
    ];
    assert_eq!(levels_a, ramps);
}

/// The voltage of the cell moves by more than the reserve of the range of channel 4.
#[test]
fn the_scope_follows_the_cell_while_its_charge_moves() {
    let bias = "bias = [\"5 A\"]\nresistance_max = \"20 mΩ\"\nbias_charge = \"4 %\"";
    let files = biased(1.0, 14, bias)
        .without(EXPERIMENT, "fixture_check")
        .edit(BENCH, "\"80 mV\"]", "\"14 mV\"]");
    let (finished, index, _) = run(&files);
    assert_eq!(index.sweeps[0].conditions.len(), 14);
    assert!(
        !finished.summary.contains("clipped"),
        "{}",
        finished.summary
    );
}

/// Ten benches with their own harness, or as many as `EIS_BENCH_SEEDS`, sweeps from 0.1 Hz to 300 Hz
/// under three currents.
#[test]
#[ignore = "drill"]
fn the_uncertainty_of_a_point_under_a_direct_current_covers_the_truth() {
    const START: f64 = 0.4;
    let bias = "bias = [\"2 A\", \"-5 A\", \"10 A\"]\nbias_charge = \"10 %\"\n\
        resistance_max = \"20 mΩ\"\norder = \"descending\"";
    let files = biased(0.1, 12, bias)
        .edit(EXPERIMENT, "periods = 11", "periods = 5")
        .edit(SCENARIO, "initial_soc = 0.60", "initial_soc = 0.40");
    let seeds = std::env::var("EIS_BENCH_SEEDS").map_or(10, |text| text.parse().unwrap());
    // By current and frequency.
    let mut covered: BTreeMap<(i32, u64), [usize; 2]> = BTreeMap::new();
    for seed in 1..=seeds {
        let mut experiment = files.load();
        experiment.seed = seed;
        let out = files.path(&format!("run{seed}"));
        let finished = run_experiment(&experiment, &out).unwrap();
        let index = fs::read_to_string(out.join("traces.json")).unwrap();
        let index: RunIndex = serde_json::from_str(&index).unwrap();
        let world = finished.simulation.as_ref().unwrap().world();
        let world = world.lock().unwrap();
        for (entry, spectrum) in index.sweeps.iter().zip(finished.measured.spectra()) {
            for (k, point) in spectrum.points.iter().enumerate() {
                let conditions = entry.conditions.get(k);
                let moved_coulomb = conditions.map_or(0.0, |at| at.charge_coulomb);
                let soc = START + moved_coulomb / (4.5 * 3600.0);
                let truth = world.truth_impedance_under(point.freq_hz, entry.bias_a, soc);
                let off_ohm = point.z_ohm - truth;
                for (off_ohm, variance) in [
                    (off_ohm.re, point.covariance.re_re),
                    (off_ohm.im, point.covariance.im_im),
                ] {
                    let [within, all] = covered
                        .entry((entry.bias_a as i32, (1e4 * point.freq_hz).round() as u64))
                        .or_default();
                    *within += usize::from(off_ohm.abs() <= 1.96 * variance.sqrt());
                    *all += 1;
                }
            }
        }
        let left = world.truth_soc() - START;
        eprintln!("seed {seed}: {:+.3} % of the charge", 100.0 * left);
        assert!(left.abs() < 1.0e-3, "seed {seed}: {left}");
    }
    let mut by_current: BTreeMap<i32, [usize; 2]> = BTreeMap::new();
    for ((bias_a, freq), [within, all]) in covered {
        let share = within as f64 / all as f64;
        eprintln!(
            "{bias_a:+} A, {} Hz: {:.1} % of {all}",
            1e-4 * freq as f64,
            100.0 * share
        );
        // 90 %, less three standard deviations of that number.
        let least = 0.9 - 3.0 * (0.09 / all as f64).sqrt();
        assert!(share >= least, "{bias_a} A, {freq}: {within} of {all}");
        let [sum, total] = by_current.entry(bias_a).or_default();
        (*sum, *total) = (*sum + within, *total + all);
    }
    for (bias_a, [within, all]) in by_current {
        let share = within as f64 / all as f64;
        eprintln!("{bias_a:+} A: {within} of {all} within 1.96 σ");
        assert!(
            (0.9..=0.99).contains(&share),
            "{bias_a} A: {within} of {all}"
        );
    }
}

/// A symmetric charge transfer is odd about rest and curved about a direct current.
#[test]
fn the_second_harmonic_of_a_symmetric_charge_transfer_appears_under_a_direct_current() {
    let bias = "bias = [\"0 A\", \"-10 A\"]\nbias_charge = \"20 %\"\nresistance_max = \"20 mΩ\"";
    let files = biased(5.0, 7, bias)
        .edit(EXPERIMENT, "amplitude = \"1 A\"", "amplitude = \"5 A\"")
        .append(SCENARIO, BUTLER_VOLMER);
    run(&files);
    let table = fs::read_to_string(files.path("run").join("harmonics.csv")).unwrap();
    // Weighted mean of the real part of the second harmonic, in its standard deviations.
    let second = |sweep: &str| {
        let (mut sum, mut weight) = (0.0, 0.0);
        for line in table.lines().skip(1) {
            let fields: Vec<&str> = line.split(',').collect();
            let number = |column: usize| fields[column].parse::<f64>().unwrap();
            if fields[0] == sweep && fields[4] == "2" {
                assert_eq!(fields[10], "V/A2");
                sum += number(5) / number(7).powi(2);
                weight += number(7).powi(-2);
            }
        }
        assert!(weight > 0.0, "{table}");
        sum / weight.sqrt()
    };
    let (rest, biased) = (second("1"), second("2"));
    eprintln!("second harmonic at rest {rest} σ, under -10 A {biased} σ");
    assert!(rest.abs() < 4.0, "{rest}");
    // The law flattens with the current.
    assert!(biased > 5.0, "{biased}");
}
