//! Measurement of one point of a sweep, and the quality of its record. Pure.

pub mod beside;
pub mod point;
pub mod quality;

pub use beside::{Bend, Beside};
pub use point::{Spent, SweepPoint};
