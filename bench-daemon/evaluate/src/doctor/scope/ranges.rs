//! The vertical ranges in use.

/// The vertical ranges in use.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Ranges {
    pub(super) per_div_v: [f64; 4],
    pub(super) applied: [f64; 4],
    pub(super) session: bool,
}

impl Ranges {
    /// Creates the ranges of the bench file for one ampere.
    pub(crate) fn new(per_ampere_v: &[f64; 4]) -> Self {
        Self {
            per_div_v: *per_ampere_v,
            applied: [f64::NAN; 4],
            session: false,
        }
    }
}
