//! From samples to impedances.
//!
//! [`sine`] fits sinusoids to samples, [`spectrum`] holds complex impedances with their
//! uncertainty, [`calibration`] corrects the harness from the control impedances, [`budget`]
//! attributes the uncertainty to its sources, [`history`] holds the errors of a bench,
//! [`multisine`] measures many frequencies in one record, [`nonlinear`] states the harmonics of a
//! cell, [`staircase`] finds a stair of
//! milliseconds in its record, [`series`] holds time series.

pub mod budget;
pub mod calibration;
pub mod history;
pub mod multisine;
pub mod nonlinear;
pub mod series;
pub mod sine;
pub mod spectrum;
pub mod staircase;
