use super::fit::not_borne;
use super::*;
use crate::fit::Bounds;
use analysis_files::formats::{SeriesOptions, read_series, read_sourced};
use analysis_model::{
    model::{Erm, RcBranch},
    ocv::{OcvCurve, OcvOptions, extract},
};
use analysis_numeric::{Covariance2, Rng};
use analysis_signal::{
    series::TimeSeries,
    spectrum::{ImpedancePoint, Origin, SourcedSpectrum, Spectrum},
};
use num_complex::Complex64;
use std::path::PathBuf;

/// The cell of the tests: R, and (R, τ) of its branches.
const R: f64 = 0.0065;
const BRANCHES: [(f64, f64); 3] = [(0.0015, 0.004), (0.001, 0.4), (0.004, 15.0)];

fn truth() -> Erm {
    Erm {
        r_ohm: R,
        branches: BRANCHES
            .iter()
            .map(|(r, tau)| RcBranch {
                r_ohm: *r,
                c_f: tau / r,
            })
            .collect(),
    }
}

fn curve() -> OcvCurve {
    OcvCurve::monotone(
        4.0,
        vec![0.0, 0.2, 0.5, 0.8, 1.0],
        vec![2.9, 3.45, 3.72, 4.0, 4.2],
    )
    .unwrap()
}

/// Voltage of the cell at 1 A with pulses of 2 A for 10 s every 600 s, integrated by Runge and
/// Kutta's fourth order in steps of 1 ms: knows nothing of step responses. Sampled every 0.5 s, in
/// pulses every 0.2 s, and 0.1 s before each edge; white noise.
fn pulsed(gain: f64, noise_v: f64, seed: u64) -> TimeSeries {
    let curve = curve();
    let current = |t: f64| {
        if (300.0..310.0).contains(&(t % 600.0)) {
            2.0
        } else {
            1.0
        }
    };
    let mut state: Vec<f64> = BRANCHES.iter().map(|(r, _)| r * gain).collect();
    let (mut drawn, h, mut rng) = (0.0, 1e-3, Rng::new(seed));
    let mut s = TimeSeries {
        name: "pulsed".to_owned(),
        time_s: vec![],
        current_a: vec![],
        voltage_v: vec![],
        temperature_degc: None,
    };
    for k in 0..3_000_000u32 {
        let t = f64::from(k) * h;
        let i = current(t + 1e-9);
        let (fast, phase) = (i > 1.5, k % 600_000);
        // The last sample before an edge is 0.1 s before it, the next 0.1 s after.
        let due = if fast {
            phase % 200 == 100
        } else {
            phase % 500 == 400 && phase != 299_900 && phase != 310_000
        } || phase == 299_900;
        if due {
            let ocv = curve.voltage_v(0.75 - drawn / (3600.0 * curve.capacity_ah));
            s.time_s.push(t);
            s.current_a.push(i);
            s.voltage_v
                .push(ocv - gain * i * R - state.iter().sum::<f64>() + noise_v * rng.normal());
        }
        for (v, (r, tau)) in state.iter_mut().zip(BRANCHES) {
            let f = |v: f64| (gain * r * i - v) / tau;
            let k1 = f(*v);
            let k2 = f(*v + 0.5 * h * k1);
            let k3 = f(*v + 0.5 * h * k2);
            let k4 = f(*v + h * k3);
            *v += h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4);
        }
        drawn += i * h;
    }
    s
}

