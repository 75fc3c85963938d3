//! Meaning of ADC codes.

/// Meaning of an ADC code: V = code · `volts_per_code` − `offset_v`.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct CodeScale {
    /// Volts per code, V; positive.
    pub volts_per_code: f64,
    /// Offset that was added before the ADC, V.
    pub offset_v: f64,
    /// Least code of the ADC; samples at or below it are clipped.
    pub code_min: i16,
    /// Greatest code of the ADC; samples at or above it are clipped.
    pub code_max: i16,
    /// Step from one code of the ADC to the next: 16 if twelve bits are in the upper part of
    /// sixteen, otherwise 1.
    pub code_step: u16,
}

impl CodeScale {
    /// Volts of a code.
    pub fn volts(&self, code: i16) -> f64 {
        f64::from(code) * self.volts_per_code - self.offset_v
    }
}
