//! The direct current under the signals of `[eis]` and `[multisine]`: its keys, checked against bench
//! and cell.

use instruments::{
    fixture::Fixture,
    units::{Amps, Celsius, Ohms, Seconds},
};

use super::{
    ConfigError, Eis,
    check::Check,
    quantity::{Current, Duration, Quantity, Resistance, Share},
    raw,
    section::EisBias,
};
use crate::plan::Bias;

/// Least direct current, A: a smaller one is of the size of a zero error.
const LEAST_A: Amps = Amps(0.1);
/// Greatest charge of a group of points, as a share of the capacity.
const MOST_CHARGE: f64 = 0.2;

/// The keys of a section.
pub(super) struct RawBias<'a> {
    /// Its name.
    pub(super) section: &'static str,
    pub(super) list: Option<&'a [Quantity<Current>]>,
    pub(super) charge: Option<Quantity<Share>>,
    /// Greatest charge that may be stated, as a share of the capacity.
    pub(super) most_charge: f64,
    pub(super) resistance: Option<Quantity<Resistance>>,
    pub(super) settle: Option<Quantity<Duration>>,
}

impl RawBias<'_> {
    fn field(&self, key: &str) -> String {
        format!("{}.{key}", self.section)
    }
}

impl Check<'_> {
    /// Returns the direct currents of a section; `None` if there is none.
    pub(super) fn bias_of(&self, raw: &RawBias<'_>) -> Result<Option<EisBias>, ConfigError> {
        let Some(list) = raw.list else {
            return self.refuse_alone(raw).map(|()| None);
        };
        let levels_a = self.levels(raw, list)?;
        if levels_a == [Amps::ZERO] {
            return self.refuse_alone(raw).map(|()| None);
        }
        let Some(resistance) = raw.resistance else {
            return Err(self.complain(
                &raw.field("resistance_max"),
                "expected it beside a bias other than 0 A: it bounds voltage and heat",
            ));
        };
        let charge = raw.charge.map_or(EisBias::CHARGE, |share| share.si);
        let charges = 0.001..=raw.most_charge;
        let charge = self.within(&raw.field("bias_charge"), charge, charges, "(share)")?;
        let settle_s = raw
            .settle
            .map_or(EisBias::SETTLE_S, |settle| Seconds(settle.si));
        let resistance_ohm = self.within(
            &raw.field("resistance_max"),
            resistance.si,
            1.0e-4..=1.0,
            "Ω",
        )?;
        Ok(Some(EisBias {
            levels_a,
            most_coulomb: charge * self.cell.capacity_coulomb,
            resistance_ohm: Ohms(resistance_ohm),
            settle_s: self.within(
                &raw.field("bias_settle"),
                settle_s,
                Seconds(5.0)..=Seconds(3600.0),
                "s",
            )?,
            capacity_coulomb: self.cell.capacity_coulomb,
        }))
    }

    /// Returns the direct currents of `[eis]`; `None` if there is none.
    pub(super) fn eis_bias(&self, raw: &raw::Eis) -> Result<Option<EisBias>, ConfigError> {
        let bias = self.bias_of(&RawBias {
            section: "eis",
            list: raw.bias.as_deref(),
            charge: raw.bias_charge,
            most_charge: MOST_CHARGE,
            resistance: raw.resistance_max,
            settle: raw.bias_settle,
        })?;
        if bias.is_none() {
            return Ok(None);
        }
        if raw.fixture != raw::SweptFixture::Cell {
            return Err(self.complain(
                "eis.bias",
                "expected a sweep of the cell: a direct current through a shunt changes nothing",
            ));
        }
        if raw.compensate_drift {
            return Err(self.complain(
                "eis.compensate_drift",
                "expected false beside a bias: the charge of the cell differs between both ways",
            ));
        }
        if raw
            .quality
            .as_ref()
            .is_some_and(|quality| quality.again > 0)
        {
            return Err(self.complain(
                "eis.quality.again",
                "expected 0 beside a bias: a point that is measured again moves charge that is not \
                planned",
            ));
        }
        Ok(bias)
    }

    /// Returns the listed currents, the rest first: the fits use the first ones.
    fn levels(
        &self,
        raw: &RawBias<'_>,
        list: &[Quantity<Current>],
    ) -> Result<Vec<Amps>, ConfigError> {
        // −0 and 0 are one current.
        let mut levels_a: Vec<f64> = list.iter().map(|level| level.si + 0.0).collect();
        let differ = levels_a
            .iter()
            .enumerate()
            .all(|(k, level)| !levels_a[..k].contains(level));
        if levels_a.is_empty() || !differ || levels_a.iter().any(|level| !level.is_finite()) {
            return Err(self.complain(
                &raw.field("bias"),
                format!("expected currents that differ, found {levels_a:?} A"),
            ));
        }
        if let Some(small) = levels_a
            .iter()
            .find(|level| **level != 0.0 && level.abs() < LEAST_A.value())
        {
            return Err(self.complain(
                &raw.field("bias"),
                format!("expected 0 A, or at least {LEAST_A} in either direction, found {small} A"),
            ));
        }
        levels_a.sort_by_key(|level| *level != 0.0);
        Ok(levels_a.into_iter().map(Amps).collect())
    }

    /// Refuses keys that have no effect without a direct current.
    fn refuse_alone(&self, raw: &RawBias<'_>) -> Result<(), ConfigError> {
        let given = [
            ("bias_charge", raw.charge.is_some()),
            ("resistance_max", raw.resistance.is_some()),
            ("bias_settle", raw.settle.is_some()),
        ];
        match given.iter().find(|(_, given)| *given) {
            None => Ok(()),
            Some((key, _)) => Err(self.complain(
                &raw.field(key),
                format!(
                    "expected {} beside it, with a current other than 0 A",
                    raw.field("bias")
                ),
            )),
        }
    }

    /// Checks the direct currents with the greatest amplitude against cell, supply and generator.
    pub(super) fn check_bias(
        &self,
        field: &str,
        bias: &EisBias,
        amplitude_a: Amps,
        setpoint_degc: Option<Celsius>,
    ) -> Result<(), ConfigError> {
        let limits = &self.cell.limits;
        let (driven_a, what) = self
            .driven_a()
            .map_err(|reason| self.complain(field, reason))?;
        for bias_a in bias.levels_a.iter().copied() {
            let (least_a, greatest_a) = (bias_a - amplitude_a, bias_a + amplitude_a);
            if -least_a > limits.discharge_a || greatest_a > limits.charge_a {
                let reason = format!(
                    "expected {bias_a} ± {amplitude_a} within -{} to {}, the limits of the \
                    cell",
                    limits.discharge_a, limits.charge_a
                );
                return Err(self.complain(field, reason));
            }
            if bias_a.abs() + amplitude_a > driven_a {
                let reason = format!(
                    "expected {bias_a} ± {amplitude_a} within ±{driven_a:.3}, the limits of \
                    {what} and its generator"
                );
                return Err(self.complain(field, reason));
            }
            let rise_k = bias.plan(bias_a, amplitude_a).rise_k();
            let warmest_degc = setpoint_degc.map(|degc| degc + rise_k);
            if let Some(warmest_degc) = warmest_degc.filter(|degc| *degc > limits.max_degc) {
                let reason = format!(
                    "expected the cell to stay below {}, found up to {warmest_degc:.1}: \
                    {bias_a} warm it by {rise_k:.1} at worst",
                    limits.max_degc
                );
                return Err(self.complain(field, reason));
            }
        }
        Ok(())
    }
}

