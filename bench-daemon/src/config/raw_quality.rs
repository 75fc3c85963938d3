//! The sections `[eis.quality]` and `[multisine.quality]` as they are typed.

use serde::Deserialize;

use super::quantity::{Charge, Duration, Quantity, Share};

/// The section; every limit has a default with its reason.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(super) struct Raw {
    /// Half a per cent: below what separates the orders of the thesis' fits, and a hundred times
    /// what the bench shows.
    pub(super) noise: Quantity<Share>,
    /// A third harmonic of 1 % may stand for an error of Z of 3 %.
    pub(super) distortion: Quantity<Share>,
    /// As the noise, for it acts like it.
    pub(super) drift: Quantity<Share>,
    /// Twice the noise: the difference of two numbers.
    pub(super) repeatability: Quantity<Share>,
    /// Bound that is common for a valid spectrum (Schönleber et al. 2014 show residuals below 1
    /// %).
    pub(super) kramers_kronig: Quantity<Share>,
    pub(super) again: usize,
    pub(super) time: Quantity<Duration>,
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
