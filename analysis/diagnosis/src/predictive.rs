//! A model for predictions if no name is certain.
//!
//! The best penalised set of effects of the cell is added to the named effects, whatever the set is
//! called: its form predicts, and it claims no cause. Each member must gain more than its
//! parameters cost, converge, lie at no bound and within the range of a sound cell, and make no
//! held-out record worse.

use super::attempts::Attempt;
use super::block::Workspace;
use super::gap::{Fits, gaps};
use super::outcome::{FittedParameter, PREDICTION_ONLY, Predictive, PredictiveTerm};
use super::prepare::Prepared;
use super::problem::{Fit, Problem};
use super::search::{Search, excess_z};
use super::select::Selection;
use crate::thresholds::{GOOD_FIT_Z, LEAST_SCORE, PREDICTIVE_TERMS, PREDICTIVE_TRIED};
use analysis_effects::{
    contract::{Group, Scale},
    effects::find,
};
use analysis_model::model::Erm;

impl Search<'_> {
    /// Returns base, named effects and the additions that predict better, or `None` if no addition
    /// does.
    ///
    /// A term may make a held-out record worse because its partner is missing: it stays for the
    /// next one, and counts only if the record is then as good as before.
    pub(super) fn predictive(&mut self, selection: &Selection) -> Option<Fit> {
        let mut proven = match self.pair_that_predicts(selection) {
            Some(pair) => pair,
            None if self
                .no_prediction_worse(&selection.base, &selection.fit)
                .is_ok() =>
            {
                selection.fit.clone()
            }
            None => selection.base.clone(),
        };
        let mut last = Term {
            fit: proven.clone(),
            is_proven: true,
        };
        let own = selection.member(0);
        while last.fit.structure.members.len() < own + PREDICTIVE_TERMS {
            let dof = self.problem.degrees_of_freedom(&last.fit);
            if last.is_proven && excess_z(last.fit.chi2, dof) < GOOD_FIT_Z {
                break;
            }
            let attempts = if last.fit.structure.members.len() == own {
                selection.first_attempts.clone()
            } else {
                self.attempts_of(&last.fit, PREDICTIVE_TRIED, may_predict)
            };
            let Some(next) = self.next_term(&selection.base, &last.fit, attempts) else {
                break;
            };
            if next.is_proven {
                proven.clone_from(&next.fit);
            }
            last = next;
        }
        (proven.structure.members.len() > own).then_some(proven)
    }

    /// Returns the best pair of effects of the cell that no held-out record speaks against.
    fn pair_that_predicts(&mut self, selection: &Selection) -> Option<Fit> {
        for pair in self.pairs(selection) {
            let fit = self.with_fine_steps(pair.fit);
            let mut members = fit.structure.members.iter().skip(selection.member(0));
            if members.all(|member| may_predict(member.name()))
                && self.has_usual_values(&selection.base, &fit)
                && fit.has_converged(pair.score)
                && self.no_prediction_worse(&selection.base, &fit).is_ok()
            {
                return Some(fit);
            }
        }
        None
    }

    /// Returns whether no parameter lies at a bound or outside the range of sound cells: such a
    /// value is not written into a model whose cause is not known.
    fn has_usual_values(&self, base: &Fit, fit: &Fit) -> bool {
        let branches = self.problem.branches();
        let (_, values) = fit.decode(branches);
        let members = fit.structure.members.iter().zip(&values).enumerate();
        members
            .skip(base.structure.members.len())
            .all(|(k, (member, values))| {
                let mut own = member.parameters.iter().zip(values);
                !fit.member_at_bound(k, branches)
                    && own.all(|(p, value)| p.unusual(*value, *value).is_none())
            })
    }

    /// Returns the best further effect of the cell: one that no held-out record contradicts,
    /// otherwise the one that gains most.
    fn next_term(&mut self, base: &Fit, fit: &Fit, mut attempts: Vec<Attempt>) -> Option<Term> {
        attempts.retain(|attempt| may_predict(attempt.name));
        attempts.sort_by(|a, b| b.score.total_cmp(&a.score));
        let mut best = None;
        for attempt in attempts {
            let attempt = self.integrated(fit, attempt);
            let converged = attempt.fit.has_converged(attempt.lambda);
            let is_usual = self.has_usual_values(base, &attempt.fit);
            if attempt.score < LEAST_SCORE || !converged || !is_usual {
                continue;
            }
            let is_proven = self.no_prediction_worse(base, &attempt.fit).is_ok()
                && self.no_prediction_worse(fit, &attempt.fit).is_ok();
            let term = Term {
                fit: attempt.fit,
                is_proven,
            };
            if is_proven {
                return Some(term);
            }
            best = best.or(Some(term));
        }
        best
    }
}

/// A fit with one term more.
struct Term {
    fit: Fit,
    /// No held-out record is predicted worse than by the base or without the term.
    is_proven: bool,
}

/// Returns whether an effect of this name may predict: it is one of the cell.
fn may_predict(name: &str) -> bool {
    find(name).is_some_and(|effect| effect.card().group == Group::Cell)
}

/// Returns the augmentation as it is written, with its remaining gaps, or `None` if no held-out
/// record has tested it.
pub(super) fn described(
    prepared: &Prepared,
    erm: &Erm,
    fits: Fits<'_>,
    workspace: &mut Workspace,
) -> Option<Predictive> {
    let problem = &prepared.problem;
    let fit = fits.augmented;
    let gap = gaps(prepared, erm, fits, workspace);
    if gap.is_empty() {
        return None;
    }
    let lambda = fits.base.chi2 - fit.chi2;
    Some(Predictive {
        claim: PREDICTION_ONLY,
        lambda,
        score: lambda - problem.spent(fits.base, fit),
        terms: terms(problem, fit),
        gap,
        range: problem.base.facts,
        model: fit.decode(problem.branches()).0,
    })
}

/// Returns all effects of a fit with their values.
pub(super) fn terms(problem: &Problem, fit: &Fit) -> Vec<PredictiveTerm> {
    let (_, values) = fit.decode(problem.branches());
    let covariance = fit.covariance();
    let n = fit.x.len();
    let mut terms = Vec::new();
    for (k, (member, values)) in fit.structure.members.iter().zip(&values).enumerate() {
        let card = member.effect.card();
        let mut at = fit.structure.first(k, problem.branches());
        let mut parameters = Vec::new();
        for (p, value) in member.parameters.iter().zip(values) {
            let unit = match p.scale {
                Scale::Linear => Some(p.typical),
                Scale::Log => Some(*value),
                Scale::Choice => None,
            };
            let sigma = unit.and_then(|unit| {
                let sigma = covariance.as_ref().map(|c| unit * c[at * n + at].sqrt());
                at += 1;
                sigma
            });
            parameters.push(FittedParameter {
                name: p.name,
                value: *value,
                sigma,
                interval: (p.range.lower, p.range.upper),
                unit: p.unit,
                caution: p.unusual(*value, *value).map(|usual| usual.source),
            });
        }
        terms.push(PredictiveTerm {
            name: card.name,
            title: card.title,
            group: card.group,
            stands_for: card.signature,
            parameters,
        });
    }
    terms
}
