//! A reason not to treat the residual as noise, as `consistency`, `intermittent` and `repeat_mean`
//! find it.

/// Sign that something may be left.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Inconsistency {
    /// Text: the quantity that differs, and the circumstances.
    pub(super) message: String,
    /// χ² that would go if it could, and as how many quantities.
    pub(super) chi2: f64,
    pub(super) dof: usize,
    /// Probability that noise alone gives this χ², corrected for the number of questions.
    pub(super) p_value: f64,
    /// An intermittent contact: not a form of an effect.
    pub(super) is_contact: bool,
}
