//! Spectra made here by closed formulas, with noise of a known size, valid and spoilt.

mod nonsense;

use super::*;
use analysis_numeric::{Covariance2, Rng};
use analysis_signal::spectrum::ImpedancePoint;
use num_complex::Complex64;
use std::f64::consts::{PI, TAU};

/// Fault of a spectrum, as a function of the number of the point and its impedance.
type Fault = fn(usize, Complex64) -> Complex64;

const NONE: Fault = |_, z| z;

struct Noisy(Rng);

impl Noisy {
    fn new(seed: u64) -> Self {
        Self(Rng::new(seed))
    }

    fn normal(&mut self) -> f64 {
        self.0.normal()
    }

    fn between(&mut self, lo: f64, hi: f64) -> f64 {
        lo + (hi - lo) * self.0.uniform()
    }

    fn log_between(&mut self, lo: f64, hi: f64) -> f64 {
        self.between(lo.ln(), hi.ln()).exp()
    }
}

fn grid(points: u32, low_hz: f64, high_hz: f64) -> Vec<f64> {
    (0..points)
        .map(|k| low_hz * (high_hz / low_hz).powf(f64::from(k) / f64::from(points - 1)))
        .collect()
}

/// (jω)^a.
fn power(omega: f64, a: f64) -> Complex64 {
    Complex64::from_polar(omega.powf(a), a * PI / 2.0)
}

/// R + jωL + two RC + ZARC + Warburg, of sizes that cells have.
fn any_cell(noise: &mut Noisy) -> impl Fn(f64) -> Complex64 + use<> {
    let r = 7e-3;
    let l = noise.between(0.0, 4e-7);
    let rc: Vec<(f64, f64)> = (0..2)
        .map(|_| (r * noise.between(0.02, 0.4), noise.log_between(3e-4, 5.0)))
        .collect();
    let zarc = (
        r * noise.between(0.05, 0.5),
        noise.log_between(1e-3, 1.0),
        noise.between(0.6, 1.0),
    );
    let warburg = r * noise.between(0.0, 0.3);
    move |f: f64| {
        let w = TAU * f;
        let rcs: Complex64 = rc
            .iter()
            .map(|(r, tau)| *r / Complex64::new(1.0, w * tau))
            .sum();
        let arc = zarc.0 / (1.0 + power(w * zarc.1, zarc.2));
        Complex64::new(r, w * l) + rcs + arc + warburg * power(w, -0.5)
    }
}

/// Measurement of a spectrum: relative noise of each part, and whether the file states it.
#[derive(Clone, Copy)]
struct Bench {
    sigma: f64,
    stated: bool,
}

fn measured(
    grid: &[f64],
    cell: impl Fn(f64) -> Complex64,
    bench: Bench,
    (noise, fault): (&mut Noisy, Fault),
) -> Spectrum {
    let point = |(k, freq_hz): (usize, &f64)| {
        let z = fault(k, cell(*freq_hz));
        let s = bench.sigma * z.norm();
        let z_ohm = z + Complex64::new(s * noise.normal(), s * noise.normal());
        let covariance = if bench.stated {
            Covariance2::circular(s * s)
        } else {
            Covariance2::UNKNOWN
        };
        ImpedancePoint {
            freq_hz: *freq_hz,
            z_ohm,
            covariance,
            amplitude_a: f64::NAN,
        }
    };
    Spectrum {
        name: "made".into(),
        points: grid.iter().enumerate().map(point).collect(),
        ..Spectrum::default()
    }
}

fn thesis_grid() -> Vec<f64> {
    grid(20, 0.1, 201.0)
}

fn judge(spectrum: &Spectrum) -> SpectrumVerdict {
    assess(std::slice::from_ref(spectrum), &[])
        .unwrap()
        .spectra
        .remove(0)
        .verdict
}

/// Most events of probability `rate` in `n` that chance brings in 999 of 1000 cases.
fn most_by_chance(n: u32, rate: f64) -> u32 {
    let mut term = (1.0 - rate).powi(i32::try_from(n).unwrap());
    let mut sum = term;
    let mut k = 0;
    while sum < 0.999 {
        term *= f64::from(n - k) / f64::from(k + 1) * rate / (1.0 - rate);
        sum += term;
        k += 1;
    }
    k
}

