//! Judges the points of a finished sweep of a cell by physics, with or without a quality gate: a
//! cell is passive, and a point that the gate has accepted is trusted only beside other accepted
//! points. The functions are pure.

use analysis_signal::spectrum::ImpedancePoint;

use super::{
    SweepPoint,
    quality::{Criterion, Failing},
};

/// Standard deviations above which a negative real part does not count as noise.
const CERTAIN: f64 = 5.0;

/// Adds the reasons for rejecting points of a sweep, which are sorted by rising frequency and come
/// with their corrected impedances.
pub fn judge_sweep(points: &mut [SweepPoint], corrected: &[ImpedancePoint]) {
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

/// Returns a failure if the real part is negative beyond the uncertainty of the point: a passive
/// two-terminal network has no negative real part at any frequency.
fn judge_passivity(point: &ImpedancePoint) -> Option<Failing> {
    let size_ohm = point.magnitude_ohm();
    let failing = Failing {
        criterion: Criterion::Passivity,
        value: -point.z_ohm.re / size_ohm,
        limit: CERTAIN * point.covariance.re_re.max(0.0).sqrt() / size_ohm,
    };
    (failing.value > failing.limit).then_some(failing)
}

/// Returns accepted points that are suspect. A sequence of accepted points beside rejected ones is
/// suspect unless it outnumbers the rejected points on each side: the rejection shows that the
/// sweep contradicts itself, and then the minority is probably wrong. At an end of a sweep the
/// test has neighbours on one side only.
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
    use analysis_numeric::Covariance2;
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
