//! Calibration with a short and an open jig beside shunt and fake cell, and the uncertainty that
//! remains without them.

use std::f64::consts::TAU;

use analysis::calibration::{
    Controls, Correction, KnownImpedance, Priors, StrayAdmittance, check_short,
};
use analysis::spectrum::{ChannelPhasors, raw_impedance};
use num_complex::Complex64;

use crate::bench::{Bench, FAKE_CELL, Probes, SHORT, SHUNT, cell, fake_cell, short};
use crate::noise::Noise;

/// Known impedance as a careful laboratory states it, drawn around the true value.
fn drawn(
    (r_ohm, l_h): (f64, f64),
    (r_sigma_ohm, l_sigma_h): (f64, f64),
    noise: &mut Noise,
) -> KnownImpedance {
    KnownImpedance {
        r_ohm: r_ohm + r_sigma_ohm * noise.gauss(),
        r_sigma_ohm,
        l_h: l_h + l_sigma_h * noise.gauss(),
        l_sigma_h,
    }
}

fn to_3khz(
    bench: &Bench,
    probes: Probes,
    in_jig: impl Fn(f64) -> Complex64,
    noise: &mut Noise,
) -> Vec<ChannelPhasors> {
    (0..25)
        .map(|k| 0.1 * 3e4f64.powf(f64::from(k) / 24.0))
        .map(|freq_hz| bench.measure(freq_hz, probes, in_jig(freq_hz), noise))
        .collect()
}

/// Returns the share of the parts within 2σ and largest error of the phase at the top, degrees,
/// over seeds.
fn coverage(with_fake: bool, with_short: bool) -> (f64, f64) {
    let (mut within, mut all, mut worst_deg) = (0, 0, 0.0f64);
    for seed in 0..200 {
        let mut noise = Noise::new(seed);
        let bench = Bench::any(&mut noise, 1e-6);
        let shunt_run = to_3khz(&bench, Probes::OnShunt, fake_cell, &mut noise);
        let fake_run = to_3khz(&bench, Probes::OnJig, fake_cell, &mut noise);
        let short_run = to_3khz(&bench, Probes::OnJig, short, &mut noise);
        let cells = to_3khz(&bench, Probes::OnJig, cell, &mut noise);
        let fake = drawn(FAKE_CELL, (1e-4 * FAKE_CELL.0, 0.3e-9), &mut noise);
        let bar = drawn(SHORT, (0.2e-6, 0.3e-9), &mut noise);
        let correction = Correction::fit(&Controls {
            current_shunt: drawn(SHUNT, (1e-4 * SHUNT.0, 0.1e-9), &mut noise),
            shunt: &shunt_run,
            fake_cell: with_fake.then_some((fake, fake_run.as_slice())),
            short: with_short.then_some((bar, short_run.as_slice())),
            open: None,
            priors: Priors::default(),
        })
        .unwrap();
        for phasors in &cells {
            let point = correction.apply(phasors);
            let error = point.z_ohm - cell(point.freq_hz);
            within += usize::from(error.re.abs() < 2.0 * point.covariance.re_re.sqrt());
            within += usize::from(error.im.abs() < 2.0 * point.covariance.im_im.sqrt());
            all += 2;
            worst_deg = worst_deg.max((point.z_ohm / cell(point.freq_hz)).arg().to_degrees().abs());
        }
    }
    (within as f64 / f64::from(all), worst_deg)
}

#[test]
fn any_subset_of_the_controls_states_what_it_leaves_open() {
    let found =
        [(true, true), (true, false), (false, true)].map(|(fake, short)| coverage(fake, short));
    for (share, _) in found {
        assert!(
            (0.93..0.975).contains(&share),
            "2σ covers {share}: {found:?}"
        );
    }
    let [(_, both_deg), (_, fake_deg), (_, short_deg)] = found;
    // Here the return wire is nearly all resistance, so that only two loads of different voltage
    // separate a skew of the current from the pick-up.
    assert!(
        both_deg < 0.8 && fake_deg > 3.0 * both_deg && short_deg > 3.0 * both_deg,
        "{found:?}"
    );
}

/// Returns a leak of half a siemens beside everything that is clamped into the jig: 0.4 % of a
/// cell's current.
fn beside(in_jig: fn(f64) -> Complex64) -> impl Fn(f64) -> Complex64 {
    move |freq_hz| (in_jig(freq_hz).inv() + Complex64::new(0.5, TAU * freq_hz * 2e-6)).inv()
}