#[test]
fn valid_spectra_pass_at_the_stated_rate() {
    assert_eq!(
        most_by_chance(300, 0.01),
        10,
        "Poisson tables, mean 3: up to 9 with 0.9989, up to 10 with 0.9997"
    );
    for (sigma, stated) in [
        (1e-4, true),
        (5e-4, true),
        (2e-3, true),
        (1e-2, true),
        (5e-4, false),
        (2e-3, false),
    ] {
        let mut noise = Noisy::new(21);
        let (mut bad, mut doubtful) = (0, 0);
        for _ in 0..300 {
            let cell = any_cell(&mut noise);
            let verdict = judge(&measured(
                &thesis_grid(),
                cell,
                Bench { sigma, stated },
                (&mut noise, NONE),
            ));
            bad += u32::from(verdict.points.iter().any(|p| p.grade == Grade::Bad));
            doubtful += u32::from(verdict.grade != Grade::Good);
        }
        assert!(
            bad <= most_by_chance(300, FALSE_ALARM_RATE),
            "σ {sigma}, stated {stated}: {bad} of 300 bad"
        );
        assert!(
            doubtful <= most_by_chance(300, DOUBTFUL_RATE),
            "σ {sigma}, stated {stated}: {doubtful} of 300 doubtful"
        );
    }
}

#[test]
fn inductive_and_diffusive_ends_are_valid() {
    let mut noise = Noisy::new(22);
    let cell = |f: f64| {
        Complex64::new(0.02, TAU * f * 2.5e-7)
            + 5e-3 / (1.0 + power(TAU * f * 2e-3, 0.7))
            + 3e-3 * power(TAU * f, -0.5)
    };
    let mut bad = 0;
    for _ in 0..60 {
        let spectrum = measured(
            &grid(54, 1.4e-3, 6000.0),
            cell,
            Bench {
                sigma: 5e-4,
                stated: true,
            },
            (&mut noise, NONE),
        );
        assert!(
            spectrum.points[0].z_ohm.im < -0.02 && spectrum.points[53].z_ohm.im > 5e-3,
            "the ends are what they are to be"
        );
        bad += u32::from(judge(&spectrum).grade != Grade::Good);
    }
    assert!(bad <= most_by_chance(60, DOUBTFUL_RATE), "{bad} of 60");
}

/// Number of a hundred cells with a fault that are not called good, and the verdicts.
fn caught(sigma: f64, fault: Fault) -> Vec<SpectrumVerdict> {
    let mut noise = Noisy::new(23);
    let judged = (0..100).map(|_| {
        let cell = any_cell(&mut noise);
        judge(&measured(
            &thesis_grid(),
            cell,
            Bench {
                sigma,
                stated: true,
            },
            (&mut noise, fault),
        ))
    });
    judged.filter(|v| v.grade != Grade::Good).collect()
}

#[test]
fn a_cell_that_drifts_is_caught_at_the_slow_end() {
    // The resistance rises by 2 % as the sweep goes down; time passes as periods do, mostly at the
    // lowest frequencies.
    let verdicts = caught(5e-4, |k, z| {
        z * (1.0 + 0.02 * (3000f64.powf(-(k as f64) / 19.0)))
    });
    assert!(verdicts.len() >= 95, "{} of 100", verdicts.len());
    let slow = |v: &&SpectrumVerdict| v.points[..5].iter().any(|p| p.grade != Grade::Good);
    assert!(verdicts.iter().filter(slow).count() >= 90);
    assert!(
        verdicts
            .iter()
            .any(|v| v.text.contains("disagrees with Kramers–Kronig")),
        "{}",
        verdicts[0].text
    );
}

#[test]
fn the_wrong_sign_is_named() {
    let verdicts = caught(2e-3, |_, z| z.conj());
    let named = verdicts.iter().filter(|v| {
        v.grade == Grade::Bad && v.text.contains("the imaginary part has the wrong sign")
    });
    assert!(named.count() >= 95);
    assert!(verdicts.iter().all(|v| v.valid_band_hz.is_none()));
}

