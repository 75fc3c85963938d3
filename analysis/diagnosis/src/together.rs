//! Two effects that come together in a cell, fitted jointly for predictions.
//!
//! Effects are added one by one, and the first is judged while the second is missing: held-out runs
//! contradict its size, and its parameters run to their bounds. So each effect of a natural group
//! is fitted with its partner. Names are still given one by one.

use super::problem::Fit;
use super::search::{Search, excess_z};
use super::select::Selection;
use crate::thresholds::{GOOD_FIT_Z, LEAST_SCORE};
use analysis_effects::effects::GROUPS;

/// A joint fit of base and two effects.
#[derive(Debug, Clone)]
pub(super) struct Joint {
    pub(super) fit: Fit,
    /// χ² that both remove from the base, after the price of their parameters.
    pub(super) score: f64,
}

impl Search<'_> {
    /// Returns pairs that gain more than the selection, best first; empty if the selection leaves
    /// only noise.
    pub(super) fn pairs(&mut self, selection: &Selection) -> Vec<Joint> {
        let dof = self.problem.degrees_of_freedom(&selection.fit);
        if excess_z(selection.fit.chi2, dof) < GOOD_FIT_Z {
            return Vec::new();
        }
        let least = self.gained(selection) + LEAST_SCORE;
        let mut pairs = Vec::new();
        for [first, second] in GROUPS {
            let Some(first) = selection.first_attempts.iter().find(|a| a.name == first) else {
                continue;
            };
            let joined = self.attempts_of(&first.fit, 1, |name| name == second);
            pairs.extend(joined.into_iter().map(|attempt| Joint {
                score: selection.base.chi2
                    - attempt.fit.chi2
                    - self.problem.spent(&selection.base, &attempt.fit),
                fit: attempt.fit,
            }));
        }
        pairs.retain(|pair| pair.score >= least);
        pairs.sort_by(|a, b| b.score.total_cmp(&a.score));
        pairs
    }
}

#[cfg(test)]
mod tests {
    use super::GROUPS;
    use analysis_effects::effects::find;

    #[test]
    fn groups_are_of_the_catalogue() {
        let names = GROUPS.as_flattened();
        assert!(names.iter().all(|name| find(name).is_some()), "{names:?}");
    }
}
