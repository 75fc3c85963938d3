//! Samples as the sums see them: a value, and whether it counts.

use super::{Channel, CodeScale};

/// A sample as it lies in the capture.
pub(super) trait Sample: Copy + PartialOrd + Into<f64> + Sync {}

impl Sample for f64 {}
impl Sample for i16 {}

/// Bounds, both exclusive, of the samples that count; `None` counts all (finite) ones.
pub(super) type Bounds<S> = Option<(S, S)>;

/// True for a finite sample within the bounds.
pub(super) fn is_inside<S: Sample>(sample: S, bounds: Bounds<S>) -> bool {
    match bounds {
        Some((low, high)) => sample > low && sample < high,
        None => sample.into().is_finite(),
    }
}

/// Returns true if all samples are finite and within the bounds. Checks all of them, which vector
/// registers do faster than stopping at the first.
pub(super) fn all_inside<S: Sample>(samples: &[S], bounds: Bounds<S>) -> bool {
    match bounds {
        Some((low, high)) => samples
            .iter()
            .fold(true, |all, sample| all & (*sample > low) & (*sample < high)),
        None => samples
            .iter()
            .fold(true, |all, sample| all & (*sample).into().is_finite()),
    }
}

/// Bounds of codes.
pub(super) fn code_bounds(scale: &CodeScale) -> Bounds<i16> {
    Some((scale.code_min, scale.code_max))
}

/// Level taken from the samples before summing, so that a large offset costs no significant digits.
pub(super) fn pivot(channel: &Channel<'_>) -> f64 {
    match channel {
        Channel::Volts { samples, .. } => samples
            .first()
            .copied()
            .filter(|v| v.is_finite())
            .unwrap_or(0.0),
        Channel::Codes { scale, .. } => f64::from(code_pivot(scale)),
        Channel::Stored(stored) => stored
            .scale
            .map_or(stored.level_v, |scale| f64::from(code_pivot(&scale))),
    }
}

/// Returns the middle of the codes.
pub(super) fn code_pivot(scale: &CodeScale) -> i16 {
    scale.code_min.midpoint(scale.code_max)
}
