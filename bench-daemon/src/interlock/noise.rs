//! Estimates how long a meter with visible noise may show the same value. The share of readings at
//! which it turns back says how rarely two are alike.

/// Standard deviations by which the share of turns is taken smaller than it was seen.
const DEVIATIONS: f64 = 2.0;
/// Chance below which a value that stands still does not do so by chance. A night has 10⁵ readings,
/// and what is taken for it is far more than what is likely: a reading that neither turns nor
/// stands still goes on in its direction.
const CHANCE: f64 = 1.0e-6;
/// Greatest share of pairs that are alike of a meter whose digits are finer than its noise.
const MOST_ALIKE: f64 = 0.1;
/// Fewest pairs of readings that show a noise.
const FEWEST: f64 = 10.0;

/// The readings of one meter so far.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Noise {
    last: Option<f64>,
    /// The change before, in its own unit.
    step: f64,
    pairs: f64,
    turns: f64,
    /// Pairs that were alike.
    alike: f64,
    /// Readings that were as the one before them, without a change since.
    still: u32,
}

impl Noise {
    /// Takes a reading.
    pub(super) fn take(&mut self, value: f64) {
        let step = self.last.replace(value).map_or(0.0, |last| value - last);
        if self.last.is_none() || !value.is_finite() {
            return;
        }
        if step == 0.0 {
            self.still += 1;
            return;
        }
        // What stood still is known to have been a pause, and counts.
        self.pairs += f64::from(self.still) + 1.0;
        self.alike += f64::from(self.still);
        self.turns += if step * self.step < 0.0 { 1.0 } else { 0.0 };
        (self.step, self.still) = (step, 0);
    }

    /// How often the value was read alike, where noise would have changed it meanwhile.
    pub(super) fn stuck(&self) -> Option<u32> {
        // A coarse meter stands still rightly wherever its value lies in the middle of a digit.
        if self.pairs < FEWEST || self.alike > MOST_ALIKE * self.pairs {
            return None;
        }
        let alike = 1.0 - least_share(self.turns, self.pairs);
        (f64::from(self.still) * alike.ln() < CHANCE.ln()).then_some(self.still)
    }

    /// It stands still for longer than usual: worth another look.
    pub(super) fn suspect(&self) -> bool {
        self.still > 1 && self.pairs >= FEWEST
    }
}

/// Lower end of Wilson's interval for a share of `pairs` of which `turns` were seen.
fn least_share(turns: f64, pairs: f64) -> f64 {
    let (share, z2) = (turns / pairs, DEVIATIONS * DEVIATIONS);
    let middle = share + 0.5 * z2 / pairs;
    let half = DEVIATIONS * (share * (1.0 - share) / pairs + 0.25 * z2 / (pairs * pairs)).sqrt();
    ((middle - half) / (1.0 + z2 / pairs)).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Noise of so many steps of the last digit, by a generator of its own.
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
            // From here on it is frozen.
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
