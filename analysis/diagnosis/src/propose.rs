//! Proposes effects that could explain the residual: a Lagrange-multiplier test of every
//! candidate's direction at absence, one extra simulation each.
//!
//! With d⊥ the derivative of the whitened prediction by the strength, projected off the tangent
//! space, the χ² that a small step of it removes is (r·d⊥)²/(d⊥·d⊥), reached at (r·d⊥)/(d⊥·d⊥).
//! Shapes and choices are tried on a grid.

use super::block::Workspace;
use super::problem::{Fit, Prediction, Problem, Tangent};
use super::structure::{Member, Structure, variants};
use super::whitening::dot;
use crate::thresholds::PROPOSAL_STEPS;
use analysis_effects::contract::Effect;

/// One way of adding an effect.
#[derive(Debug, Clone)]
pub(super) struct Proposal {
    /// Effect with its start values. The strength is that of the linear test.
    pub(super) member: Member,
    /// χ² that a small step would remove.
    pub(super) lagrange: f64,
}

/// Returns all variants of an effect on top of a fit with its prediction, best first; empty if the
/// effect does not apply.
pub(super) fn propose(
    problem: &Problem,
    fit: &Fit,
    predicted: &Prediction,
    tangent: &Tangent,
    effect: &'static dyn Effect,
    workspace: &mut Workspace,
) -> Vec<Proposal> {
    let mut proposals: Vec<Proposal> = Vec::new();
    // Bounds come from the base fit before any effect was added, so that they do not move with the
    // additions.
    for mut member in variants(effect, &problem.base) {
        let structure = fit.structure.with(member.clone());
        let (range, typical) = (member.parameters[0].range, member.parameters[0].typical);
        let mut best = 0.0;
        for step in PROPOSAL_STEPS {
            let Some(mut outside) = direction(problem, fit, predicted, &structure, step, workspace)
            else {
                continue;
            };
            tangent.project(&mut outside);
            let (along, size) = (dot(&fit.residuals, &outside), dot(&outside, &outside));
            let wanted = if size > 1e-20 {
                along / size * typical
            } else {
                0.0
            };
            let strength = wanted.clamp(range.lower, range.upper);
            let lagrange = if size > 1e-20 {
                along * along / size
            } else {
                0.0
            };
            if strength != 0.0 && lagrange > best {
                best = lagrange;
                member.start[0] = strength;
            }
        }
        proposals.push(Proposal {
            member,
            lagrange: best,
        });
    }
    proposals.sort_by(|a, b| b.lagrange.total_cmp(&a.lagrange));
    proposals
}

/// Returns the change of the whitened prediction per typical strength of the last member, from its
/// absence over a step in that unit. `predicted` is [`Problem::prediction`] of the fit.
pub(super) fn direction(
    problem: &Problem,
    fit: &Fit,
    predicted: &Prediction,
    structure: &Structure,
    step: f64,
    workspace: &mut Workspace,
) -> Option<Vec<f64>> {
    let last = structure.members.len().checked_sub(1)?;
    let axes = structure.axes(&problem.base.erm);
    let mut x = fit.x.clone();
    x.extend(structure.members[last].encode());
    let first = structure.first(last, problem.branches());
    x[first] = 0.0;
    let step = if axes[first].upper > 0.0 {
        step.min(0.5 * axes[first].upper)
    } else {
        (-step).max(0.5 * axes[first].lower)
    };
    let mut change = problem.change(structure.at(&x), predicted, first, step, workspace);
    change.iter_mut().for_each(|c| *c /= step);
    change.iter().all(|c| c.is_finite()).then_some(change)
}
