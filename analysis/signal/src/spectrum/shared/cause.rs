//! One error that the points of a spectrum have in common.

use num_complex::Complex64;
use serde::{Deserialize, Serialize};

/// Name of the shared error that represents the uncertainty of an [`OcvSlope`].
pub const OCV_SLOPE: &str = "OCV slope";

/// One error that all points share. Errors of one name in several spectra are one error.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SharedError {
    /// Cause. Errors of other runs have other names.
    pub name: String,
    /// Deviation of each point by one standard deviation of the error, Ω.
    pub at_ohm: Vec<Complex64>,
}

/// Slope dU/dQ of the open-circuit voltage at the charge of a spectrum. It adds −j·(dU/dQ)/ω to the
/// impedance: charge that is stored, no resistance.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OcvSlope {
    /// Slope, V/C.
    #[serde(rename = "v_per_c")]
    pub v_per_coulomb: f64,
    /// Its standard deviation, V/C.
    #[serde(rename = "sigma_v_per_c")]
    pub sigma_v_per_coulomb: f64,
}
