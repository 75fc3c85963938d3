//! The tools of a search for missing effects. `attempts` fits candidates, `accept` judges them,
//! `rivals` searches for others that fit as well, `select` combines all of it.

use super::block::Workspace;
use super::guards::Guards;
use super::problem::Problem;
use super::progress::Progress;
use analysis_effects::contract::Effect;

/// Problem, candidates and tools of a search.
pub(super) struct Search<'a> {
    pub(super) problem: &'a Problem,
    pub(super) candidates: &'a [&'static dyn Effect],
    pub(super) guards: Guards,
    /// The noise was measured by repeats, not assumed.
    pub(super) measured: bool,
    pub(super) progress: &'a Progress,
    pub(super) workspace: Workspace,
}

impl Search<'_> {
    /// Returns the same tools for another thread.
    pub(super) fn aside(&self) -> Search<'_> {
        Search {
            workspace: Workspace::default(),
            ..*self
        }
    }
}

/// (χ² − dof)/√(2·dof).
pub(super) fn excess_z(chi2: f64, dof: f64) -> f64 {
    (chi2 - dof) / (2.0 * dof).sqrt()
}
