//! The guards of the workflow. Studies can switch each off to measure its benefit; the product
//! never does. Their thresholds are in `thresholds`.

use crate::thresholds::{ASSUMED_LEAD, FORMULA_SHARE, NAMING_LEAD, OUTSIDE_LEAD};

/// Guards that are on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Guards {
    /// Errors of the current channel are pushed through the model into the noise.
    pub(crate) current_channel_noise: bool,
    /// Localisation and scores use only the part outside the model's tangent space.
    pub(crate) tangent_projection: bool,
    /// No held-out run may become worse.
    pub(crate) held_out: bool,
    /// An addition must remove a material share of the excess.
    pub(crate) material_share: bool,
    /// Repeats must agree with each other and with the bench's history.
    pub(crate) sentinel: bool,
    /// A parameter at its bound is not named.
    pub(crate) bound: bool,
    /// The error of integration must be below a tenth of the floor.
    pub(crate) integration: bool,
    /// A fit that did not converge is not evidence.
    pub(crate) convergence: bool,
    /// A name that an effect outside the catalogue beats is withdrawn.
    pub(crate) outside: bool,
    /// A named effect must have the same value in all measurements.
    pub(crate) consistency: bool,
}

impl Default for Guards {
    fn default() -> Self {
        Self {
            current_channel_noise: true,
            tangent_projection: true,
            held_out: true,
            material_share: true,
            sentinel: true,
            bound: true,
            integration: true,
            convergence: true,
            outside: true,
            consistency: true,
        }
    }
}

/// Penalised gain by which an effect of this λ must lead its rivals. Nature may differ from a
/// formula by [`FORMULA_SHARE`] of the effect, so that a strong effect must lead by as much as that
/// is worth.
pub(super) fn naming_lead(measured: bool, lambda: f64) -> f64 {
    let part = if measured {
        FORMULA_SHARE * FORMULA_SHARE
    } else {
        ASSUMED_LEAD
    };
    NAMING_LEAD.max(part * lambda)
}

/// Penalised gain by which a change outside the catalogue must lead a name of this λ: a deviation
/// of 3 % of an effect from its formula is not a lead.
pub(super) fn outside_lead(lambda: f64) -> f64 {
    OUTSIDE_LEAD
        .max(FORMULA_SHARE * FORMULA_SHARE * lambda)
        .min(NAMING_LEAD)
}

/// Returns χ² of a further λ after subtracting the formula's error, if `gained` was gained already.
/// The added effect differs from the real cell by up to [`FORMULA_SHARE`] of its size, and this
/// difference looks like another effect.
pub(super) fn beyond_formula(lambda: f64, gained: f64) -> f64 {
    (lambda.max(0.0).sqrt() - FORMULA_SHARE * gained.max(0.0).sqrt())
        .max(0.0)
        .powi(2)
}
