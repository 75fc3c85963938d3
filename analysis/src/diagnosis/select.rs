//! Adds effects one by one, each only if everything speaks for it, and takes back what later ones make needless.

use super::block::Desk;
use super::data::Role;
use super::guards::{
    ALWAYS_FITTED, GOOD_FIT_Z, Guards, HELD_OUT_PART, HELD_OUT_SHARE, HELD_OUT_SUM, HELD_OUT_Z, INTEGRATION_PART, LEAST_LAGRANGE,
    LEAST_LAMBDA, LEAST_SCORE, MATERIAL_SHARE, MOST_EFFECTS, MOST_FITTED, MOST_PARTS, NAMING_LEAD, NEAR_BEST,
};
use super::outcome::{Candidate, Evidence};
use super::problem::{Fit, Problem, Tangent};
use super::propose::{Proposal, propose};
use super::structure::Member;
use super::whitening::dot;
use crate::effects::Effect;

/// Refused additions that are kept.
const MOST_REFUSED: usize = 3;
/// χ² that a shape at its bound must gain over a held one to be believed.
const DRIFT: f64 = 12.0;

/// Effects that contain another one as a special case, with that one.
const GENERALISES: [(&str, &str); 2] = [("butler_volmer_asymmetric", "butler_volmer"), ("inductance_lossy", "inductance")];

/// A fitted addition.
#[derive(Debug, Clone)]
pub(super) struct Attempt {
    pub(super) name: &'static str,
    pub(super) fit: Fit,
    pub(super) lambda: f64,
    pub(super) score: f64,
}

/// An effect that was taken.
#[derive(Debug, Clone)]
pub(super) struct Taken {
    pub(super) name: &'static str,
    pub(super) evidence: Evidence,
    pub(super) rivals: Vec<RivalFit>,
}

/// What would do as well in the place of an effect that was taken.
#[derive(Debug, Clone)]
pub(super) struct RivalFit {
    pub(super) name: &'static str,
    pub(super) score_gap: f64,
    pub(super) discriminability: f64,
    pub(super) fit: Fit,
}

/// How the search ended.
#[derive(Debug, Clone)]
pub(super) struct Selection {
    pub(super) fit: Fit,
    pub(super) taken: Vec<Taken>,
    /// Candidates of the first round.
    pub(super) ranking: Vec<Candidate>,
    /// The best addition that was refused in the last round, with the reason.
    pub(super) refused: Option<(&'static str, f64, String)>,
    /// The best that were refused in the last round.
    pub(super) refused_fits: Vec<Attempt>,
}

impl Selection {
    /// Nothing was looked for.
    pub(super) fn nothing(base: &Fit) -> Self {
        Self { fit: base.clone(), taken: Vec::new(), ranking: Vec::new(), refused: None, refused_fits: Vec::new() }
    }
}

/// What a search works with.
pub(super) struct Search<'a> {
    pub(super) problem: &'a Problem,
    pub(super) candidates: &'a [&'static dyn Effect],
    pub(super) guards: Guards,
    pub(super) desk: Desk,
}

/// (χ² − dof)/√(2·dof).
pub(super) fn excess_z(chi2: f64, dof: f64) -> f64 {
    (chi2 - dof) / (2.0 * dof).sqrt()
}

