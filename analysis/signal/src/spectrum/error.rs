//! Reasons why numbers are not a valid spectrum.

/// Reason why fits or points are not a valid spectrum.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SpectrumError {
    /// The record does not have the four probe channels.
    #[error("expected fits of 4 channels, met {found}")]
    Channels {
        /// Channels met.
        found: usize,
    },
    /// The spectrum has no points.
    #[error("spectrum {name:?}: expected at least one point, met none")]
    Empty {
        /// Name of the spectrum.
        name: String,
    },
    /// A shared error does not have one value per point.
    #[error(
        "spectrum {name:?}: expected one value of the shared error {error:?} per point, {points} \
        in all, met {found}"
    )]
    Shared {
        /// Name of the spectrum.
        name: String,
        /// Name of the error.
        error: String,
        /// Points of the spectrum.
        points: usize,
        /// Values met.
        found: usize,
    },
    /// A number of a point is unusable.
    #[error("spectrum {name:?}, point {number} ({freq_hz} Hz): expected {expected}, met {found}")]
    Point {
        /// Name of the spectrum.
        name: String,
        /// Number of the point, from 1.
        number: usize,
        /// Its frequency, Hz.
        freq_hz: f64,
        /// Allowed values, as text.
        expected: &'static str,
        /// Value found.
        found: String,
    },
}
