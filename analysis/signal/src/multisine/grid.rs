//! Choice of the harmonics that are excited.

use std::ops::RangeInclusive;

/// Returns odd harmonics of `base_hz` within `range_hz`, `lines` of them as evenly spaced on a
/// logarithmic axis as the harmonics allow, or fewer if the range does not contain that number. Of
/// three odd neighbours at least one is left out: it detects the odd distortion.
pub fn odd_grid(base_hz: f64, range_hz: RangeInclusive<f64>, lines: usize) -> Vec<usize> {
    let greatest = (range_hz.end() / base_hz * (1.0 + 1.0e-9)).floor();
    let least = (range_hz.start() / base_hz * (1.0 - 1.0e-9)).max(1.0);
    let last = ((greatest as usize).max(1) - 1) / 2 * 2 + 1;
    let mut chosen: Vec<usize> = Vec::new();
    for k in 0..lines {
        let share = if lines > 1 {
            k as f64 / (lines - 1) as f64
        } else {
            0.0
        };
        let wanted = least * (greatest / least).powf(share);
        let mut harmonic = nearest_odd(wanted).min(last);
        while harmonic < least as usize
            || chosen.last().is_some_and(|last| harmonic <= *last)
            || crowded(&chosen, harmonic)
        {
            harmonic += 2;
        }
        if harmonic as f64 <= greatest {
            chosen.push(harmonic);
        }
    }
    chosen
}

fn nearest_odd(value: f64) -> usize {
    2 * ((value - 1.0) / 2.0).round().max(0.0) as usize + 1
}

/// Returns whether the harmonic would be the third of three odd neighbours.
fn crowded(chosen: &[usize], harmonic: usize) -> bool {
    matches!(chosen, [.., first, second] if harmonic == second + 2 && *second == first + 2)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_grid_is_odd_rising_within_its_band_and_leaves_detection_lines() {
        assert_eq!(
            odd_grid(0.1, 0.1..=10.0, 12),
            [1, 3, 7, 9, 13, 15, 19, 21, 29, 43, 65, 99]
        );
        for (base_hz, band, lines) in [
            (0.1, 0.1..=10.0, 15),
            (5.0, 15.0..=300.0, 8),
            (1.0, 1.0..=9.0, 40),
        ] {
            let grid = odd_grid(base_hz, band.clone(), lines);
            assert!(
                grid.iter().all(|h| h % 2 == 1
                    && *h as f64 * base_hz <= *band.end()
                    && *h as f64 * base_hz >= *band.start() * 0.999),
                "{grid:?}"
            );
            assert!(grid.windows(2).all(|pair| pair[0] < pair[1]), "{grid:?}");
            assert!(
                !grid.windows(3).any(|three| three[2] == three[0] + 4),
                "{grid:?}"
            );
        }
    }
}
