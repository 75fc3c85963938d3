//! Models of a cell's impedance: today the extended Randles model (ERM), a resistance in series with parallel RC branches.
//!
//! Frequency domain only; how the model behaves in time is not told here, nor how its parameters are found (see [`crate::fit`]).

mod erm;

pub use erm::{Erm, ModelError, RcBranch};