#[test]
fn a_spike_is_named_and_the_others_are_believed() {
    let verdicts = caught(2e-3, |k, z| if k == 6 { z * 1.02 } else { z });
    assert!(verdicts.len() >= 95, "{} of 100", verdicts.len());
    let alone =
        |v: &&SpectrumVerdict| (0..20).all(|k| (v.points[k].grade != Grade::Good) == (k == 6));
    assert!(
        verdicts.iter().filter(alone).count() >= 85,
        "{}",
        verdicts.iter().filter(alone).count()
    );
    let text = &verdicts.iter().find(alone).unwrap().text;
    assert!(
        text.starts_with(
            "valid from 0.1 Hz to 201 Hz; point 7 (1.1 Hz): disagrees with Kramers–Kronig by "
        ),
        "{text}"
    );
}

#[test]
fn a_small_spike_is_caught_by_its_own_point() {
    // 1.4 % is 7 σ of one part: among 114 parts that hardly moves the sum of all, which has a
    // standard deviation of some 13.
    let mut noise = Noisy::new(28);
    let spike: Fault = |k, z| if k == 28 { z * 1.014 } else { z };
    let (mut named, mut hidden_from_the_sum) = (0, 0);
    for _ in 0..100 {
        let cell = any_cell(&mut noise);
        let spectrum = measured(
            &grid(57, 0.01, 1e4),
            cell,
            Bench {
                sigma: 2e-3,
                stated: true,
            },
            (&mut noise, spike),
        );
        let found = assess(std::slice::from_ref(&spectrum), &[])
            .unwrap()
            .spectra
            .remove(0);
        let (kk, point) = (&found.kramers_kronig, &found.verdict.points[28]);
        let alone = kk.outcome == KkOutcome::SinglePoints
            && (0..57).all(|k| kk.points[k].left_out == (k == 28));
        let reason = format!(
            "disagrees with Kramers–Kronig by {:.2} % ({:.1} σ)",
            kk.points[28].percent(),
            kk.points[28].sigmas
        );
        let reported = point.grade == Grade::Bad
            && point.reasons == [reason.clone()]
            && found.verdict.text.contains(&reason);
        named += u32::from(alone && reported && (0.4..2.6).contains(&kk.points[28].percent()));
        // With the spike's square put back, the sum over the others' degrees of freedom and its two
        // is still no rare one (99.7 % point, Wilson and Hilferty).
        let (sum, dof) = (kk.chi2 + kk.points[28].sigmas.powi(2), kk.dof + 2.0);
        hidden_from_the_sum += u32::from(
            sum < dof * (1.0 - 2.0 / (9.0 * dof) + 2.748 * (2.0 / (9.0 * dof)).sqrt()).powi(3),
        );
    }
    assert!(named >= 80, "{named} of 100");
    assert!(
        hidden_from_the_sum >= 40,
        "the sum of all sees {} of 100 by itself",
        100 - hidden_from_the_sum
    );
}

#[test]
fn clipping_is_caught() {
    // The voltage cannot exceed that of 8 mΩ.
    let verdicts = caught(1e-3, |_, z| z * (8e-3 / z.norm()).min(1.0));
    assert!(verdicts.len() >= 90, "{} of 100", verdicts.len());
}

#[test]
fn noise_is_found_without_a_stated_one() {
    let mut noise = Noisy::new(24);
    for sigma in [5e-4, 5e-3] {
        let cell = any_cell(&mut noise);
        let bench = Bench {
            sigma,
            stated: false,
        };
        let repeats: Vec<Spectrum> = (0..5)
            .map(|_| measured(&thesis_grid(), &cell, bench, (&mut noise, NONE)))
            .collect();
        let from_repeats = Noise::of(&repeats[0], &repeats).unwrap();
        assert_eq!(from_repeats.source, NoiseSource::Repeats);
        let met = from_repeats.relative(&repeats[0].points);
        assert!((0.8..1.25).contains(&(met / sigma)), "{met} for {sigma}");
        let alone: Vec<f64> = repeats
            .iter()
            .map(|r| Noise::of(r, &[]).unwrap().relative(&r.points) / sigma)
            .collect();
        assert!(
            alone.iter().all(|ratio| (0.5..2.2).contains(ratio)),
            "{alone:?}"
        );
    }
}

