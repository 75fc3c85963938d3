//! Captures to sinusoids, sinusoids to impedance, impedance to a battery model. Numbers in, numbers
//! out.
//!
//! This crate only re-exports the crates below it, in the order in which they depend on each other:
//!
//! * `analysis-numeric` – [`numeric`]: linear algebra, minimisers, statistics; [`brief`]:
//!   significant digits.
//! * `analysis-plot` – [`plot`]: charts; [`report`]: pages.
//! * `analysis-signal` – [`sine`]: fits of sinusoids to samples; [`spectrum`]: impedances with
//!   uncertainty; [`calibration`]: harness; [`budget`]: uncertainty by cause; [`multisine`],
//!   [`staircase`], [`series`]: records.
//! * `analysis-model` – [`model`]: extended Randles model (ERM) and circuits; [`ocv`]: open-circuit
//!   voltage; [`pack`].
//! * `analysis-effects` – [`contract`]: what an effect is; [`augmented`]: a model with effects;
//!   [`effects`]: the catalogue.
//! * `analysis-fit` – [`validity`]: tests of a spectrum; [`fit`]; [`drt`]: time constants;
//!   [`joint`]: spectra and pulses; [`given`]: a model from a file or from text.
//! * `analysis-forward` – [`forward`]: simulation under a load; [`sop`]: state of power.
//! * `analysis-files` – [`run_folder`] and [`dataset`]: files of a run; [`formats`]: files of
//!   other programs; [`thinning`]: frames to rows.
//! * `analysis-diagnosis` – [`diagnosis`]: which effect is missing.
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
