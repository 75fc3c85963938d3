//! Parameters of the extended Randles model from impedance spectra.
//!
//! [`fit_erm`] pools the spectra, searches globally over the time constants (the resistances are linear once these are held), polishes the
//! distinct basins to the last digits within the bounds, and says how well the data fix each parameter. It needs no start values. Which order
//! is worth having is for the caller to judge from the figures of several fits. [`fit_circuit`] does the same for any equivalent circuit.

mod batch;
mod circuit;
mod erm;
mod global;
mod json;
pub(crate) mod linalg;
mod local;
mod minima;
mod options;
mod problem;
mod projection;
mod rng;
mod search;
mod uncertainty;
mod warnings;

pub use circuit::{CircuitFit, CircuitFitError, CircuitOptions, MAX_STARTS, Search, State, Weight, fit_circuit};
pub use erm::{ErmFit, fit_erm, fit_erm_from};
pub use global::{Columns, DeOptions, Evolution, Member, Strategy, differential_evolution};
pub use json::{FitEntry, FitReport, JointProvenance, JsonError, MODEL_SCHEMA, MODEL_SCHEMA_VERSION, ModelFile, PackModel};
pub use local::{LocalOptions, Minimum, Smooth, minimise};
pub use minima::{LocalMinimum, SeedSurvey, survey_seeds};
pub use options::{Bounds, FitError, FitOptions, MAX_RC, Objective};
pub use rng::Rng;
pub(crate) use uncertainty::sigma_of;
pub use uncertainty::{ErmSigma, RcSigma};

#[cfg(test)]
mod tests;
