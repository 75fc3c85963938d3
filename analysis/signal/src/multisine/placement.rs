//! Rates and lines for which no image of a generator's steps falls onto a line within the noise.

use std::f64::consts::TAU;

use super::images::{Image, Sampling, images};

/// Transfer path from the generator to the difference of two probes, as far as it turns images into
/// volts. The values are guesses made before a record; a factor of two is close enough.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Path {
    /// Corner of the supply's response, Hz.
    pub corner_hz: f64,
    /// Inductance of the loop between the probes' ground and the jig, H: both probes of the jig see
    /// it.
    pub loop_h: f64,
    /// Delay of one of them against the other, s.
    pub skew_s: f64,
    /// Inductance between the two, H.
    pub pickup_h: f64,
}

impl Path {
    /// Error of the impedance at the line that an image falls onto, Ω. Both lines have equal
    /// currents.
    pub fn error_ohm(&self, image: &Image, base_hz: f64) -> f64 {
        let freq_hz = image.at as f64 * base_hz;
        // Two probes that sample the same current at different times differ by at most twice its
        // volts.
        let unlike = (TAU * freq_hz * self.skew_s).min(2.0);
        image.share() * TAU * freq_hz * (self.loop_h * unlike + self.pickup_h)
            / (freq_hz / self.corner_hz).hypot(1.0)
    }
}

/// Allowed lines and rates, and the criteria to choose by.
#[derive(Debug, Clone, Copy)]
pub struct Choice<'a> {
    /// Numbers of steps per period that the generator supports, by preference.
    pub steps: &'a [usize],
    /// Samples that the record can have, by preference.
    pub samples: &'a [usize],
    /// Periods in the record.
    pub periods: usize,
    /// Least and greatest harmonic.
    pub range: (usize, usize),
    /// Base frequency, Hz.
    pub base_hz: f64,
    /// Path that turns images into volts.
    pub path: Path,
    /// Tolerated sum on a line, root of squares, Ω.
    pub tolerated_ohm: f64,
}

/// Lines and rates, and the images that still fall onto a line.
#[derive(Debug, Clone, PartialEq)]
pub struct Placement {
    /// Harmonics, rising.
    pub harmonics: Vec<usize>,
    /// Rates.
    pub sampling: Sampling,
    /// The line that images disturb most, their contribution to its Z, Ω, and the largest of them;
    /// `None` if no image falls onto a line.
    pub worst: Option<Disturbed>,
}

/// A line that images fall onto.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Disturbed {
    /// The largest image.
    pub image: Image,
    /// Error of Z by all images on the line, root of the sum of squares, Ω.
    pub error_ohm: f64,
}

impl Placement {
    fn of(harmonics: Vec<usize>, sampling: Sampling, choice: &Choice<'_>) -> Self {
        let mut by_line: Vec<(f64, Option<(f64, Image)>)> = vec![(0.0, None); harmonics.len()];
        for image in images(&harmonics, &harmonics, sampling) {
            let error_ohm = choice.path.error_ohm(&image, choice.base_hz);
            if let Some((square, largest)) = harmonics
                .binary_search(&image.onto)
                .ok()
                .and_then(|line| by_line.get_mut(line))
            {
                *square += error_ohm * error_ohm;
                if largest.is_none_or(|(least, _)| error_ohm > least) {
                    *largest = Some((error_ohm, image));
                }
            }
        }
        let worst = by_line.iter().max_by(|a, b| a.0.total_cmp(&b.0));
        let worst = worst.and_then(|(square, largest)| {
            largest.map(|(_, image)| Disturbed {
                image,
                error_ohm: square.sqrt(),
            })
        });
        Self {
            harmonics,
            sampling,
            worst,
        }
    }

    fn error_ohm(&self) -> f64 {
        self.worst.map_or(0.0, |worst| worst.error_ohm)
    }
}

/// Finds the first rates at which all images on lines are tolerated: first the fewest samples, then
/// the steps in the order of the lists. If no rates help, lines move to free odd harmonics beside
/// them; if that does not help, the least disturbed placement is returned.
pub fn place(harmonics: &[usize], choice: &Choice<'_>) -> Option<Placement> {
    let mut best: Option<Placement> = None;
    for moving in [false, true] {
        for samples in choice.samples {
            for steps in choice.steps {
                let sampling = Sampling {
                    steps: *steps,
                    periods: choice.periods,
                    samples: *samples,
                };
                let fixed = Placement::of(harmonics.to_vec(), sampling, choice);
                let found = if moving { moved(fixed, choice) } else { fixed };
                if found.error_ohm() <= choice.tolerated_ohm {
                    return Some(found);
                }
                if best
                    .as_ref()
                    .is_none_or(|best| found.error_ohm() < best.error_ohm())
                {
                    best = Some(found);
                }
            }
        }
    }
    best
}

