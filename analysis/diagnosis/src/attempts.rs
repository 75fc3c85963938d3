//! Fits of candidates on top of a fit, from several starts.
//!
//! A fit may stand in a minimum that no single addition leaves: the base has bent its branches to
//! imitate the missing effect. Candidates are then also fitted from the model file's own
//! parameters, where the linear test gives another strength and shape.

use super::block::Workspace;
use super::outcome::Candidate;
use super::problem::{Fit, Tangent};
use super::propose::{Proposal, propose};
use super::search::{Search, excess_z};
use super::structure::Member;
use crate::thresholds::{
    ALWAYS_FITTED, DEEPER_CHI2, HELD_STARTS, INTEGRATION_PART, KEPT_PART, LEAST_LAGRANGE,
    LEAST_SCORE, MISFIT_Z, MOST_FITTED, MOST_PARTS, MOST_RESTARTS, NEAR_BEST, SHAPE_DRIFT,
    STRONG_LAGRANGE, WEAKER_STARTS,
};
use analysis_effects::{
    contract::Effect,
    effects::{outside, title},
};
use rayon::prelude::*;

/// A fitted addition.
#[derive(Debug, Clone)]
pub(super) struct Attempt {
    pub(super) name: &'static str,
    pub(super) fit: Fit,
    pub(super) lambda: f64,
    pub(super) score: f64,
    /// Score of the best fit with shapes held at their starts, if it differs from the effects that
    /// it contains.
    pub(super) distinct: f64,
}

/// Start of an addition, and its ways from there, best first.
struct Origin {
    fit: Fit,
    /// One entry per effect that applies, in the order of the candidates.
    proposals: Vec<Vec<Proposal>>,
}

impl Origin {
    /// Returns the greatest Lagrange score of an effect.
    fn lagrange(&self, name: &str) -> f64 {
        self.of(name).map_or(0.0, |p| p[0].lagrange)
    }

    fn of(&self, name: &str) -> Option<&Vec<Proposal>> {
        self.proposals.iter().find(|p| p[0].member.name() == name)
    }

    /// Returns the names by falling Lagrange score.
    fn names(&self) -> Vec<&'static str> {
        let mut all: Vec<&Vec<Proposal>> = self.proposals.iter().collect();
        all.sort_by(|a, b| b[0].lagrange.total_cmp(&a[0].lagrange));
        all.iter().map(|p| p[0].member.name()).collect()
    }
}

/// Takes over the better attempt of each effect; best score first.
fn keep_better(attempts: &mut Vec<Attempt>, others: Vec<Attempt>) {
    for other in others {
        match attempts.iter_mut().find(|a| a.name == other.name) {
            Some(own) if own.score < other.score => *own = other,
            Some(_) => {}
            None => attempts.push(other),
        }
    }
    attempts.sort_by(|a, b| b.score.total_cmp(&a.score));
}

/// Assigns the results of the attempts to the candidates; best score first.
fn rank(ranking: &mut [Candidate], attempts: &[Attempt]) {
    for attempt in attempts {
        if let Some(candidate) = ranking.iter_mut().find(|c| c.name == attempt.name) {
            (candidate.lambda, candidate.score) = (Some(attempt.lambda), Some(attempt.score));
            candidate.refused_because.clear();
        }
    }
    let score = |c: &Candidate| c.score.unwrap_or(f64::NEG_INFINITY);
    ranking.sort_by(|a, b| {
        score(b)
            .total_cmp(&score(a))
            .then(b.lagrange.total_cmp(&a.lagrange))
    });
}

/// True for an effect that is never named.
pub(super) fn is_outside(name: &str) -> bool {
    outside().iter().any(|e| e.card().name == name)
}

