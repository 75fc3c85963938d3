//! Options of the comparison, and why one is refused.

use crate::fit::FitError;

/// Options of the comparison.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct UnderCurrentOptions {
    /// Number of RC branches; `None` for the smallest from 2 that suits the differences between the
    /// sweeps at rest.
    pub rc: Option<usize>,
    /// All sweeps under a direct current are of one cell, so that they can be compared with each other.
    pub same_cell: bool,
    /// Seed of the search for the model.
    pub seed: u64,
}

/// Reason why sweeps are not compared.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum UnderCurrentError {
    /// No sweep carries a direct current.
    #[error("expected at least one spectrum with a direct current, found none")]
    NoBias,
    /// The sweeps at rest do not show how much cells differ.
    #[error(
        "spectrum {name:?}: expected repeats of two or more cells without direct current, found {cells} \
        with frequencies in common: the spread of cells states how certain a change is"
    )]
    Cells {
        /// Name of the spectrum under a direct current.
        name: String,
        /// Number of cells found.
        cells: usize,
    },
    /// No cell was measured twice at rest.
    #[error(
        "expected two or more sweeps of at least one cell without direct current, found one of each: \
        repeats state the noise of a sweep"
    )]
    NoRepeats,
    /// Too few frequencies in common.
    #[error(
        "spectrum {name:?}: expected at least {expected} frequencies that all sweeps without direct \
        current have as well, found {found}"
    )]
    Frequencies {
        /// Name of the spectrum.
        name: String,
        /// Number needed.
        expected: usize,
        /// Number found.
        found: usize,
    },
    /// The model of the sweeps at rest.
    #[error(transparent)]
    Fit(#[from] FitError),
}