/// Sweeps of five cells five times: cells differ by a factor of 0.8 %, sweeps scatter by 0.2 %. The
/// impedance is that of admittances in parallel.
fn sweeps(seed: u64) -> Vec<SourcedSpectrum> {
    let mut rng = Rng::new(seed);
    let mut all = Vec::new();
    for cell in 0..5 {
        let factor = 1.0 + 0.008 * [-1.2, -0.4, 0.1, 0.5, 1.0][cell];
        for repeat in 0..5 {
            let point = |k: i32| {
                let freq_hz = 0.1 * 3000f64.powf(f64::from(k) / 20.0);
                let w = std::f64::consts::TAU * freq_hz;
                let branch = |(r, tau): &(f64, f64)| Complex64::new(1.0 / r, w * tau / r).inv();
                let z = R + BRANCHES.iter().map(branch).sum::<Complex64>();
                let scatter = Complex64::new(1.0 + 0.002 * rng.normal(), 0.002 * rng.normal());
                ImpedancePoint {
                    freq_hz,
                    z_ohm: z * factor * scatter,
                    covariance: Covariance2::UNKNOWN,
                    amplitude_a: 1.0,
                }
            };
            let spectrum = Spectrum {
                name: format!("cell{cell}_{repeat}"),
                points: (0..20).map(point).collect(),
                ..Spectrum::default()
            };
            all.push(SourcedSpectrum {
                origin: Origin::default(),
                spectrum,
                flagged: Vec::new(),
            });
        }
    }
    all
}

struct Case {
    series: TimeSeries,
    noise: NoiseModel,
    curve: OcvCurve,
    windows: Vec<PulseWindow>,
    pooled: PooledSpectrum,
}

impl Case {
    fn new(series: TimeSeries, curve: OcvCurve, pooled: PooledSpectrum) -> Self {
        let pulses = find_pulses(&series, &PulseOptions::default());
        let noise = NoiseModel::measure(&series, &pulses).unwrap();
        let numbered = pulses.into_iter().enumerate().map(|(k, p)| (k + 1, p));
        let windows = numbered
            .filter_map(|(number, pulse)| {
                PulseWindow::new(
                    &series,
                    &noise,
                    &curve,
                    number,
                    pulse,
                    0.0135,
                    &WindowOptions::default(),
                )
            })
            .collect();
        Self {
            series,
            noise,
            curve,
            windows,
            pooled,
        }
    }

    fn source(&self) -> Source<'_> {
        Source {
            series: &self.series,
            noise: &self.noise,
            curve: &self.curve,
        }
    }
}

fn synthetic(seed: u64) -> Case {
    Case::new(
        pulsed(1.01, 2e-4, seed),
        curve(),
        PooledSpectrum::new(&sweeps(seed + 100)).unwrap(),
    )
}

#[test]
fn the_joint_fit_finds_the_cell_and_pins_the_dc_resistance() {
    let case = synthetic(1);
    assert_eq!(case.windows.len(), 5);
    assert!(
        (case.noise.sample_v() / 2e-4 - 1.0).abs() < 0.1,
        "{}",
        case.noise.sample_v()
    );
    assert!(
        (case.pooled.cell_spread.unwrap() / 0.0068 - 1.0).abs() < 0.2 && case.pooled.cells == 5,
        "{:?}",
        case.pooled.cell_spread
    );
    assert!(
        (case.pooled.repeatability.unwrap() / 0.002 - 1.0).abs() < 0.1,
        "{:?}",
        case.pooled.repeatability
    );
    let options = JointOptions {
        rc: 3,
        starts: 16,
        ..JointOptions::default()
    };
    let joint = fit_joint(
        &JointInput {
            spectrum: &case.pooled,
            windows: &case.windows,
        },
        &options,
    )
    .unwrap();
    let truth = truth();
    assert!(joint.reduced_chi2 < 1.6, "{}", joint.reduced_chi2);
    let within = |name: &str, met: f64, expected: f64, sigma: Option<f64>| {
        let sigma = sigma.unwrap();
        assert!(
            (met - expected).abs() < 3.5 * sigma,
            "{name}: {met} ± {sigma}, expected {expected}"
        );
    };
    within("R", joint.erm.r_ohm, R, joint.sigma.r_ohm);
    for (k, (met, expected)) in joint.erm.branches.iter().zip(&truth.branches).enumerate() {
        within(
            &format!("R{}", k + 1),
            met.r_ohm,
            expected.r_ohm,
            joint.sigma.branches[k].r_ohm,
        );
        within(
            &format!("C{}", k + 1),
            met.c_f,
            expected.c_f,
            joint.sigma.branches[k].c_f,
        );
    }
    within(
        "DC resistance",
        joint.dc_resistance_ohm,
        truth.dc_resistance_ohm(),
        joint.sigma.dc_resistance_ohm,
    );
    within("gain", joint.gain, 1.01, joint.gain_sigma);
    let spectra = fit_spectra(&case.pooled, &options).unwrap();
    let (wide, narrow) = (
        spectra.sigma.dc_resistance_ohm.unwrap_or(f64::INFINITY),
        joint.sigma.dc_resistance_ohm.unwrap(),
    );
    assert!(wide > 5.0 * narrow, "spectra alone {wide}, joint {narrow}");
    assert!(joint.starts.0 >= 5, "{:?}", joint.starts);
}

