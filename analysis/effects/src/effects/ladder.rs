//! Ladders of relaxations that represent diffusion over a finite length.
//!
//! tanh(√s)/√s = Σ 2/(s + g) with g = (k + ½)²π², k = 0, 1, …, and 3(coth(√s)/√s − 1/s) = Σ 6/(s +
//! g) with g = k²π², k = 1, 2, …: both are 1 at s = 0. The first terms are kept as they are; later
//! ones, whose time constants lie close together, are merged by groups, each group with its
//! resistance and its mean time constant; all beyond the last group become one more rung: nothing
//! is dropped.

use std::sync::LazyLock;

/// One relaxation of a ladder with resistance 1 and diffusion time 1.
#[derive(Debug, Clone, Copy)]
pub(super) struct Rung {
    /// Its part of the resistance; all parts sum to 1.
    pub(super) part: f64,
    /// Its time constant as a part of the diffusion time.
    pub(super) time: f64,
}

/// Terms that are not merged.
const SINGLE: usize = 5;
/// First term of a group over first term of the one before it.
const RATIO: f64 = 1.4;

/// tanh(√s)/√s: the far end is held at its concentration.
pub(super) fn transmissive() -> &'static [Rung] {
    static LADDER: LazyLock<Vec<Rung>> = LazyLock::new(|| ladder(0.5, 2.0, 400));
    &LADDER
}

/// 3(coth(√s)/√s − 1/s): nothing passes the far end; the mean concentration is taken off.
pub(super) fn reflective() -> &'static [Rung] {
    static LADDER: LazyLock<Vec<Rung>> = LazyLock::new(|| ladder(1.0, 6.0, 200));
    &LADDER
}

/// Σ scale/(s + g), g = (k + shift)²π², merged from term [`SINGLE`] on and lumped from term `last`
/// on.
fn ladder(shift: f64, scale: f64, last: usize) -> Vec<Rung> {
    let rate = |k: usize| ((k as f64 + shift) * std::f64::consts::PI).powi(2);
    let mut rungs = Vec::new();
    let mut from = 0;
    while from < last {
        let to = if from < SINGLE {
            from + 1
        } else {
            ((from as f64 * RATIO).ceil() as usize).min(last)
        };
        let (part, moment) = (from..to).map(rate).fold((0.0, 0.0), |(part, moment), g| {
            (part + scale / g, moment + scale / (g * g))
        });
        rungs.push(Rung {
            part,
            time: moment / part,
        });
        from = to;
    }
    let part = 1.0 - rungs.iter().map(|r| r.part).sum::<f64>();
    // Σ 1/g² beyond a large k is 1/(3π⁴k³), Σ 1/g is 1/(π²k).
    rungs.push(Rung {
        part,
        time: 1.0 / (3.0 * rate(last)),
    });
    rungs
}

#[cfg(test)]
mod tests {
    use super::*;
    use num_complex::Complex64;

    fn sum(ladder: &[Rung], s: Complex64) -> Complex64 {
        ladder.iter().map(|r| r.part / (1.0 + s * r.time)).sum()
    }

    #[test]
    fn the_ladders_follow_their_closed_forms() {
        let (mut worst, mut relative) = (0.0_f64, 0.0_f64);
        for k in 0..=160 {
            let s = Complex64::new(0.0, 10f64.powf(-3.0 + 0.05 * f64::from(k)));
            let root = s.sqrt();
            let tanh = root.tanh() / root;
            let coth = 3.0 * (1.0 / (root.tanh() * root) - 1.0 / s);
            for (met, expected) in [(sum(transmissive(), s), tanh), (sum(reflective(), s), coth)] {
                worst = worst.max((met - expected).norm());
                if s.im < 3e3 {
                    relative = relative.max((met - expected).norm() / expected.norm());
                }
            }
        }
        assert!(
            worst < 1e-3,
            "largest error {worst}, as a part of the resistance"
        );
        assert!(relative < 1e-2, "largest relative error {relative}");
    }
}
