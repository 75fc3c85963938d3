//! The correction of the harness against a bench of closed formulas.

use analysis::{
    calibration::{
        COMMON, ControlTolerance, Controls, Correction, CorrectionModes, KnownImpedance, Priors,
        check_control,
    },
    numeric::Covariance2,
    spectrum::{ChannelPhasors, ImpedancePoint, PhasorVariance, Spectrum, raw_impedance},
};
use num_complex::Complex64;

use crate::bench::{Bench, FAKE_CELL, Probes, SHUNT, cell, fake_cell};
use crate::noise::Noise;

/// Returns a known impedance as measured by an ohmmeter of 0.1 % and a ruler.
fn known((r_ohm, l_h): (f64, f64), noise: &mut Noise) -> KnownImpedance {
    let (r_sigma_ohm, l_sigma_h) = (1e-3 * r_ohm, 10e-9);
    KnownImpedance {
        r_ohm: r_ohm + r_sigma_ohm * noise.gauss(),
        r_sigma_ohm,
        l_h: l_h + l_sigma_h * noise.gauss(),
        l_sigma_h,
    }
}

fn exactly((r_ohm, l_h): (f64, f64)) -> KnownImpedance {
    KnownImpedance {
        r_ohm,
        r_sigma_ohm: 0.0,
        l_h,
        l_sigma_h: 0.0,
    }
}

struct Runs {
    shunt: Vec<ChannelPhasors>,
    fake: Vec<ChannelPhasors>,
    cell: Vec<ChannelPhasors>,
}

fn runs(bench: &Bench, noise: &mut Noise) -> Runs {
    Runs {
        shunt: bench.sweep(Probes::OnShunt, fake_cell, noise),
        fake: bench.sweep(Probes::OnJig, fake_cell, noise),
        cell: bench.sweep(Probes::OnJig, cell, noise),
    }
}

fn crooked() -> Bench {
    Bench {
        gains: [1.004, 0.994, 1.003],
        skews_s: [0.4e-6, -0.7e-6, 0.9e-6],
        mutual_shunt_h: 0.25e-6,
        mutual_jig_h: -0.4e-6,
        ..Bench::ideal()
    }
}

fn errors(correction: &Correction, cells: &[ChannelPhasors]) -> Vec<(ImpedancePoint, Complex64)> {
    let of = |phasors: &ChannelPhasors| {
        let point = correction.apply(phasors);
        (point, point.z_ohm - cell(phasors.freq_hz))
    };
    cells.iter().map(of).collect()
}

fn worst(errors: &[(ImpedancePoint, Complex64)]) -> f64 {
    errors
        .iter()
        .map(|(point, error)| error.norm() / point.z_ohm.norm())
        .fold(0.0, f64::max)
}

#[test]
fn a_crooked_bench_is_set_right() {
    let mut noise = Noise::new(1);
    let runs = runs(&crooked(), &mut noise);
    let shunt = exactly(SHUNT);
    let controls = Controls {
        current_shunt: shunt,
        shunt: &runs.shunt,
        fake_cell: Some((exactly(FAKE_CELL), &runs.fake)),
        short: None,
        open: None,
        priors: Priors::default(),
    };
    let correction = Correction::fit(&controls).unwrap();
    let errors = errors(&correction, &runs.cell);
    // Remaining error: skews act on the cell a little differently than on the fake cell, by 1 µs ·
    // 6 mΩ · ω.
    assert!(worst(&errors) < 2e-3, "{}", worst(&errors));
    assert!(errors.iter().all(|(point, error)| error.norm()
        < 4.0 * (point.covariance.re_re + point.covariance.im_im).sqrt()));
    let uncorrected = runs.cell.iter().map(|p| {
        (raw_impedance(p, SHUNT.0).z_ohm - cell(p.freq_hz)).norm() / cell(p.freq_hz).norm()
    });
    assert!(
        uncorrected.fold(0.0, f64::max) > 0.05,
        "the bench is crooked"
    );
    assert_eq!((correction.dof, correction.noise_factor), (120, 1.0));
    let (low, high) = correction.span_hz.unwrap();
    assert!(low == 0.1 && (high - 300.0).abs() < 1e-9);
}