#[test]
fn a_leak_counts_where_the_open_jig_was_measured_and_only_there() {
    let mut noise = Noise::new(5);
    let bench = Bench {
        mutual_jig_h: 50e-9,
        ..Bench::ideal()
    };
    let shunt_run = to_3khz(&bench, Probes::OnShunt, fake_cell, &mut noise);
    let cells = to_3khz(&bench, Probes::OnJig, beside(cell), &mut noise);
    let fake_run = to_3khz(&bench, Probes::OnJig, beside(fake_cell), &mut noise);
    let exactly = |(r_ohm, l_h): (f64, f64)| KnownImpedance {
        r_ohm,
        r_sigma_ohm: 1e-9 * r_ohm,
        l_h,
        l_sigma_h: 1e-12,
    };
    let stray = StrayAdmittance {
        g_s: 0.5,
        g_sigma_s: 1e-4,
        c_f: 2e-6,
        c_sigma_f: 1e-10,
    };
    let controls = Controls {
        current_shunt: exactly(SHUNT),
        shunt: &shunt_run,
        fake_cell: Some((exactly(FAKE_CELL), &fake_run)),
        short: None,
        open: Some(stray),
        priors: Priors::default(),
    };
    let error = |controls: &Controls<'_>| {
        let correction = Correction::fit(controls).unwrap();
        let errors = cells
            .iter()
            .filter(|phasors| phasors.freq_hz < 300.0)
            .map(|phasors| {
                let truth = cell(phasors.freq_hz);
                (correction.apply(phasors).z_ohm - truth).norm() / truth.norm()
            });
        (errors.fold(0.0, f64::max), correction.parameters().len())
    };
    let ((with, count_with), (without, count_without)) = (
        error(&controls),
        error(&Controls {
            open: None,
            ..controls
        }),
    );
    assert!(
        with < 5e-5 && without > 1e-3,
        "{with} with the open, {without} without"
    );
    assert_eq!(
        (count_with, count_without),
        (14, 12),
        "what was not measured is not a parameter"
    );
}

#[test]
fn bounds_of_a_leak_are_their_middle() {
    let stray = StrayAdmittance::within(1e6, 2e-9);
    // Uniform between 0 and the bound: mean a half, standard deviation 1/√12.
    assert!(
        (stray.g_s - 0.5e-6).abs() < 1e-18 && (stray.g_sigma_s - 0.288_675e-6).abs() < 1e-12,
        "{stray:?}"
    );
    assert!(
        (stray.c_f - 1e-9).abs() < 1e-21 && (stray.c_sigma_f - 0.577_350e-9).abs() < 1e-15,
        "{stray:?}"
    );
}

#[test]
fn a_short_and_an_open_that_are_none_are_refused() {
    let mut noise = Noise::new(5);
    let run = to_3khz(&Bench::ideal(), Probes::OnJig, short, &mut noise);
    let bar = KnownImpedance {
        r_ohm: SHORT.0,
        r_sigma_ohm: 0.0,
        l_h: SHORT.1,
        l_sigma_h: 0.0,
    };
    let good = Controls {
        current_shunt: bar,
        shunt: &[],
        fake_cell: None,
        short: Some((bar, &run)),
        open: None,
        priors: Priors::default(),
    };
    let refusal = |controls: &Controls<'_>| Correction::fit(controls).unwrap_err().to_string();
    let text = refusal(&Controls {
        short: Some((KnownImpedance { r_ohm: 0.0, ..bar }, &run)),
        ..good
    });
    assert!(
        text.starts_with("short: expected a positive resistance"),
        "{text}"
    );
    let text = refusal(&Controls {
        open: Some(StrayAdmittance {
            c_sigma_f: -1.0,
            ..StrayAdmittance::NONE
        }),
        ..good
    });
    assert!(
        text.starts_with("open jig: expected a finite conductance and capacitance")
            && text.contains("c_sigma_f: -1.0"),
        "{text}"
    );
}

#[test]
fn a_short_is_judged_in_ohms() {
    let bench = Bench {
        gains: [1.0, 1.0, 1.005],
        noise_v: 1e-12,
        shunt: (SHUNT.0, 0.0),
        ..Bench::ideal()
    };
    let run = to_3khz(
        &bench,
        Probes::OnJig,
        |_| Complex64::from(20e-6),
        &mut Noise::new(1),
    );
    let points: Vec<_> = run
        .iter()
        .take(5)
        .map(|phasors| raw_impedance(phasors, SHUNT.0))
        .collect();
    let bar = KnownImpedance {
        r_ohm: 20e-6,
        r_sigma_ohm: 0.0,
        l_h: 0.0,
        l_sigma_h: 0.0,
    };
    // C4 shows 0.5 % more of (17 + 9.96 + 12 + 0.02) mΩ: 194.9 µΩ.
    let wrong = check_short(&points, &bar, 100e-6);
    assert!(
        !wrong.passed
            && wrong
                .text
                .starts_with("short of 20 µΩ FAILS: off by 194.9 µΩ at "),
        "{}",
        wrong.text
    );
    assert!(
        wrong.text.ends_with("OUTSIDE the tolerance of 100 µΩ"),
        "{}",
        wrong.text
    );
    let right = check_short(&points, &bar, 200e-6);
    assert!(
        right.passed
            && right.text.contains("within the tolerance of 200 µΩ")
            && (right.worst_magnitude_rel - 9.745).abs() < 1e-2,
        "{right:?}"
    );
    let mut bad = points;
    bad[0].z_ohm.im = f64::NAN;
    assert!(!check_short(&bad, &bar, 200e-6).passed);
    assert!(!check_short(&[], &bar, 200e-6).passed);
}
