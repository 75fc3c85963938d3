//! Measurement of one point of a sweep, and the quality of its record. Pure.

pub mod harmonics_and_drift;
pub mod point;
pub mod quality;

pub use harmonics_and_drift::{Bend, HarmonicsAndDrift};
pub use point::{Spent, SweepPoint};
