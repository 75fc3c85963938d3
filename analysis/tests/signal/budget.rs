//! Uncertainty budget: the parts add up, and each follows its own cause.

use analysis::{
    budget::{Budget, BudgetPoint, Cause},
    calibration::{Controls, Correction, KnownImpedance, Priors, Source, StrayAdmittance},
    numeric::Covariance2,
    spectrum::{ChannelPhasors, PhasorVariance},
};
use proptest::prelude::*;

use crate::bench::{Bench, FAKE_CELL, Probes, SHORT, SHUNT, cell, fake_cell, short};
use crate::noise::Noise;

const EXACT_LIMIT: f64 = 1e-9;

fn known((r_ohm, l_h): (f64, f64), (r_rel, l_sigma_h): (f64, f64)) -> KnownImpedance {
    KnownImpedance {
        r_ohm,
        r_sigma_ohm: r_rel * r_ohm,
        l_h,
        l_sigma_h,
    }
}

/// The runs over a bench of the usual kind: all controls, and the cell.
struct Runs {
    shunt: Vec<ChannelPhasors>,
    fake: Vec<ChannelPhasors>,
    short: Vec<ChannelPhasors>,
    cell: Vec<ChannelPhasors>,
}

fn runs(bench: &Bench, noise: &mut Noise) -> Runs {
    Runs {
        shunt: bench.sweep(Probes::OnShunt, fake_cell, noise),
        fake: bench.sweep(Probes::OnJig, fake_cell, noise),
        short: bench.sweep(Probes::OnJig, short, noise),
        cell: bench.sweep(Probes::OnJig, cell, noise),
    }
}

fn bench() -> Bench {
    Bench {
        gains: [1.004, 0.994, 1.003],
        skews_s: [0.1e-6, -0.2e-6, 0.15e-6],
        mutual_shunt_h: 90e-9,
        mutual_jig_h: 50e-9,
        ..Bench::ideal()
    }
}

const PRIORS: Priors = Priors {
    gain_sigma: 0.01,
    skew_sigma_s: 0.2e-6,
    mutual_sigma_h: 100e-9,
};

fn controls(runs: &Runs) -> Controls<'_> {
    Controls {
        current_shunt: known(SHUNT, (2e-4, 1e-9)),
        shunt: &runs.shunt,
        fake_cell: Some((known(FAKE_CELL, (3e-4, 1e-9)), &runs.fake)),
        short: Some((known(SHORT, (1e-2, 0.5e-9)), &runs.short)),
        open: Some(StrayAdmittance {
            g_s: 1e-3,
            g_sigma_s: 1e-3,
            c_f: 1e-9,
            c_sigma_f: 1e-9,
        }),
        priors: PRIORS,
    }
}

fn part(point: &BudgetPoint, cause: Cause) -> Covariance2 {
    point.parts.iter().find(|part| part.0 == cause).unwrap().1
}

fn same(a: Covariance2, b: Covariance2) -> bool {
    let scale = a.re_re + a.im_im + b.re_re + b.im_im;
    [(a.re_re, b.re_re), (a.re_im, b.re_im), (a.im_im, b.im_im)]
        .into_iter()
        .all(|(a, b)| (a - b).abs() <= EXACT_LIMIT * scale)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    /// Holds for any measurement and any spectrum of the channels' noise.
    #[test]
    fn the_parts_add_up_to_the_whole(
        seed in 0_u64..1000,
        (with_shunt, with_fake, with_short, with_open) in (any::<bool>(), any::<bool>(), any::<bool>(), any::<bool>()),
        shape in (0.1f64..3.0, -0.9f64..0.9, 0.1f64..3.0),
        extra in (0.0f64..1e-10, 0.0f64..1e-10),
    ) {
        let mut noise = Noise::new(seed);
        let runs = runs(
            &Bench {
                noise_v: 3e-6,
                ..bench()
            },
            &mut noise,
        );
        let mut controls = controls(&runs);
        if !with_shunt {
            controls.shunt = &[];
        }
        if !with_fake {
            controls.fake_cell = None;
        }
        if !with_short {
            controls.short = None;
        }
        if !with_open {
            controls.open = None;
        }
        let correction =
            Correction::fit(&controls).unwrap_or_else(|_| Correction::none(controls.current_shunt));
        for phasors in &runs.cell {
            let mut phasors = *phasors;
            let (a, rho, b) = shape;
            let shaped = Covariance2 {
                re_re: a * 1e-11,
                re_im: rho * (a * b).sqrt() * 1e-11,
                im_im: b * 1e-11,
            };
            let (quantisation, drift) = (
                Covariance2::circular(extra.0),
                Covariance2::circular(extra.1),
            );
            phasors.variance[3] = PhasorVariance {
                noise: shaped,
                quantisation,
                drift,
            };
            let point = BudgetPoint::new(&correction, &phasors);
            let sum: Covariance2 = point.parts.iter().map(|part| part.1).sum();
            prop_assert!(
                same(sum, correction.apply(&phasors).covariance),
                "{point:?}"
            );
            prop_assert!(same(
                point.correction(),
                correction.carried_covariance(&phasors)
            ));
            for (cause, part) in &point.parts {
                let slack =
                    EXACT_LIMIT * (point.point.covariance.re_re + point.point.covariance.im_im);
                prop_assert!(
                    part.re_re >= 0.0
                        && part.im_im >= 0.0
                        && part.re_im.powi(2) <= part.re_re * part.im_im + slack * slack,
                    "{cause:?}"
                );
            }
        }
    }
}

