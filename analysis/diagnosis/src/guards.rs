//! The guards of the workflow and their thresholds. Each can be switched off, for studies of what
//! it is worth; the product never does.

/// Which guards are on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Guards {
    /// Errors of the current channel are pushed through the model into the noise.
    pub(crate) current_channel_noise: bool,
    /// Localisation and scores look outside the model's tangent space only.
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
    /// A fit that did not converge is no evidence.
    pub(crate) convergence: bool,
    /// A name that an effect outside the catalogue beats is withdrawn.
    pub(crate) outside: bool,
    /// A named effect must be the same wherever it is measured.
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

/// Penalised gain that an addition must have.
pub(super) const LEAST_SCORE: f64 = 8.0;
/// Lagrange score above which a candidate is fitted in any case.
pub(super) const LEAST_LAGRANGE: f64 = 5.0;
/// Candidates that are fitted even below it.
pub(super) const ALWAYS_FITTED: usize = 3;
/// Candidates that are fitted at most, unless their score is within [`NEAR_BEST`] of the best.
pub(super) const MOST_FITTED: usize = 8;
/// Part of the best Lagrange score that keeps a candidate beyond [`MOST_FITTED`].
pub(super) const NEAR_BEST: f64 = 0.3;
/// Share of the excess of χ² over its degrees of freedom that an addition must remove, unless it
/// reaches the floor.
pub(super) const MATERIAL_SHARE: f64 = 0.3;
/// (χ² − dof)/√(2·dof) from which on fits are tried from other starts too.
pub(super) const MISFIT_Z: f64 = 3.0;
/// (χ² − dof)/√(2·dof) below which nothing is missing.
pub(super) const GOOD_FIT_Z: f64 = 5.0;
/// Penalised gain from which on an effect outside the catalogue says by itself that something is
/// missing. Small systematic errors of a bench, which no repeat shows, look like one: on a
/// simulated bench with nothing hidden, one gained 15.
pub(super) const OUTSIDE_ALONE: f64 = 30.0;
/// Penalised gain by which the best must lead a rival to be named.
pub(super) const NAMING_LEAD: f64 = 14.0;
/// Penalised gain by which an effect outside the catalogue must lead a named one for the name to be
/// withdrawn. Where the name is the truth, the other one leads by so much at most in one of a
/// hundred cases, however well or badly the data tell them apart.
pub(super) const OUTSIDE_LEAD: f64 = 6.0;
/// Part of the named one's gain by which it must lead where the noise is assumed: a χ² is then
/// worth no more than the assumption.
pub(super) const ASSUMED_LEAD: f64 = 0.05;
/// χ² below which the freer of two forms gains nothing: the 99 % interval of its further parameter
/// holds the limit where it is the other form.
pub(super) const SUFFICES: f64 = 6.63;
/// A held-out run's χ² may grow by this part …
pub(super) const HELD_OUT_PART: f64 = 0.1;
/// … and this much.
pub(super) const HELD_OUT_SUM: f64 = 20.0;
/// Standard deviations by which held-out runs may contradict the size of what an addition predicts
/// for them.
pub(super) const HELD_OUT_Z: f64 = 4.0;
/// Part of an effect's size that nature may differ from a catalogue's formula.
pub(super) const FORMULA_SHARE: f64 = 0.03;
/// Times that the steps of a record may be halved to integrate well enough.
pub(super) const MOST_PARTS: usize = 8;
/// Error of integration as a part of the floor.
pub(super) const INTEGRATION_PART: f64 = 0.1;
/// χ² that a further step of a fit may still promise where it counts as converged …
pub(super) const CONVERGED: f64 = 0.1;
/// … or this part of the λ that it is evidence for.
pub(super) const CONVERGED_PART: f64 = 0.01;
/// χ² that leaving an addition out must cost: its 95 % interval, by the likelihood, leaves zero
/// out.
pub(super) const LEAST_LAMBDA: f64 = 3.84;
/// λ below which a name is never certain: something outside the catalogue that shares 70 % of an
/// effect's signal would leave less than 5 standard deviations.
pub(super) const CERTAIN_LAMBDA: f64 = 150.0;
/// Effects added at most.
pub(super) const MOST_EFFECTS: usize = 3;

/// Penalised gain by which an effect of this λ must lead its rivals.
pub(super) fn naming_lead(measured: bool, lambda: f64) -> f64 {
    if measured {
        NAMING_LEAD
    } else {
        NAMING_LEAD.max(ASSUMED_LEAD * lambda)
    }
}

/// Penalised gain by which something outside the catalogue must lead a name of this λ: 3 % of an
/// effect that differ from its formula are no lead.
pub(super) fn outside_lead(lambda: f64) -> f64 {
    OUTSIDE_LEAD
        .max(FORMULA_SHARE * FORMULA_SHARE * lambda)
        .min(NAMING_LEAD)
}

/// χ² that is left of a further λ where so much was gained already: what was added differs from
/// nature by up to [`FORMULA_SHARE`] of its size, and the difference has the look of something
/// else.
pub(super) fn beyond_formula(lambda: f64, gained: f64) -> f64 {
    (lambda.max(0.0).sqrt() - FORMULA_SHARE * gained.max(0.0).sqrt())
        .max(0.0)
        .powi(2)
}
