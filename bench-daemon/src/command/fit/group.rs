//! Spectra that are fitted together, with their models.

use analysis::{
    fit::{ErmFit, RefusedPoint},
    spectrum::Spectrum,
};

use super::more::More;

/// The spectra that one set of models belongs to.
pub(super) struct Group {
    pub(super) name: String,
    pub(super) spectra: Vec<Spectrum>,
    pub(super) fits: Vec<ErmFit>,
    pub(super) more: More,
    pub(super) refused: Vec<RefusedPoint>,
}
