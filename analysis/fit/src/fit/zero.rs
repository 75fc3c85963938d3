//! Decides whether the series resistance is zero. Its logarithm has a lower bound; a value at that
//! bound is not a fault if the data show no resistance.

use super::options::Bounds;
use super::problem::Problem;
use analysis_model::model::Erm;
use std::f64::consts::TAU;

/// A parameter this near to a bound (as a ratio) counts as held by it.
pub(super) const NEAR_BOUND: f64 = 1.02;
/// A branch whose time constant is this many times that of the highest frequency has fallen to a
/// tenth of its resistance there.
const FALLEN_OFF: f64 = 3.0;
/// Share of the greatest |Z| that the data may still have at the highest frequency.
const LEFT: f64 = 0.4;

/// Returns whether the series resistance is zero within the data: it is at its lower bound, and all
/// branches and the measured |Z| have fallen off within the band, so that no branch replaces it.
pub(super) fn is_r_zero(erm: &Erm, bounds: &Bounds, problem: &Problem) -> bool {
    let Some(fastest) = problem.groups.last() else {
        return false;
    };
    let fallen = |tau_s: f64| TAU * fastest.freq_hz * tau_s > FALLEN_OFF;
    let sizes = problem.groups.iter().map(|g| g.mean.norm());
    fastest.mean.norm() < LEFT * sizes.fold(0.0, f64::max)
        && !erm.branches.is_empty()
        && erm.r_ohm <= bounds.r_ohm.0 * NEAR_BOUND
        && erm.time_constants_s().into_iter().all(fallen)
}
