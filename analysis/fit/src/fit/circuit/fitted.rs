//! Fitted circuit and what is known of it.

use serde::{Deserialize, Serialize};

use super::{super::options::Objective, super::warning::Warnings, options::Weight};

/// State of a parameter after the fit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum State {
    /// Fitted.
    Free,
    /// Held at a given value.
    Constant,
    /// Fitted, at the lower bound.
    AtLowerBound,
    /// Fitted, at the upper bound.
    AtUpperBound,
}

impl State {
    /// Name as JSON and tables have it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Free => "free",
            Self::Constant => "constant",
            Self::AtLowerBound => "at-lower-bound",
            Self::AtUpperBound => "at-upper-bound",
        }
    }
}

/// A fitted circuit and what is known of it. The lists about parameters stand in the order of the
/// circuit's string.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CircuitFit {
    /// The circuit's string.
    pub circuit: String,
    /// Names of the parameters, as impedance.py's: `R0`, `CPE1_0`, …
    pub names: Vec<String>,
    /// Their values, in their units. Equal blocks stand by rising time constant.
    pub values: Vec<f64>,
    /// Standard uncertainties (1σ), in the same units; `None` if the data do not determine the
    /// parameter, a bound holds it, or it is a constant.
    pub sigmas: Vec<Option<f64>>,
    /// Units; empty for a pure number.
    pub units: Vec<String>,
    /// State of each parameter.
    pub states: Vec<State>,
    /// Bounds each was kept in.
    pub bounds: Vec<(f64, f64)>,
    /// Covariance of the values to first order, row by row; `None` as for the sigmas.
    pub covariance: Vec<Vec<Option<f64>>>,
    /// Value of the objective.
    pub objective: f64,
    /// Objective that was minimised.
    pub objective_kind: Objective,
    /// Weight of the residuals that was used.
    pub weight: Weight,
    /// Numbers minus fitted parameters.
    pub degrees_of_freedom: usize,
    /// χ² per degree of freedom; only where residuals were compared with a measured covariance.
    pub reduced_chi2: Option<f64>,
    /// Corrected Akaike criterion for a comparison of circuits on the same data, objective and
    /// weight: smaller is better. `None` for too few numbers.
    pub aicc: Option<f64>,
    /// Root mean square of |Z_model − Z_data|, Ω. Errors that the points have in common count as
    /// part of the model.
    pub rms_ohm: f64,
    /// Condition number of the parameters' information, scaled to a unit diagonal; none where the
    /// data fix only combinations.
    pub condition: Option<f64>,
    /// Number of points fitted, over all spectra.
    pub points: usize,
    /// Lowest and highest frequency of the points fitted, Hz; none in files of programs that did
    /// not write it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub band_hz: Option<(f64, f64)>,
    /// Names of the spectra fitted together.
    pub spectra: Vec<String>,
    /// Starts tried.
    pub starts: usize,
    /// Number of starts that ended at the best optimum.
    pub starts_at_optimum: usize,
    /// Seed of the starts.
    pub seed: u64,
    /// Warnings, in sentences.
    #[serde(flatten)]
    pub warnings: Warnings,
}
