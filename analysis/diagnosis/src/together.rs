//! Two effects together that explain what neither explains alone.
//!
//! Effects are added one by one, and the first is judged while the second is missing: held-out runs
//! contradict its size, its parameters run to their bounds, another one does better. So pairs are
//! tried too. They come from the Lagrange scores of two directions at once, from the best partner of
//! each of the best single effects, and from what comes together in nature. All are fitted jointly.
//! They serve predictions only; names are given one by one.

use super::attempts::{Attempt, is_outside};
use super::problem::Fit;
use super::propose::direction;
use super::search::{Search, excess_z};
use super::select::Selection;
use super::structure::{Member, variants};
use super::whitening::dot;
use crate::thresholds::{
    GOOD_FIT_Z, LEAST_SCORE, PAIR_DISTINCT, PAIR_PARTNERS, PAIRS_FITTED, PARTNERS_TRIED,
    PROPOSAL_STEPS,
};
use analysis_effects::effects::GROUPS;

/// A variant of an effect, and its direction outside the tangent space of a fit.
struct Direction {
    member: Member,
    outside: Vec<f64>,
    /// Scalar product with the residuals.
    along: f64,
    /// Its own square.
    size: f64,
}

/// Two variants whose directions together take up much of what is left.
struct Pair {
    members: [Member; 2],
    /// χ² that small steps of both would remove, after the price of their parameters.
    score: f64,
}

/// A joint fit of base and two effects.
#[derive(Debug, Clone)]
pub(super) struct Joint {
    pub(super) fit: Fit,
    /// χ² that both remove from the base, after the price of their parameters.
    pub(super) score: f64,
}

impl Search<'_> {
    /// Pairs that gain more than what was selected, best first; none where that leaves noise only.
    pub(super) fn pairs(&mut self, selection: &Selection) -> Vec<Joint> {
        let dof = self.problem.degrees_of_freedom(&selection.fit);
        if excess_z(selection.fit.chi2, dof) < GOOD_FIT_Z {
            return Vec::new();
        }
        let mut joint = self.pairs_by_score(&selection.base);
        joint.extend(self.partners(selection));
        joint.sort_by(|a, b| b.score.total_cmp(&a.score));
        let gained = self.gained(selection);
        joint.retain(|j| j.score >= gained + LEAST_SCORE);
        joint
    }

    /// Joint fits of the pairs whose directions at the base take up most.
    fn pairs_by_score(&mut self, base: &Fit) -> Vec<Joint> {
        let directions = self.directions(base);
        let mut best: Vec<Pair> = Vec::new();
        for (k, a) in directions.iter().enumerate() {
            for b in &directions[k + 1..] {
                let Some(pair) = self.pair(a, b) else {
                    continue;
                };
                let same = |other: &Pair| {
                    (0..2).all(|n| other.members[n].name() == pair.members[n].name())
                };
                match best.iter_mut().find(|other| same(other)) {
                    Some(other) if other.score < pair.score => *other = pair,
                    Some(_) => {}
                    None => best.push(pair),
                }
            }
        }
        best.sort_by(|a, b| b.score.total_cmp(&a.score));
        best.truncate(PAIRS_FITTED);
        best.into_iter()
            .map(|pair| self.fit_pair(base, &pair.members))
            .collect()
    }

    fn directions(&mut self, base: &Fit) -> Vec<Direction> {
        let problem = self.problem;
        let tangent = base.tangent();
        let predicted = problem.prediction(base.at(), &mut self.workspace);
        let mut all = Vec::new();
        for effect in self.candidates {
            for member in variants(*effect, &problem.base) {
                let structure = base.structure.with(member.clone());
                let Some(mut outside) = direction(
                    problem,
                    base,
                    &predicted,
                    &structure,
                    PROPOSAL_STEPS[0],
                    &mut self.workspace,
                ) else {
                    continue;
                };
                tangent.project(&mut outside);
                let size = dot(&outside, &outside);
                if size > 1e-20 {
                    all.push(Direction {
                        member,
                        along: dot(&base.residuals, &outside),
                        outside,
                        size,
                    });
                }
            }
        }
        all
    }

    /// Both directions at once; none where one of them does not help, or where a strength would lie
    /// outside its range.
    fn pair(&self, a: &Direction, b: &Direction) -> Option<Pair> {
        if a.member.name() == b.member.name() {
            return None;
        }
        let strengths = both(a, b)?;
        let removed = strengths[0] * a.along + strengths[1] * b.along;
        let alone = (a.along * a.along / a.size).max(b.along * b.along / b.size);
        let mut members = [a.member.clone(), b.member.clone()];
        for (member, strength) in members.iter_mut().zip(strengths) {
            let parameter = &member.parameters[0];
            let (range, value) = (parameter.range, strength * parameter.typical);
            if value < range.lower || (value > range.upper && range.upper <= 0.0) {
                return None;
            }
            member.start[0] = value.min(range.upper);
        }
        let price: f64 = members.iter().map(|m| self.problem.penalty(m)).sum();
        (removed > alone + LEAST_SCORE).then_some(Pair {
            score: removed - price,
            members,
        })
    }

    /// Base and two effects: with their shapes held first, then free.
    fn fit_pair(&mut self, base: &Fit, members: &[Member; 2]) -> Joint {
        let (erm, _) = base.decode(self.problem.branches());
        let held = members.iter().fold(base.structure.clone(), |structure, m| {
            structure.with(m.frozen())
        });
        let held = self.problem.fit(&held, &erm, &mut self.workspace);
        let held = self.joint(base, held);
        let (erm, values) = held.fit.decode(self.problem.branches());
        let mut structure = base.structure.clone();
        for (member, value) in members.iter().zip(&values) {
            let mut start = member.start.clone();
            start[0] = value[0];
            structure = structure.with(member.from(&start));
        }
        let free = self.problem.fit(&structure, &erm, &mut self.workspace);
        let free = self.joint(base, free);
        if free.score > held.score { free } else { held }
    }

    /// Joint fits of what comes together in nature, and of each of the best single effects with its
    /// best partners.
    fn partners(&mut self, selection: &Selection) -> Vec<Joint> {
        let base = selection.base.clone();
        let firsts: Vec<Attempt> = selection
            .first_attempts
            .iter()
            .filter(|a| !is_outside(a.name))
            .take(PAIR_PARTNERS)
            .cloned()
            .collect();
        let mut all = Vec::new();
        for [first, second] in GROUPS {
            let Some(first) = selection.first_attempts.iter().find(|a| a.name == first) else {
                continue;
            };
            let seconds = self.attempts_of(&first.fit, 1, |name| name == second);
            all.extend(seconds.into_iter().map(|a| self.joint(&base, a.fit)));
        }
        for first in firsts {
            let seconds = self.attempts_of(&first.fit, PARTNERS_TRIED, |name| !is_outside(name));
            all.extend(seconds.into_iter().map(|a| self.joint(&base, a.fit)));
        }
        all
    }

    fn joint(&self, base: &Fit, fit: Fit) -> Joint {
        Joint {
            score: base.chi2 - fit.chi2 - self.problem.spent(&fit),
            fit,
        }
    }
}

