//! The points of `[map]`: a grid of `soc` and `temperatures`, or the list `points`.

use super::{
    ConfigError,
    check::Check,
    raw_map::{Point, Raw, Signal},
};
use crate::plan::percent;
use instruments::units::{Celsius, Ohms};

/// A temperature of a map.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MapTemperature {
    /// Temperature, °C.
    pub degc: Celsius,
    /// Highest resistance of the cell, leads included, Ω.
    pub resistance_ohm: Ohms,
}

/// A point of a map, and what is measured there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MapPlace {
    /// State of charge.
    pub soc: f64,
    /// Temperature, °C.
    pub temperature_degc: f64,
    /// The sweep or the multisine is measured.
    pub spectrum: bool,
    /// The pulses are measured.
    pub pulses: bool,
}

/// Largest difference of two states of charge that are one: a file has them in percent.
const SAME_SOC: f64 = 1e-5;

impl MapPlace {
    /// Checks whether the point has a state of charge and a temperature, °C.
    pub fn is_at(&self, soc: f64, temperature_degc: f64) -> bool {
        (self.soc - soc).abs() < SAME_SOC && self.temperature_degc == temperature_degc
    }
}

/// What an experiment can measure at a point.
#[derive(Debug, Clone, Copy)]
pub(super) struct Signals {
    /// A sweep or a multisine.
    pub(super) spectrum: bool,
    /// Pulses.
    pub(super) pulses: bool,
}

impl Check<'_> {
    /// The points of a map in order.
    pub(super) fn map_places(
        &self,
        raw: &Raw,
        temperatures: &[MapTemperature],
        has: Signals,
    ) -> Result<Vec<MapPlace>, ConfigError> {
        match (&raw.soc, &raw.points) {
            (Some(soc), None) => {
                let found: Vec<f64> = soc.iter().map(|soc| soc.si).collect();
                let socs = self.map_socs(&found)?;
                let at = |at: &MapTemperature| {
                    let temperature_degc = at.degc.value();
                    socs.iter().map(move |soc| MapPlace {
                        soc: *soc,
                        temperature_degc,
                        spectrum: has.spectrum,
                        pulses: has.pulses,
                    })
                };
                Ok(temperatures.iter().flat_map(at).collect())
            }
            (None, Some(points)) => self.map_points(points, temperatures, has),
            (Some(_), Some(_)) => {
                let reason = "expected `soc` or `points`, found both";
                Err(self.complain("map.points", reason))
            }
            (None, None) => {
                let reason = "expected `soc`, measured at each temperature, or `points`, found \
                    neither";
                Err(self.complain("map", reason))
            }
        }
    }

    fn map_socs(&self, found: &[f64]) -> Result<Vec<f64>, ConfigError> {
        self.within("map.soc", found.len() as f64, 1.0..=50.0, "points")?;
        let mut socs: Vec<f64> = Vec::new();
        for soc in found {
            let soc = self.within("map.soc", *soc, 0.01..=0.99, "(share)")?;
            if let Some(before) = socs.last().filter(|before| soc >= **before) {
                let reason = format!(
                    "expected falling states of charge, because the cell is discharged from point \
                    to point, found {} % after {} %",
                    percent(soc),
                    percent(*before)
                );
                return Err(self.complain("map.soc", reason));
            }
            socs.push(soc);
        }
        Ok(socs)
    }

    fn map_points(
        &self,
        points: &[Point],
        temperatures: &[MapTemperature],
        has: Signals,
    ) -> Result<Vec<MapPlace>, ConfigError> {
        self.within("map.points", points.len() as f64, 1.0..=200.0, "points")?;
        let mut places: Vec<MapPlace> = Vec::new();
        for (number, point) in (1..).zip(points) {
            let place = self.map_point(number, point, temperatures, has)?;
            let field = |name: &str| format!("map.points.{number}.{name}");
            let degc = place.temperature_degc;
            let before = places
                .iter()
                .rposition(|known| known.temperature_degc == degc);
            if let Some(before) = before {
                if before + 1 < places.len() {
                    let reason = format!(
                        "expected the points of {degc} °C one after the other, because each change of \
                        the temperature begins with a full charge"
                    );
                    return Err(self.complain(&field("temperature"), reason));
                }
                if place.soc >= places[before].soc {
                    let reason = format!(
                        "expected falling states of charge, because the cell is discharged from point \
                        to point, found {} % after {} %",
                        percent(place.soc),
                        percent(places[before].soc)
                    );
                    return Err(self.complain(&field("soc"), reason));
                }
            }
            places.push(place);
        }
        Ok(places)
    }

    fn map_point(
        &self,
        number: usize,
        point: &Point,
        temperatures: &[MapTemperature],
        has: Signals,
    ) -> Result<MapPlace, ConfigError> {
        let field = |name: &str| format!("map.points.{number}.{name}");
        let soc = self.within(&field("soc"), point.soc.si, 0.01..=0.99, "(share)")?;
        let temperature_degc = point.temperature.si;
        if !temperatures
            .iter()
            .any(|at| at.degc.value() == temperature_degc)
        {
            let known: Vec<String> = temperatures
                .iter()
                .map(|at| at.degc.value().to_string())
                .collect();
            let reason = format!(
                "expected one of the temperatures of [map] ({} °C), which have a resistance_max, found \
                {temperature_degc} °C",
                known.join(", ")
            );
            return Err(self.complain(&field("temperature"), reason));
        }
        let measures = |signal: Signal, has: bool, needs: &str| {
            let listed = point.measure.as_ref().map(|list| list.contains(&signal));
            if listed == Some(true) && !has {
                let reason = format!("expected {needs}, found none");
                return Err(self.complain(&field("measure"), reason));
            }
            Ok(listed.unwrap_or(has))
        };
        let place = MapPlace {
            soc,
            temperature_degc,
            spectrum: measures(
                Signal::Spectrum,
                has.spectrum,
                "a section [eis] with a repeat of 1, or [multisine], for a spectrum",
            )?,
            pulses: measures(Signal::Pulses, has.pulses, "`pulses` in [map]")?,
        };
        if !place.spectrum && !place.pulses {
            let reason = "expected \"spectrum\", \"pulses\" or both, found none";
            return Err(self.complain(&field("measure"), reason));
        }
        Ok(place)
    }
}