#[test]
fn the_stated_uncertainty_of_the_dc_resistance_is_that_of_repetition() {
    let options = JointOptions {
        rc: 3,
        starts: 4,
        ..JointOptions::default()
    };
    let expected = truth().dc_resistance_ohm();
    let mut normalised = Vec::new();
    for seed in 10..18 {
        let case = synthetic(seed);
        let joint = fit_joint(
            &JointInput {
                spectrum: &case.pooled,
                windows: &case.windows,
            },
            &options,
        )
        .unwrap();
        normalised
            .push((joint.dc_resistance_ohm - expected) / joint.sigma.dc_resistance_ohm.unwrap());
    }
    let rms = (normalised.iter().map(|n| n * n).sum::<f64>() / normalised.len() as f64).sqrt();
    // χ² of 8: 99.8 % lie within 0.33…1.81.
    assert!((0.33..1.81).contains(&rms), "{normalised:?}");
}

#[test]
fn a_pulse_shows_the_resistance_of_its_cell() {
    let case = synthetic(2);
    let joint = fit_joint(
        &JointInput {
            spectrum: &case.pooled,
            windows: &case.windows,
        },
        &JointOptions {
            rc: 3,
            ..JointOptions::default()
        },
    )
    .unwrap();
    for gap in gaps(&case.source(), &case.windows, &joint, &[2.4, 9.0]) {
        for at in &gap.at {
            // The edge is 0.1 s after the last sample; 2 A draw down the OCV at its slope.
            let since = at.time_s - 0.1;
            let answer: f64 = R + BRANCHES
                .iter()
                .map(|(r, tau)| r * (1.0 - (-since / tau).exp()))
                .sum::<f64>();
            let fall = 2.0 * at.time_s / (3600.0 * 4.0) * curve().slope_v(gap.soc);
            let expected = 1.01 * answer + fall;
            assert!(
                (at.measured_ohm - expected).abs() < 4.0 * at.measured_sigma_ohm + 2e-5,
                "{at:?}, expected {expected}"
            );
            assert!(
                (at.predicted_ohm - expected).abs() < 5e-5,
                "{at:?}, expected {expected}"
            );
        }
        assert!(gap.rms_v < 3e-4 && gap.relaxation_rms_v < 3e-4, "{gap:?}");
    }
}

#[test]
fn answers_to_steps_have_the_slopes_they_state() {
    let erm = truth();
    let x = erm.log_parameters();
    for time_s in [0.001, 0.3, 7.0, 100.0] {
        let mut slopes = vec![0.0; x.len()];
        let (value, rate) = response::add_step(&erm, time_s, 2.0, &mut slopes);
        assert!((value - 2.0 * step_resistance_ohm(&erm, time_s)).abs() < 1e-15);
        let h = 1e-6;
        let moved = |i: usize, h: f64| {
            let mut y = x.clone();
            y[i] += h;
            2.0 * step_resistance_ohm(&Erm::from_log_parameters(&y).unwrap(), time_s)
        };
        for (i, slope) in slopes.iter().enumerate() {
            let quotient = (moved(i, h) - moved(i, -h)) / (2.0 * h);
            assert!(
                (quotient - slope).abs() < 1e-9,
                "parameter {i} at {time_s} s: {slope} against {quotient}"
            );
        }
        let dt = 1e-6 * time_s;
        let quotient =
            (step_resistance_ohm(&erm, time_s + dt) - step_resistance_ohm(&erm, time_s - dt)) / dt;
        assert!((quotient - rate).abs() < 1e-6 * rate.abs() + 1e-9);
    }
    assert_eq!(step_resistance_ohm(&erm, -1.0), 0.0);
}

