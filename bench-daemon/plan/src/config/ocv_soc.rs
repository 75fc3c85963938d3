//! The open-circuit voltage over the state of charge: the section `[ocv_soc]` against bench and
//! cell.

use instruments::{
    instrument::by_key,
    load, supply,
    units::{Amps, Ohms, Seconds, Volts},
};

use super::{ConfigError, check::Check, raw_ocv_soc::Raw};

/// The measurement of the open-circuit voltage (thesis 3.1).
#[derive(Debug, Clone, Copy)]
pub struct OcvSoc {
    /// Current of the charge before it, and of the way up, A.
    pub charge_a: Amps,
    /// Voltage that the supply holds at the end of a charge, V.
    pub charge_limit_v: Volts,
    /// The cell is full when the current has fallen to this, A.
    pub cut_off_a: Amps,
    /// Current of the discharge, A, positive.
    pub discharge_a: Amps,
    /// End of the discharge, V under load.
    pub discharge_until_v: Volts,
    /// Current of the end of the discharge, A, positive: the less, the nearer the end is to the
    /// limit at rest.
    pub tail_a: Amps,
    /// How often each direction is interrupted.
    pub interruptions: usize,
    /// Length of an interruption, s.
    pub interruption_s: Seconds,
    /// Shortest and longest rest before the discharge and between the directions, s.
    pub rest_s: (Seconds, Seconds),
    /// The rest ends when the voltage changes more slowly, V/s.
    pub rest_slope_v_per_s: f64,
    /// The charge is measured too.
    pub both_directions: bool,
    /// Resistance for the compensation of the load's voltage drop, Ω; by default, that of the
    /// interruptions.
    pub dcir_ohm: Option<Ohms>,
    /// Order of an additional polynomial, if requested.
    pub polynomial: Option<usize>,
}

/// A tail of less than this share of the discharge current would no longer count as one discharge
/// with it.
const LEAST_TAIL: f64 = 0.15;

impl Check<'_> {
    pub(super) fn ocv_soc(&self, raw: &Raw) -> Result<OcvSoc, ConfigError> {
        let load = self.needs(self.bench.instruments.load.as_ref(), "load", "ocv_soc")?;
        let supply = self.needs(self.bench.instruments.supply.as_ref(), "supply", "ocv_soc")?;
        let limits = &self.cell.limits;
        let load_a = by_key(load::DIALECTS, &load.model)
            .map_or(Amps::ZERO, |dialect| dialect.capabilities().max_current);
        let supply_a = by_key(supply::DIALECTS, &supply.model)
            .map_or(Amps::ZERO, |dialect| dialect.capabilities().max_current);
        // A discharge faster than 1C does not measure an open-circuit voltage. The bounds in time
        // follow from the current.
        let greatest_a = |instrument_a: Amps, limit_a: Amps| {
            instrument_a
                .min(limit_a)
                .min(self.cell.capacity_coulomb / Seconds(3600.0))
        };
        let least_a = 0.01 * self.cell.capacity_coulomb / Seconds(3600.0);
        let window = limits.min_v..=limits.max_v;
        let charge_a = self.within(
            "ocv_soc.charge_current",
            Amps(raw.charge_current.si),
            least_a..=greatest_a(supply_a, limits.charge_a),
            "A",
        )?;
        let discharge_a = self.within(
            "ocv_soc.discharge_current",
            Amps(raw.discharge_current.si),
            least_a..=greatest_a(load_a, limits.discharge_a),
            "A",
        )?;
        let tail = raw.tail_current.map_or(discharge_a, |tail| Amps(tail.si));
        let dcir = raw
            .dcir
            .map(|dcir| self.within("ocv_soc.dcir", Ohms(dcir.si), Ohms::ZERO..=Ohms(1.0), "Ω"))
            .transpose()?;
        let found = OcvSoc {
            charge_a,
            charge_limit_v: self.within(
                "ocv_soc.charge_voltage",
                Volts(raw.charge_voltage.si),
                window.clone(),
                "V",
            )?,
            cut_off_a: self.within(
                "ocv_soc.cut_off",
                Amps(raw.cut_off.si),
                Amps(0.02)..=0.5 * charge_a,
                "A",
            )?,
            discharge_a,
            discharge_until_v: self.within(
                "ocv_soc.discharge_until",
                Volts(raw.discharge_until.si),
                window,
                "V",
            )?,
            tail_a: self.within(
                "ocv_soc.tail_current",
                tail,
                LEAST_TAIL * discharge_a..=discharge_a,
                "A",
            )?,
            interruptions: self
                .within(
                    "ocv_soc.interruptions",
                    raw.interruptions as f64,
                    0.0..=50.0,
                    "times",
                )
                .map(|_| raw.interruptions)?,
            interruption_s: Seconds(self.within(
                "ocv_soc.interruption",
                raw.interruption.si,
                30.0..=7200.0,
                "s",
            )?),
            rest_s: (
                Seconds(self.within("ocv_soc.rest_min", raw.rest_min.si, 1.0..=86_400.0, "s")?),
                Seconds(self.within(
                    "ocv_soc.rest_max",
                    raw.rest_max.si,
                    raw.rest_min.si..=86_400.0,
                    "s",
                )?),
            ),
            rest_slope_v_per_s: self.within(
                "ocv_soc.rest_slope",
                raw.rest_slope.si,
                1.0e-9..=1.0e-2,
                "V/s",
            )?,
            both_directions: raw.both_directions,
            dcir_ohm: dcir,
            polynomial: raw.polynomial,
        };
        if found.discharge_until_v >= found.charge_limit_v {
            let reason = format!(
                "expected less than charge_voltage ({}), found {}",
                found.charge_limit_v, found.discharge_until_v
            );
            return Err(self.complain("ocv_soc.discharge_until", reason));
        }
        if found.dcir_ohm.is_none() && found.interruptions == 0 {
            let reason =
                "expected a resistance to compensate with: without interruptions none is measured";
            return Err(self.complain("ocv_soc.dcir", reason));
        }
        if let Some(order) = found.polynomial {
            self.within(
                "ocv_soc.polynomial",
                order as f64,
                1.0..=analysis_model::ocv::MAX_ORDER as f64,
                "(order)",
            )?;
        }
        Ok(found)
    }
}