#[test]
fn amplitudes_that_change_the_impedance_are_nonlinear() {
    let mut noise = Noisy::new(25);
    let cell = any_cell(&mut noise);
    let bench = Bench {
        sigma: 5e-4,
        stated: true,
    };
    let mut sweep = |amplitude_a: f64, fault: Fault| {
        let mut spectrum = measured(&thesis_grid(), &cell, bench, (&mut noise, fault));
        spectrum
            .points
            .iter_mut()
            .for_each(|p| p.amplitude_a = amplitude_a);
        spectrum
    };
    let fall: Fault = |k, z| if k < 3 { z * 0.99 } else { z };
    let both = [sweep(1.0, NONE), sweep(4.0, fall)];
    let assessment = assess(&both, &[]).unwrap();
    let linearity = assessment.linearity.unwrap();
    assert_eq!(linearity.amplitudes_a, (1.0, 4.0));
    let flagged: Vec<bool> = linearity.points.iter().map(|p| p.nonlinear).collect();
    assert_eq!(flagged[..3], [true; 3]);
    assert!(
        flagged[3..].iter().filter(|f| **f).count() <= 1,
        "{flagged:?}"
    );
    assert!((linearity.points[0].change_percent - 1.0).abs() < 0.3);
    assert!(
        assessment.spectra[0]
            .verdict
            .text
            .contains("% with the amplitude: not linear"),
        "{}",
        assessment.spectra[0].verdict.text
    );
    assert!(
        assess(&[sweep(1.0, NONE), sweep(1.0, NONE)], &[])
            .unwrap()
            .linearity
            .is_none(),
        "one amplitude does not show linearity"
    );
}

#[test]
fn harmonics_tell_the_error_of_a_polynomial() {
    // v = i + b iⁿ over one period, its harmonics by direct summation.
    for (order, b) in [(3, 0.01), (5, 0.02), (2, 0.05)] {
        let n = 4096;
        let coefficient = |k: f64| {
            let at = |j: i32| TAU * f64::from(j) / f64::from(n);
            2.0 / f64::from(n)
                * (0..n)
                    .map(|j| (at(j).cos() + b * at(j).cos().powi(order)) * (k * at(j)).cos())
                    .sum::<f64>()
        };
        let harmonic = Harmonic {
            order: order.unsigned_abs(),
            ratio: coefficient(f64::from(order)),
            sigma: 1e-5,
        };
        let error = 100.0 * (coefficient(1.0) - 1.0);
        assert!(
            (harmonic.error_percent() - error).abs() < 1e-6,
            "order {order}: {} for {error}",
            harmonic.error_percent()
        );
        let record = Record {
            freq_hz: 1.0,
            harmonics: vec![harmonic],
            drift: None,
        };
        assert_eq!(
            beyond_noise(&[record]),
            [[order % 2 == 1]],
            "an even order changes nothing"
        );
    }
}

#[test]
fn of_a_hundred_sweeps_of_noise_one_has_a_harmonic_however_many_points_it_has() {
    let mut rng = analysis_numeric::Rng::new(11);
    let mut gauss = move || (0..12).map(|_| rng.uniform()).sum::<f64>() - 6.0;
    for points in [5, 20, 60] {
        let mut harmonic = |order| Harmonic {
            order,
            ratio: 1e-3 * gauss().hypot(gauss()),
            sigma: 1e-3,
        };
        let mut sweep = || -> Vec<Record> {
            (0..points)
                .map(|k| Record {
                    freq_hz: f64::from(k),
                    harmonics: vec![harmonic(2), harmonic(3)],
                    drift: None,
                })
                .collect()
        };
        let found = (0..3000)
            .filter(|_| {
                beyond_noise(&sweep())
                    .iter()
                    .flatten()
                    .any(|beyond| *beyond)
            })
            .count();
        // One in a hundred, and four standard deviations of that.
        assert!(
            (8..=52).contains(&found),
            "{points} points: {found} of 3000"
        );
    }
    // A true harmonic is found among many that are noise.
    let mut records: Vec<Record> = (0..40)
        .map(|k| Record {
            freq_hz: f64::from(k),
            harmonics: vec![Harmonic {
                order: 3,
                ratio: 1e-3,
                sigma: 1e-3,
            }],
            drift: None,
        })
        .collect();
    records[7].harmonics[0].ratio = 6e-3;
    assert_eq!(
        beyond_noise(&records).iter().position(|beyond| beyond[0]),
        Some(7)
    );
}

