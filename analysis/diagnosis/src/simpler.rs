//! One effect in place of several names.
//!
//! Effects are added one by one, and the base adapts. A branch of the base that represented a
//! missing effect then returns to its position, and a second name takes up the remainder. From the
//! final base, one effect alone may replace all names together.

use super::attempts::{Attempt, is_outside};
use super::search::Search;
use super::select::{SelectedEffect, Selection};

impl Search<'_> {
    /// Replaces several names by the best single effect if it gains as much after the price of
    /// their parameters; returns true if it did.
    pub(super) fn in_place_of_several(&mut self, selection: &mut Selection) -> bool {
        if selection.selected.len() < 2 {
            return false;
        }
        let base = selection.base.clone();
        let start = self.beside(&base, &selection.fit);
        let (mut attempts, _) = self.attempts_from(&base, vec![start], None);
        attempts.sort_by(|a, b| b.score.total_cmp(&a.score));
        let gained = self.gained(selection);
        let enough: Vec<Attempt> = attempts
            .into_iter()
            .filter(|a| a.score >= gained && !is_outside(a.name))
            .collect();
        for attempt in enough {
            let attempt = self.integrated(&base, attempt);
            if let Ok(evidence) = self.accept(&base, 0.0, &attempt, selection.member(0)) {
                selection.selected = vec![SelectedEffect::new(attempt.name, evidence)];
                selection.fit = attempt.fit;
                return true;
            }
        }
        false
    }
}
