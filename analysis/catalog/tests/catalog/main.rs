//! Catalogues of run folders that were generated for the tests: the records found, the effect of a
//! change of a folder, and equal replies after the catalogue was deleted and rebuilt.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "helpers of tests may end a test"
)]

mod drill;
mod made;
mod questions;
mod scans;
