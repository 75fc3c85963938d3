//! Tables of many spectra in, tables of many results out, a batch at a time.
//!
//! [`LongForm`] reads a Parquet or CSV table in long form: one row for each point, the rows of a
//! spectrum contiguous. [`Parts`] stores results on disk as they arrive, so that a killed call can
//! resume, and merges them into one Parquet or CSV table. [`read_models`] reads the models of such a
//! table.

mod any_table;
mod columns;
mod csv;
mod error;
mod long_form;
mod models;
mod parquet;
mod parts;
mod results;
mod written;

#[cfg(test)]
mod tests;

pub use any_table::{Cells, TableColumn, csv_text, parquet_bytes, write_table};
pub use error::BatchError;
pub use long_form::{LongForm, TableSpectrum};
pub use models::{TableModel, is_table_of_models, read_models};
pub use parquet::has_same_rows;
pub use parts::{Parts, PartsPlan};
pub use written::write_long_form;
