//! Points that stand out, and data that only look as if nothing were wrong.

use super::noisy;
use crate::fit::{FitOptions, Objective, fit_erm};
use analysis_numeric::Rng;

const CIRCUIT: super::Circuit<'_> = (0.007, &[(0.0017, 1.2), (0.0026, 200.0)]);

fn warnings(spectrum: &analysis_signal::spectrum::Spectrum, objective: Objective) -> Vec<String> {
    fit_erm(
        std::slice::from_ref(spectrum),
        &FitOptions {
            rc: 2,
            objective,
            ..FitOptions::default()
        },
    )
    .unwrap()
    .warnings
    .words()
}

fn off(warnings: &[String]) -> Vec<&String> {
    warnings
        .iter()
        .filter(|w| w.contains("off the fit to the others"))
        .collect()
}

#[test]
fn a_wrong_point_is_named_by_every_objective_and_none_of_forty_clean_sweeps_is() {
    let mut rng = Rng::new(5);
    for k in 0..40 {
        let mut sweep = noisy(CIRCUIT, 25, 0.002, &mut rng);
        assert_eq!(
            off(&warnings(&sweep, Objective::Complex)),
            Vec::<&String>::new(),
            "sweep {k}"
        );
        if k % 8 > 0 {
            continue;
        }
        let wrong = 3 + k / 2;
        sweep.points[wrong].z_ohm.re *= -1.0;
        for objective in [Objective::Complex, Objective::SumAbs] {
            let met = warnings(&sweep, objective);
            let named = off(&met);
            let freq_hz =
                analysis_numeric::significant::format_significant(sweep.points[wrong].freq_hz, 3);
            assert!(
                named.len() == 1 && named[0].contains(&format!("the point at {freq_hz} Hz lies")),
                "sweep {k}, {objective:?}: {met:?}"
            );
        }
    }
}