#[test]
fn drift_in_a_record_is_worth_what_was_measured() {
    for (periods, percent) in [(1.0, 0.32), (5.0, 0.064)] {
        assert!(
            (Drift {
                over_amplitude: 0.01,
                periods,
                shape: DriftShape::Ramp
            }
            .error_percent()
                / percent
                - 1.0)
                .abs()
                < 0.01
        );
    }
    let mut noise = Noisy::new(26);
    let cell = any_cell(&mut noise);
    let spectrum = measured(
        &thesis_grid(),
        cell,
        Bench {
            sigma: 2e-3,
            stated: true,
        },
        (&mut noise, NONE),
    );
    let record = |drift, ratio| Record {
        freq_hz: spectrum.points[4].freq_hz,
        harmonics: vec![Harmonic {
            order: 3,
            ratio,
            sigma: 1e-4,
        }],
        drift: Some(Drift {
            over_amplitude: drift,
            periods: 5.0,
            shape: DriftShape::Ramp,
        }),
    };
    let verdict = |record| {
        assess(std::slice::from_ref(&spectrum), &[record])
            .unwrap()
            .spectra
            .remove(0)
            .verdict
            .points[4]
            .clone()
    };
    assert_eq!(verdict(record(0.01, 1e-4)).grade, Grade::Good);
    assert_eq!(
        verdict(record(0.1, 1e-4)).reasons,
        ["the offset drifts within the record: Z may be off by 0.6 %"]
    );
    let both = verdict(record(0.01, 0.005));
    assert_eq!(
        (both.grade, both.reasons[0].as_str()),
        (
            Grade::Bad,
            "harmonic 3 of 0.50 %: not linear, Z may be off by 1.5 %"
        )
    );
}

/// The verdict on the point of a good spectrum whose record shows this.
fn by_record(harmonics: Vec<Harmonic>, drift: Option<Drift>) -> PointVerdict {
    let mut noise = Noisy::new(26);
    let cell = any_cell(&mut noise);
    let spectrum = measured(
        &thesis_grid(),
        cell,
        Bench {
            sigma: 2e-3,
            stated: true,
        },
        (&mut noise, NONE),
    );
    let record = Record {
        freq_hz: spectrum.points[4].freq_hz,
        harmonics,
        drift,
    };
    assess(std::slice::from_ref(&spectrum), &[record])
        .unwrap()
        .spectra
        .remove(0)
        .verdict
        .points[4]
        .clone()
}