#[test]
fn the_likelihood_has_the_gradient_it_states() {
    use analysis_numeric::Smooth;
    let case = synthetic(4);
    let likelihood = problem::Likelihood {
        spectrum: &case.pooled,
        factor: case.pooled.factor().unwrap(),
        windows: &case.windows[..2],
        gain_sigma: 0.013,
    };
    let mut x = truth().log_parameters();
    x.iter_mut()
        .enumerate()
        .for_each(|(k, v)| *v += 0.02 * (k as f64).sin());
    x.extend([0.015, 0.4]);
    let n = x.len();
    let (mut gradient, mut hessian) = (vec![0.0; n], vec![0.0; n * n]);
    let value = likelihood.expand(&x, &mut gradient, &mut hessian);
    assert!((likelihood.value(&x) / value - 1.0).abs() < 1e-9);
    for i in 0..n {
        let moved = |h: f64| {
            let mut y = x.clone();
            y[i] += h;
            likelihood.value(&y)
        };
        let quotient = (moved(1e-5) - moved(-1e-5)) / 2e-5;
        assert!(
            (quotient - gradient[i]).abs() < 1e-4 * (gradient[i].abs() + 1.0),
            "parameter {i}: {} against {quotient}",
            gradient[i]
        );
    }
}

#[test]
fn noise_that_does_not_average_away_is_not_promised_to() {
    let mut series = pulsed(1.0, 2e-4, 3);
    let pulses = find_pulses(&series, &PulseOptions::default());
    let white = NoiseModel::measure(&series, &pulses).unwrap();
    assert!((white.variance_v2(16) * 16.0 / 4e-8 - 1.0).abs() < 0.4);
    // A wander of 25 s beside it.
    for (v, t) in series.voltage_v.iter_mut().zip(&series.time_s) {
        *v += 2e-4 * (t / 4.0).sin();
    }
    let wandering = NoiseModel::measure(&series, &pulses).unwrap();
    assert!(
        wandering.floor_v() > 2.0 * white.floor_v(),
        "{} against {}",
        wandering.floor_v(),
        white.floor_v()
    );
    assert_eq!(wandering.variance_v2(1000), wandering.variance_v2(32));
    assert!(NoiseModel::measure(&series, &[]).is_none());
}

#[test]
fn pulses_without_steady_current_around_them_are_left_out() {
    let current = |t: f64| {
        if t < 5.0 || (100.0..110.0).contains(&t) || t > 150.0 {
            2.0
        } else {
            0.0
        }
    };
    let time_s: Vec<f64> = (0..400).map(|k| 0.5 * f64::from(k)).collect();
    let mut current_a: Vec<f64> = time_s.iter().map(|t| current(*t)).collect();
    current_a[200] = 1.0;
    let series = TimeSeries {
        name: "s".to_owned(),
        voltage_v: vec![3.7; 400],
        time_s,
        current_a,
        temperature_degc: None,
    };
    let found = find_pulses(&series, &PulseOptions::default());
    assert_eq!(found.len(), 1);
    let pulse = &found[0];
    // The sample on the slope belongs to neither side.
    assert_eq!(
        (pulse.before.end, pulse.during.clone(), pulse.after.start),
        (200, 201..220, 220)
    );
    assert_eq!(
        (pulse.current_a, pulse.edges_s[0]),
        ([0.0, 2.0, 0.0], (99.5, 100.5))
    );
    assert!(
        find_pulses(
            &series,
            &PulseOptions {
                before_s: 200.0,
                ..PulseOptions::default()
            }
        )
        .is_empty()
    );
}

