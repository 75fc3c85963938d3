//! Named effects with their parameters and 95 % intervals by profile likelihood: the values at
//! which χ², with everything else refitted, is 3.84 above its least. Shapes that were held while
//! effects were chosen are free here, so that the intervals contain their uncertainty.

use super::block::Workspace;
use super::outcome::{FittedParameter, NamedEffect};
use super::problem::{Fit, Problem};
use super::select::Selection;
use crate::thresholds::TWO_SIDED_95;
use analysis_effects::contract::Scale;

/// Refits to find one end at most.
const MOST_REFITS: usize = 8;
/// Tolerance of an end against the quantile, in standard deviations.
const NEAR: f64 = 0.1;

/// Returns the effects taken, with values, intervals and evidence.
pub(super) fn named(
    problem: &Problem,
    selection: &Selection,
    workspace: &mut Workspace,
) -> Vec<NamedEffect> {
    let fit = &selection.fit;
    let (_, values) = fit.decode(problem.branches());
    let mut all = Vec::new();
    for ((k, member), selected) in fit
        .structure
        .members
        .iter()
        .enumerate()
        .skip(selection.member(0))
        .zip(&selection.selected)
    {
        let open = with_free_shapes(problem, fit, k, workspace);
        let covariance = open.covariance();
        let n = open.x.len();
        let mut at = open.structure.first(k, problem.branches());
        let mut parameters = Vec::new();
        for (p, value) in open.structure.members[k].parameters.iter().zip(&values[k]) {
            if p.scale == Scale::Choice {
                let interval = (p.range.lower, p.range.upper);
                parameters.push(FittedParameter {
                    name: p.name,
                    value: *value,
                    sigma: None,
                    interval,
                    unit: p.unit,
                    caution: None,
                });
                continue;
            }
            let deviation = covariance.as_ref().map(|c| c[at * n + at].sqrt());
            let ends = [-1.0, 1.0]
                .map(|side| end(problem, &open, at, side, covariance.as_deref(), workspace));
            let linear = p.scale == Scale::Linear;
            let natural = |x: f64| if linear { x * p.typical } else { x.exp() };
            let interval = (
                natural(ends[0]).min(*value).max(p.range.lower),
                natural(ends[1]).max(*value).min(p.range.upper),
            );
            let sigma = deviation.map(|s| s * if linear { p.typical } else { *value });
            parameters.push(FittedParameter {
                name: p.name,
                value: *value,
                sigma,
                interval,
                unit: p.unit,
                caution: p.unusual(interval.0, interval.1).map(|usual| usual.source),
            });
            at += 1;
        }
        let card = member.effect.card();
        all.push(NamedEffect {
            name: card.name,
            title: card.title,
            group: card.group,
            parameters,
            evidence: selected.evidence,
            falsified_by: format!(
                "{} — without the signature \"{}\" the name is wrong",
                card.experiment, card.signature
            ),
        });
    }
    all
}

/// Returns the fit with all shapes of a member searched, or unchanged if they already are.
fn with_free_shapes(problem: &Problem, fit: &Fit, member: usize, workspace: &mut Workspace) -> Fit {
    let (erm, values) = fit.decode(problem.branches());
    let own = fit.structure.members[member].searched(&problem.base, &values[member]);
    if fit.structure.members[member].parameters == own {
        return fit.clone();
    }
    let mut structure = fit.structure.clone();
    structure
        .members
        .iter_mut()
        .zip(&values)
        .for_each(|(m, v)| m.start.clone_from(v));
    structure.members[member].parameters = own;
    problem.fit(&structure, &erm, workspace)
}

/// Returns one end of a coordinate's interval, on the side of the sign, or its bound if the data
/// leave it open. Each refit begins where the last one within the interval ended, so that a curved
/// valley is followed and one long jump does not leave it permanently.
fn end(
    problem: &Problem,
    fit: &Fit,
    k: usize,
    side: f64,
    covariance: Option<&[f64]>,
    workspace: &mut Workspace,
) -> f64 {
    let axis = &fit.axes[k];
    let bound = if side > 0.0 { axis.upper } else { axis.lower };
    // Change of all other coordinates when this coordinate moves by 1.
    let along =
        |j: usize| covariance.map_or(0.0, |c| c[j * fit.x.len() + k] / c[k * fit.x.len() + k]);
    let mut inside = (fit.x.clone(), 0.0);
    let mut step = TWO_SIDED_95
        * covariance.map_or(0.1 * (axis.upper - axis.lower), |c| {
            c[k * fit.x.len() + k].sqrt()
        });
    for _ in 0..MOST_REFITS {
        let from = inside.0[k];
        let at = (from + side * step).clamp(axis.lower, axis.upper);
        let mut axes = fit.axes.clone();
        (axes[k].lower, axes[k].upper) = (at, at);
        let x = inside
            .0
            .iter()
            .enumerate()
            .map(|(j, x)| (x + along(j) * (at - from)).clamp(axes[j].lower, axes[j].upper))
            .collect();
        let found = problem.fit_from(&fit.structure, x, axes, workspace);
        let deviations = (found.chi2 - fit.chi2).max(0.0).sqrt();
        if (deviations - TWO_SIDED_95).abs() < NEAR || (at == bound && deviations <= TWO_SIDED_95) {
            return at;
        }
        // χ² is a parabola from the least: deviations grow in proportion.
        let left = (TWO_SIDED_95 - inside.1) / (deviations - inside.1).max(0.1);
        if deviations < TWO_SIDED_95 {
            step = (at - from).abs() * (left - 1.0).clamp(0.05, 2.0);
            inside = (found.x, deviations);
        } else {
            step = (at - from).abs() * left.clamp(0.1, 0.8);
        }
    }
    (inside.0[k] + side * step).clamp(axis.lower, axis.upper)
}
