//! One effect in the place of several names.
//!
//! Effects are added one by one, and the base follows. A branch of the base that has stood in for a
//! missing effect then goes back to its place, and a second name takes up what is left. From where
//! the base has ended, one effect alone may do what the names do together.

use super::attempts::{Attempt, is_outside};
use super::search::Search;
use super::select::{SelectedEffect, Selection};

impl Search<'_> {
    /// Puts the best single effect into the place of several names where it gains as much after the
    /// price of their parameters; true where it did.
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
            if let Ok(evidence) = self.accept(&base, 0.0, &attempt, 0) {
                selection.selected = vec![SelectedEffect::new(attempt.name, evidence)];
                selection.fit = attempt.fit;
                return true;
            }
        }
        false
    }
}
