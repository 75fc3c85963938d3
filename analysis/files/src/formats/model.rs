//! A cell's model for other programs: a C header, an FMU, Modelica, tables for Simscape, and Python
//! modules for PyBaMM and CasADi.
//!
//! All contain the same law: a series resistance, RC branches, and the open-circuit voltage over the
//! state of charge as knots of a cubic Hermite curve, as evaluated by `OcvCurve::at`. Currents
//! are positive for discharge. All take a current or a power, with the tangent beyond P₀, and a map
//! over state of charge and temperature. Additions of a diagnosis that are RC branches are branches
//! of every format; C, CasADi and an FMU also hold the others.
//!
//! One template per language has the law; the numbers come from the model.

mod added;
mod cell;
mod error;
mod fmu;
mod parts;
mod tables;
mod text;

pub use cell::CellModel;
pub use error::{ModelExportError, ModelFormat};
pub use fmu::Fmu;

#[cfg(test)]
mod tests;