#[test]
fn a_factor_found_on_the_shunt_is_wrong_on_the_cell() {
    let mut noise = Noise::new(1);
    let runs = runs(&crooked(), &mut noise);
    let shunt = exactly(SHUNT);
    let by_factor = runs
        .shunt
        .iter()
        .zip(&runs.cell)
        .map(|(control, measured)| {
            let factor = shunt.at(control.freq_hz) / raw_impedance(control, SHUNT.0).z_ohm;
            (raw_impedance(measured, SHUNT.0).z_ohm * factor - cell(measured.freq_hz)).norm()
                / cell(measured.freq_hz).norm()
        });
    assert!(
        by_factor.fold(f64::INFINITY, f64::min) > 0.01,
        "wrong by more than 1 % at every frequency"
    );
}

/// Returns the share of real and imaginary parts within 2σ, mean of error over σ, and largest
/// relative error, over seeds.
fn coverage(seeds: std::ops::Range<u64>, with_fake: bool) -> (f64, f64, f64) {
    let (mut within, mut all, mut sum, mut largest, mut chi2) = (0, 0, 0.0, 0.0f64, 0.0);
    for seed in seeds.clone() {
        let mut noise = Noise::new(seed);
        let bench = Bench::any(&mut noise, 5e-6);
        let runs = runs(&bench, &mut noise);
        let (shunt, fake) = (known(SHUNT, &mut noise), known(FAKE_CELL, &mut noise));
        let fake_cell = with_fake.then_some((fake, runs.fake.as_slice()));
        let controls = Controls {
            current_shunt: shunt,
            shunt: &runs.shunt,
            fake_cell,
            short: None,
            open: None,
            priors: Priors::default(),
        };
        let correction = Correction::fit(&controls).unwrap();
        chi2 += correction.reduced_chi2.unwrap() / (seeds.end - seeds.start) as f64;
        for (point, error) in errors(&correction, &runs.cell) {
            let (re, im) = (
                error.re / point.covariance.re_re.sqrt(),
                error.im / point.covariance.im_im.sqrt(),
            );
            within += usize::from(re.abs() < 2.0) + usize::from(im.abs() < 2.0);
            (all, sum) = (all + 2, sum + re + im);
            largest = largest.max(error.norm() / point.z_ohm.norm());
        }
    }
    assert!((chi2 - 1.0).abs() < 0.05, "mean reduced χ²: {chi2}");
    (
        within as f64 / f64::from(all),
        sum / f64::from(all),
        largest,
    )
}

#[test]
fn both_controls_leave_an_error_that_the_sigma_covers() {
    let (share, mean, largest) = coverage(0..300, true);
    assert!((0.93..0.975).contains(&share), "2σ covers {share}");
    assert!(mean.abs() < 0.25, "mean error over σ: {mean}");
    assert!(largest < 0.02, "largest error: {largest}");
}

#[test]
fn the_shunt_alone_leaves_an_error_that_the_sigma_covers() {
    let (share, mean, largest) = coverage(1000..1300, false);
    assert!((0.93..0.975).contains(&share), "2σ covers {share}");
    assert!(mean.abs() < 0.25, "mean error over σ: {mean}");
    assert!(
        largest > 0.02,
        "gain 2 and the pick-up in the jig stay unknown: {largest}"
    );
}

#[test]
fn nothing_measured_is_covered_too() {
    let (mut within, mut all) = (0, 0);
    for seed in 200..280 {
        let mut noise = Noise::new(seed);
        let bench = Bench::any(&mut noise, 5e-6);
        let measured = bench.sweep(Probes::OnJig, cell, &mut noise);
        let correction = Correction::none(known(SHUNT, &mut noise));
        assert_eq!(
            (correction.reduced_chi2, correction.dof, correction.span_hz),
            (None, 0, None)
        );
        for (point, error) in errors(&correction, &measured) {
            within += usize::from(error.re.abs() < 2.0 * point.covariance.re_re.sqrt());
            within += usize::from(error.im.abs() < 2.0 * point.covariance.im_im.sqrt());
            all += 2;
        }
    }
    let share = f64::from(within as u32) / f64::from(all);
    assert!((0.90..0.99).contains(&share), "2σ covers {share}");
}