#[test]
fn a_record_is_doubted_from_0_3_percent_and_bad_from_1_percent() {
    // A ramp of d amplitudes over five periods puts d/(5π) into the fundamental: 0.3 % for 0.0471,
    // 1 % for 0.1571. A parabola that bends by d puts 4d/(25π²) there: 0.3 % for 0.1851, 1 %
    // for 0.6169.
    let ramp = |over_amplitude| {
        by_record(
            Vec::new(),
            Some(Drift {
                over_amplitude,
                periods: 5.0,
                shape: DriftShape::Ramp,
            }),
        )
        .grade
    };
    assert_eq!(
        [0.0465, 0.0477, 0.155, 0.159].map(ramp),
        [Grade::Good, Grade::Doubtful, Grade::Doubtful, Grade::Bad]
    );
    assert_eq!(
        [-0.0465, -0.0477, -0.155, -0.159].map(ramp),
        [Grade::Good, Grade::Doubtful, Grade::Doubtful, Grade::Bad]
    );
    let bend = |over_amplitude| {
        by_record(
            Vec::new(),
            Some(Drift {
                over_amplitude,
                periods: 5.0,
                shape: DriftShape::Bend,
            }),
        )
        .grade
    };
    assert_eq!(
        [0.183, 0.187, 0.61, 0.623].map(bend),
        [Grade::Good, Grade::Doubtful, Grade::Doubtful, Grade::Bad]
    );
    // exp(−x²/2) is 0.01 at x = 3.035; a second harmonic leaves the fundamental alone.
    let harmonic = |(order, ratio, sigma)| {
        by_record(
            vec![Harmonic {
                order,
                ratio,
                sigma,
            }],
            None,
        )
        .grade
    };
    let met = [
        (3, 0.006, 0.00201),
        (3, 0.006, 0.00196),
        (3, 0.0009, 1e-5),
        (3, 0.0011, 1e-5),
        (2, 0.05, 1e-5),
    ]
    .map(harmonic);
    assert_eq!(
        met,
        [
            Grade::Good,
            Grade::Bad,
            Grade::Good,
            Grade::Doubtful,
            Grade::Good
        ]
    );
}

#[test]
fn a_clipped_sine_is_bad_by_its_harmonics() {
    // Cut off at c of its height. Its k-th harmonic by direct summation, what it loses of its
    // fundamental by Fourier's integral.
    let n = 4096;
    let clipped = |c: f64| {
        let coefficient = |k: f64| {
            let at = |j: i32| TAU * f64::from(j) / f64::from(n);
            2.0 / f64::from(n)
                * (0..n)
                    .map(|j| at(j).sin().clamp(-c, c) * (k * at(j)).sin())
                    .sum::<f64>()
        };
        let harmonic = |order: u32| Harmonic {
            order,
            ratio: (coefficient(f64::from(order)) / coefficient(1.0)).abs(),
            sigma: 1e-5,
        };
        (
            by_record(vec![harmonic(3), harmonic(5)], None),
            1.0 - std::f64::consts::FRAC_2_PI * (c.asin() + c * (1.0 - c * c).sqrt()),
        )
    };
    let (hard, lost) = clipped(0.95);
    assert!((0.013..0.014).contains(&lost), "{lost}");
    assert_eq!(hard.grade, Grade::Bad);
    assert!(
        hard.reasons[0].starts_with("harmonic 3 of 1.24 %"),
        "{:?}",
        hard.reasons
    );
    let (soft, lost) = clipped(0.999);
    assert!(
        lost < 1e-4 && soft.grade == Grade::Good,
        "{lost} {:?}",
        soft.reasons
    );
}

#[test]
fn repeats_that_drift_are_distinguished_from_repeats_that_do_not() {
    let run = |seed: u64, drift: f64| {
        let mut noise = Noisy::new(seed);
        let cell = any_cell(&mut noise);
        let bench = Bench {
            sigma: 1e-3,
            stated: true,
        };
        let sweep = |r: usize| {
            let mut spectrum = measured(&thesis_grid(), &cell, bench, (&mut noise, NONE));
            spectrum
                .points
                .iter_mut()
                .for_each(|p| p.z_ohm *= 1.0 + drift * (r as f64 - 2.0) / 4.0);
            spectrum
        };
        let repeats: Vec<Spectrum> = (0..5).map(sweep).collect();
        assess(&repeats, &[]).unwrap().stationarity.unwrap()
    };
    let still: usize = (0..40)
        .filter(|seed| {
            run(*seed, 0.0)
                .points
                .iter()
                .any(|p| p.drifts() || p.scatters())
        })
        .count();
    // Two families of tests at 1 % each.
    assert!(
        still <= usize::try_from(most_by_chance(40, 0.02)).unwrap(),
        "{still} of 40"
    );
    let drifting = run(1, 0.01);
    assert!(drifting.points.iter().filter(|p| p.drifts()).count() >= 15);
    let trend = drifting
        .points
        .iter()
        .filter_map(|p| p.trend_percent)
        .sum::<f64>()
        / 20.0;
    assert!((trend - 1.0).abs() < 0.1, "{trend}");
    assert!(
        (drifting.shift_percent[0] + 0.5).abs() < 0.1,
        "{:?}",
        drifting.shift_percent
    );
    // The deviations −0.5, −0.25 … +0.5 % have a standard deviation of 0.395 % in the modulus
    // alone, over both parts 0.280 %.
    assert!(
        (drifting.excess_percent.unwrap() - 0.280).abs() < 0.03,
        "{:?}",
        drifting.excess_percent
    );
}

