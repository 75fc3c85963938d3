//! Captures to sinusoids, sinusoids to impedance, impedance to a battery model. Numbers in, numbers
//! out.
//!
//! In reading order: [`sine`] fits sinusoids to samples, [`calibration`] corrects the harness from
//! the control impedances, [`budget`] tells where the uncertainty comes from, [`spectrum`] holds
//! complex impedances with their uncertainty, [`validity`] judges them, [`model`] is the extended
//! Randles model (ERM) and circuits in general, [`fit`] finds their parameters, [`drt`] shows their
//! time constants, [`ocv`] is the voltage at rest, [`multisine`] measures many frequencies in one
//! record, [`joint`] fits the model to spectra and pulses of a [`series`] together, [`pack`] maps a
//! cell to an SxP pack, [`forward`] simulates a cell or a pack under a load, [`sop`] finds the most
//! power that can be held; [`given`] is a cell's model from whatever it was given as, fitted
//! circuits as ladders of RC too; [`thinning`] averages frames of direct currents;
//! [`run_folder`], [`dataset`] and [`formats`] are the files, [`plot`] and [`report`] the pictures, [`brief`] the numbers in words.
//!
//! Knows no sockets, no clock, no async runtime, no instrument and no simulated truth.

pub use analysis_diagnosis as diagnosis;
pub use analysis_effects::{augmented, contract, effects};
pub use analysis_files::{dataset, formats, run_folder, thinning};
pub use analysis_fit::{drt, fit, given, joint, validity};
pub use analysis_forward::{forward, sop};
pub use analysis_model::{model, ocv, pack};
pub use analysis_numeric::{self as numeric, brief};
pub use analysis_plot::report;
pub use analysis_signal::{budget, calibration, multisine, series, sine, spectrum, staircase};

/// Charts and plots.
pub mod plot {
    pub use analysis_fit::figures::*;
    pub use analysis_plot::*;
}
