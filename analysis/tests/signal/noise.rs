//! Seeded Gaussian numbers, so that statistics are equal in every run.

/// A 64-bit linear congruential generator, upper bits used, with the Box–Muller transform on top.
pub(crate) struct Noise {
    state: u64,
}

impl Noise {
    pub(crate) fn new(seed: u64) -> Self {
        let mut noise = Self {
            state: seed
                .wrapping_mul(0x9e37_79b9_7f4a_7c15)
                .wrapping_add(0x1234_5678_9abc_def1),
        };
        for _ in 0..8 {
            noise.uniform();
        }
        noise
    }

    /// Uniform in 0…1, both excluded.
    pub(crate) fn uniform(&mut self) -> f64 {
        self.state = self
            .state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        ((self.state >> 11) as f64 + 0.5) / (1u64 << 53) as f64
    }

    /// Gaussian, mean 0, variance 1.
    pub(crate) fn gauss(&mut self) -> f64 {
        let radius = (-2.0 * self.uniform().ln()).sqrt();
        radius * (std::f64::consts::TAU * self.uniform()).cos()
    }
}