#[test]
fn refuses_what_cannot_be_judged() {
    let mut noise = Noisy::new(27);
    let cell = any_cell(&mut noise);
    let short = measured(
        &grid(4, 1.0, 100.0),
        cell,
        Bench {
            sigma: 1e-3,
            stated: true,
        },
        (&mut noise, NONE),
    );
    let message = assess(std::slice::from_ref(&short), &[])
        .unwrap_err()
        .to_string();
    assert_eq!(
        message,
        "spectrum \"made\": expected at least 6 points to judge it by, met 4"
    );
    let mut zero = measured(
        &thesis_grid(),
        any_cell(&mut noise),
        Bench {
            sigma: 1e-3,
            stated: false,
        },
        (&mut noise, NONE),
    );
    zero.points[2].z_ohm = Complex64::ZERO;
    let message = assess(&[zero], &[]).unwrap_err().to_string();
    assert!(
        message.starts_with("spectrum \"made\", point 3 (0.22"),
        "{message}"
    );
    assert!(
        message.ends_with("expected an impedance other than 0 Ω, met 0 Ω"),
        "{message}"
    );
    let empty = Spectrum {
        name: "nothing".into(),
        points: Vec::new(),
        ..Spectrum::default()
    };
    assert!(
        assess(&[empty], &[])
            .unwrap_err()
            .to_string()
            .contains("at least one point, met none")
    );
}

/// How many of a hundred valid cells on the thesis' grid have a bad point and how many are not
/// good, without stated noise, its size by frequency.
fn called_without_sigmas(sigma: fn(f64) -> f64) -> (u32, u32) {
    let mut noise = Noisy::new(31);
    let (mut bad, mut not_good) = (0, 0);
    for _ in 0..100 {
        let cell = any_cell(&mut noise);
        let mut spectrum = measured(
            &grid(50, 0.01, 1e4),
            cell,
            Bench {
                sigma: 0.0,
                stated: false,
            },
            (&mut noise, NONE),
        );
        for p in &mut spectrum.points {
            let s = sigma(p.freq_hz) * p.z_ohm.norm();
            p.z_ohm += Complex64::new(s * noise.normal(), s * noise.normal());
        }
        let verdict = judge(&spectrum);
        bad += u32::from(verdict.points.iter().any(|p| p.grade == Grade::Bad));
        not_good += u32::from(verdict.grade != Grade::Good);
    }
    (bad, not_good)
}

#[test]
fn small_noise_that_is_not_in_proportion_is_not_a_fault() {
    let slow: fn(f64) -> f64 = |f| if f < 0.1 { 1.5e-3 } else { 5e-4 };
    let fast: fn(f64) -> f64 = |f| if f > 1e3 { 1e-3 } else { 1e-4 };
    for sigma in [slow, fast] {
        let (bad, _) = called_without_sigmas(sigma);
        assert!(
            bad <= most_by_chance(100, FALSE_ALARM_RATE),
            "{bad} of 100 bad"
        );
    }
}

