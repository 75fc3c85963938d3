//! Measurement of one point of a sweep, and the quality of its record. The functions are pure.

pub mod channels;
pub mod harmonics_and_drift;
pub mod point;
pub mod quality;
pub mod repeated;
pub mod spectrum_gate;
pub mod zero;

/// Harmonics that are fitted beside the sinusoid: overdriving of a cell, a supply or an amplifier
/// appears in these first.
pub const HARMONICS: [u32; 2] = [2, 3];

pub use harmonics_and_drift::{Bend, HarmonicsAndDrift};
pub use point::{Spent, SweepPoint};
