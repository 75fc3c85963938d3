//! Decoding of Parquet that other programs wrote.

use std::panic::{AssertUnwindSafe, catch_unwind};

use polars::prelude::PolarsError;

/// Decodes Parquet, and turns a panic of the decoder into an error: polars panics on some damaged
/// pages instead of returning one.
///
/// # Errors
/// In words: what cannot be decoded.
pub(super) fn decode<T>(work: impl FnOnce() -> Result<T, PolarsError>) -> Result<T, String> {
    match catch_unwind(AssertUnwindSafe(work)) {
        Ok(decoded) => decoded.map_err(|error| error.to_string()),
        Err(_) => Err("its pages are damaged".to_owned()),
    }
}
