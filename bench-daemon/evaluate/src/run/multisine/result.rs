//! Result of one multisine.

use analysis::{
    dataset::PointConditions,
    multisine::Line,
    spectrum::{FlaggedPoint, Spectrum},
};

/// Result of one multisine.
#[derive(Debug, serde::Serialize, serde::Deserialize)]
pub struct MultisineRun {
    /// The corrected spectrum.
    pub spectrum: Spectrum,
    /// The corrected spectrum with the noise of its own records only.
    pub own_noise: Spectrum,
    /// Degrees of freedom of that noise, which is determined from the bins between the harmonics.
    pub noise_dof: f64,
    /// Lines that the quality gate refused to the end.
    pub flagged: Vec<FlaggedPoint>,
    /// Its lines.
    pub lines: Vec<Line>,
    /// V/div of channels 1…4 at each line.
    #[serde(default)]
    pub volts_per_div: Vec<[f64; 4]>,
    /// Bench time that it took, including everything that belongs to it, s.
    pub took_s: f64,
    /// Direct current, charge and temperature of each line; empty without a direct current.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub conditions: Vec<PointConditions>,
    /// Voltage of the cell at rest before the direct current, V.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rest_v: Option<f64>,
}
