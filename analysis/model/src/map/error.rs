//! Error of the voltage that a map predicts.

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
    /// Factor on the standard deviation that a band for a whole run needs beside that of χ² of its
    /// [`lasting_errors`](super::CellMap::lasting_errors), as whole pieces of the logs show; none in files of
    /// earlier versions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub whole_runs: Option<f64>,
}

/// Probability with which the band of a run holds the whole run.
pub const RUN_PROBABILITY: f64 = 0.95;

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
    /// Returns the standard deviation between temperature nodes, given as indices and weights, V, from the
    /// slope dOCV/dSOC, V, and the overpotential, V.
    pub(super) fn sigma_v(
        &self,
        nodes: [(usize, f64); 2],
        slope_v: f64,
        overpotential_v: f64,
    ) -> f64 {
        let share: f64 = nodes.map(|(j, w)| w * self.share[j].powi(2)).iter().sum();
        let variance =
            self.rest_v.powi(2) + (self.soc * slope_v).powi(2) + share * overpotential_v.powi(2);
        variance.sqrt()
    }
}
