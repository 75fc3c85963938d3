//! The quality gate of a sweep or of a multisine: the sections `[eis.quality]` and
//! `[multisine.quality]` against the cell.

use instruments::units::{Coulombs, Seconds};

use super::{ConfigError, check::Check, raw_quality::Raw};
use crate::measure::quality::Quality;

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
            time_s: Seconds(self.within(
                &format!("{section}.quality.time"),
                raw.time.si,
                0.0..=86_400.0,
                "s",
            )?),
            charge_coulomb: self.within(
                &format!("{section}.quality.charge"),
                Coulombs(raw.charge.si),
                Coulombs::ZERO..=10.0 * self.cell.capacity_coulomb,
                "C",
            )?,
        })
    }
}