impl Search<'_> {
    /// Fits of the promising candidates on top of a fit, best score first; `instead` leaves that
    /// member's own effect out.
    pub(super) fn attempts(
        &mut self,
        fit: &Fit,
        instead: Option<&'static str>,
    ) -> (Vec<Attempt>, Vec<Candidate>) {
        let starts = self.starts(fit);
        let (found, mut ranking) = self.attempts_from(fit, starts, instead);
        let mut attempts = Vec::new();
        keep_better(&mut attempts, found);
        for _ in 0..MOST_RESTARTS {
            let Some(best) = attempts.first().filter(|a| self.is_strong_and_misses(a)) else {
                break;
            };
            let best_score = best.score;
            let start = self.beside(fit, &best.fit);
            let (others, _) = self.attempts_from(fit, vec![start], instead);
            keep_better(&mut attempts, others);
            if attempts[0].score <= best_score + DEEPER_CHI2 {
                break;
            }
        }
        rank(&mut ranking, &attempts);
        (attempts, ranking)
    }

    /// Returns whether an addition gains much and leaves more than noise: its fit may then be in a
    /// wrong minimum.
    fn is_strong_and_misses(&self, attempt: &Attempt) -> bool {
        let dof = self.problem.degrees_of_freedom(&attempt.fit);
        attempt.lambda > STRONG_LAGRANGE && excess_z(attempt.fit.chi2, dof) > MISFIT_Z
    }

    /// Returns the fit from the parameters that additions have reached, without the additions:
    /// there the branches of the base may have their true values, and only from there a better
    /// addition is found.
    pub(super) fn beside(&mut self, fit: &Fit, with: &Fit) -> Fit {
        let Fit {
            structure, x, axes, ..
        } = with.base_of(fit);
        self.problem.at(&structure, x, axes, &mut self.workspace)
    }

    /// Returns fits from these starts, and the candidates that have no result yet. The first of
    /// them decides how promising a candidate is.
    pub(super) fn attempts_from(
        &mut self,
        fit: &Fit,
        starts: Vec<Fit>,
        instead: Option<&'static str>,
    ) -> (Vec<Attempt>, Vec<Candidate>) {
        let origins: Vec<Origin> = starts
            .into_iter()
            .map(|f| self.origin(f, |name| instead != Some(name)))
            .collect();
        let names = origins[0].names();
        let best = names.first().map_or(0.0, |n| origins[0].lagrange(n));
        let elsewhere: Vec<&'static str> = origins.get(1).map_or_else(Vec::new, |o| {
            o.names().into_iter().take(ALWAYS_FITTED).collect()
        });
        let kept = |rank: usize, name: &'static str| {
            let lagrange = origins[0].lagrange(name);
            let near =
                lagrange > LEAST_LAGRANGE && (rank < MOST_FITTED || lagrange > NEAR_BEST * best);
            rank < ALWAYS_FITTED || near || elsewhere.contains(&name)
        };
        let (promising, others): (Vec<_>, Vec<_>) = names
            .iter()
            .copied()
            .enumerate()
            .partition(|(rank, name)| kept(*rank, name));
        let ranking = names
            .iter()
            .map(|name| Candidate {
                name,
                lagrange: origins[0].lagrange(name),
                lambda: None,
                score: None,
                refused_because: if others.iter().any(|(_, other)| other == name) {
                    "Lagrange score too low to fit it".to_owned()
                } else {
                    String::new()
                },
            })
            .collect();
        let promising = promising.into_iter().map(|(_, name)| name).collect();
        (self.attempt_all(fit, promising, &origins), ranking)
    }

    /// Fits of these candidates, on all cores.
    fn attempt_all(&self, fit: &Fit, names: Vec<&'static str>, origins: &[Origin]) -> Vec<Attempt> {
        let fitted = names.into_par_iter();
        fitted
            .filter_map(|name| self.aside().attempt(fit, name, origins))
            .collect()
    }

    /// Returns the fit, and if it misses the data also the model file's base with the same effects.
    fn starts(&mut self, fit: &Fit) -> Vec<Fit> {
        let mut starts = vec![fit.clone()];
        if excess_z(fit.chi2, self.problem.degrees_of_freedom(fit)) > MISFIT_Z {
            let mut x = self.problem.start();
            x.extend_from_slice(&fit.x[x.len()..]);
            starts.push(
                self.problem
                    .at(&fit.structure, x, fit.axes.clone(), &mut self.workspace),
            );
        }
        starts
    }

    /// Fits of the candidates with the best Lagrange scores among those that are wanted.
    pub(super) fn attempts_of(
        &mut self,
        fit: &Fit,
        most: usize,
        wanted: impl Fn(&'static str) -> bool,
    ) -> Vec<Attempt> {
        let origins = [self.origin(fit.clone(), wanted)];
        let mut names = origins[0].names();
        names.truncate(most);
        self.attempt_all(fit, names, &origins)
    }

    fn origin(&mut self, fit: Fit, wanted: impl Fn(&'static str) -> bool) -> Origin {
        let tangent = if self.guards.tangent_projection {
            fit.tangent()
        } else {
            Tangent::default()
        };
        let more: &[&'static dyn Effect] = if self.guards.outside { outside() } else { &[] };
        let predicted = self.problem.prediction(fit.at(), &mut self.workspace);
        let mut asked: Vec<&'static dyn Effect> =
            self.candidates.iter().chain(more).copied().collect();
        asked.retain(|effect| {
            let name = effect.card().name;
            wanted(name) && !fit.structure.members.iter().any(|m| m.name() == name)
        });
        let proposals = asked
            .into_par_iter()
            .map(|effect| {
                let mut workspace = Workspace::default();
                propose(
                    self.problem,
                    &fit,
                    &predicted,
                    &tangent,
                    effect,
                    &mut workspace,
                )
            })
            .filter(|of| !of.is_empty())
            .collect();
        Origin { fit, proposals }
    }

    /// Returns the best fit of one candidate. A choice that changes the meaning of a further
    /// parameter makes it another law, which is fitted separately.
    fn attempt(&mut self, fit: &Fit, name: &str, origins: &[Origin]) -> Option<Attempt> {
        self.progress
            .tell(&format!("fitting {}", title(name).unwrap_or(name)));
        let mut laws: Vec<usize> = origins[0]
            .of(name)?
            .iter()
            .map(|p| p.member.free())
            .collect();
        laws.sort_unstable();
        laws.dedup();
        let attempts: Vec<Attempt> = laws
            .into_iter()
            .filter_map(|free| self.attempt_law(fit, name, free, origins))
            .collect();
        let best = attempts
            .into_iter()
            .max_by(|a, b| a.score.total_cmp(&b.score))?;
        Some(self.widened(fit, best))
    }

    /// Returns the best fit of a candidate's law with `free` free parameters: from its most
    /// promising starts with the shapes held there, and from the best of them (the best two for a
    /// strong effect) with the shapes free. The gain from free shapes must justify their number.
    fn attempt_law(
        &mut self,
        fit: &Fit,
        name: &str,
        free: usize,
        origins: &[Origin],
    ) -> Option<Attempt> {
        let strong = origins[0].lagrange(name) > STRONG_LAGRANGE;
        let mut all: Vec<(Attempt, &Member)> = Vec::new();
        for (n, origin) in origins.iter().enumerate() {
            let of_law = origin
                .of(name)?
                .iter()
                .filter(|p| p.lagrange > 0.0 && p.member.free() == free);
            let most = match n {
                0 if strong => usize::MAX,
                0 => HELD_STARTS,
                _ => 1,
            };
            all.extend(
                of_law
                    .take(most)
                    .map(|p| (self.hold(fit, &origin.fit, p), &p.member)),
            );
        }
        all.retain(|(a, _)| a.score.is_finite());
        all.sort_by(|a, b| b.0.score.total_cmp(&a.0.score));
        let (held, member) = all.first()?.clone();
        if member.frozen().free() == member.free() {
            return Some(self.polished(held));
        }
        // A strong effect has minima between the starts' shapes: the best one is not always reached
        // from the best start.
        let other = all
            .iter()
            .find(|(_, m)| strong && m.start[1..] != member.start[1..]);
        let freed: Vec<Attempt> = [Some(&all[0]), other]
            .into_iter()
            .flatten()
            .map(|(held, member)| self.set_free(fit, held, member))
            .collect();
        let (is_guarded, branches) = (self.guards.bound, self.problem.branches());
        let at_bound = |a: &Attempt| {
            is_guarded
                && a.fit
                    .member_at_bound(a.fit.structure.members.len() - 1, branches)
        };
        let worth = |a: &Attempt| a.score - if at_bound(a) { SHAPE_DRIFT } else { 0.0 };
        let freed = freed.into_iter().filter(|a| a.score.is_finite());
        let Some(free) = freed.max_by(|a, b| worth(a).total_cmp(&worth(b))) else {
            return Some(self.polished(held));
        };
        let free = self.exchanged(fit.chi2, free);
        let bound = at_bound(&free);
        // Shapes that the data do not fix drift to a bound, and then carry no information.
        let drifted = bound && free.lambda < held.lambda + SHAPE_DRIFT;
        let distinct = held.score;
        Some(if drifted || held.score >= free.score {
            self.polished(held)
        } else {
            Attempt { distinct, ..free }
        })
    }

    /// Returns the fit with the shapes held. The linear test far overestimates an effect that grows
    /// faster than in proportion to its strength, as the depletion of an electrolyte does near its
    /// end, and the iteration can then return to zero: if a strong effect's fit does not reach the
    /// gain of the linear test, the test's own step and weaker starts are tried.
    fn hold(&mut self, fit: &Fit, from: &Fit, proposal: &Proposal) -> Attempt {
        let member = proposal.member.frozen();
        let mut best = self.try_member(fit.chi2, from, &member, true);
        if self.has_lost(from, &best, proposal)
            && let Some(found) = self.fit_from_step(from, &member)
        {
            let other = self.as_attempt(fit.chi2, &member, found);
            if other.score > best.score || best.score.is_nan() {
                best = other;
            }
        }
        for weaker in WEAKER_STARTS {
            if !self.has_lost(from, &best, proposal) {
                break;
            }
            let mut start = member.start.clone();
            start[0] *= weaker;
            let other = self.try_member(fit.chi2, from, &member.from(&start), true);
            if other.score > best.score || best.score.is_nan() {
                best = other;
            }
        }
        best
    }

    /// Returns whether the fit of a strong effect lacks the gain that its linear test promised for
    /// the fit that the attempt started from.
    fn has_lost(&self, from: &Fit, attempt: &Attempt, proposal: &Proposal) -> bool {
        let keeps = from.chi2 - attempt.fit.chi2 >= KEPT_PART * proposal.lagrange;
        proposal.lagrange > STRONG_LAGRANGE && !keeps
    }

    /// Completes the fit of an attempt that was ended early.
    fn polished(&mut self, attempt: Attempt) -> Attempt {
        let before = attempt.fit.chi2;
        let fit = self.problem.polished(attempt.fit, &mut self.workspace);
        let gained = before - fit.chi2;
        Attempt {
            score: attempt.score + gained,
            lambda: attempt.lambda + gained,
            fit,
            ..attempt
        }
    }

    /// Returns the fit with the shapes free, starting where the fit with held shapes ended.
    fn set_free(&mut self, fit: &Fit, held: &Attempt, member: &Member) -> Attempt {
        let strength = held
            .fit
            .decode(self.problem.branches())
            .1
            .pop()
            .and_then(|v| v.first().copied())
            .unwrap_or(member.start[0]);
        let mut start = member.start.clone();
        start[0] = strength;
        let from = held.fit.base_of(fit);
        let mut freed = self.try_member(fit.chi2, &from, &member.from(&start), false);
        freed.fit = self.with_identity(freed.fit);
        freed
    }

    /// Returns a fit with one effect more, from a fit's base; its λ counts from `before_chi2`.
    fn try_member(
        &mut self,
        before_chi2: f64,
        from: &Fit,
        member: &Member,
        is_rough: bool,
    ) -> Attempt {
        let found = self
            .problem
            .fit_added(from, member, is_rough, &mut self.workspace);
        self.as_attempt(before_chi2, member, found)
    }

    fn as_attempt(&self, before_chi2: f64, member: &Member, found: Fit) -> Attempt {
        let lambda = before_chi2 - found.chi2;
        let score = lambda - self.problem.penalty(member);
        Attempt {
            name: member.name(),
            score,
            lambda,
            distinct: score,
            fit: found,
        }
    }

    /// Returns the attempt with steps so fine that the integration error is negligible, or
    /// unchanged if it does not affect the result.
    pub(super) fn integrated(&mut self, before: &Fit, attempt: Attempt) -> Attempt {
        if attempt.score < LEAST_SCORE {
            return attempt;
        }
        let fit = self.with_fine_steps(attempt.fit);
        let lambda = before.chi2 - fit.chi2;
        Attempt {
            score: attempt.score + lambda - attempt.lambda,
            lambda,
            fit,
            ..attempt
        }
    }

    /// Returns the fit with its steps halved until the integration error is negligible.
    pub(super) fn with_fine_steps(&mut self, mut fit: Fit) -> Fit {
        while self.guards.integration
            && fit.structure.parts < MOST_PARTS
            && self.integration_error(&fit) > INTEGRATION_PART
        {
            let mut structure = fit.structure.clone();
            structure.parts *= 2;
            fit = self
                .problem
                .fit_from(&structure, fit.x, fit.axes, &mut self.workspace);
        }
        fit
    }
}
