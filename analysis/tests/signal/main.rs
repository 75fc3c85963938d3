//! Captures to sinusoids, sinusoids to corrected impedance, and the files of a run: laws and
//! statistics, against signals made here.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "helpers of tests fail the test that calls them"
)]

mod bench;
mod budget;
mod calibration;
mod dataset;
mod end_to_end;
mod noise;
mod short_open;
mod sine;
mod sine_bound;
mod sine_change;
mod sine_errors;
mod sine_model;
mod spectrum;
