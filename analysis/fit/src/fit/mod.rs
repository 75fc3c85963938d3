//! Fits the extended Randles model, and circuits in general, to impedance spectra, with
//! uncertainties.
//!
//! [`fit_erm`] (or [`fit_cells`], where it is known which sweeps share a cell) pools the spectra
//! and searches globally over the time constants; the resistances are linear once these are held.
//! It polishes the distinct basins to full precision within the bounds, and states how well the
//! data fix each parameter. It needs no start values.
//!
//! [`select_order`] finds the number of branches that the data support, [`profiles`] the interval
//! of each parameter, [`cell_spread`] the differences between cells and repeats. [`survey_seeds`]
//! measures how reliably the search ends at the best minimum, and lists the others. [`fit_circuit`]
//! fits any equivalent circuit.

mod addition;
mod batch;
mod between;
mod cells;
mod circuit;
mod clusters;
mod common;
mod erm;
mod evidence;
mod json;
mod minima;
mod options;
mod order;
mod outliers;
mod pooled;
mod problem;
mod profile;
mod projection;
mod request;
mod result;
mod schema;
mod search;
mod slope;
mod spread;
mod storage;
mod uncertainty;
mod verdict;
mod warning;
mod warnings;
mod whiteness;
mod zero;

pub(crate) use addition::augmented;
pub use addition::{Addition, AdditionEvidence, AdditionParameter};
pub(crate) use cells::smooth_relative;
pub use cells::{CellSweeps, Components, FrequencySpread, components, frequency_spread};
pub use circuit::{
    CircuitFit, CircuitFitError, CircuitOptions, MAX_STARTS, Search, State, Weight, fit_circuit,
    fit_circuit_cells,
};
pub use erm::{fit_cells, fit_erm};
pub use json::{FitEntry, FitReport, JointProvenance, ModelFile, PackModel, RefusedPoint};
pub use minima::{LocalMinimum, SeedSurvey, survey_seeds};
pub use options::{Bounds, FitError, FitOptions, MAX_RC, Objective};
pub use order::{MOST_AUTO, OrderOptions, OrderSelection, select_order};
pub use profile::{Interval, Profile, profiles};
pub use request::{ErmAnswer, ErmRequest, Prepared};
pub use result::ErmFit;
pub use schema::{JsonError, MODEL_SCHEMA, MODEL_SCHEMA_VERSION, PROGRAM};
pub use slope::{Slope, SlopeError};
pub use spread::{CellSpread, ParameterSpread, QuantitySpread, cell_spread};
pub use storage::ChargeStorage;
pub(crate) use uncertainty::sigma_of;
pub use uncertainty::{ErmSigma, RcSigma};
pub use verdict::OrderRow;
pub use warning::{Warning, WarningCode, Warnings};

#[cfg(test)]
mod tests;
