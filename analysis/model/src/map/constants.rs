//! Constants of temperature laws.

/// 0 °C, K.
pub const ZERO_DEGC_K: f64 = 273.15;
/// Molar gas constant, J/(mol·K) (CODATA 2018, exact).
pub const GAS_J_PER_MOL_K: f64 = 8.314_462_618_153_24;
