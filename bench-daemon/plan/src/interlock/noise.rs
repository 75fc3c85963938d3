//! Estimates how long a meter with visible noise may show the same value. The share of readings
//! that reverse the direction indicates how rarely two successive readings are equal.

/// Standard deviations by which the observed share of reversals is reduced.
const DEVIATIONS: f64 = 2.0;
/// Probability below which a constant value is not due to chance. A night has 10⁵ readings, and
/// the estimate of this probability is far above the likely one: a reading that neither reverses
/// nor stays the same continues in its direction.
const CHANCE: f64 = 1.0e-6;
/// Greatest share of equal pairs for a meter whose digits are finer than its noise.
const MOST_ALIKE: f64 = 0.1;
/// Least number of pairs of readings that show a noise.
const FEWEST: f64 = 10.0;

/// Statistics of the readings of one meter.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Noise {
    last: Option<f64>,
    /// The previous change, in the meter's unit.
    step: f64,
    pairs: f64,
    turns: f64,
    /// Number of equal pairs.
    alike: f64,
    /// Number of readings equal to the previous one, since the last change.
    still: u32,
}

impl Noise {
    /// Adds a reading.
    pub(super) fn take(&mut self, value: f64) {
        let step = self.last.replace(value).map_or(0.0, |last| value - last);
        if self.last.is_none() || !value.is_finite() {
            return;
        }
        if step == 0.0 {
            self.still += 1;
            return;
        }
        // The value has changed again, so the equal readings before count as noise.
        self.pairs += f64::from(self.still) + 1.0;
        self.alike += f64::from(self.still);
        self.turns += if step * self.step < 0.0 { 1.0 } else { 0.0 };
        (self.step, self.still) = (step, 0);
    }

    /// Returns the number of equal readings if noise would have changed the value in that time.
    pub(super) fn stuck(&self) -> Option<u32> {
        // A coarse meter may correctly stay constant if its value lies in the middle of a digit.
        if self.pairs < FEWEST || self.alike > MOST_ALIKE * self.pairs {
            return None;
        }
        let alike = 1.0 - least_share(self.turns, self.pairs);
        (f64::from(self.still) * alike.ln() < CHANCE.ln()).then_some(self.still)
    }

    /// Checks whether the value has been constant for longer than usual, so that it should be read
    /// again.
    pub(super) fn suspect(&self) -> bool {
        self.still > 1 && self.pairs >= FEWEST
    }
}

/// Returns the lower end of Wilson's interval for a share: `turns` out of `pairs`.
fn least_share(turns: f64, pairs: f64) -> f64 {
    let (share, z2) = (turns / pairs, DEVIATIONS * DEVIATIONS);
    let middle = share + 0.5 * z2 / pairs;
    let half = DEVIATIONS * (share * (1.0 - share) / pairs + 0.25 * z2 / (pairs * pairs)).sqrt();
    ((middle - half) / (1.0 + z2 / pairs)).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns noise with a standard deviation in steps of the last digit, from a local generator.
    fn readings(sigma: f64, drift: f64, count: u32) -> impl Iterator<Item = f64> {
        let mut state = 0x9e37_79b9_7f4a_7c15_u64;
        (0..count).map(move |k| {
            let mut uniform = || {
                state = state
                    .wrapping_mul(6_364_136_223_846_793_005)
                    .wrapping_add(1_442_695_040_888_963_407);
                (state >> 11) as f64 / (1_u64 << 53) as f64
            };
            let normal = (0..12).map(|_| uniform()).sum::<f64>() - 6.0;
            (sigma * normal + drift * f64::from(k)).round()
        })
    }

    #[test]
    fn a_noisy_meter_that_freezes_is_caught_soon_and_none_that_only_stands_still_at_times() {
        for (sigma, drift) in [
            (0.0, 0.0),
            (0.0, 0.03),
            (0.1, 0.0),
            (0.3, 0.0),
            (0.5, 0.0),
            (0.5, 0.1),
            (0.1, 0.003),
            (0.2, 0.003),
            (0.3, 0.003),
            (4.0, 0.0),
            (5.0, 0.2),
            (30.0, 1.0),
        ] {
            let mut noise = Noise::default();
            for (number, value) in readings(sigma, drift, 100_000).enumerate() {
                noise.take(value);
                assert_eq!(noise.stuck(), None, "{sigma} {drift}: reading {number}");
            }
            // The meter is frozen from here on.
            let caught = (1..=200).find(|_| {
                noise.take(7.0);
                noise.stuck().is_some()
            });
            match sigma {
                s if s >= 4.0 => assert!(
                    caught.is_some_and(|readings| readings <= 25),
                    "{sigma}: {caught:?}"
                ),
                s if s < 0.1 => assert_eq!(caught, None, "{sigma}: nothing is known of its noise"),
                _ => {}
            }
        }
    }
}
