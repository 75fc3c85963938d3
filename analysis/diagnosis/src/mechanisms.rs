//! Verdict on mechanisms where no single formula of the catalogue explains the data.

use super::outcome::{Diagnosis, Verdict};
use crate::thresholds::MOSTLY_SHARE;

/// Changes an unexplained verdict to [`Verdict::Mostly`] if mechanisms remove most of the gap on
/// held-out runs and nothing else can replace the largest; returns whether it did.
pub(super) fn judge_mechanisms(d: &mut Diagnosis) -> bool {
    let large = d.large_shares();
    let explained: f64 = large.iter().map(|share| share.held_out).sum();
    let is_distinct = large.first().is_some_and(|share| share.partners.is_empty());
    if d.verdict != Verdict::Unexplained || !is_distinct || explained < MOSTLY_SHARE {
        return false;
    }
    let parts: Vec<String> = large.iter().map(|share| share.in_words()).collect();
    let left_mv = large.first().map_or(0.0, |share| share.with_mv);
    d.summary = format!(
        "Mostly {}. Formulas of the catalogue together predict the held-out runs to {left_mv:.2} mV; \
        no single one does.",
        parts.join(", with ")
    );
    d.verdict = Verdict::Mostly;
    if !d.effects.is_empty() {
        let titles: Vec<&str> = d.effects.iter().map(|effect| effect.title).collect();
        d.notes
            .push(format!("{} passes every test alone", titles.join(", ")));
    }
    // A formula that leaves more than its mechanism does is not the name.
    d.effects.clear();
    d.rivals.clear();
    true
}
