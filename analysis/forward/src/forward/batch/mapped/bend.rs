//! The step of a branch of charge transfer in single precision, without branches in the code, so that
//! it becomes vectors.
//!
//! It is the step of [`analysis_model::map::BranchStep::bent_end`], written as the change of the
//! voltage: with x = v/b, a = R·i/b, s² = 1 + a² and d = exp(−s·h/τ),
//! Δx = ln((den + num)/(den − num)), num = (a − sinh x)(1 − d), den = s(1 + d) + cosh x·(1 − d).
//! For |x| to 2.5 and |a| to 8 the change is exact to 10⁻⁵ of |a| + |sinh x| times h/τ or of the larger
//! move, as are the slope and the leaks. A single step over more bends is off by more.

/// Largest voltage of a branch over its bend.
const MOST_BEND: f32 = 20.0;
/// Largest drive of a branch over its bend.
const MOST_DRIVE: f32 = 1e4;

/// A step of a branch in units of its bend.
#[derive(Debug, Clone, Copy)]
pub(super) struct Bent {
    /// Change of the voltage over the bend.
    pub(super) change: f32,
    /// Change of the voltage at the end with the mean drive.
    pub(super) slope: f32,
    /// Current that leaks through the resistance, over twice the exchange current, at both ends.
    pub(super) leaks: [f32; 2],
}

impl Bent {
    /// Returns the step of a branch from its voltage and its mean drive, both over the bend, and the
    /// length of the step over the time constant.
    #[inline(always)]
    pub(super) fn new(x: f32, a: f32, ratio: f32) -> Self {
        let x = x.clamp(-MOST_BEND, MOST_BEND);
        let a = a.clamp(-MOST_DRIVE, MOST_DRIVE);
        let s = (1.0 + a * a).sqrt();
        // Of the size of x: 1 + exp_m1 of a negative one would lose digits.
        let above_one = exp_m1(x.abs());
        let large = 1.0 + above_one;
        let small = 1.0 / large;
        let (sinh, cosh) = (0.5 * above_one * (1.0 + small), 0.5 * (large + small));
        let sinh = sinh.copysign(x);
        let (up, down) = if x < 0.0 {
            (small, large)
        } else {
            (large, small)
        };
        let fell = -exp_m1(-ratio * s);
        let left = 1.0 - fell;
        let held = s * (1.0 + left);
        let (num, den) = ((a - sinh) * fell, held + cosh * fell);
        // den ± num, without the difference of near numbers.
        let (plus, minus) = (held + (down + a) * fell, held + (up - a) * fell);
        // s − |a| is at least 1/2s, which rounding may lose.
        let least = 0.25 / s;
        let (plus, minus) = (plus.max(least), minus.max(least));
        let product = plus * minus;
        // The slope's terms times s, so that one division is enough.
        let num_slope = s * fell + (a - sinh) * ratio * left * a;
        let den_slope = a * ((1.0 + left) - ratio * left * (s - cosh));
        Self {
            change: log_ratio(plus, minus, num),
            slope: 2.0 * (num_slope * den - num * den_slope) / (s * product),
            leaks: [
                sinh,
                (sinh * 0.5 * (plus * plus + minus * minus) + cosh * 2.0 * den * num) / product,
            ],
        }
    }
}

/// Returns exp(x) − 1 for |x| of at most 87, exact to 3·10⁻⁷ of itself.
#[inline(always)]
fn exp_m1(x: f32) -> f32 {
    /// Added and subtracted, it rounds to a whole number, whose bits it keeps.
    const ROUND: f32 = 12_582_912.0;
    const LN_2: [f32; 2] = [0.693_359_4, -2.121_944_4e-4];
    let x = x.max(-87.0);
    let rounded = x * std::f32::consts::LOG2_E + ROUND;
    let whole = rounded - ROUND;
    let r = (x - whole * LN_2[0]) - whole * LN_2[1];
    // In pairs, so that fewer products wait for each other.
    let square = r * r;
    let (low, high) = (0.5 + r * (1.0 / 6.0), 1.0 / 24.0 + r * (1.0 / 120.0));
    let sum = (low + square * high) + (square * square) * (1.0 / 720.0 + r * (1.0 / 5040.0));
    let power = power_of_two(rounded.to_bits().wrapping_sub(ROUND.to_bits()));
    power * (r + square * sum) + (power - 1.0)
}

