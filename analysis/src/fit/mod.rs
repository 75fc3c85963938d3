//! Parameters of the extended Randles model from impedance spectra.
//!
//! [`fit_erm`] pools the spectra, searches globally over the time constants (the resistances are linear once these are held), polishes the
//! distinct basins to the last digits within the bounds, and says how well the data fix each parameter. It needs no start values. Which order
//! is worth having is for the caller to judge from the figures of several fits.

mod erm;
mod global;
mod json;
pub(crate) mod linalg;
mod local;
mod options;
mod problem;
mod projection;
mod rng;
mod uncertainty;
mod warnings;

pub use erm::{ErmFit, fit_erm};
pub use global::{DeOptions, Member, Strategy, differential_evolution};
pub use json::{FitEntry, FitReport, JointProvenance, JsonError, MODEL_SCHEMA, MODEL_SCHEMA_VERSION, ModelFile, PackModel};
pub use local::{LocalOptions, Minimum, Smooth, minimise};
pub use options::{Bounds, FitError, FitOptions, MAX_RC, Objective};
pub use rng::Rng;
pub(crate) use uncertainty::sigma_of;
pub use uncertainty::{ErmSigma, RcSigma};

#[cfg(test)]
mod tests;
