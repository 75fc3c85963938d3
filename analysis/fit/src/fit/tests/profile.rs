//! Profile intervals: coverage where all is well, and words where nothing bounds a parameter.

use super::{Circuit, noisy};
use crate::fit::{FitOptions, Objective, Profile, fit_erm, profiles};
use analysis_numeric::{Covariance2, Rng};
use analysis_signal::spectrum::Spectrum;

const TWO: Circuit<'static> = (0.007, &[(0.0017, 1.2), (0.0026, 200.0)]);

fn of(spectrum: Spectrum, rc: usize, objective: Objective) -> Vec<Profile> {
    let spectra = [spectrum];
    let fit = fit_erm(
        &spectra,
        &FitOptions {
            rc,
            objective,
            ..FitOptions::default()
        },
    )
    .unwrap();
    profiles(&spectra, &fit).unwrap()
}

#[test]
fn intervals_cover_the_truth_as_often_as_they_say() {
    let truth = [0.007, 0.0017, 1.2, 0.0026, 200.0, 0.007 + 0.0017 + 0.0026];
    let runs = 150;
    for (objective, stated) in [(Objective::Complex, true), (Objective::Complex, false)] {
        let mut rng = Rng::new(8);
        let (mut hit_95, mut hit_68) = (0, 0);
        for _ in 0..runs {
            let mut sweep = noisy(TWO, 20, 0.004, &mut rng);
            if !stated {
                sweep
                    .points
                    .iter_mut()
                    .for_each(|p| p.covariance = Covariance2::UNKNOWN);
            }
            for (profile, truth) in of(sweep, 2, objective).iter().zip(truth) {
                let inside = |i: crate::fit::Interval| {
                    i32::from(i.low.unwrap() <= truth && truth <= i.high.unwrap())
                };
                hit_95 += inside(profile.interval_95);
                hit_68 += inside(profile.interval_68);
            }
        }
        let share = |hit: i32| f64::from(hit) / f64::from(6 * runs);
        // 900 intervals, the six of a sweep not independent; stated noise is widened for the
        // unlucky half, so that more than the level is covered.
        assert!(
            (share(hit_95) - 0.95).abs() < 0.03,
            "{objective}, stated {stated}: {} of 95 %",
            share(hit_95)
        );
        assert!(
            (-0.04..0.08).contains(&(share(hit_68) - 0.6827)),
            "{objective}, stated {stated}: {} of 68 %",
            share(hit_68)
        );
    }
}

#[test]
fn near_the_minimum_profile_and_sigma_agree() {
    for objective in [Objective::SumAbs, Objective::Complex] {
        let spectra = [noisy(TWO, 40, 0.001, &mut Rng::new(4))];
        let fit = fit_erm(
            &spectra,
            &FitOptions {
                rc: 2,
                objective,
                ..FitOptions::default()
            },
        )
        .unwrap();
        let dc = profiles(&spectra, &fit).unwrap().pop().unwrap();
        let half = (dc.interval_68.high.unwrap() - dc.interval_68.low.unwrap()) / 2.0;
        let ratio = half / fit.sigma.dc_resistance_ohm.unwrap();
        assert!((0.8..1.25).contains(&ratio), "{objective}: {ratio}");
    }
}

#[test]
fn a_time_constant_beyond_the_band_is_not_bounded() {
    // 1/(2π 0.1 Hz) is 1.6 s; the branch has 400 s and shows as a mere capacitance: its resistance
    // may be anything large.
    let slow: Circuit<'_> = (0.007, &[(0.0017, 1.2), (0.05, 8000.0)]);
    let all = of(
        noisy(slow, 20, 0.004, &mut Rng::new(3)),
        2,
        Objective::Complex,
    );
    let named = |name: &str| all.iter().find(|p| p.name == name).unwrap();
    let r2 = named("R2");
    assert!(
        r2.interval_95.high.is_none() && r2.interval_95.low.is_some(),
        "{r2:?}"
    );
    assert!(
        r2.warning()
            .unwrap()
            .starts_with("R2 is not bounded above by this band: above "),
        "{:?}",
        r2.warning()
    );
    assert!(named("R").warning().is_none() && named("C2").interval_95.low.is_some());
    assert!(
        named("DC resistance").interval_95.high.is_none(),
        "{:?}",
        named("DC resistance")
    );
}
