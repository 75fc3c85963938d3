//! Search for rivals: other effects that explain the data as well in place of a selected one.

use super::attempts::{Attempt, is_outside};
use super::guards::naming_lead;
use super::problem::Fit;
use super::search::Search;
use super::select::{RivalFit, SelectedEffect, Selection};
use super::whitening::dot;
use crate::thresholds::SUFFICES;
use analysis_effects::effects::find;

impl Search<'_> {
    /// For every effect taken, those that would do as well in its place.
    pub(super) fn find_rivals(&mut self, selection: &mut Selection) {
        let names: Vec<&'static str> = selection.selected.iter().map(|t| t.name).collect();
        for (k, name) in names.iter().enumerate() {
            let at = selection.member(k);
            let without = self.refit_without(&selection.base, &selection.fit, at);
            let lambda = without.chi2 - selection.fit.chi2;
            let own = lambda - self.problem.penalty(&selection.fit.structure.members[at]);
            // An effect that was added later may have taken a share of it.
            selection.selected[k].evidence.lambda = lambda;
            selection.selected[k].evidence.score = own;
            let (attempts, _) = self.attempts(&without, Some(name));
            for other in attempts {
                let lead = naming_lead(self.measured, lambda);
                if !rivals(&selection.selected[k], &other, lead) || names.contains(&other.name) {
                    if contains(&other, name) && other.lambda > lambda - SUFFICES {
                        selection.selected[k].limit_of.push(other.name);
                    }
                    continue;
                }
                let index = other.fit.structure.members.len() - 1;
                if self.guards.bound
                    && !is_outside(other.name)
                    && other.fit.member_at_bound(index, self.problem.branches())
                {
                    continue;
                }
                let distinct = self.discriminability(&selection.fit, &without, &other.fit);
                let gap = other.score - own;
                selection.selected[k].rivals.push(RivalFit {
                    name: other.name,
                    score_gap: gap,
                    discriminability: distinct,
                    fit: other.fit,
                });
            }
        }
    }

    /// Returns r: the part of the named effect's addition that the other cannot imitate, to first
    /// order around its fit.
    fn discriminability(&self, named: &Fit, without: &Fit, other: &Fit) -> f64 {
        let difference = |a: &Fit, b: &Fit| {
            b.residuals
                .iter()
                .zip(&a.residuals)
                .map(|(b, a)| b - a)
                .collect::<Vec<f64>>()
        };
        let mut apart = difference(named, other);
        other.tangent().project(&mut apart);
        let whole = difference(named, without);
        (dot(&apart, &apart) / dot(&whole, &whole).max(1e-12)).min(1.0)
    }
}

/// Returns whether another effect becomes a named one at a limit of its shape.
fn contains(other: &Attempt, name: &str) -> bool {
    find(other.name).is_some_and(|e| e.card().contains.contains(&name))
}

/// Returns whether another effect is a rival of a named one. An effect that contains the named
/// effect as a limit necessarily fits as well: if the interval of its shape contains the limit,
/// only its forms away from the limit count.
fn rivals(named: &SelectedEffect, other: &Attempt, lead: f64) -> bool {
    let (lambda, own) = (named.evidence.lambda, named.evidence.score);
    let near = |score: f64| score - own >= -lead;
    if !contains(other, named.name) {
        return near(other.score);
    }
    let suffices = other.lambda - lambda < SUFFICES;
    other.score >= own || near(other.distinct) || (!suffices && near(other.score))
}