impl Search<'_> {
    /// Adds and prunes, from the base's fit.
    pub(super) fn run(&mut self, base: &Fit) -> Selection {
        let mut selection = Selection::nothing(base);
        while selection.taken.len() < MOST_EFFECTS {
            let (attempts, mut ranking) = self.attempts(&selection.fit, None);
            let first = selection.taken.is_empty();
            selection.refused = None;
            selection.refused_fits.clear();
            let mut accepted = None;
            for attempt in attempts {
                let attempt = self.integrated(&selection.fit, attempt);
                match self.accept(&selection.fit, &attempt) {
                    Ok(evidence) => {
                        accepted = Some((attempt, evidence));
                        break;
                    }
                    Err(reason) => {
                        if attempt.score >= LEAST_SCORE && selection.refused.is_none() {
                            selection.refused = Some((attempt.name, attempt.score, reason.clone()));
                        }
                        note(&mut ranking, attempt.name, reason);
                        if attempt.score >= LEAST_SCORE && selection.refused_fits.len() < MOST_REFUSED {
                            selection.refused_fits.push(attempt);
                        }
                    }
                }
            }
            if first {
                if let Some((taken, _)) = &accepted {
                    let rest = ranking.iter_mut().filter(|c| c.name != taken.name && c.refused_because.is_empty());
                    rest.for_each(|c| c.refused_because = "another explains more".to_owned());
                }
                selection.ranking = ranking;
            }
            let Some((attempt, evidence)) = accepted else { break };
            // What fits clearly better but may not be named leaves nothing to be named with confidence.
            if selection.refused.as_ref().is_some_and(|r| r.1 > attempt.score + NAMING_LEAD) {
                break;
            }
            selection.refused = None;
            selection.fit = attempt.fit;
            selection.taken.push(Taken { name: attempt.name, evidence, rivals: Vec::new() });
        }
        self.prune(base, &mut selection);
        self.find_rivals(&mut selection);
        self.free_shapes(&mut selection);
        selection
    }

    /// Fits of the promising candidates on top of a fit, best score first; `instead` leaves that member's own effect out.
    fn attempts(&mut self, fit: &Fit, instead: Option<&'static str>) -> (Vec<Attempt>, Vec<Candidate>) {
        let tangent = if self.guards.tangent_projection { fit.tangent() } else { Tangent::default() };
        let mut proposals: Vec<Vec<Proposal>> = Vec::new();
        for effect in self.candidates {
            let name = effect.card().name;
            if instead == Some(name) || fit.structure.members.iter().any(|m| m.name() == name) {
                continue;
            }
            let of = propose(self.problem, fit, &tangent, *effect, &mut self.desk);
            if !of.is_empty() {
                proposals.push(of);
            }
        }
        proposals.sort_by(|a, b| b[0].lagrange.total_cmp(&a[0].lagrange));
        let best = proposals.first().map_or(0.0, |p| p[0].lagrange);
        let mut attempts = Vec::new();
        let mut ranking = Vec::new();
        for (rank, of) in proposals.iter().enumerate() {
            let lagrange = of[0].lagrange;
            let keep = rank < ALWAYS_FITTED || (lagrange > LEAST_LAGRANGE && (rank < MOST_FITTED || lagrange > NEAR_BEST * best));
            let attempt = (keep && lagrange > 0.0).then(|| self.attempt(fit, of));
            ranking.push(Candidate {
                name: of[0].member.name(),
                lagrange,
                lambda: attempt.as_ref().map(|a| a.lambda),
                score: attempt.as_ref().map(|a| a.score),
                refused_because: if keep { String::new() } else { "Lagrange score too low to fit it".to_owned() },
            });
            attempts.extend(attempt);
        }
        attempts.sort_by(|a, b| b.score.total_cmp(&a.score));
        ranking.sort_by(|a, b| {
            b.score.unwrap_or(f64::NEG_INFINITY).total_cmp(&a.score.unwrap_or(f64::NEG_INFINITY)).then(b.lagrange.total_cmp(&a.lagrange))
        });
        (attempts, ranking)
    }

    /// The best fit of one candidate: over its two most promising starts with the shapes held there, and from the better one with the shapes free.
    /// What the shapes gain must be worth their number.
    fn attempt(&mut self, fit: &Fit, proposals: &[Proposal]) -> Attempt {
        let held: Vec<Attempt> = proposals.iter().take(2).map(|p| self.try_member(fit, &p.member.frozen())).collect();
        let best = usize::from(held.len() > 1 && held[1].score > held[0].score);
        let (member, held) = (&proposals[best].member, held[best].clone());
        if member.frozen().free() == member.free() {
            return held;
        }
        let strength = held.fit.decode(self.problem.branches()).1.pop().and_then(|v| v.first().copied()).unwrap_or(member.start[0]);
        let mut start = member.start.clone();
        start[0] = strength;
        let free = self.try_member(&held.fit.base_of(fit), &member.from(&start));
        let free = Attempt {
            lambda: fit.chi2 - free.fit.chi2,
            score: fit.chi2 - free.fit.chi2 - self.penalty(member.free(), member.choices()),
            ..free
        };
        let bound = self.guards.bound && free.fit.member_at_bound(free.fit.structure.members.len() - 1, self.problem.branches());
        // Shapes that the data do not fix drift to a bound: they say nothing then.
        let drifted = bound && free.lambda < held.lambda + DRIFT;
        if drifted || held.score >= free.score { held } else { free }
    }

    fn try_member(&mut self, fit: &Fit, member: &Member) -> Attempt {
        let found = self.problem.fit_added(fit, member, &mut self.desk);
        let lambda = fit.chi2 - found.chi2;
        Attempt { name: member.name(), score: lambda - self.penalty(member.free(), member.choices()), lambda, fit: found }
    }

    /// What parameters and choices cost: k·ln N, and twice the logarithm of the number of choices.
    fn penalty(&self, free: usize, choices: usize) -> f64 {
        free as f64 * (self.problem.training_rows() as f64).ln() + 2.0 * (choices as f64).ln()
    }

    /// The attempt with steps so fine that integration is no question; as it is where it has no say anyway.
    fn integrated(&mut self, before: &Fit, mut attempt: Attempt) -> Attempt {
        while self.guards.integration
            && attempt.score >= LEAST_SCORE
            && attempt.fit.structure.parts < MOST_PARTS
            && self.integration_error(&attempt.fit) > INTEGRATION_PART
        {
            let mut structure = attempt.fit.structure.clone();
            structure.parts *= 2;
            let fit = self.problem.fit_from(&structure, attempt.fit.x, attempt.fit.axes, &mut self.desk);
            let lambda = before.chi2 - fit.chi2;
            attempt = Attempt { score: attempt.score + lambda - attempt.lambda, lambda, fit, ..attempt };
        }
        attempt
    }

    /// Everything that must speak for an addition; the reason where something does not.
    fn accept(&mut self, before: &Fit, attempt: &Attempt) -> Result<Evidence, String> {
        let dof = self.problem.degrees_of_freedom(before);
        let (excess, left) = (before.chi2 - dof, excess_z(attempt.fit.chi2, self.problem.degrees_of_freedom(&attempt.fit)));
        let share = if excess > 0.0 { (attempt.lambda / excess).min(1.0) } else { 1.0 };
        if attempt.score < LEAST_SCORE {
            return Err(format!("penalised gain {:.1}: expected at least {LEAST_SCORE}", attempt.score));
        }
        if self.guards.material_share && share < MATERIAL_SHARE && left >= GOOD_FIT_Z {
            return Err(format!("removes {:.0} % of the excess: expected at least {:.0} %", 100.0 * share, 100.0 * MATERIAL_SHARE));
        }
        let member = attempt.fit.structure.members.len() - 1;
        if self.guards.bound && attempt.fit.member_at_bound(member, self.problem.branches()) {
            return Err("a parameter lies at its bound".to_owned());
        }
        if attempt.lambda < LEAST_LAMBDA {
            return Err("its interval does not leave zero out".to_owned());
        }
        let held_out_change = self.held_out(before, &attempt.fit)?;
        let integration_error = self.integration_error(&attempt.fit);
        if self.guards.integration && integration_error > INTEGRATION_PART {
            return Err(format!("integration is wrong by {integration_error:.2} of the floor: expected at most {INTEGRATION_PART}"));
        }
        Ok(Evidence { lambda: attempt.lambda, score: attempt.score, share_of_excess: share, held_out_change, integration_error })
    }

    /// Change of the held-out χ²; an error where one run becomes worse.
    fn held_out(&mut self, before: &Fit, after: &Fit) -> Result<f64, String> {
        let mut change = 0.0;
        for k in self.problem.of_role(Role::HeldOut) {
            let old = self.problem.block_chi2((&before.structure, &before.x), k, &mut self.desk);
            let new = self.problem.block_chi2((&after.structure, &after.x), k, &mut self.desk);
            if self.guards.held_out && new > old * (1.0 + HELD_OUT_PART) + HELD_OUT_SUM {
                return Err(format!("held-out run {} becomes worse: χ² from {old:.0} to {new:.0}", self.problem.blocks[k].name));
            }
            change += new - old;
        }
        let z = self.contradiction(before, after);
        if self.guards.held_out && z.abs() > HELD_OUT_Z {
            return Err(format!("held-out runs contradict the size of what it predicts for them by {z:.1} standard deviations"));
        }
        Ok(change)
    }

    /// What the held-out runs still say along the change that the addition makes to their prediction, in standard deviations of noise and parameters:
    /// u·r/√(1 + uᵀJΣJᵀu) with u the direction of the change. A true effect leaves nothing there but noise.
    fn contradiction(&mut self, before: &Fit, after: &Fit) -> f64 {
        let problem = self.problem;
        let old = problem.whitened_of(Role::HeldOut, (&before.structure, &before.x), &mut self.desk);
        let new = problem.whitened_of(Role::HeldOut, (&after.structure, &after.x), &mut self.desk);
        let mut u: Vec<f64> = new.iter().zip(&old).map(|(n, o)| n - o).collect();
        let size = dot(&u, &u).sqrt();
        let n = after.x.len();
        let (Some(covariance), true) = (after.covariance(), size > 1e-6) else { return 0.0 };
        u.iter_mut().for_each(|u| *u /= size);
        let (left, columns) = problem.held_out(after, &mut self.desk);
        let along: Vec<f64> = columns.iter().map(|c| dot(&u, c)).collect();
        let spread: f64 = (0..n * n).map(|ij| along[ij / n] * along[ij % n] * covariance[ij]).sum();
        let along = dot(&u, &left);
        let beyond = (along.abs() - HELD_OUT_SHARE * size).max(0.0).copysign(along);
        beyond / (1.0 + spread.max(0.0)).sqrt()
    }

    /// Largest change of any row by halving all steps, as a part of its noise.
    fn integration_error(&mut self, fit: &Fit) -> f64 {
        let at = (&fit.structure, fit.x.as_slice());
        let mut worst: f64 = 0.0;
        for k in 0..self.problem.blocks.len() {
            let once = self.problem.predict(at, k, 1, &mut self.desk);
            let halves = self.problem.predict(at, k, 2, &mut self.desk);
            let floor = &self.problem.floors[k];
            worst = once.iter().zip(&halves).zip(floor).fold(worst, |w, ((a, b), f)| w.max((a - b).abs() / f));
        }
        worst
    }

    /// Takes back effects that later ones have made needless.
    fn prune(&mut self, base: &Fit, selection: &mut Selection) {
        let mut k = 0;
        while selection.taken.len() > 1 && k < selection.taken.len() {
            let without = self.refit_without(base, &selection.fit, k);
            let member = &selection.fit.structure.members[k];
            let cost = without.chi2 - selection.fit.chi2 - self.penalty(member.free(), member.choices());
            if cost < 0.0 {
                selection.fit = without;
                selection.taken.remove(k);
            } else {
                k += 1;
            }
        }
    }

    /// The fit with one member less, from the better of two starts: where it stands, and the base.
    fn refit_without(&mut self, base: &Fit, fit: &Fit, member: usize) -> Fit {
        let branches = self.problem.branches();
        let structure = fit.structure.without(member);
        let axes = structure.axes(&self.problem.base.erm);
        let first = fit.structure.first(member, branches);
        let mut x = fit.x.clone();
        x.drain(first..first + fit.structure.members[member].free());
        let mut y = base.x[..1 + 2 * branches].to_vec();
        y.extend_from_slice(&x[1 + 2 * branches..]);
        let stay = self.problem.fit_from(&structure, x, axes.clone(), &mut self.desk);
        let fresh = self.problem.fit_from(&structure, y, axes, &mut self.desk);
        if stay.chi2 <= fresh.chi2 { stay } else { fresh }
    }

    /// Lets shapes go that were held while effects were chosen, so that intervals know of them; as they are where that drives one to a bound.
    fn free_shapes(&mut self, selection: &mut Selection) {
        let branches = self.problem.branches();
        for k in 0..selection.taken.len() {
            let (erm, values) = selection.fit.decode(branches);
            let mut structure = selection.fit.structure.clone();
            for (member, value) in structure.members.iter_mut().zip(&values) {
                member.start.clone_from(value);
            }
            let own = structure.members[k].effect.parameters(&self.problem.base);
            if structure.members[k].parameters == own {
                continue;
            }
            structure.members[k].parameters = own;
            let free = self.problem.fit(&structure, &erm, &mut self.desk);
            if !free.member_at_bound(k, branches) && free.chi2 <= selection.fit.chi2 + 1.0 {
                selection.fit = free;
            }
        }
    }

    /// For every effect taken, those that would do as well in its place.
    fn find_rivals(&mut self, selection: &mut Selection) {
        let names: Vec<&'static str> = selection.taken.iter().map(|t| t.name).collect();
        let start = selection.fit.clone();
        for (k, name) in names.iter().enumerate() {
            let without = self.refit_without(&start, &selection.fit, k);
            // What came later may have taken a share of it.
            selection.taken[k].evidence.lambda = without.chi2 - selection.fit.chi2;
            let member = &selection.fit.structure.members[k];
            let (attempts, _) = self.attempts(&without, Some(name));
            let own = without.chi2 - selection.fit.chi2 - self.penalty(member.free(), member.choices());
            for other in attempts {
                let gap = other.score - own;
                // What contains the named effect as a special case fits as well by necessity: it has to be better than that.
                let least = if GENERALISES.contains(&(other.name, *name)) { 0.0 } else { -NAMING_LEAD };
                if gap < least || names.contains(&other.name) {
                    continue;
                }
                let index = other.fit.structure.members.len() - 1;
                if self.guards.bound && other.fit.member_at_bound(index, self.problem.branches()) {
                    continue;
                }
                let distinct = self.discriminability(&selection.fit, &without, &other.fit);
                selection.taken[k].rivals.push(RivalFit { name: other.name, score_gap: gap, discriminability: distinct, fit: other.fit });
            }
        }
    }

    /// r: part of what the named effect adds that the other cannot imitate, to first order around its fit.
    fn discriminability(&self, named: &Fit, without: &Fit, other: &Fit) -> f64 {
        let difference = |a: &Fit, b: &Fit| b.residuals.iter().zip(&a.residuals).map(|(b, a)| b - a).collect::<Vec<f64>>();
        let mut apart = difference(named, other);
        other.tangent().project(&mut apart);
        let whole = difference(named, without);
        (dot(&apart, &apart) / dot(&whole, &whole).max(1e-12)).min(1.0)
    }
}

fn note(ranking: &mut [Candidate], name: &str, reason: String) {
    if let Some(c) = ranking.iter_mut().find(|c| c.name == name) {
        c.refused_because = reason;
    }
}
