//! Files: [`run_folder`] owns the names in the folder of a run, [`dataset`] its tables, [`formats`]
//! reads files of other programs, [`thinning`] averages frames of direct currents to rows.

pub mod dataset;
pub mod formats;
pub mod run_folder;
pub mod thinning;
