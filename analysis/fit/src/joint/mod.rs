//! Spectra, pulses and relaxations in one likelihood, so that slow time constants and the DC
//! resistance are fixed by data and not by the order of the model.
//!
//! A sweep that ends at 0.1 Hz knows nothing slower than a second or two; a pulse of ten seconds
//! and its relaxation do. [`find_pulses`] finds the pulses of a series, [`NoiseModel`] measures its
//! noise, [`PooledSpectrum`] the mean of the sweeps with the scatter within and between cells,
//! [`fit_joint`] fits the extended Randles model to all of them, [`gaps`] says per pulse by how
//! much a model misses what was measured, and [`study`] does all of it for every order, with half
//! of the pulses held out.
//!
//! The time domain here is the response to steps of current, in closed form. Power profiles are not
//! simulated here.

mod apparent;
mod figures;
mod fit;
mod gap;
mod noise;
mod pooled;
mod problem;
mod pulse;
mod response;
mod study;
mod window;

pub use apparent::{Apparent, apparent};
pub use fit::{
    JointError, JointFit, JointInput, JointOptions, choose_order, fit_joint, fit_spectra,
};
pub use gap::{Gap, GapAt, Source, gaps, overlay};
pub use noise::NoiseModel;
pub use pooled::{PooledError, PooledPoint, PooledSpectrum};
pub use pulse::{Pulse, PulseOptions, SLOWEST_EDGE_S, find_pulses};
pub use response::{step_resistance_ohm, step_resistance_sigma_ohm};
pub use study::{
    OrderResult, PulseResult, Role, Study, StudyError, StudyInput, StudyOptions, TIMES_S, study,
};
pub use window::{PulseWindow, WindowOptions};

#[cfg(test)]
mod tests;
