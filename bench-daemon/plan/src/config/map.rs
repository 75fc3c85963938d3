//! The section `[map]`: points of charge and temperature, against bench and cell.

use std::sync::Arc;

use analysis_model::ocv::OcvCurve;
use instruments::{
    fixture::Fixture,
    instrument::by_key,
    load, supply,
    units::{Amps, Celsius, Coulombs, Ohms, Seconds, Volts},
};

use super::{
    ConfigError, Eis, Multisine, Temperature, Trace,
    check::{Check, LOAD_CUT_OFF_V},
    map_places::{MapPlace, MapTemperature, Signals},
    raw_map::Raw,
};
use crate::plan::{CampaignRun, MapPoint, Missed, Specimen};

/// Distance of the held voltage from the highest of the cell, V: a meter error of a few millivolts
/// must not cause a trip at the end.
const INSIDE_V: Volts = Volts(0.005);
/// Distance of the end of a discharge from the lowest voltage of the cell, V: the load's own end lies
/// between them.
const ABOVE_V: Volts = LOAD_CUT_OFF_V;

/// A map over charge and temperature.
#[derive(Debug, Clone)]
pub struct MapProcedure {
    /// Its points in order: from the fullest to the emptiest at each temperature.
    pub places: Vec<MapPlace>,
    /// Temperatures, °C, each with the highest resistance of the cell, Ω.
    pub temperatures: Vec<MapTemperature>,
    /// The cell.
    pub cell: Arc<Specimen>,
    /// Capacity by which the charge is counted, C.
    pub capacity_coulomb: Coulombs,
    /// Full charge, discharge and rest, with the end of the charge as a current.
    pub legs: MapLegs,
    /// Where the voltage at rest may be, as a share of the capacity, and what if it is not there.
    pub acceptance: (f64, Missed),
    /// Pulses at each point; their first row is a rest.
    pub pulses: Option<Trace>,
    /// The open-circuit voltage by which the counted charge is checked.
    pub ocv: OcvCurve,
}

/// How a map brings the cell to its points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MapLegs {
    /// Current of the full charge, A.
    pub charge_a: Amps,
    /// Voltage that the supply holds, V.
    pub charge_limit_v: Volts,
    /// Current at which the cell is full, A.
    pub cut_off_a: Amps,
    /// Current of the discharges, A, positive.
    pub discharge_a: Amps,
    /// Voltage at which a discharge ends, V under load.
    pub discharge_until_v: Volts,
    /// Shortest and longest rest, s.
    pub rest_s: (Seconds, Seconds),
    /// The rest ends when the voltage changes more slowly, V/s.
    pub rest_slope_v_per_s: f64,
}

/// Distance from a point within which the cell counts as being there, as a part of the capacity.
const AT_POINT: f64 = 0.005;
/// Least temperature of a charge, °C: lithium plates below.
pub const CHARGE_LEAST_DEGC: Celsius = Celsius(0.0);

impl MapProcedure {
    /// Its points as runs, in order: from the fullest to the emptiest at each temperature.
    pub fn runs(&self) -> impl Iterator<Item = CampaignRun> + '_ {
        (1..).zip(&self.places).map(|(number, place)| CampaignRun {
            number,
            cell: self.cell.clone(),
            repeat: number,
            point: Some(MapPoint {
                soc: place.soc,
                temperature_degc: Celsius(place.temperature_degc),
                below_full_coulomb: (1.0 - place.soc) * self.capacity_coulomb,
                within_coulomb: AT_POINT * self.capacity_coulomb,
            }),
        })
    }

    /// What is measured at a point, by its number.
    pub fn place(&self, number: usize) -> Option<&MapPlace> {
        self.places.get(number.checked_sub(1)?)
    }

    /// A point by its number.
    pub fn run(&self, number: usize) -> Option<CampaignRun> {
        self.runs().nth(number.checked_sub(1)?)
    }

    /// Returns the voltages at rest that agree with a state of charge, V.
    pub fn band_v(&self, soc: f64) -> (Volts, Volts) {
        let within = self.acceptance.0;
        let volts = |soc: f64| self.ocv.voltage_v(soc.clamp(0.0, 1.0));
        (Volts(volts(soc - within)), Volts(volts(soc + within)))
    }

    /// Returns the highest resistance of the cell at a temperature, Ω.
    pub fn resistance_ohm(&self, degc: Celsius) -> Ohms {
        let at = self.temperatures.iter().find(|at| at.degc == degc);
        at.map_or(Ohms::INFINITY, |at| at.resistance_ohm)
    }
}

/// Other sections of the experiment that a map depends on.
pub(super) struct Beside<'a> {
    /// The sweeps.
    pub(super) eis: Option<&'a Eis>,
    /// The multisine.
    pub(super) multisine: Option<&'a Multisine>,
    /// The temperature at which the cell is charged.
    pub(super) temperature: Option<&'a Temperature>,
    /// The named cell.
    pub(super) specimen: Option<&'a Specimen>,
    /// Sections that cannot stand beside it, if they are there.
    pub(super) refused: Option<&'static str>,
}