#[test]
fn a_pulse_is_seen_where_its_record_has_a_sample_a_second() {
    let current = |t: f64| {
        if (200.0..240.0).contains(&t) {
            2.0
        } else {
            0.0
        }
    };
    let seen = |sampling_s: f64| {
        let count = (400.0 / sampling_s) as usize;
        let time_s: Vec<f64> = (0..count).map(|k| sampling_s * k as f64).collect();
        let current_a = time_s.iter().map(|t| current(*t)).collect();
        let series = TimeSeries {
            name: "s".to_owned(),
            voltage_v: vec![3.7; count],
            time_s,
            current_a,
            temperature_degc: None,
        };
        let found = find_pulses(&series, &PulseOptions::default());
        assert_eq!(found.len(), 1, "{sampling_s} s");
        (found[0].is_seen(&series), found[0].sampling_s(&series))
    };
    assert!(seen(0.1).0 && seen(1.0).0);
    assert_eq!((seen(2.0), seen(10.0)), ((false, 2.0), (false, 10.0)));
}

#[test]
fn an_order_that_the_data_do_not_bear_is_named_and_not_chosen() {
    let bounds = Bounds {
        r_ohm: (1e-5, 0.1),
        c_f: (0.01, 1e6),
    };
    let erm = |branches: &[(f64, f64)]| Erm {
        r_ohm: R,
        branches: branches
            .iter()
            .map(|(r_ohm, c_f)| RcBranch {
                r_ohm: *r_ohm,
                c_f: *c_f,
            })
            .collect(),
    };
    assert!(not_borne(&truth(), &bounds).is_empty());
    let words = not_borne(&erm(&[(0.001, 10.0), (0.1, 1e5), (0.1, 1e5)]), &bounds);
    let reported = |words: &[String], text: &str| words.iter().any(|w| w.contains(text));
    assert!(
        reported(&words, "R2 is at one of its bounds (1.000e-1 Ω)")
            && reported(&words, "R3 is at one of its bounds"),
        "{words:?}"
    );
    assert!(
        reported(
            &words,
            "branches 2 and 3 have one time constant (1.000e4 s): they are one branch"
        ),
        "{words:?}"
    );
    assert_eq!(words.len(), 3);
    let pooled = PooledSpectrum::new(&sweeps(1)).unwrap();
    let one = fit_spectra(
        &pooled,
        &JointOptions {
            rc: 1,
            starts: 4,
            ..JointOptions::default()
        },
    )
    .unwrap();
    let more = JointFit {
        erm: truth(),
        spectrum_chi2: (1.0, one.spectrum_chi2.1),
        ..one.clone()
    };
    assert_eq!(choose_order(&[one.clone(), more.clone()]), Some(3));
    let double = JointFit {
        not_borne: words,
        ..more
    };
    assert_eq!(choose_order(&[one.clone(), double.clone()]), Some(1));
    // Where no order is borne the best is taken, and its warnings say so.
    assert_eq!(
        choose_order(&[
            JointFit {
                not_borne: vec!["R1".to_owned()],
                ..one
            },
            double
        ]),
        Some(3)
    );
}

#[test]
fn spectra_that_do_not_belong_together_are_refused() {
    assert_eq!(
        PooledSpectrum::new(&[]).unwrap_err().to_string(),
        "expected at least one spectrum with points, met none"
    );
    let mut two = sweeps(1)[..2].to_vec();
    two[1].spectrum.points.pop();
    let text = "spectrum \"cell0_1\": expected the 20 frequencies of \"cell0_0\", met others (19)";
    assert_eq!(PooledSpectrum::new(&two).unwrap_err().to_string(), text);
    let one = PooledSpectrum::new(&sweeps(1)[..1]).unwrap();
    assert_eq!((one.cell_spread, one.repeatability), (None, None));
    assert!(
        one.basis.starts_with("assumed, 0.5 % of |Z|"),
        "{}",
        one.basis
    );
    let error = fit_spectra(
        &one,
        &JointOptions {
            rc: 9,
            ..JointOptions::default()
        },
    )
    .unwrap_err();
    assert_eq!(
        error.to_string(),
        "joint fit: expected 1 to 8 RC branches, met 9"
    );
}

