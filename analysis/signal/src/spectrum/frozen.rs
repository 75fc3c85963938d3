//! The spectrum of a changing cell at one time. Every frequency is visited several times, and a
//! straight line in time through its visits is evaluated in the middle of the sweep. A change that
//! is linear in time cancels at every frequency. For visits in both directions, all frequencies
//! have the same middle, and the line is their mean.

use super::ImpedancePoint;
use analysis_numeric::Covariance2;

/// Visits of less than this apart, relative, are of one frequency.
const SAME: f64 = 1.0e-9;

/// Returns the points (time in s, impedance) to one per frequency at the middle of all times, by
/// rising frequency. A frequency with one visit stays as it is.
pub fn at_one_time(visits: &[(f64, ImpedancePoint)]) -> Vec<ImpedancePoint> {
    let (first_s, last_s) = visits.iter().fold(
        (f64::INFINITY, f64::NEG_INFINITY),
        |(first, last), (time_s, _)| (first.min(*time_s), last.max(*time_s)),
    );
    let mut sorted = visits.to_vec();
    sorted.sort_by(|a, b| a.1.freq_hz.total_cmp(&b.1.freq_hz));
    sorted
        .chunk_by(|a, b| (a.1.freq_hz / b.1.freq_hz - 1.0).abs() < SAME)
        .filter_map(|group| line(group, 0.5 * (first_s + last_s)))
        .collect()
}

/// Returns the straight line of least squares through the visits of one frequency, at a time.
fn line(group: &[(f64, ImpedancePoint)], at_s: f64) -> Option<ImpedancePoint> {
    let count = group.len() as f64;
    let mean_s = group.iter().map(|(time_s, _)| time_s).sum::<f64>() / count;
    let square: f64 = group
        .iter()
        .map(|(time_s, _)| (time_s - mean_s).powi(2))
        .sum();
    let weight = |time_s: f64| {
        1.0 / count
            + if square > 0.0 {
                (at_s - mean_s) * (time_s - mean_s) / square
            } else {
                0.0
            }
    };
    Some(ImpedancePoint {
        freq_hz: group.first()?.1.freq_hz,
        z_ohm: group
            .iter()
            .map(|(time_s, point)| point.z_ohm * weight(*time_s))
            .sum(),
        covariance: group
            .iter()
            .map(|(time_s, point)| point.covariance.times(weight(*time_s).powi(2)))
            .sum::<Covariance2>(),
        amplitude_a: group
            .iter()
            .map(|(_, point)| point.amplitude_a)
            .sum::<f64>()
            / count,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use num_complex::Complex64;

    fn point(freq_hz: f64, z_ohm: Complex64) -> ImpedancePoint {
        ImpedancePoint {
            freq_hz,
            z_ohm,
            covariance: Covariance2::circular(4.0),
            amplitude_a: 1.0,
        }
    }

    #[test]
    fn a_linear_change_cancels_there_and_back_also_where_the_way_back_is_slower() {
        let z = |freq_hz: f64| Complex64::new(2.0 + freq_hz, -1.0 / freq_hz);
        let changed =
            |freq_hz: f64, time_s: f64| point(freq_hz, z(freq_hz) * (1.0 + 0.01 * (time_s - 50.0)));
        for back in [[60.0, 80.0, 100.0], [61.0, 85.0, 100.0]] {
            let there = [(1.0, 0.0), (2.0, 20.0), (3.0, 40.0)];
            let back = [(3.0, back[0]), (2.0, back[1]), (1.0, back[2])];
            let visits: Vec<(f64, ImpedancePoint)> = there
                .iter()
                .chain(&back)
                .map(|&(freq_hz, at_s)| (at_s, changed(freq_hz, at_s)))
                .collect();
            let found = at_one_time(&visits);
            assert_eq!(
                found.iter().map(|p| p.freq_hz).collect::<Vec<_>>(),
                [1.0, 2.0, 3.0]
            );
            for p in &found {
                assert!(
                    (p.z_ohm - z(p.freq_hz)).norm() < 1e-9,
                    "{} Hz: {}",
                    p.freq_hz,
                    p.z_ohm
                );
            }
            // Two visits of equal weight halve the variance.
            assert!((found[0].covariance.re_re - 2.0).abs() < 1e-12);
        }
    }

    #[test]
    fn a_single_visit_stays_as_it_is() {
        let one = point(5.0, Complex64::new(1.0, 2.0));
        assert_eq!(at_one_time(&[(7.0, one)]), [one]);
        assert_eq!(at_one_time(&[]), []);
    }
}
