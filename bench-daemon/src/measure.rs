//! What is measured of one point of a sweep, and what its record says of its own quality. Pure.

pub mod beside;
pub mod point;
pub mod quality;

pub use beside::{Bend, Beside};
pub use point::{Spent, SweepPoint};