fn shared() -> Option<PathBuf> {
    let beside = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared"));
    let folder = std::env::var_os("EIS_BENCH_SHARED")
        .map_or(beside, PathBuf::from)
        .join("data/p45b");
    if folder.is_dir() {
        return Some(folder);
    }
    eprintln!("skipped: no measured data at {}", folder.display());
    None
}

fn measured(folder: &std::path::Path) -> Case {
    let read = |name: &str| {
        read_series(
            &folder.join("cycler_25C").join(name),
            &SeriesOptions::default(),
        )
        .unwrap()
    };
    let slow = extract(
        &read("2023_08_25-13_19_52_discharge_1A.csv"),
        None,
        &OcvOptions::default(),
    )
    .unwrap();
    assert!(
        (slow.capacity_ah - 4.2).abs() < 0.01,
        "{}",
        slow.capacity_ah
    );
    let names = (0..5).flat_map(|c| (0..5).map(move |r| format!("eis/cell{c}_{r}.csv")));
    let spectra: Vec<SourcedSpectrum> = names
        .flat_map(|n| read_sourced(&folder.join(n)).unwrap())
        .collect();
    Case::new(
        read("2023_08_29-14_19_21_discharge_1A_pulse_2A.csv"),
        slow.curve,
        PooledSpectrum::new(&spectra).unwrap(),
    )
}

#[test]
fn the_p45bs_pulses_are_as_measured_and_the_joint_fit_closes_the_gap() {
    let Some(folder) = shared() else { return };
    let mut case = measured(&folder);
    assert_eq!(
        case.windows.len(),
        9,
        "the tenth pulse comes in the first second"
    );
    let middle = case
        .windows
        .iter()
        .position(|w| (w.ocv_v - 0.0135 - 3.718).abs() < 0.002)
        .unwrap();
    for (time_s, expected) in [(0.2, 8.5e-3), (2.4, 10.9e-3), (10.0, 13.8e-3)] {
        let met = apparent(
            &case.series,
            &case.windows[middle].pulse,
            time_s,
            &case.noise,
        )
        .unwrap();
        assert!(
            (met.resistance_ohm / expected - 1.0).abs() < 0.05,
            "{met:?}, expected {expected} Ω"
        );
    }
    case.windows.retain(|w| (w.ocv_v - 3.72).abs() < 0.2);
    let train: Vec<PulseWindow> = case.windows.iter().step_by(2).cloned().collect();
    let held: Vec<PulseWindow> = case.windows.iter().skip(1).step_by(2).cloned().collect();
    assert_eq!((train.len(), held.len()), (3, 2));
    let rms = |g: &[Gap]| (g.iter().map(|g| g.rms_v.powi(2)).sum::<f64>() / g.len() as f64).sqrt();
    let mut after_10_s = Vec::new();
    for rc in [4, 6] {
        let options = JointOptions {
            rc,
            starts: 6,
            ..JointOptions::default()
        };
        let alone = fit_spectra(&case.pooled, &options).unwrap();
        let joint = fit_joint(
            &JointInput {
                spectrum: &case.pooled,
                windows: &train,
            },
            &options,
        )
        .unwrap();
        let before = gaps(&case.source(), &held, &alone, &[10.0]);
        let after = gaps(&case.source(), &held, &joint, &[10.0]);
        assert!(
            rms(&after) < 0.8 * rms(&before),
            "{rc} RC, held out: {} V, then {} V",
            rms(&before),
            rms(&after)
        );
        after_10_s.push((alone.step_resistance[0].1, joint.step_resistance[0].1));
    }
    let wander = |a: f64, b: f64| (a / b - 1.0).abs();
    let (four, six) = (after_10_s[0], after_10_s[1]);
    assert!(
        wander(four.1, six.1) < 0.03 && wander(four.0, six.0) > 0.05,
        "resistance after 10 s, Ω: {after_10_s:?}"
    );
}
