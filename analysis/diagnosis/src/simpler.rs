//! One effect in the place of several names.
//!
//! Effects are added one by one, and the base follows. A branch of the base that has stood in for a
//! missing effect then goes back to its place, and a second name takes up what is left. From where
//! the base has ended, one effect alone may do what the names do together.

use super::attempts::{Attempt, is_outside};
use super::problem::Fit;
use super::search::Search;
use super::select::{SelectedEffect, Selection};

impl Search<'_> {
    /// Puts the best single effect into the place of several names where it gains as much after the
    /// price of their parameters; true where it did.
    pub(super) fn in_place_of_several(&mut self, selection: &mut Selection) -> bool {
        if selection.selected.len() < 2 {
            return false;
        }
        let Fit {
            structure, x, axes, ..
        } = selection.fit.base_of(&selection.base);
        let start = self.problem.at(&structure, x, axes, &mut self.workspace);
        let base = selection.base.clone();
        let (mut attempts, _) = self.attempts_from(&base, vec![start], None);
        attempts.sort_by(|a, b| b.score.total_cmp(&a.score));
        let members = &selection.fit.structure.members;
        let spent: f64 = members.iter().map(|m| self.problem.penalty(m)).sum();
        let gained = base.chi2 - selection.fit.chi2 - spent;
        let enough: Vec<Attempt> = attempts
            .into_iter()
            .filter(|a| a.score >= gained && !is_outside(a.name))
            .collect();
        for attempt in enough {
            let attempt = self.integrated(&base, attempt);
            if let Ok(evidence) = self.accept(&base, 0.0, &attempt, 0) {
                selection.selected = vec![SelectedEffect {
                    name: attempt.name,
                    evidence,
                    rivals: Vec::new(),
                    limit_of: Vec::new(),
                }];
                selection.fit = attempt.fit;
                return true;
            }
        }
        false
    }
}
