//! Files: [`dataset`] are those of a run, [`formats`] those of other programs, [`thinning`] averages
//! frames of direct currents to rows.

pub mod dataset;
pub mod formats;
pub mod thinning;
