//! A profile and its simulation options, as passed from Python.

use analysis::forward::{Beyond, CellWindow, Demand, Interpolation, Profile, SimOptions};
use analysis::pack::Pack;
use numpy::PyReadonlyArray1;
use pyo3::prelude::*;

use crate::error::refused;

/// A profile and its simulation options.
#[derive(FromPyObject)]
pub(crate) struct Play<'py> {
    demand: String,
    time_s: PyReadonlyArray1<'py, f64>,
    value: PyReadonlyArray1<'py, f64>,
    pub(crate) soc: Option<f64>,
    pub(crate) ocv_v: Option<f64>,
    pub(crate) ambient_c: f64,
    linear: bool,
    series: u32,
    parallel: u32,
    interconnect_ohm: f64,
    beyond: String,
    fraction: f64,
    low_v: f64,
    high_v: f64,
    max_step_s: f64,
}

impl Play<'_> {
    /// Returns the profile, the pack that it loads, and the options.
    pub(crate) fn read(&self) -> PyResult<(Profile, Pack, SimOptions)> {
        let demand = match self.demand.as_str() {
            "power" => Demand::Power,
            "current" => Demand::Current,
            "resistance" => Demand::Resistance,
            met => {
                let expected = "expected power, current or resistance";
                return Err(refused(&format!("demand: {expected}, met {met:?}")));
            }
        };
        let beyond = match self.beyond.as_str() {
            "stop" => Beyond::Stop,
            "clamp" => Beyond::Clamp,
            "extrapolate" => Beyond::Extrapolate {
                fraction: self.fraction,
            },
            met => {
                let expected = "expected stop, clamp or extrapolate";
                return Err(refused(&format!("beyond: {expected}, met {met:?}")));
            }
        };
        let (time_s, value) = (self.time_s.as_array(), self.value.as_array());
        if time_s.len() != value.len() {
            return Err(refused(&format!(
                "profile: expected a value for each of {} times, met {}",
                time_s.len(),
                value.len()
            )));
        }
        let rows: Vec<(f64, f64)> = time_s.iter().copied().zip(value.iter().copied()).collect();
        let interpolation = if self.linear {
            Interpolation::Linear
        } else {
            Interpolation::Hold
        };
        let profile =
            Profile::new("profile", demand, interpolation, &rows).map_err(|e| refused(&e))?;
        let pack = Pack::new(self.series, self.parallel, self.interconnect_ohm)
            .map_err(|e| refused(&e))?;
        let options = SimOptions {
            beyond,
            max_step_s: self.max_step_s,
            window: CellWindow {
                low_v: self.low_v,
                high_v: self.high_v,
            },
            ..SimOptions::default()
        };
        Ok((profile, pack, options))
    }
}
