//! Judges the points of a finished sweep of a cell by physics, with or without a quality gate: a
//! cell is passive, and a point that the gate has let through is believed only beside others. Pure.

use analysis::spectrum::ImpedancePoint;

use super::{
    SweepPoint,
    quality::{Criterion, Failing},
};

/// Standard deviations from which on a negative real part is no noise.
const CERTAIN: f64 = 5.0;

/// Adds what refuses points of a sweep, which come by rising frequency with their corrected
/// impedances.
pub(crate) fn judge_sweep(points: &mut [SweepPoint], corrected: &[ImpedancePoint]) {
    for (point, impedance) in points.iter_mut().zip(corrected) {
        point.failing.extend(judge_passivity(impedance));
    }
    let refused: Vec<bool> = points
        .iter()
        .map(|point| point.failing.iter().any(Failing::is_of_sweep))
        .collect();
    for (point, suspect) in points.iter_mut().zip(suspects(&refused)) {
        if point.failing.is_empty() {
            point.failing.extend(suspect);
        }
    }
}

/// A passive two-terminal has no negative real part at any frequency; beyond the uncertainty of the
/// point it contradicts that.
fn judge_passivity(point: &ImpedancePoint) -> Option<Failing> {
    let size_ohm = point.magnitude_ohm();
    let failing = Failing {
        criterion: Criterion::Passivity,
        value: -point.z_ohm.re / size_ohm,
        limit: CERTAIN * point.covariance.re_re.max(0.0).sqrt() / size_ohm,
    };
    (failing.value > failing.limit).then_some(failing)
}

/// Points in a row that were let through beside points that the sweep refuses are suspect, unless
/// they outnumber the refused ones on each side: the refusal says that the sweep contradicts
/// itself, and of few against many the few are not the right ones. At an end of a sweep the test
/// has neighbours on one side only.
fn suspects(refused: &[bool]) -> Vec<Option<Failing>> {
    let runs: Vec<&[bool]> = refused.chunk_by(|a, b| a == b).collect();
    let beside = |index: usize| {
        let before = index.checked_sub(1).and_then(|before| runs.get(before));
        before
            .into_iter()
            .chain(runs.get(index + 1))
            .map(|run| run.len())
            .max()
            .unwrap_or(0)
    };
    let judge = |(index, run): (usize, &&[bool])| {
        let let_through = run.first() == Some(&false);
        let failing = Failing {
            criterion: Criterion::Neighbours,
            value: run.len() as f64,
            limit: beside(index) as f64,
        };
        let suspect = let_through && failing.value <= failing.limit;
        vec![suspect.then_some(failing); run.len()]
    };
    runs.iter().enumerate().flat_map(judge).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use analysis::numeric::Covariance2;
    use num_complex::Complex64;

    #[test]
    fn few_points_beside_many_that_the_sweep_refuses_are_suspect() {
        for (refused, expected) in [
            (".......", "......."),
            ("..xxxxx", "ssxxxxx"),
            (".xxxxx.", "sxxxxxs"),
            (".x.....", "sx....."),
            ("..x....", "..x...."),
            ("...x...", "...x..."),
            ("..xx...", "ssxx..."),
            ("...x.x.", "...xsxs"),
            ("xxxxxxx", "xxxxxxx"),
        ] {
            let flags: Vec<bool> = refused.chars().map(|c| c == 'x').collect();
            let found: String = suspects(&flags)
                .iter()
                .zip(&flags)
                .map(|(suspect, refused)| match (suspect, refused) {
                    (Some(_), _) => 's',
                    (None, true) => 'x',
                    (None, false) => '.',
                })
                .collect();
            assert_eq!(found, expected, "{refused}");
        }
    }

    #[test]
    fn a_negative_real_part_counts_beyond_its_uncertainty_only() {
        let point = |re: f64, sigma: f64| ImpedancePoint {
            freq_hz: 1.0,
            z_ohm: Complex64::new(re, 1e-3),
            amplitude_a: 1.0,
            covariance: Covariance2::circular(sigma * sigma),
        };
        assert_eq!(judge_passivity(&point(5e-3, 1e-6)), None);
        assert_eq!(judge_passivity(&point(-1e-4, 3e-5)), None);
        let failing = judge_passivity(&point(-1e-3, 1e-5)).unwrap();
        assert_eq!(
            failing.to_string(),
            "negative real part of Z: expected at most 3.5 %, found 71 %"
        );
    }
}