#[test]
fn without_errors_the_correction_changes_nothing() {
    let mut noise = Noise::new(7);
    let runs = runs(&Bench::ideal(), &mut noise);
    let correction = Correction::none(exactly((SHUNT.0, 0.0)));
    for phasors in &runs.cell {
        let (corrected, raw) = (correction.apply(phasors), raw_impedance(phasors, SHUNT.0));
        assert!(
            (corrected.z_ohm - raw.z_ohm).norm() < 1e-15
                && (corrected.amplitude_a - raw.amplitude_a).abs() < 1e-12
        );
        let carried = correction.carried_covariance(phasors);
        assert!(
            (corrected.covariance.re_re - carried.re_re - raw.covariance.re_re).abs()
                < 1e-6 * raw.covariance.re_re + 1e-20
        );
    }
}

/// The phase error of a correction at the upper end of the band is a skew and an inductance only.
#[test]
fn the_common_error_is_what_the_correction_carries() {
    let mut noise = Noise::new(13);
    let runs = runs(&crooked(), &mut noise);
    let controls = Controls {
        current_shunt: known(SHUNT, &mut noise),
        shunt: &runs.shunt,
        fake_cell: Some((known(FAKE_CELL, &mut noise), &runs.fake)),
        short: None,
        open: None,
        priors: Priors::default(),
    };
    let correction = Correction::fit(&controls).unwrap();
    let left = correction.common_error(&runs.cell, &runs.shunt).unwrap();
    let mut compared = 0;
    let high = |phasors: &&ChannelPhasors| phasors.freq_hz > 60.0;
    for (jig, shunt) in runs
        .cell
        .iter()
        .filter(high)
        .zip(runs.shunt.iter().filter(high))
    {
        let z_ohm = correction.apply(jig).z_ohm;
        let variance = |is_cell: bool| {
            (0..COMMON)
                .map(|error| left.at(error, jig.freq_hz, z_ohm, is_cell).im.powi(2))
                .sum::<f64>()
        };
        let carried = correction.carried_covariance(jig).im_im;
        assert!(
            (variance(true) / carried - 1.0).abs() < 0.05,
            "{} Hz: {} Ω² of {carried} Ω²",
            jig.freq_hz,
            variance(true)
        );
        let own: f64 = correction
            .measured_parts(shunt)
            .iter()
            .map(|part| part.im_im)
            .sum();
        let carried = correction.apply_at_shunt(shunt).covariance.im_im - own;
        assert!(
            (variance(false) / carried - 1.0).abs() < 0.2,
            "{} Hz, shunt: {} Ω² of {carried} Ω²",
            jig.freq_hz,
            variance(false)
        );
        compared += 1;
    }
    assert!(compared > 2);
    // The common error of the real part does not exceed the correction's own error in it.
    let end = runs
        .cell
        .iter()
        .max_by(|a, b| a.freq_hz.total_cmp(&b.freq_hz))
        .unwrap();
    let z_ohm = correction.apply(end).z_ohm;
    let re = |error: usize| left.at(error, end.freq_hz, z_ohm, true).re;
    let squares: f64 = (0..COMMON).map(|error| re(error).powi(2)).sum();
    let flat = correction
        .carried_covariance(
            runs.cell
                .iter()
                .min_by(|a, b| a.freq_hz.total_cmp(&b.freq_hz))
                .unwrap(),
        )
        .re_re;
    assert!(
        squares > 0.0 && squares < 2.0 * (correction.carried_covariance(end).re_re + flat),
        "{squares} Ω²"
    );
    assert!(correction.common_error(&runs.cell[..1], &[]).is_none());
}