/// Strengths of two directions that together leave least; none where they are hardly distinct.
fn both(a: &Direction, b: &Direction) -> Option<[f64; 2]> {
    let between = dot(&a.outside, &b.outside);
    let determinant = a.size * b.size - between * between;
    (determinant >= PAIR_DISTINCT * a.size * b.size).then(|| {
        [
            (b.size * a.along - between * b.along) / determinant,
            (a.size * b.along - between * a.along) / determinant,
        ]
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use analysis_effects::effects::{GROUPS, find};

    fn direction(outside: &[f64], residuals: &[f64]) -> Direction {
        let effect = find("rc_slow").unwrap();
        Direction {
            member: Member {
                effect,
                parameters: Vec::new(),
                choice: Vec::new(),
                start: Vec::new(),
            },
            outside: outside.to_vec(),
            along: dot(outside, residuals),
            size: dot(outside, outside),
        }
    }

    #[test]
    fn two_directions_find_what_they_made() {
        let (a, b) = ([1.0, 2.0, 0.0, 1.0], [1.0, 1.0, 1.0, 0.0]);
        let made: Vec<f64> = a.iter().zip(&b).map(|(a, b)| 0.7 * a - 1.3 * b).collect();
        let [first, second] = both(&direction(&a, &made), &direction(&b, &made)).unwrap();
        assert!((first - 0.7).abs() < 1e-12 && (second + 1.3).abs() < 1e-12);
        assert!(both(&direction(&a, &made), &direction(&a, &made)).is_none());
    }

    #[test]
    fn groups_are_of_the_catalogue() {
        assert!(
            GROUPS
                .as_flattened()
                .iter()
                .all(|name| find(name).is_some())
        );
    }
}
