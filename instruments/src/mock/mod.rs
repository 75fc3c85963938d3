//! Placeholder.

pub mod plant;