#[test]
fn significance_needs_size() {
    // A zigzag of ±ε in modulus, which no ladder follows: of 0.001 % noise as stated, it is
    // hundreds of σ.
    let zigzag = |size: f64| {
        let mut noise = Noisy::new(32);
        let cell = any_cell(&mut noise);
        let mut spectrum = measured(
            &thesis_grid(),
            cell,
            Bench {
                sigma: 1e-5,
                stated: true,
            },
            (&mut noise, NONE),
        );
        spectrum
            .points
            .iter_mut()
            .enumerate()
            .for_each(|(k, p)| p.z_ohm *= 1.0 + if k % 2 == 0 { size } else { -size });
        judge(&spectrum)
    };
    assert_eq!(
        [5e-4, 2e-3, 8e-3].map(|size| zigzag(size).grade),
        [Grade::Good, Grade::Doubtful, Grade::Bad]
    );
    assert!(
        zigzag(2e-3)
            .text
            .contains("Kramers–Kronig leaves more than the noise explains"),
        "{}",
        zigzag(2e-3).text
    );
    assert!(zigzag(2e-3).valid_band_hz.is_some() && zigzag(8e-3).valid_band_hz.is_none());
}

#[test]
fn an_end_of_the_band_is_reported_by_the_fit_to_all() {
    let mut noise = Noisy::new(33);
    let cell = any_cell(&mut noise);
    let fault: Fault = |k, z| {
        if k < 8 {
            z * (1.0 + 0.03 * (-1f64).powi(k as i32))
        } else {
            z
        }
    };
    let spectrum = measured(
        &grid(50, 0.01, 1e4),
        cell,
        Bench {
            sigma: 1e-4,
            stated: true,
        },
        (&mut noise, fault),
    );
    let found = assess(std::slice::from_ref(&spectrum), &[])
        .unwrap()
        .spectra
        .remove(0);
    assert_eq!(
        (found.kramers_kronig.outcome, found.verdict.grade),
        (KkOutcome::PartOfBand, Grade::Bad)
    );
    // The fault is of 3 %: so is what is printed, not what an extrapolation makes of it.
    assert!(
        found
            .kramers_kronig
            .points
            .iter()
            .all(|p| p.percent() < 6.0),
        "{:?}",
        found.kramers_kronig.points
    );
    assert!(
        found.verdict.valid_band_hz.unwrap().0 > spectrum.points[6].freq_hz,
        "{}",
        found.verdict.text
    );
}

#[test]
fn reversed_leads_are_named() {
    let verdicts = caught(2e-3, |_, z| -z);
    assert_eq!(verdicts.len(), 100);
    for v in &verdicts {
        assert!(v.grade == Grade::Bad && v.valid_band_hz.is_none());
        assert!(
            v.text
                .starts_with("not valid: the real part is negative: leads reversed?"),
            "{}",
            v.text
        );
    }
}

/// An error that all points share is an impedance of a linear system, and not noise that could hide
/// a bad point.
#[test]
fn shared_errors_do_not_hide_a_bad_point() {
    let sigma = 1e-5;
    let point = |k: i32| {
        let freq_hz = 0.1 * 10f64.powf(f64::from(k) / 6.0);
        let z_ohm = 0.006
            + 0.004 / Complex64::new(1.0, TAU * freq_hz * 0.05)
            + if k == 12 { 8e-5 } else { 0.0 };
        ImpedancePoint {
            freq_hz,
            z_ohm,
            covariance: Covariance2::circular(sigma * sigma),
            amplitude_a: 1.0,
        }
    };
    let mut spectrum = Spectrum::new("shared", (0..24).map(point).collect());
    let grade = |spectrum: &Spectrum| {
        kramers_kronig(spectrum, &Noise::of(spectrum, &[]).unwrap())
            .unwrap()
            .outcome
    };
    assert_eq!(grade(&spectrum), KkOutcome::SinglePoints);
    // A gain of 1 %, stated.
    let at_ohm: Vec<Complex64> = spectrum.points.iter().map(|p| 0.01 * p.z_ohm).collect();
    for (point, direction) in spectrum.points.iter_mut().zip(&at_ohm) {
        point.covariance = point.covariance + Covariance2::along(*direction);
    }
    spectrum.shared = vec![analysis_signal::spectrum::SharedError {
        name: "gain".to_owned(),
        at_ohm,
    }];
    assert_eq!(grade(&spectrum), KkOutcome::SinglePoints);
    let all = Noise::of(&spectrum, &[]).unwrap().with_shared(&spectrum);
    assert_eq!(all.covariance[3], spectrum.points[3].covariance);
}
