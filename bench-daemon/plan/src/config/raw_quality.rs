//! The sections `[eis.quality]` and `[multisine.quality]` as they are typed.

use serde::Deserialize;

use super::quantity::{Charge, Duration, Quantity, Share};

/// Quality gate; every limit is a share from 0.001 % to 100 % and has a default with its reason.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(super) struct Raw {
    /// Standard deviation of Z from noise and rounding. The default is below the value at which the
    /// orders of the thesis' fits can no longer be separated.
    pub(super) noise: Quantity<Share>,
    /// Harmonics 2 to 7 of current and voltage. A third harmonic of 1 % can indicate an error of Z
    /// of 3 %.
    pub(super) distortion: Quantity<Share>,
    /// Part of Z that comes from the drift of the voltage. It acts like noise.
    pub(super) drift: Quantity<Share>,
    /// Difference between the halves of a record. As the difference of two numbers it has twice the
    /// noise.
    pub(super) repeatability: Quantity<Share>,
    /// Residual of the Kramers–Kronig test in the finished sweep. The bound is common for a valid
    /// spectrum (Schönleber et al. 2014 show residuals below 1 %).
    pub(super) kramers_kronig: Quantity<Share>,
    /// Largest number of further records of a point, 0 to 10.
    pub(super) again: usize,
    /// Budget of further records for a sweep, 0 s to 86 400 s.
    pub(super) time: Quantity<Duration>,
    /// Budget of charge that further records may move, up to ten times the capacity.
    pub(super) charge: Quantity<Charge>,
}

impl Default for Raw {
    fn default() -> Self {
        Self {
            noise: Quantity::of(0.005),
            distortion: Quantity::of(0.01),
            drift: Quantity::of(0.005),
            repeatability: Quantity::of(0.01),
            kramers_kronig: Quantity::of(0.01),
            again: 2,
            time: Quantity::of(600.0),
            charge: Quantity::of(720.0),
        }
    }
}