/// The shared errors of a cell's spectrum add up to the error that the correction leaves in it,
/// with any control to choose them by and without a control.
#[test]
fn shared_errors_add_up_to_what_the_correction_carries() {
    let mut noise = Noise::new(5);
    let runs = runs(&crooked(), &mut noise);
    let controls = Controls {
        current_shunt: known(SHUNT, &mut noise),
        shunt: &runs.shunt,
        fake_cell: Some((known(FAKE_CELL, &mut noise), &runs.fake)),
        short: None,
        open: None,
        priors: Priors::default(),
    };
    let correction = Correction::fit(&controls).unwrap();
    for control in [&runs.fake[..], &[]] {
        let modes = CorrectionModes::new(&correction, control, "test");
        let points = runs
            .cell
            .iter()
            .map(|phasors| correction.apply(phasors))
            .collect();
        let spectrum = correction.with_shared(Spectrum::new("cell", points), &runs.cell, &modes);
        assert!(spectrum.shared.len() < 17, "{}", spectrum.shared.len());
        for (k, phasors) in runs.cell.iter().enumerate() {
            let carried = correction.carried_covariance(phasors);
            let own: f64 = correction
                .measured_parts(phasors)
                .iter()
                .map(|part| part.re_re.max(part.im_im))
                .sum();
            let sum: Covariance2 = spectrum
                .shared
                .iter()
                .map(|error| Covariance2::along(error.at_ohm[k]))
                .sum();
            // The part left out is small against the noise of the point.
            for (all, shared) in [(carried.re_re, sum.re_re), (carried.im_im, sum.im_im)] {
                assert!(
                    (all - shared).abs() < 0.01 * own + 1e-6 * all,
                    "{} Hz: {all:e} and {shared:e}, noise {own:e}",
                    phasors.freq_hz
                );
            }
        }
    }
}

#[test]
fn parameters_come_back_where_the_controls_tell_them() {
    let mut noise = Noise::new(11);
    let bench = crooked();
    let runs = runs(&bench, &mut noise);
    let controls = Controls {
        current_shunt: exactly(SHUNT),
        shunt: &runs.shunt,
        fake_cell: Some((exactly(FAKE_CELL), &runs.fake)),
        short: None,
        open: None,
        priors: Priors::default(),
    };
    let correction = Correction::fit(&controls).unwrap();
    let parameters = correction.parameters();
    let names: Vec<_> = parameters.iter().map(|p| (p.name, p.unit)).collect();
    let expected = [
        ("gain_c2", "1"),
        ("gain_c3", "1"),
        ("gain_c4", "1"),
        ("skew_c2", "s"),
        ("skew_c3", "s"),
        ("skew_c4", "s"),
        ("mutual_shunt", "H"),
        ("mutual_jig", "H"),
        ("shunt_r", "Ω"),
        ("shunt_l", "H"),
        ("fake_cell_r", "Ω"),
        ("fake_cell_l", "H"),
    ];
    assert_eq!(names, expected);
    let truths = bench.gains.into_iter().chain(bench.skews_s).chain([
        bench.mutual_shunt_h,
        bench.mutual_jig_h,
        SHUNT.0,
        SHUNT.1,
    ]);
    for (parameter, truth) in parameters.iter().zip(truths) {
        assert!(
            (parameter.value - truth).abs() <= 3.0 * parameter.sigma + 1e-12 * truth.abs(),
            "{parameter:?}, truth {truth}"
        );
    }
    assert!(
        parameters[..3].iter().all(|gain| gain.sigma < 1e-5),
        "all gains are determined: {parameters:?}"
    );
    let alone = Correction::fit(&Controls {
        fake_cell: None,
        ..controls
    })
    .unwrap();
    let found = alone.parameters();
    assert_eq!(found.len(), 10);
    assert!(
        found[1].sigma < 1e-5 && found[0].sigma > 0.005 && found[2].sigma > 0.005,
        "the shunt determines gain 3 and the ratio of 4 and 2: {found:?}"
    );
}

#[test]
fn scatter_beyond_the_stated_noise_widens_the_correction() {
    // Stated 5 µV, true 20 µV: χ² is 16 per degree of freedom of which the parameters take a few.
    let bench = Bench {
        noise_v: 20e-6,
        ..crooked()
    };
    let (seeds, mut chi2) = (40, 0.0);
    for seed in 0..seeds {
        let mut runs = runs(&bench, &mut Noise::new(seed));
        for phasors in runs.shunt.iter_mut().chain(&mut runs.fake) {
            phasors.variance = [PhasorVariance::circular(25e-12); 4];
        }
        let fake_cell = Some((exactly(FAKE_CELL), runs.fake.as_slice()));
        let controls = Controls {
            current_shunt: exactly(SHUNT),
            shunt: &runs.shunt,
            fake_cell,
            short: None,
            open: None,
            priors: Priors::default(),
        };
        let correction = Correction::fit(&controls).unwrap();
        let own = correction.reduced_chi2.unwrap();
        assert!(
            (correction.noise_factor - own.sqrt()).abs() < 1e-12,
            "{correction:?}"
        );
        chi2 += own / seeds as f64;
    }
    assert!((14.3..16.3).contains(&chi2), "{chi2}");
}