/// Returns 2 to the power of a whole number, as bits of two's complement.
#[inline(always)]
fn power_of_two(whole: u32) -> f32 {
    f32::from_bits(whole.wrapping_add(127) << 23)
}

/// Returns ln(plus/minus), where `num` is half their difference: exact to 3·10⁻⁷ of itself, also if
/// they are nearly equal.
#[inline(always)]
fn log_ratio(plus: f32, minus: f32, num: f32) -> f32 {
    let bits = (plus.to_bits() as i32).wrapping_sub(minus.to_bits() as i32);
    let whole = bits.wrapping_add(1 << 22) >> 23;
    let power = power_of_two(whole as u32);
    let scaled = power * minus;
    let apart = if whole == 0 { 2.0 * num } else { plus - scaled };
    let w = apart / (plus + scaled);
    let square = w * w;
    let sum =
        (1.0 / 3.0 + square * (1.0 / 5.0)) + (square * square) * (1.0 / 7.0 + square * (1.0 / 9.0));
    whole as f32 * std::f32::consts::LN_2 + 2.0 * (w + w * square * sum)
}

#[cfg(test)]
mod tests {
    use super::*;
    use analysis_model::map::{BranchStep, Drive};

    #[test]
    fn a_step_in_single_precision_is_that_in_double_precision() {
        let mut worst = [0.0_f64; 3];
        for ratio in [1e-7, 1e-4, 0.01, 0.3, 2.0, 30.0] {
            for x in [0.0, 1e-4, 0.03, -0.4, 1.0, -2.5] {
                for a in [0.0, 1e-4, 0.02, -0.5, 2.0, -8.0] {
                    let (x, a) = (f64::from(x as f32), f64::from(a as f32));
                    let ratio = f64::from(ratio as f32);
                    let held = Drive {
                        driven_v: a,
                        bend_v: 1.0,
                    };
                    let exact = BranchStep::new(ratio, 1.0).bent_end(x, held, held);
                    let share = BranchStep::new(ratio, 1.0).end_share;
                    let met = Bent::new(x as f32, a as f32, ratio as f32);
                    let size = a.abs().asinh() + x.abs();
                    // The change counts per length of a short step, where it drives the branch: the
                    // rate is a − sinh x.
                    let rate = (a.abs() + x.sinh().abs()).max(1e-9) * ratio.min(1.0);
                    let apart = (x + f64::from(met.change) - exact.v).abs();
                    worst[0] = worst[0].max(apart / rate.min(size.max(1e-9)));
                    let slope = f64::from(met.slope) * share - exact.slope;
                    worst[1] = worst[1].max(slope.abs() / exact.slope.abs());
                    let leak = (f64::from(met.leaks[1]) - exact.v.sinh()).abs();
                    worst[2] = worst[2].max(leak / (x.sinh().abs() + a.abs() + 1e-9));
                }
            }
        }
        assert!(worst[0] < 1e-5, "{worst:?}");
        assert!(worst[1] < 2e-5 && worst[2] < 1e-5, "{worst:?}");
    }

    #[test]
    fn an_extreme_drive_keeps_finite_numbers() {
        for x in [-1e9, -20.0, 0.0, 20.0, 1e9] {
            for a in [-1e12, -1e6, 0.0, 1e6, 1e12] {
                for ratio in [0.0, 1e-6, 1.0, 1e6] {
                    let met = Bent::new(x, a, ratio);
                    assert!(
                        met.change.is_finite() && met.slope.is_finite(),
                        "{x} {a} {ratio}: {met:?}"
                    );
                }
            }
        }
    }
}
