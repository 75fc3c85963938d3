//! A small seeded generator: xoshiro256++ (Blackman and Vigna, 2019), its state filled by
//! SplitMix64. Equal seeds give equal fits on every machine. Not for secrets.

/// Pseudo-random numbers of one seed.
#[derive(Debug, Clone)]
pub struct Rng {
    state: [u64; 4],
}

impl Rng {
    /// Creates the generator of a seed; every seed is good.
    pub fn new(seed: u64) -> Self {
        let mut s = seed;
        let mut split_mix = || {
            s = s.wrapping_add(0x9E37_79B9_7F4A_7C15);
            let z = (s ^ (s >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
            let z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
            z ^ (z >> 31)
        };
        Self {
            state: std::array::from_fn(|_| split_mix()),
        }
    }

    /// Returns the next 64 bits.
    pub fn next_u64(&mut self) -> u64 {
        let [a, b, c, d] = self.state;
        let result = a.wrapping_add(d).rotate_left(23).wrapping_add(a);
        let (c, d) = (c ^ a, d ^ b);
        self.state = [a ^ d, b ^ c, c ^ (b << 17), d.rotate_left(45)];
        result
    }

    /// Uniform in [0, 1).
    pub fn uniform(&mut self) -> f64 {
        (self.next_u64() >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
    }

    /// Normal with mean 0 and variance 1 (Box and Muller).
    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.uniform()).cos()
    }

    /// Uniform in 0…n−1; 0 for n = 0.
    pub fn below(&mut self, n: usize) -> usize {
        ((self.uniform() * n as f64) as usize).min(n.saturating_sub(1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn matches_the_published_recurrence() {
        // First outputs of xoshiro256++ from the state 1, 2, 3, 4.
        let mut rng = Rng {
            state: [1, 2, 3, 4],
        };
        let met: Vec<u64> = (0..4).map(|_| rng.next_u64()).collect();
        assert_eq!(
            met,
            [
                41_943_041,
                58_720_359,
                3_588_806_011_781_223,
                3_591_011_842_654_386
            ]
        );
        // First output of SplitMix64 from the state 0.
        assert_eq!(Rng::new(0).state[0], 0xE220_A839_7B1D_CDAF);
    }

    #[test]
    fn uniform_fills_its_interval() {
        let mut rng = Rng::new(7);
        let n = 10_000;
        let mean = (0..n)
            .map(|_| rng.uniform())
            .inspect(|u| assert!((0.0..1.0).contains(u)))
            .sum::<f64>()
            / f64::from(n);
        assert!((mean - 0.5).abs() < 0.015, "{mean}");
        assert!((0..1000).all(|_| rng.below(3) < 3));
        assert_eq!(rng.below(0), 0);
    }

    #[test]
    fn normal_numbers_have_their_moments() {
        let mut rng = Rng::new(7);
        let all: Vec<f64> = (0..20_000).map(|_| rng.normal()).collect();
        let moment = |power: i32| all.iter().map(|x| x.powi(power)).sum::<f64>() / 20_000.0;
        let moments = [1, 2, 3, 4].map(moment);
        for (met, expected) in moments.into_iter().zip([0.0, 1.0, 0.0, 3.0]) {
            assert!((met - expected).abs() < 0.15, "{moments:?}");
        }
    }
}