#[test]
fn each_part_of_a_record_follows_its_own_cause() {
    let runs = runs(
        &Bench {
            noise_v: 3e-6,
            ..bench()
        },
        &mut Noise::new(1),
    );
    let correction = Correction::fit(&controls(&runs)).unwrap();
    let mut phasors = runs.cell[7];
    for variance in &mut phasors.variance {
        variance.quantisation = Covariance2::circular(2e-13);
        variance.drift = Covariance2 {
            re_re: 1e-13,
            re_im: 0.0,
            im_im: 0.0,
        };
    }
    let before = BudgetPoint::new(&correction, &phasors);
    type Pick = fn(&mut PhasorVariance) -> &mut Covariance2;
    let doubled: [(Cause, Pick); 3] = [
        (Cause::Noise, |variance| &mut variance.noise),
        (Cause::Quantisation, |variance| &mut variance.quantisation),
        (Cause::Drift, |variance| &mut variance.drift),
    ];
    for (cause, pick) in doubled {
        let mut phasors = phasors;
        for variance in &mut phasors.variance {
            let part = pick(variance);
            *part = part.times(4.0);
        }
        let after = BudgetPoint::new(&correction, &phasors);
        for ((name, old), (_, new)) in before.parts.iter().zip(&after.parts) {
            let factor = if *name == cause { 4.0 } else { 1.0 };
            assert!(
                same(old.times(factor), *new),
                "{cause:?} doubled: {name:?} went from {old:?} to {new:?}"
            );
        }
    }
}

#[test]
fn each_part_of_an_unmeasured_bench_follows_its_own_prior() {
    let phasors = bench().measure(100.0, Probes::OnJig, cell(100.0), &mut Noise::new(1));
    let point = |shunt: KnownImpedance| BudgetPoint::new(&Correction::none(shunt), &phasors);
    let before = point(known(SHUNT, (2e-4, 1e-9)));
    let after = point(known(SHUNT, (4e-4, 2e-9)));
    for ((name, old), (_, new)) in before.parts.iter().zip(&after.parts) {
        let factor = if *name == Cause::Correction(Source::Shunt) {
            4.0
        } else {
            1.0
        };
        assert!(same(old.times(factor), *new), "{name:?}");
    }
    // Z = R·u/(v2 − v1): a shunt that is off by 0.02 % puts Z off by as much; 1 nH turns it by
    // 2π·100 Hz·1 nH/9.96 mΩ.
    let polar = before.polar(part(&before, Cause::Correction(Source::Shunt)));
    let turn_deg = (std::f64::consts::TAU * 100.0 * 1e-9 / SHUNT.0).to_degrees();
    assert!(
        (polar.magnitude_pct - 0.02).abs() < 2e-4
            && (polar.phase_deg / turn_deg - 1.0).abs() < 0.01,
        "{polar:?}, {turn_deg}°"
    );
}

