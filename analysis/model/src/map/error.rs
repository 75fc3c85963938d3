//! Error of the voltage that a map predicts.

use super::{CellMap, MapError, Place, length, zero_or_more};
use serde::{Deserialize, Serialize};

/// Half width of a band that holds 95 % of the errors, over their standard deviation.
pub const BAND_SIGMAS: f64 = 1.96;

/// Error of the predicted voltage of a cell. Its variance is that at rest, plus that of the counted
/// charge by the slope of the OCV, plus a share of the overpotential: a map that is wrong by some
/// percent of a resistance is wrong by as much of the voltage that a load takes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VoltageError {
    /// Standard deviation at rest, V.
    pub rest_v: f64,
    /// Standard deviation of the counted charge, as SOC.
    pub soc: f64,
    /// Standard deviation of the overpotential as a share of it, at each temperature node.
    pub share: Vec<f64>,
    /// Data that show it.
    pub from: ErrorSource,
}

/// Data that show the error of a map.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ErrorSource {
    /// Logs that the fit has not seen.
    HeldOut,
    /// Pieces of the fitted logs, each predicted by a fit without it: loads like the fitted ones.
    LeftOut,
}

impl VoltageError {
    pub(super) fn validate(&self, nodes: usize) -> Result<(), MapError> {
        length("voltage_error.share", nodes, self.share.len())?;
        zero_or_more("voltage_error.rest_v", &[self.rest_v])?;
        zero_or_more("voltage_error.soc", &[self.soc])?;
        zero_or_more("voltage_error.share", &self.share)
    }
}

impl CellMap {
    /// Returns the standard deviation of the predicted voltage of a cell, V, from the slope dOCV/dSOC,
    /// V, and the overpotential, V, at a place; `None` if the map does not state its error.
    pub fn sigma_v(&self, at: &Place, slope_v: f64, overpotential_v: f64) -> Option<f64> {
        let error = self.voltage_error.as_ref()?;
        let weights = self.temperature_weights(at);
        let share: f64 = weights
            .map(|(j, w)| w * error.share[j].powi(2))
            .iter()
            .sum();
        let variance =
            error.rest_v.powi(2) + (error.soc * slope_v).powi(2) + share * overpotential_v.powi(2);
        Some(variance.sqrt())
    }

    /// Returns the weights of the temperature nodes at a place.
    pub fn temperature_weights(&self, at: &Place) -> [(usize, f64); 2] {
        at.temperature.pairs(self.temperature_degc.len())
    }
}
