//! Bounds that move: an effect that explains almost everything at a bound shows that the bound is
//! wrong.
//!
//! The bounds come from typical cells. Beyond them the search continues, and the report states that
//! the value is unusual.

use super::attempts::{Attempt, is_outside};
use super::problem::Fit;
use super::search::Search;
use super::structure::{Member, at_bound};
use crate::thresholds::{DEEPER_CHI2, MATERIAL_SHARE, MOST_WIDENED, WIDENED_BY, WIDENED_SHARE};
use analysis_effects::contract::{Parameter, Scale, Usual};

/// Reason why a value beyond the bounds of the catalogue is unusual.
const BEYOND: &str = "it lies beyond the bounds that the catalogue derives from typical cells and \
    benches; the data require it all the same";

impl Search<'_> {
    /// Returns an attempt, or, if a parameter lies at a bound, its fit with that bound moved. The
    /// fit must then remove nearly all that the fit before it has missed.
    pub(super) fn widened(&mut self, before: &Fit, attempt: Attempt) -> Attempt {
        let excess = before.chi2 - self.problem.degrees_of_freedom(before);
        let (last, branches) = (before.structure.members.len(), self.problem.branches());
        let is_weak = attempt.lambda < MATERIAL_SHARE * excess;
        if is_weak || is_outside(attempt.name) || !attempt.fit.member_at_bound(last, branches) {
            return attempt;
        }
        let mut moved = attempt.clone();
        for _ in 0..MOST_WIDENED {
            let Some(member) = self.with_wider_bounds(&moved.fit) else {
                break;
            };
            let mut structure = moved.fit.structure.clone();
            structure.members[last] = member;
            let axes = structure.axes(&self.problem.base.erm);
            let x = moved.fit.x.clone();
            let fit = self
                .problem
                .fit_from(&structure, x, axes, &mut self.workspace);
            let gained = moved.fit.chi2 - fit.chi2;
            if gained.is_nan() || gained <= DEEPER_CHI2 {
                break;
            }
            moved.lambda += gained;
            moved.score += gained;
            moved.fit = fit;
        }
        let is_inside = !moved.fit.member_at_bound(last, branches);
        if is_inside && moved.lambda >= WIDENED_SHARE * excess {
            moved
        } else {
            attempt
        }
    }

    /// Returns the last member of a fit with the bounds moved at which it lies, or `None` if it lies
    /// at none that may move.
    fn with_wider_bounds(&self, fit: &Fit) -> Option<Member> {
        let last = fit.structure.members.len() - 1;
        let mut member = fit.structure.members[last].clone();
        let mut at = fit.structure.first(last, self.problem.branches());
        let mut has_moved = false;
        for parameter in &mut member.parameters {
            if parameter.scale == Scale::Choice {
                continue;
            }
            if at_bound(fit.x[at], &fit.axes[at]) && may_move(parameter) {
                widen(parameter, fit.x[at] - fit.axes[at].lower);
                has_moved = true;
            }
            at += 1;
        }
        has_moved.then_some(member)
    }
}

/// Returns whether the bounds of a parameter come from typical cells and are not part of its
/// definition: a state, an exponent, a share and a relative error end where their formula does.
fn may_move(parameter: &Parameter) -> bool {
    let is_share = parameter.unit.is_empty() && parameter.range.upper <= 1.0;
    parameter.only_with.is_none() && !is_share
}

/// Moves the bound that is nearer, `above` the lower one.
fn widen(parameter: &mut Parameter, above: f64) {
    let range = parameter.range;
    parameter.usual = parameter.usual.or(Some(Usual {
        range,
        source: BEYOND,
    }));
    let is_lower = match parameter.scale {
        Scale::Linear => above < 0.5 * (range.upper - range.lower) / parameter.typical,
        _ => above < 0.5 * (range.upper / range.lower).ln(),
    };
    match (is_lower, parameter.scale) {
        (true, Scale::Log) => parameter.range.lower /= WIDENED_BY,
        (true, _) => parameter.range.lower *= WIDENED_BY,
        (false, _) => parameter.range.upper *= WIDENED_BY,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use analysis_effects::contract::{Base, Facts};
    use analysis_effects::effects::find;
    use analysis_model::{model::Erm, ocv::OcvCurve};

    #[test]
    fn a_bound_moves_away_and_a_definition_stays() {
        let base = Base {
            erm: Erm {
                r_ohm: 6e-3,
                branches: Vec::new(),
            },
            ocv: OcvCurve::monotone(4.5, vec![0.0, 1.0], vec![3.0, 4.0]).unwrap(),
            facts: Facts {
                widest_soc: 0.2,
                longest_s: 600.0,
                ..Facts::NONE
            },
        };
        let of = |name: &str, k: usize| find(name).unwrap().parameters(&base)[k].clone();
        assert!(!may_move(&of("ocv_slope", 0)) && !may_move(&of("hysteresis", 3)));
        let mut slope = of("soc_resistance", 0);
        assert!(may_move(&slope));
        widen(&mut slope, 0.0);
        assert_eq!((slope.range.lower, slope.range.upper), (-9.0, 3.0));
        assert!(slope.unusual(-3.6, -3.5).is_some() && slope.unusual(-2.0, -1.0).is_none());
        let mut tau = of("self_heating", 1);
        widen(&mut tau, (6000.0_f64 / 60.0).ln());
        assert_eq!((tau.range.lower, tau.range.upper), (60.0, 18_000.0));
    }
}