#[test]
fn a_correction_survives_the_disk() {
    let mut noise = Noise::new(31);
    let runs = runs(&crooked(), &mut noise);
    let controls = Controls {
        current_shunt: known(SHUNT, &mut noise),
        shunt: &runs.shunt,
        fake_cell: None,
        short: None,
        open: None,
        priors: Priors::default(),
    };
    let correction = Correction::fit(&controls).unwrap();
    let back: Correction =
        serde_json::from_str(&serde_json::to_string(&correction).unwrap()).unwrap();
    let (a, b) = (correction.apply(&runs.cell[5]), back.apply(&runs.cell[5]));
    assert!(
        (a.z_ohm - b.z_ohm).norm() < 1e-15
            && (a.covariance.re_re / b.covariance.re_re - 1.0).abs() < 1e-6
    );
}

#[test]
fn unusable_controls_are_refused() {
    let mut noise = Noise::new(41);
    let runs = runs(&crooked(), &mut noise);
    let good = Controls {
        current_shunt: exactly(SHUNT),
        shunt: &runs.shunt,
        fake_cell: None,
        short: None,
        open: None,
        priors: Priors::default(),
    };
    let refusal = |controls: &Controls<'_>| Correction::fit(controls).unwrap_err().to_string();
    assert_eq!(
        refusal(&Controls { shunt: &[], ..good }),
        "expected points of at least one control, met none"
    );
    let negative = KnownImpedance {
        r_ohm: -1.0,
        ..exactly(SHUNT)
    };
    let text = refusal(&Controls {
        current_shunt: negative,
        ..good
    });
    assert!(
        text.starts_with("current shunt: expected a positive resistance")
            && text.contains("r_ohm: -1.0"),
        "{text}"
    );
    let text = refusal(&Controls {
        fake_cell: Some((negative, &runs.fake)),
        ..good
    });
    assert!(
        text.starts_with("fake cell: expected a positive resistance"),
        "{text}"
    );
    let text = refusal(&Controls {
        priors: Priors {
            gain_sigma: 0.0,
            ..Priors::default()
        },
        ..good
    });
    assert!(
        text.starts_with(
            "expected priors with positive, finite standard deviations, met \
    Priors { gain_sigma: 0.0,"
        ),
        "{text}"
    );
    let spoilt = |change: fn(&mut ChannelPhasors)| {
        let mut points = runs.shunt.clone();
        change(&mut points[1]);
        points[1].freq_hz = if points[1].freq_hz.is_nan() {
            f64::NAN
        } else {
            0.25
        };
        refusal(&Controls {
            shunt: &points,
            ..good
        })
    };
    assert_eq!(
        spoilt(|p| p.freq_hz = f64::NAN),
        "shunt control, point 2 (NaN Hz): expected a frequency above 0 Hz, met NaN Hz"
    );
    assert_eq!(
        spoilt(|p| p.variance[2] = PhasorVariance::circular(0.0)),
        "shunt control, point 2 (0.25 Hz): expected positive, finite variances, met 0, 0, 0 V²"
    );
    assert_eq!(
        spoilt(|p| p.volts[3].re = f64::NAN)
            .split(", met")
            .next()
            .unwrap(),
        "shunt control, point 2 (0.25 Hz): expected finite phasors"
    );
    let text = spoilt(|p| p.volts[1] = p.volts[0]);
    assert!(
        text.starts_with(
            "shunt control, point 2 (0.25 Hz): expected a current through the \
    shunt, met 0.000e0 V across it"
        ),
        "{text}"
    );
}

fn verdict(bench: &Bench, tolerance: ControlTolerance) -> analysis::calibration::ControlVerdict {
    let measured = bench.sweep(Probes::OnShunt, fake_cell, &mut Noise::new(51));
    let points: Vec<_> = measured
        .iter()
        .map(|phasors| raw_impedance(phasors, SHUNT.0))
        .collect();
    check_control(&points, &exactly((SHUNT.0, 0.0)), &tolerance)
}

