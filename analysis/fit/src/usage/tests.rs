//! Records of simulated cells whose impedance is known.

use analysis_model::model::{Erm, RcBranch};
use analysis_numeric::Rng;

use super::*;

fn cell(factor: f64) -> Erm {
    let branch = |r_ohm: f64, tau_s: f64| RcBranch {
        r_ohm: factor * r_ohm,
        c_f: tau_s / (factor * r_ohm),
    };
    Erm {
        r_ohm: 0.008 * factor,
        branches: vec![branch(0.002, 0.03), branch(0.003, 2.0)],
    }
}

/// A logger: interval, jitter of the stamps, step of the voltage, noise of the current.
struct Logger {
    interval_s: f64,
    jitter_s: f64,
    lsb_v: f64,
    noise_a: f64,
    /// Delay of the current, s.
    delay_s: f64,
    /// Time constant of the current's low-pass, s.
    low_pass_s: f64,
}

const BMS: Logger = Logger {
    interval_s: 0.01,
    jitter_s: 0.001,
    lsb_v: 1e-3,
    noise_a: 0.02,
    delay_s: 0.0,
    low_pass_s: 0.0,
};

/// Steps of a load as a robot draws them: each lasts 50 ms to 1 s.
fn record(cells: &[Erm], seconds: f64, logger: &Logger, load_a: f64, seed: u64) -> UsageRecord {
    let mut rng = Rng::new(seed);
    let rows = (seconds / logger.interval_s) as usize;
    let fine = 4;
    let mut shown_a = vec![0.0];
    let mut passed_a = 0.0;
    let step_s = logger.interval_s / f64::from(fine);
    let mut states = vec![[0.0; 2]; cells.len()];
    let (mut level_a, mut until_s) = (0.0, 0.0);
    let (mut time_s, mut current_a) = (Vec::new(), Vec::new());
    let mut voltages = vec![Vec::new(); cells.len()];
    for row in 0..rows {
        let jitter_s = logger.jitter_s * (rng.uniform() - 0.5);
        for part in 0..fine {
            let t_s = row as f64 * logger.interval_s + f64::from(part) * step_s;
            if t_s >= until_s {
                level_a = load_a * rng.uniform();
                until_s = t_s + 0.05 + 0.95 * rng.uniform();
            }
            if logger.low_pass_s > 0.0 {
                passed_a += (level_a - passed_a) * -(-step_s / logger.low_pass_s).exp_m1();
            } else {
                passed_a = level_a;
            }
            shown_a.push(passed_a);
            for (state, erm) in states.iter_mut().zip(cells) {
                for (v, branch) in state.iter_mut().zip(&erm.branches) {
                    let fade = (-step_s / branch.time_constant_s()).exp();
                    *v = *v * fade + branch.r_ohm * level_a * (1.0 - fade);
                }
            }
        }
        time_s.push(row as f64 * logger.interval_s + jitter_s);
        let late = (logger.delay_s / step_s).round() as usize;
        let shown = shown_a[(shown_a.len() - 1).saturating_sub(late)];
        current_a.push(shown + logger.noise_a * rng.normal());
        for (k, (erm, state)) in cells.iter().zip(&states).enumerate() {
            // Open-circuit voltages that differ and fall.
            let ocv_v = 3.7 + 0.003 * k as f64
                - 1e-4 * (1.0 + 0.05 * k as f64) * row as f64 * logger.interval_s;
            let v = ocv_v - erm.r_ohm * level_a - state[0] - state[1] + 2e-4 * rng.normal();
            voltages[k].push((v / logger.lsb_v).round() * logger.lsb_v);
        }
    }
    let cells = voltages
        .into_iter()
        .enumerate()
        .map(|(k, voltage_v)| CellVoltage {
            name: format!("cell {}", k + 1),
            voltage_v,
        });
    UsageRecord {
        time_s,
        current_a,
        cells: cells.collect(),
    }
}

#[test]
fn the_impedance_of_a_robots_log_lies_within_its_interval_and_quiet_bands_are_refused() {
    let (mut inside, mut all) = (0, 0);
    for seed in 0..12 {
        let logged = record(&[cell(1.0)], 300.0, &BMS, 30.0, seed);
        let found = usage(&logged).unwrap();
        let spectrum = &found.cells[0].spectrum;
        assert!(
            spectrum.points.len() >= 8,
            "{} points",
            spectrum.points.len()
        );
        for point in &spectrum.points {
            let truth = cell(1.0).impedance(point.freq_hz);
            let off = point.z_ohm - truth;
            let sigma = point.covariance.re_re.sqrt();
            inside +=
                usize::from(off.re.abs() < 1.96 * sigma) + usize::from(off.im.abs() < 1.96 * sigma);
            all += 2;
        }
        let [change, sigma] = found.cells[0].change.unwrap();
        assert!(change.abs() < 5.0 * sigma + 0.01, "{change} ± {sigma}");
    }
    let share = inside as f64 / f64::from(all);
    assert!(share > 0.9, "{share} lie within 95 %");
}

