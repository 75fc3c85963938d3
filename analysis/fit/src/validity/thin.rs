//! Long spectra: the tests are made for tens of points. Z-HIT holds matrices of points × points,
//! and points are left out one by one, so that time and memory grow with the square of their number
//! and more. Beyond some number nothing is gained: the ladder has no more than sixty elements.

use analysis_signal::spectrum::{SharedError, Spectrum};

/// Maximum number of judged points: eight for each of the ladder's sixty elements, with 2 MB for
/// each matrix of Z-HIT.
pub const MOST_POINTS: usize = 500;

/// Returns a long spectrum with no more than [`MOST_POINTS`] of its points, those nearest to an
/// even grid over ln f with both ends; `None` for a spectrum that is short enough. Original points
/// are used, because a mean of neighbours would hide a bad one.
pub fn thinned(spectrum: &Spectrum) -> Option<Spectrum> {
    let points = &spectrum.points;
    let (first, last) = (points.first()?.freq_hz.ln(), points.last()?.freq_hz.ln());
    if points.len() <= MOST_POINTS {
        return None;
    }
    let mut taken: Vec<usize> = Vec::with_capacity(MOST_POINTS);
    let mut next = 0;
    for k in 0..MOST_POINTS {
        let target = first + (last - first) * k as f64 / (MOST_POINTS - 1) as f64;
        let off = |index: usize| (points[index].freq_hz.ln() - target).abs();
        while next + 1 < points.len() && off(next + 1) <= off(next) {
            next += 1;
        }
        if taken.last() != Some(&next) {
            taken.push(next);
        }
    }
    let of = |error: &SharedError| SharedError {
        name: error.name.clone(),
        at_ohm: taken
            .iter()
            .filter_map(|k| error.at_ohm.get(*k).copied())
            .collect(),
    };
    Some(Spectrum {
        name: spectrum.name.clone(),
        shared: spectrum.shared.iter().map(of).collect(),
        points: taken.iter().map(|k| points[*k]).collect(),
        less: spectrum.less,
    })
}

/// By how many points a spectrum was judged.
pub(super) fn remark(judged: usize, points: usize) -> String {
    format!(
        "; judged by {judged} of its {points} points, evenly spaced over ln f: what the others \
        show was not looked at"
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use analysis_numeric::Covariance2;
    use analysis_signal::spectrum::ImpedancePoint;

    fn spectrum(freqs_hz: impl Iterator<Item = f64>) -> Spectrum {
        let point = |freq_hz| ImpedancePoint {
            freq_hz,
            z_ohm: 0.01.into(),
            covariance: Covariance2::UNKNOWN,
            amplitude_a: f64::NAN,
        };
        Spectrum {
            name: "long".to_owned(),
            points: freqs_hz.map(point).collect(),
            ..Spectrum::default()
        }
    }

    #[test]
    fn short_spectra_stay_and_long_ones_keep_ends_and_order() {
        assert_eq!(
            thinned(&spectrum((1..=MOST_POINTS).map(|k| k as f64))),
            None
        );
        // Evenly over f: few points at the low end, so that fewer than the grid has are taken, each
        // once.
        for count in [MOST_POINTS + 1, 100_000] {
            let all = spectrum((1..=count).map(|k| k as f64));
            let thin = thinned(&all).unwrap();
            assert!(
                thin.points.len() <= MOST_POINTS && thin.points.len() > MOST_POINTS / 3,
                "{}",
                thin.points.len()
            );
            assert!(thin.points.is_sorted_by(|a, b| a.freq_hz < b.freq_hz));
            assert_eq!(
                (
                    thin.points[0].freq_hz,
                    thin.points[thin.points.len() - 1].freq_hz
                ),
                (1.0, count as f64)
            );
        }
    }
}
