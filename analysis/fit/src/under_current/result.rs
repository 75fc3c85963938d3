//! Results of the comparison.

use analysis_model::model::Erm;
use analysis_signal::spectrum::FlaggedPoint;
use serde::Serialize;

/// Greatest adjusted probability at which a change counts as one.
const CERTAIN: f64 = 0.05;

/// Sweeps under a direct current compared with those at rest.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct UnderCurrent {
    /// Model of the sweeps at rest.
    pub model: Erm,
    /// Number of cells at rest.
    pub cells: usize,
    /// Number of sweeps at rest.
    pub sweeps: usize,
    /// Mean χ² per degree of freedom of the sweeps at rest: near 1 if changes of the resistances
    /// describe how sweeps differ.
    pub chi2_at_rest: f64,
    /// One entry for each sweep under a direct current, by rising current.
    pub changes: Vec<CurrentChange>,
    /// Differences between sweeps under a direct current; empty unless they are of one cell.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub pairs: Vec<PairChange>,
    /// What the numbers do not show, in sentences.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub remarks: Vec<String>,
}

/// What a sweep is compared with.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Compared {
    /// The sweeps at rest of the same cell.
    OwnCell {
        /// Its name.
        cell: String,
    },
    /// The cells at rest, because the cell of the sweep is not among them.
    AllCells {
        /// Their number.
        cells: usize,
    },
}

/// The change of one sweep.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CurrentChange {
    /// Name of the sweep.
    pub name: String,
    /// Direct current, A; charging is positive.
    pub bias_a: f64,
    /// What it is compared with.
    pub compared: Compared,
    /// The series resistance, then the branches by rising time constant.
    pub branches: Vec<BranchChange>,
    /// χ² per degree of freedom with the noise of a sweep at rest.
    pub chi2: f64,
    /// Points that the change of all higher frequencies does not predict; they are left out.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub flagged: Vec<FlaggedPoint>,
    /// Frequencies that the sweeps at rest do not have, Hz.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub left_out_hz: Vec<f64>,
    /// Differences from the mean at rest, by rising frequency.
    pub points: Vec<PointChange>,
}

/// The change of one resistance of the model.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BranchChange {
    /// R, R1, R2, … as in the model.
    pub name: String,
    /// Change over the resistance at rest.
    pub share: f64,
    /// Its standard uncertainty, with the spread of cells or repeats.
    pub sigma: f64,
    /// Degrees of freedom of that uncertainty.
    pub freedom: usize,
    /// Probability of such a change by chance, both signs counted (Student).
    pub p: f64,
    /// The same, adjusted for the number of changes that are tested (Holm).
    pub p_adjusted: f64,
    /// False if the points that are left do not determine it.
    pub measured: bool,
}

impl BranchChange {
    /// Returns true if the change is more than chance.
    pub fn is_certain(&self) -> bool {
        self.measured && self.p_adjusted < CERTAIN
    }

    /// Returns the change in standard uncertainties.
    pub fn sigmas(&self) -> f64 {
        self.share / self.sigma
    }
}

/// The difference between two sweeps of one cell under different currents.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PairChange {
    /// The first sweep.
    pub from: String,
    /// The second sweep.
    pub to: String,
    /// Change from the first to the second, over the resistance at rest.
    pub branches: Vec<BranchChange>,
}

/// The difference of one point from the mean at rest, over its |Z|.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct PointChange {
    /// Frequency, Hz.
    pub freq_hz: f64,
    /// Real part.
    pub re: f64,
    /// Imaginary part.
    pub im: f64,
    /// Standard uncertainty of the real part: one sweep of any cell at rest.
    pub sigma_re: f64,
    /// Standard uncertainty of the imaginary part.
    pub sigma_im: f64,
    /// False for a point that is left out.
    pub kept: bool,
}
