//! Which effects could explain the residual: a Lagrange-multiplier test of every candidate's direction at absence, one extra simulation each.
//!
//! With d⊥ the derivative of the whitened prediction by the strength, projected off the tangent space, the χ² that a small step of it removes is
//! (r·d⊥)²/(d⊥·d⊥), reached at (r·d⊥)/(d⊥·d⊥). Shapes and choices are tried on a grid.

use super::block::Desk;
use super::problem::{Fit, Problem, Tangent};
use super::structure::{Member, Structure, variants};
use super::whitening::dot;
use crate::effects::Effect;

/// Step of a strength in units of its typical size.
const STEP: f64 = 2e-2;

/// One way of adding an effect.
#[derive(Debug, Clone)]
pub(super) struct Proposal {
    /// The effect with its starts, the strength set to what the linear test wants.
    pub(super) member: Member,
    /// χ² that a small step would remove.
    pub(super) lagrange: f64,
}

/// All variants of an effect, best first; empty where the effect does not apply.
pub(super) fn propose(problem: &Problem, fit: &Fit, tangent: &Tangent, effect: &'static dyn Effect, desk: &mut Desk) -> Vec<Proposal> {
    let mut proposals: Vec<Proposal> = Vec::new();
    // Bounds come from the base fit before any effect was added, so that they do not move with what is added.
    for mut member in variants(effect, &problem.base) {
        let structure = fit.structure.with(member.clone());
        let Some(direction) = direction(problem, fit, &structure, desk) else { continue };
        let mut outside = direction;
        tangent.project(&mut outside);
        let (along, size) = (dot(&fit.residuals, &outside), dot(&outside, &outside));
        let range = member.parameters[0].range;
        let typical = member.parameters[0].typical;
        let wanted = if size > 1e-20 { along / size * typical } else { 0.0 };
        let strength = wanted.clamp(range.lower, range.upper);
        if strength == 0.0 {
            proposals.push(Proposal { member, lagrange: 0.0 });
            continue;
        }
        member.start[0] = strength;
        proposals.push(Proposal { member, lagrange: along * along / size });
    }
    proposals.sort_by(|a, b| b.lagrange.total_cmp(&a.lagrange));
    proposals
}

/// Derivative of the whitened prediction by the strength of the last member, at absence.
pub(super) fn direction(problem: &Problem, fit: &Fit, structure: &Structure, desk: &mut Desk) -> Option<Vec<f64>> {
    let last = structure.members.len().checked_sub(1)?;
    let axes = structure.axes(&problem.base.erm);
    let mut x = fit.x.clone();
    x.extend(structure.members[last].encode());
    let first = structure.first(last, problem.branches());
    x[first] = 0.0;
    let step = if axes[first].upper >= STEP { STEP } else { -STEP };
    let predicted = problem.prediction(fit);
    let mut change = problem.change(structure, (&x, &predicted), &[(first, step)], desk);
    change.iter_mut().for_each(|c| *c /= step);
    change.iter().all(|c| c.is_finite()).then_some(change)
}
