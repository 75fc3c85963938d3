//! Files: [`run_folder`] owns the names in the folder of a run, [`dataset`] its tables, [`formats`]
//! reads files of other programs, [`batch`] tables of many spectra and results, [`table`] tables that
//! a person writes, [`thinning`] averages frames of direct currents to rows.

pub mod batch;
pub mod dataset;
pub mod formats;
pub mod run_folder;
pub mod table;
pub mod thinning;
