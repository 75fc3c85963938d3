//! A reason not to take what is left for noise, as `consistency`, `intermittent` and `repeat_mean`
//! find it.

/// Sign that something may be left.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Inconsistency {
    /// In words: what differs between which circumstances.
    pub(super) message: String,
    /// χ² that would go if it could, and as how many quantities.
    pub(super) chi2: f64,
    pub(super) dof: usize,
    /// Probability of so much by noise, corrected for the number of questions.
    pub(super) p_value: f64,
    /// A contact that comes and goes: no form of an effect.
    pub(super) is_contact: bool,
}