/// If only one thing is left to chance, the scatter of corrected impedances equals the budget's
/// value for it.
#[test]
fn a_part_is_the_scatter_that_its_cause_alone_makes() {
    let quiet = runs(&bench(), &mut Noise::new(2));
    // The controls' weight is that of the noise that they state, whatever they truly have.
    let stated = |mut runs: Runs| {
        for phasors in runs
            .shunt
            .iter_mut()
            .chain(&mut runs.fake)
            .chain(&mut runs.short)
            .chain(&mut runs.cell)
        {
            phasors.variance = [PhasorVariance::circular(1e-12); 4];
        }
        runs
    };
    let quiet = stated(quiet);
    let budget = |correction: &Correction| Budget::new(correction, quiet.cell.iter());
    let expected = budget(&Correction::fit(&controls(&quiet)).unwrap());
    let count = 400;
    let mut noise = Noise::new(77);
    for source in [
        Source::Shunt,
        Source::FakeCell,
        Source::Short,
        Source::ControlNoise,
    ] {
        let mut scatter = vec![Covariance2::ZERO; quiet.cell.len()];
        for _ in 0..count {
            let noisy = (source == Source::ControlNoise).then(|| {
                stated(runs(
                    &Bench {
                        noise_v: 1e-6,
                        ..bench()
                    },
                    &mut noise,
                ))
            });
            let mut controls = controls(noisy.as_ref().unwrap_or(&quiet));
            let mut off = |known: &mut KnownImpedance| {
                known.r_ohm += known.r_sigma_ohm * noise.gauss();
                known.l_h += known.l_sigma_h * noise.gauss();
            };
            match source {
                Source::Shunt => off(&mut controls.current_shunt),
                Source::FakeCell => off(&mut controls.fake_cell.as_mut().unwrap().0),
                Source::Short => off(&mut controls.short.as_mut().unwrap().0),
                _ => {}
            }
            let correction = Correction::fit(&controls).unwrap();
            for ((sum, phasors), expected) in
                scatter.iter_mut().zip(&quiet.cell).zip(&expected.points)
            {
                *sum = *sum
                    + Covariance2::along(correction.apply(phasors).z_ohm - expected.point.z_ohm)
                        .times(1.0 / f64::from(count));
            }
        }
        for (met, point) in scatter.iter().zip(&expected.points) {
            let stated = part(point, Cause::Correction(source));
            let scale = stated.re_re + stated.im_im;
            for (met, stated) in [
                (met.re_re, stated.re_re),
                (met.re_im, stated.re_im),
                (met.im_im, stated.im_im),
            ] {
                assert!(
                    (met - stated).abs() < 0.25 * scale,
                    "{source:?} at {} Hz: {met:e} Ω², stated {stated:e} Ω²",
                    point.point.freq_hz
                );
            }
        }
    }
}

#[test]
fn the_table_has_a_column_for_every_cause_that_is_there() {
    let runs = runs(
        &Bench {
            noise_v: 3e-6,
            ..bench()
        },
        &mut Noise::new(1),
    );
    let mut controls = controls(&runs);
    (controls.short, controls.open) = (None, None);
    let correction = Correction::fit(&controls).unwrap();
    let budget = Budget::new(&correction, runs.cell.iter());
    let csv = budget.to_csv();
    let lines: Vec<Vec<&str>> = csv.lines().map(|line| line.split(',').collect()).collect();
    assert_eq!(lines.len(), 21);
    assert!(
        lines.iter().all(|line| line.len() == lines[0].len()),
        "{csv}"
    );
    for name in [
        "noise_pct",
        "shunt_deg",
        "gain_pct",
        "skew_deg",
        "mutual_inductance_deg",
        "fake_cell_pct",
        "control_noise_pct",
        "total_deg",
    ] {
        assert!(lines[0].contains(&name), "{name}: {:?}", lines[0]);
    }
    for name in ["short_pct", "open_pct", "drift_pct", "quantisation_pct"] {
        assert!(
            !lines[0].contains(&name),
            "{name} was not there: {:?}",
            lines[0]
        );
    }
    // The columns of the magnitude add up in squares.
    let column = |row: usize, name: &str| -> f64 {
        lines[row][lines[0].iter().position(|c| *c == name).unwrap()]
            .parse()
            .unwrap()
    };
    for row in 1..21 {
        let parts = lines[0].iter().filter(|name| {
            name.ends_with("_pct") && !["correction_pct", "total_pct"].contains(name)
        });
        let sum: f64 = parts.map(|name| column(row, name).powi(2)).sum();
        assert!(
            (sum.sqrt() / column(row, "total_pct") - 1.0).abs() < 1e-3,
            "{}",
            lines[row].join(",")
        );
    }
    let table = budget.table();
    assert!(table.rows.len() == 20 && table.rows.iter().all(|row| row.len() == table.header.len()));
    let svg = analysis::plot::chart_svg(&budget.chart("Budget")).unwrap();
    for word in [
        "skew",
        "noise of the controls",
        "total",
        "1σ of |Z| / %",
        "Frequency / Hz",
    ] {
        assert!(svg.contains(word), "{word}");
    }
    let back: Budget = serde_json::from_str(&serde_json::to_string(&budget).unwrap()).unwrap();
    assert_eq!(back.points[3].parts[4].0, budget.points[3].parts[4].0);
    assert!(
        budget.in_words().unwrap().contains("at 0.10 Hz"),
        "{:?}",
        budget.in_words()
    );
    assert_eq!(
        (
            Budget::default().in_words(),
            Budget::default().to_csv().as_str()
        ),
        (None, "freq_hz,z_abs_ohm,phase_deg\n")
    );
}
