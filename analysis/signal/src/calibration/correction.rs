//! Parameters of the harness with their covariance.

use super::model::COUNT;

/// The harness as it turned out, to correct measurements by.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Correction {
    pub(super) values: [f64; COUNT],
    pub(super) covariance: [[f64; COUNT]; COUNT],
    pub(super) prior_sigmas: [f64; COUNT],
    #[serde(rename = "told")]
    pub(super) known: [bool; COUNT],
    /// Sum of squared deviations, each over its standard deviation, per degree of freedom: near 1
    /// if model and noise are right. `None` if nothing was measured.
    pub reduced_chi2: Option<f64>,
    /// Degrees of freedom: real numbers measured. Every parameter has a prior and so takes none.
    pub dof: usize,
    /// Factor on the stated noise of the controls that follows from the scatter; 1 unless
    /// `reduced_chi2` is significantly above 1.
    pub noise_factor: f64,
    /// Lowest and highest frequency of the controls, Hz.
    pub span_hz: Option<(f64, f64)>,
}