#[test]
fn a_lag_of_the_current_is_found_and_taken_out() {
    for (delay_s, low_pass_s, kind) in [
        (0.01, 0.0, LagKind::Delay),
        (0.03, 0.0, LagKind::Delay),
        (0.0, 0.01, LagKind::LowPass),
        (0.0, 0.03, LagKind::LowPass),
    ] {
        let logger = Logger {
            delay_s,
            low_pass_s,
            ..BMS
        };
        let logged = record(&[cell(1.0)], 300.0, &logger, 30.0, 7);
        let found = usage(&logged).unwrap();
        let lag = found.lag.unwrap();
        let truth_s = delay_s + low_pass_s;
        let off_s = (lag.lag_s - truth_s).abs();
        assert_eq!(lag.kind, kind, "{lag:?} of {truth_s}");
        assert!(off_s < 0.001 + 2.0 * lag.sigma_s, "{lag:?} of {truth_s}");
        assert!(
            lag.sigma_s < 0.001 || kind == LagKind::LowPass,
            "{lag:?} of {truth_s}"
        );
        for point in &found.cells[0].spectrum.points {
            let truth = cell(1.0).impedance(point.freq_hz);
            let off = (point.z_ohm - truth).norm() / truth.norm();
            let both = point.covariance.re_re + point.covariance.im_im;
            let sigma = both.sqrt() / truth.norm();
            assert!(
                off < 0.03 + 3.0 * sigma && sigma <= 0.12,
                "{off} ± {sigma} at {} Hz behind {lag:?}",
                point.freq_hz
            );
        }
    }
}

#[test]
fn a_current_that_is_not_late_has_no_lag() {
    let lags = (0..12).filter_map(|seed| {
        let found = usage(&record(&[cell(1.0)], 300.0, &BMS, 30.0, seed)).unwrap();
        found.lag.map(|lag| lag.lag_s)
    });
    // The load changes between the rows, which looks like a small lag.
    let lags: Vec<f64> = lags.collect();
    assert!(
        lags.iter().all(|lag_s| lag_s.abs() < 0.1 * BMS.interval_s),
        "{lags:?}"
    );
}

/// Noise of the current sensor lowers the impedance; where it is a tenth of the current's power or more,
/// nothing is stated.
#[test]
fn noise_of_the_current_is_not_a_smaller_impedance() {
    for (load_a, noise_a) in [(2.0, 0.2), (5.0, 0.2), (30.0, 0.5)] {
        let noisy = Logger { noise_a, ..BMS };
        let logged = record(&[cell(1.0)], 600.0, &noisy, load_a, 3);
        let Ok(found) = usage(&logged) else {
            continue;
        };
        for point in &found.cells[0].spectrum.points {
            let truth = cell(1.0).impedance(point.freq_hz).norm();
            let off = point.z_ohm.norm() / truth - 1.0;
            let sigma = point.magnitude_sigma_ohm() / truth;
            assert!(
                off.abs() < 0.12 && off.abs() < 4.0 * sigma,
                "{off} ± {sigma} at {} Hz, {load_a} A",
                point.freq_hz
            );
        }
    }
}

#[test]
fn a_log_without_any_current_names_the_frequencies_that_it_lacks() {
    let still = Logger {
        noise_a: 0.0,
        ..BMS
    };
    let logged = record(&[cell(1.0)], 120.0, &still, 0.0, 1);
    let error = usage(&logged).unwrap_err().to_string();
    assert!(!error.contains("NaN"), "{error}");
}

#[test]
fn a_current_that_does_not_change_gives_no_impedance() {
    let quiet = Logger {
        noise_a: 0.05,
        ..BMS
    };
    let logged = record(&[cell(1.0)], 120.0, &quiet, 0.0, 1);
    let error = usage(&logged).unwrap_err().to_string();
    assert!(
        error.contains("known to 10 %") && error.contains("found none from"),
        "{error}"
    );
}

/// Sixteen cells whose resistances scatter, the sixth with an excess.
fn cells(excess: f64, rng: &mut Rng) -> Vec<Erm> {
    (0..16)
        .map(|k| {
            let own = 1.0 + 0.005 * rng.normal();
            cell(if k == 5 { own * (1.0 + excess) } else { own })
        })
        .collect()
}

#[test]
fn a_weak_cell_is_named_and_a_healthy_string_has_no_suspect() {
    let (mut named, mut wrong, mut accused) = (0, 0, 0);
    let strings = 60;
    for seed in 0..strings {
        let mut rng = Rng::new(1000 + seed);
        let weak = usage(&record(&cells(0.05, &mut rng), 60.0, &BMS, 30.0, seed)).unwrap();
        for cell in weak.string.iter().filter(|cell| cell.weak) {
            if cell.name == "cell 6" {
                named += 1;
                assert!((cell.excess - 0.05).abs() < 0.02, "{cell:?}");
            } else {
                wrong += 1;
            }
        }
        let healthy = usage(&record(&cells(0.0, &mut rng), 60.0, &BMS, 30.0, seed + 500)).unwrap();
        accused += usize::from(healthy.string.iter().any(|cell| cell.weak));
    }
    assert!(
        named >= 57,
        "the weak cell was named in {named} of {strings}"
    );
    assert_eq!(wrong, 0);
    assert!(
        accused <= 2,
        "{accused} of {strings} healthy strings accuse a cell"
    );
}

#[test]
fn a_gap_divides_a_record_and_invalid_rows_are_named() {
    let mut logged = record(&[cell(1.0)], 120.0, &BMS, 30.0, 3);
    let rows = logged.time_s.len();
    logged.time_s[rows / 2..]
        .iter_mut()
        .for_each(|t| *t += 1000.0);
    let found = usage(&logged).unwrap();
    assert!((found.length_s - 120.0).abs() < 1.0, "{}", found.length_s);
    logged.time_s[10] = logged.time_s[9];
    assert!(
        usage(&logged)
            .unwrap_err()
            .to_string()
            .starts_with("row 11 ")
    );
    logged.time_s.truncate(100);
    assert!(
        usage(&logged)
            .unwrap_err()
            .to_string()
            .contains("found 100")
    );
}