/// Moves the worst pair of lines, one at a time, as long as it helps.
fn moved(mut placement: Placement, choice: &Choice<'_>) -> Placement {
    while let Some(worst) = placement
        .worst
        .filter(|worst| worst.error_ohm > choice.tolerated_ohm)
    {
        let tries = [worst.image.of, worst.image.onto]
            .into_iter()
            .flat_map(|line| neighbours(&placement.harmonics, line, choice));
        let found = tries.map(|harmonics| Placement::of(harmonics, placement.sampling, choice));
        match found.min_by(|a, b| a.error_ohm().total_cmp(&b.error_ohm())) {
            Some(better) if better.error_ohm() < 0.999 * placement.error_ohm() => {
                placement = better;
            }
            _ => break,
        }
    }
    placement
}

/// Returns the lines with one of them at other odd harmonics, between its neighbours and no further
/// than halfway to them, no three odd ones in a row.
fn neighbours(harmonics: &[usize], line: usize, choice: &Choice<'_>) -> Vec<Vec<usize>> {
    let (least, greatest) = choice.range;
    let Ok(place) = harmonics.binary_search(&line) else {
        return Vec::new();
    };
    let below = place
        .checked_sub(1)
        .map_or(least, |before| (harmonics[before] + line) / 2 + 1);
    let above = harmonics.get(place + 1).map_or(greatest, |after| {
        usize::midpoint(line, *after).saturating_sub(1)
    });
    let to = |other: usize| {
        let mut tried = harmonics.to_vec();
        tried[place] = other;
        tried
    };
    let spaced = |tried: &Vec<usize>| {
        tried.windows(2).all(|pair| pair[0] < pair[1])
            && !tried.windows(3).any(|three| three[2] == three[0] + 4)
    };
    (below..=above)
        .filter(|other| other % 2 == 1 && *other != line && *other >= least)
        .map(to)
        .filter(spaced)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const LINES: [usize; 8] = [3, 5, 9, 11, 17, 25, 39, 59];

    fn found(harmonics: &[usize], steps: &[usize], samples: &[usize]) -> Placement {
        let path = Path {
            corner_hz: 6.0e3,
            loop_h: 2.0e-6,
            skew_s: 150.0e-9,
            pickup_h: 100.0e-9,
        };
        let choice = Choice {
            steps,
            samples,
            periods: 10,
            range: (3, 60),
            base_hz: 5.0,
            path,
            tolerated_ohm: 3.0e-6,
        };
        place(harmonics, &choice).unwrap()
    }

    #[test]
    fn the_rates_change_before_the_lines() {
        let before = found(&LINES, &[4096], &[100_000]);
        assert!(
            before.error_ohm() > 8.0e-6 || before.harmonics != LINES,
            "{before:?}"
        );
        let after = found(&LINES, &[4096, 8192, 16_384], &[100_000, 200_000]);
        assert_eq!(after.harmonics, LINES);
        assert_eq!(
            (after.sampling.steps, after.sampling.samples),
            (16_384, 200_000),
            "{after:?}"
        );
        assert!(after.error_ohm() < 3.0e-6);
    }

    #[test]
    fn lines_move_where_no_rates_help() {
        // 25 and 39 add up to 64, of which the generator's rate has a multiple at 3.4 MHz.
        let lines = [3, 9, 17, 25, 39];
        let moved = found(&lines, &[4096], &[200_000]);
        assert!(
            moved.harmonics != lines && moved.error_ohm() < 3.0e-6,
            "{moved:?}"
        );
        assert_eq!(moved.harmonics.len(), lines.len());
    }

    #[test]
    fn what_cannot_be_moved_is_reported() {
        // Eight classes of odd harmonics beside multiples of 32 hold no twenty lines.
        let lines: Vec<usize> = (0..20)
            .map(|k| 3 + 2 * k + 2 * (k / 2))
            .filter(|h| *h < 60)
            .collect();
        let worst = found(&lines, &[4096], &[200_000]).worst.unwrap();
        assert!(
            worst.error_ohm > 3.0e-6 && worst.image.of != worst.image.onto,
            "{worst:?}"
        );
    }
}