impl Check<'_> {
    pub(super) fn map(&self, raw: &Raw, beside: &Beside<'_>) -> Result<MapProcedure, ConfigError> {
        if let Some(section) = beside.refused {
            let reason = format!(
                "expected [map] without [{section}]: a map sets the charge itself, and its points \
                are sweeps, multisines and pulses of one cell"
            );
            return Err(self.complain("map", reason));
        }
        if beside.temperature.is_none() {
            let reason = "expected a section [temperature]: the cell is charged at its setpoint, \
                and its within and timeout hold for every temperature of the map";
            return Err(self.complain("map", reason));
        }
        if let Some(setpoint_degc) = beside.temperature.map(|held| held.setpoint_degc)
            && setpoint_degc < CHARGE_LEAST_DEGC
        {
            let reason = format!(
                "expected a temperature of at least {CHARGE_LEAST_DEGC}: the cell is charged at it, \
                and a colder charge can plate lithium; found {setpoint_degc}"
            );
            return Err(self.complain("temperature.setpoint", reason));
        }
        self.refuse_analog("map")?;
        self.check_map_signals(raw, beside)?;
        let Some(ocv) = &self.cell.ocv else {
            let reason = "expected a section [ocv] in the cell file: the counted charge is checked \
                by it";
            return Err(self.complain("map", reason));
        };
        let temperatures = self.map_temperatures(raw)?;
        let signals = Signals {
            spectrum: beside.multisine.is_some() || beside.eis.is_some_and(|eis| eis.repeat > 0),
            pulses: raw.pulses.is_some(),
        };
        let map = MapProcedure {
            places: self.map_places(raw, &temperatures, signals)?,
            temperatures,
            cell: Arc::new(self.map_cell(beside.specimen)),
            capacity_coulomb: self.cell.capacity_coulomb,
            legs: self.map_legs(raw)?,
            acceptance: (
                self.within("map.soc_within", raw.soc_within.si, 0.002..=0.2, "(share)")?,
                raw.missed,
            ),
            pulses: self.pulses_of_map(raw)?,
            ocv: ocv.clone(),
        };
        self.check_amplitudes(&map, beside)?;
        Ok(map)
    }

    /// Refuses a map that would measure nothing, or signals that are not one sweep at rest.
    fn check_map_signals(&self, raw: &Raw, beside: &Beside<'_>) -> Result<(), ConfigError> {
        if let Some(eis) = beside.eis {
            if eis.fixture != Fixture::Cell || eis.repeat > 1 {
                let reason = "expected a sweep of the cell with a repeat of 1 beside [map], which \
                    sweeps once at each point; 0 leaves the sweeps out";
                return Err(self.complain("eis", reason));
            }
            if eis.steps_a.len() > 1 || eis.bias.is_some() {
                let reason = "expected one amplitude and no direct current beside [map], which \
                    sweeps once at each point, at rest";
                return Err(self.complain("eis", reason));
            }
        }
        if beside
            .multisine
            .is_some_and(|multisine| multisine.repeat != 1 || multisine.bias.is_some())
        {
            let reason = "expected a repeat of 1 and no direct current beside [map], which measures \
                once at each point, at rest";
            return Err(self.complain("multisine", reason));
        }
        let swept = beside.eis.is_some_and(|eis| eis.repeat > 0);
        if swept && beside.multisine.is_some() {
            let reason = "expected [multisine] or a sweep at each point of [map], found both: \
                eis.repeat = 0 leaves the sweeps out";
            return Err(self.complain("multisine", reason));
        }
        if !swept && beside.multisine.is_none() && raw.pulses.is_none() {
            let reason = "expected pulses, or a section [eis] with a repeat of 1, or [multisine]: \
                nothing would be measured";
            return Err(self.complain("map", reason));
        }
        Ok(())
    }

    fn map_cell(&self, specimen: Option<&Specimen>) -> Specimen {
        let dashed = |name: &str| {
            name.chars()
                .map(|c| if c.is_ascii_alphanumeric() { c } else { '-' })
                .collect()
        };
        let named = || Specimen {
            number: 1,
            name: dashed(&self.cell.name),
            serial: None,
            batch: self.cell.identity.batch.clone(),
            barcode: None,
        };
        specimen.cloned().unwrap_or_else(named)
    }

    fn map_temperatures(&self, raw: &Raw) -> Result<Vec<MapTemperature>, ConfigError> {
        let (count, resistances) = (raw.temperatures.len(), raw.resistance_max.len());
        self.within("map.temperatures", count as f64, 1.0..=20.0, "temperatures")?;
        if resistances != 1 && resistances != count {
            let reason = format!(
                "expected one resistance, or {count}, one for each temperature, found {resistances}"
            );
            return Err(self.complain("map.resistance_max", reason));
        }
        let range = self.temperatures_of_bench();
        let mut found: Vec<MapTemperature> = Vec::new();
        for (index, temperature) in raw.temperatures.iter().enumerate() {
            let degc = self.within(
                "map.temperatures",
                Celsius(temperature.si),
                range.clone(),
                "°C",
            )?;
            if found.iter().any(|known| known.degc == degc) {
                let reason = format!("expected temperatures that differ, found {degc} twice");
                return Err(self.complain("map.temperatures", reason));
            }
            let place = if resistances == 1 { 0 } else { index };
            let resistance = raw.resistance_max.get(place).map_or(0.0, |one| one.si);
            let resistance_ohm =
                self.within("map.resistance_max", resistance, 1.0e-4..=1.0, "Ω")?;
            found.push(MapTemperature {
                degc,
                resistance_ohm: Ohms(resistance_ohm),
            });
        }
        Ok(found)
    }

    fn map_legs(&self, raw: &Raw) -> Result<MapLegs, ConfigError> {
        let load = self.needs(self.bench.instruments.load.as_ref(), "load", "map")?;
        let supply = self.needs(self.bench.instruments.supply.as_ref(), "supply", "map")?;
        let limits = &self.cell.limits;
        let load_a = by_key(load::DIALECTS, &load.model)
            .map_or(Amps::ZERO, |dialect| dialect.capabilities().max_current);
        let supply_a = by_key(supply::DIALECTS, &supply.model)
            .map_or(Amps::ZERO, |dialect| dialect.capabilities().max_current);
        let one_c_a = self.cell.capacity_coulomb / Seconds(3600.0);
        let charge_a = self.within(
            "map.charge_current",
            Amps(raw.charge_current.si),
            0.01 * one_c_a..=one_c_a.min(supply_a).min(limits.charge_a),
            "A",
        )?;
        let least_v = limits.min_v + ABOVE_V;
        let until_v = raw.discharge_until.map_or(least_v, |until| Volts(until.si));
        Ok(MapLegs {
            charge_a,
            charge_limit_v: self
                .within(
                    "map.charge_voltage",
                    Volts(raw.charge_voltage.si),
                    least_v..=limits.max_v,
                    "V",
                )?
                .min(limits.max_v - INSIDE_V),
            cut_off_a: self.within(
                "map.cut_off",
                Amps(raw.cut_off.si),
                Amps(0.02)..=0.5 * charge_a,
                "A",
            )?,
            discharge_a: self.within(
                "map.discharge_current",
                Amps(raw.discharge_current.si),
                0.01 * one_c_a..=limits.discharge_a.min(load_a),
                "A",
            )?,
            discharge_until_v: self.within(
                "map.discharge_until",
                until_v,
                least_v..=limits.max_v,
                "V",
            )?,
            rest_s: (
                Seconds(self.within("map.rest_min", raw.rest_min.si, 1.0..=86_400.0, "s")?),
                Seconds(self.within(
                    "map.rest_max",
                    raw.rest_max.si,
                    raw.rest_min.si..=86_400.0,
                    "s",
                )?),
            ),
            rest_slope_v_per_s: self.within(
                "map.rest_slope",
                raw.rest_slope.si,
                1.0e-9..=1.0e-2,
                "V/s",
            )?,
        })
    }

    /// Refuses a sweep or multisine that could exceed the voltage limits of the cell at a point.
    fn check_amplitudes(&self, map: &MapProcedure, beside: &Beside<'_>) -> Result<(), ConfigError> {
        let limits = &self.cell.limits;
        let signals = [
            (
                "eis.amplitude",
                beside
                    .eis
                    .filter(|eis| eis.repeat > 0)
                    .map(|eis| eis.amplitude_a),
            ),
            (
                "multisine.peak",
                beside.multisine.map(|multisine| multisine.peak_a),
            ),
        ];
        for (field, peak_a) in signals {
            let Some(peak_a) = peak_a else { continue };
            let swept = map
                .runs()
                .zip(&map.places)
                .filter(|(_, place)| place.spectrum);
            for point in swept.filter_map(|(run, _)| run.point) {
                let (low_v, high_v) = map.band_v(point.soc);
                let swing_v = peak_a * map.resistance_ohm(point.temperature_degc);
                let (least_v, most_v) = (low_v - swing_v, high_v + swing_v);
                if least_v < limits.min_v || most_v > limits.max_v {
                    let reason = format!(
                        "expected a cell voltage within {} to {} at every point of [map], found \
                        {least_v:.3} to {most_v:.3} at {}",
                        limits.min_v, limits.max_v, point
                    );
                    return Err(self.complain(field, reason));
                }
            }
        }
        Ok(())
    }
}
