//! Models of a cell's impedance: the extended Randles model (ERM), a resistance in series with
//! parallel RC branches, and equivalent circuits in general, of which it is one.
//!
//! Frequency domain only; the model's behaviour in time and the fit of its parameters are elsewhere
//! (see `fit`).

mod circuit;
mod erm;

pub use circuit::Node;
pub use circuit::{
    Circuit, ElementKind, MAX_DEPTH, MAX_ELEMENTS, ParameterKind, ParseError, Role, WrittenCircuit,
};
pub use erm::{Erm, ModelError, RcBranch};
