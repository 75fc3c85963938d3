//! Measurement of one point of a sweep, and the quality of its record. Pure.

pub(crate) mod channels;
pub mod harmonics_and_drift;
pub mod point;
pub mod quality;
pub(crate) mod repeated;
pub(crate) mod spectrum_gate;
pub(crate) mod zero;

/// Harmonics that are fitted besides the sinusoid: a cell, a supply or an amplifier driven too far
/// shows in these first.
pub const HARMONICS: [u32; 2] = [2, 3];

pub use harmonics_and_drift::{Bend, HarmonicsAndDrift};
pub use point::{Spent, SweepPoint};