#[test]
fn a_control_is_judged_in_words() {
    let tolerance = ControlTolerance {
        magnitude_rel: 0.02,
        phase_deg: 1.0,
    };
    let bench = Bench {
        gains: [1.0, 1.0, 1.005],
        shunt: (SHUNT.0, 0.0),
        noise_v: 1e-12,
        ..Bench::ideal()
    };
    // C4 shows 0.5 % more of (17 + 9.96) mΩ and of the return wire's 150 nH: 1.35 % of the
    // magnitude, 0.5 % · 283 µΩ of phase.
    let right = verdict(&bench, tolerance);
    assert!(
        right.passed && (right.worst_magnitude_rel - 0.005 * 26.96 / 9.96).abs() < 1e-4,
        "{right:?}"
    );
    assert_eq!(
        right.text,
        "control of 9.960 mΩ: magnitude off by +1.35 % at 300 Hz, within the tolerance of 2 %; \
        phase off by +0.01° at 300 Hz, \
         within the tolerance of 1°"
    );
    let wrong = verdict(
        &Bench {
            mutual_shunt_h: 0.1e-6,
            ..bench
        },
        ControlTolerance {
            magnitude_rel: 0.01,
            ..tolerance
        },
    );
    assert!(
        !wrong.passed && wrong.worst_phase_freq_hz > 299.0,
        "{wrong:?}"
    );
    assert_eq!(
        wrong.text,
        "control of 9.960 mΩ FAILS: magnitude off by +1.37 % at 300 Hz, OUTSIDE the tolerance of 1 \
        %; phase off by +1.08° at 300 Hz, \
         OUTSIDE the tolerance of 1°"
    );
    let none = check_control(&[], &exactly(SHUNT), &tolerance);
    assert!(
        !none.passed
            && none.text == "the control was not measured: expected at least one point, met none"
    );
    let mut bad = raw_impedance(
        &bench.measure(10.0, Probes::OnShunt, cell(10.0), &mut Noise::new(1)),
        SHUNT.0,
    );
    bad.z_ohm.re = f64::NAN;
    let bad = check_control(&[bad], &exactly(SHUNT), &tolerance);
    assert!(
        !bad.passed
            && bad
                .text
                .starts_with("the control has no finite impedance at 10 Hz: met NaN"),
        "{}",
        bad.text
    );
}

#[test]
fn noise_that_is_not_a_circle_counts_as_it_lies() {
    // Ten times more noise along one diagonal than across it, of which the whitened residuals must
    // show nothing.
    let (along, across) = (
        Complex64::from_polar(10e-6, 0.8),
        Complex64::from_polar(1e-6, 0.8 + std::f64::consts::FRAC_PI_2),
    );
    let covariance = Covariance2::along(along) + Covariance2::along(across);
    let (seeds, mut spread) = (150, 0.0);
    for seed in 0..seeds {
        let mut noise = Noise::new(seed);
        let mut runs = runs(&crooked(), &mut noise);
        for phasors in runs.shunt.iter_mut().chain(&mut runs.fake) {
            for (volts, variance) in phasors.volts.iter_mut().zip(&mut phasors.variance) {
                *volts += along * noise.gauss() + across * noise.gauss();
                *variance = PhasorVariance {
                    noise: covariance,
                    ..PhasorVariance::circular(0.0)
                };
            }
        }
        let fake_cell = Some((exactly(FAKE_CELL), runs.fake.as_slice()));
        let controls = Controls {
            current_shunt: exactly(SHUNT),
            shunt: &runs.shunt,
            fake_cell,
            short: None,
            open: None,
            priors: Priors::default(),
        };
        let correction = Correction::fit(&controls).unwrap();
        let own = correction.reduced_chi2.unwrap();
        // χ² of f degrees of freedom, per f, scatters by 2/f.
        spread += (own - 1.0).powi(2) * correction.dof as f64 / 2.0 / seeds as f64;
    }
    assert!(
        (0.6..1.45).contains(&spread),
        "χ² scatters {spread} times as it should"
    );
}
