//! Model of a cell as it was given, and all that is known of it.

use analysis_effects::contract::Facts;
use analysis_model::{map::CellMap, model::Erm, ocv::OcvCurve};

use super::ladder::Ladder;
use crate::fit::{Addition, ModelFile};

/// A cell's model and all that is known of it.
#[derive(Debug, Clone, PartialEq)]
pub struct GivenModel {
    /// Name: of the cell, of the file, of the circuit.
    pub name: String,
    /// The model.
    pub erm: Erm,
    /// Open-circuit voltage over state of charge, if known.
    pub ocv: Option<OcvCurve>,
    /// Resistances over state of charge and temperature, of which `erm` is one point; none for a
    /// model of one point.
    pub map: Option<CellMap>,
    /// Covariance of the logarithmic parameters of `erm`, row by row, if known.
    pub log_covariance: Option<Vec<Vec<f64>>>,
    /// Warnings of the fit.
    pub warnings: Vec<String>,
    /// Effects that a diagnosis has added.
    pub additions: Vec<Addition>,
    /// Range of the data that the additions come from.
    pub facts: Option<Facts>,
    /// Report on the ladder that follows the circuit; none for other sources.
    pub ladder: Option<Ladder>,
    /// The model file; `None` for typed models and circuits.
    pub(super) fitted: Option<Box<ModelFile>>,
}
