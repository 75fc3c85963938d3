//! Catalogues of run folders that were made for the tests: what is found, what a change of a folder
//! does, and the same answers after the catalogue was deleted and built again.
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
