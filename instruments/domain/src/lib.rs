//! Vocabulary that drivers, mocks and callers share: [`units`] of the values sent to an instrument,
//! and [`fixture`], the test position.
//!
//! Knows no instrument and does no I/O.

pub mod fixture;
pub mod units;
