//! The quality gate of a sweep or of a multisine: the sections `[eis.quality]` and
//! `[multisine.quality]`. Every limit has a default with its reason.

use serde::Deserialize;

use super::{
    ConfigError,
    check::Check,
    quantity::{Charge, Duration, Quantity, Share},
};
use crate::measure::quality::Quality;

/// As it is typed.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(super) struct Raw {
    /// Half a per cent: below what separates the orders of the thesis' fits, and a hundred times
    /// what the bench shows.
    noise: Quantity<Share>,
    /// A third harmonic of 1 % may stand for an error of Z of 3 %.
    distortion: Quantity<Share>,
    /// As the noise, for it acts like it.
    drift: Quantity<Share>,
    /// Twice the noise: the difference of two numbers.
    repeatability: Quantity<Share>,
    /// What is commonly asked of a valid spectrum (Schönleber et al. 2014 show residuals below 1
    /// %).
    kramers_kronig: Quantity<Share>,
    again: usize,
    time: Quantity<Duration>,
    charge: Quantity<Charge>,
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

impl Check<'_> {
    /// The gate of `section`, `eis` or `multisine`.
    pub(super) fn quality(&self, raw: &Raw, section: &str) -> Result<Quality, ConfigError> {
        let share = |part: &str, value: f64| {
            self.within(
                &format!("{section}.quality.{part}"),
                value,
                1.0e-5..=1.0,
                "(share)",
            )
        };
        Ok(Quality {
            noise: share("noise", raw.noise.si)?,
            distortion: share("distortion", raw.distortion.si)?,
            drift: share("drift", raw.drift.si)?,
            repeatability: share("repeatability", raw.repeatability.si)?,
            kramers_kronig: share("kramers_kronig", raw.kramers_kronig.si)?,
            again: self
                .within(
                    &format!("{section}.quality.again"),
                    raw.again as f64,
                    0.0..=10.0,
                    "times",
                )
                .map(|_| raw.again)?,
            time_s: self.within(
                &format!("{section}.quality.time"),
                raw.time.si,
                0.0..=86_400.0,
                "s",
            )?,
            charge_c: self.within(
                &format!("{section}.quality.charge"),
                raw.charge.si,
                0.0..=10.0 * self.cell.capacity_c,
                "C",
            )?,
        })
    }
}
