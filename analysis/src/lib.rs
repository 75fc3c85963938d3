//! Captures to sinusoids, sinusoids to impedance, impedance to a battery model. Numbers in, numbers
//! out.
//!
//! This crate only re-exports the crates below it, in the order in which they depend on each other:
//!
//! * `analysis-numeric` – [`numeric`]: linear algebra, minimisers, statistics; [`mixed`]:
//!   components of variance; [`significant`]:
//!   significant digits.
//! * `analysis-plot` – [`plot`]: charts; [`report`]: pages.
//! * `analysis-signal` – [`sine`]: fits of sinusoids to samples; [`spectrum`]: impedances with
//!   uncertainty; [`calibration`]: harness; [`budget`]: uncertainty by cause; [`nonlinear`]: harmonics; [`multisine`],
//!   [`staircase`], [`series`]: records.
//! * `analysis-model` – [`model`]: extended Randles model (ERM) and circuits; [`ocv`]: open-circuit
//!   voltage; [`map`]: over state of charge and temperature; [`pack`].
//! * `analysis-effects` – [`contract`]: what an effect is; [`augmented`]: a model with effects;
//!   [`effects`]: the catalogue.
//! * `analysis-fit` – [`validity`]: tests of a spectrum; [`fit`]; [`drt`]: time constants;
//!   [`joint`]: spectra and pulses; [`loads`]: rests and loads of a log; [`hppc`]: pulse resistances;
//!   [`given`]: a model from a file or from text; [`rows`]: tables of
//!   many results; [`under_current`]: sweeps under a direct current; [`usage`]: records of
//!   ordinary use.
//! * `analysis-forward` – [`forward`]: simulation under a load; [`sop`]: state of power.
//! * `analysis-files` – [`run_folder`] and [`dataset`]: files of a run; [`formats`]: files of
//!   other programs; [`batch`]: tables of many spectra; [`table`]: tables that a person writes;
//!   [`thinning`]: frames to rows.
//! * `analysis-diagnosis` – [`diagnosis`]: which effect is missing.
//! * `analysis-catalog` – [`catalog`]: questions across run folders.
//!
//! From the text of a spectrum to the power of a pack:
//!
//! ```
//! use analysis::fit::{FitOptions, fit_erm};
//! use analysis::forward::{OcvSource, SimModel};
//! use analysis::model::{Erm, RcBranch};
//! use analysis::sop::{SopOptions, most_power};
//! use analysis::{formats, pack::Pack};
//! use std::path::Path;
//!
//! // A cell of 10 mΩ and 20 mΩ ‖ 16 F, from 10 mHz to 1 kHz.
//! let cell = Erm { r_ohm: 0.01, branches: vec![RcBranch { r_ohm: 0.02, c_f: 16.0 }] };
//! let mut text = "freq_hz,z_re_ohm,z_im_ohm\n".to_owned();
//! for k in 0..26 {
//!     let freq_hz = 10.0_f64.powf(-2.0 + 0.2 * f64::from(k));
//!     let z_ohm = cell.impedance(freq_hz);
//!     text += &format!("{freq_hz},{},{}\n", z_ohm.re, z_ohm.im);
//! }
//! let read = formats::parse(Path::new("cell.csv"), text.as_bytes())?;
//! let fit = fit_erm(&[read[0].spectrum.clone()], &FitOptions { rc: 1, ..FitOptions::default() })?;
//! // 64 cells of 3.7 V: after ten seconds each gives 40 A at the limit of 2.5 V.
//! let model = SimModel::pack(&fit.erm, OcvSource::Constant(3.7), Pack::new(16, 4, 0.0)?)?;
//! let (discharge, _) = most_power(&model, &model.rest(0.5)?, 10.0, &SopOptions::default())?;
//! assert!((discharge.power_w - 6400.0).abs() < 1.0);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Features
//!
//! All are on by default.
//!
//! * `files`: run folders and files of other programs; builds polars.
//! * `draw`: SVG and PNG; builds plotters. Without it plots can be described, and drawing one is an
//!   error.
//! * `diagnosis`: which effect is missing.
//! * `catalog`: questions across run folders; builds SQLite.
//!
//! Fits, tests of validity, circuits and simulation alone: `default-features = false`, 54 crates.
//!
//! # Versions
//!
//! The crates follow [semantic versioning](https://semver.org): before 1.0 a minor version may break
//! what uses it, a patch version does not. Enums that will grow are `#[non_exhaustive]`. Numbers may
//! change in their last digits with any version; JSON and tables only gain fields.
//!
//! `examples/` of this crate fits a file, fits a circuit and simulates a pack.
//!
//! Knows no sockets, no clock, no async runtime, no instrument and no simulated truth.

#[cfg(feature = "catalog")]
pub use analysis_catalog as catalog;
#[cfg(feature = "diagnosis")]
pub use analysis_diagnosis as diagnosis;
pub use analysis_effects::{augmented, contract, effects};
#[cfg(feature = "files")]
pub use analysis_files::{batch, dataset, formats, run_folder, table, thinning};
pub use analysis_fit::{drt, fit, given, hppc, joint, loads, rows, under_current, usage, validity};
pub use analysis_forward::{forward, sop};
pub use analysis_model::{model, ocv, pack};
/// Resistances over state of charge and temperature.
pub mod map {
    pub use analysis_fit::map::*;
    pub use analysis_model::map::*;
}
pub use analysis_numeric::mixed;
pub use analysis_numeric::{self as numeric, significant};
pub use analysis_plot::report;
pub use analysis_signal::{
    budget, calibration, multisine, nonlinear, series, sine, spectrum, staircase,
};

/// Charts and plots.
pub mod plot {
    pub use analysis_fit::figures::*;
    pub use analysis_plot::*;
}