impl EisBias {
    /// Returns the ramp from zero to a direct current, A.
    pub fn plan(&self, bias_a: Amps, amplitude_a: Amps) -> Bias {
        Bias {
            from_a: Amps::ZERO,
            to_a: bias_a,
            settle_s: self.settle_s,
            amplitude_a,
            resistance_ohm: self.resistance_ohm,
            most_coulomb: self.most_coulomb,
            capacity_coulomb: self.capacity_coulomb,
        }
    }
}

impl Eis {
    /// Returns the sweeps of a round: direct current and amplitude of each, A. Every second round is
    /// reversed, so that a linear drift of the cell cancels in the means over two rounds.
    pub fn sweeps_of(&self, round: usize) -> Vec<[Amps; 2]> {
        let levels_a = match &self.bias {
            Some(bias) if self.fixture == Fixture::Cell => bias.levels_a.as_slice(),
            _ => &[Amps::ZERO],
        };
        let all = levels_a.iter().flat_map(|bias_a| {
            let with = |amplitude_a: &Amps| [*bias_a, *amplitude_a];
            self.steps_a.iter().map(with)
        });
        let mut sweeps: Vec<[Amps; 2]> = all.collect();
        if levels_a.len() > 1 && round.is_multiple_of(2) {
            sweeps.reverse();
        }
        sweeps
    }
}
