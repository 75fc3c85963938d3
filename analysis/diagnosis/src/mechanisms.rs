//! Verdict on mechanisms where no single formula of the catalogue explains the data.

use super::outcome::{Diagnosis, Share, Verdict};
use crate::thresholds::MOSTLY_SHARE;

/// Changes an unexplained verdict to [`Verdict::Mostly`] if mechanisms remove most of the gap on
/// held-out runs and nothing else can replace the largest; returns whether it did. The reason of the
/// former verdict stays as a note.
pub(super) fn judge_mechanisms(d: &mut Diagnosis) -> bool {
    let large = d.large_shares();
    let of = |share: &&Share| share.held_out;
    let named: f64 = large.iter().map(of).sum();
    // A mechanism that makes the gap larger takes back what another one removes.
    let together: f64 = d.shares.iter().map(|share| share.held_out).sum();
    let is_distinct = large.first().is_some_and(|share| share.partners.is_empty());
    if d.verdict != Verdict::Unexplained || !is_distinct || named.min(together) < MOSTLY_SHARE {
        return false;
    }
    let parts: Vec<String> = large.iter().map(|share| share.in_words()).collect();
    let left_mv = large.first().map_or(0.0, |share| share.with_mv);
    let formulas: usize = d.shares.iter().map(|share| share.effects.len()).sum();
    let (subject, verb) = if formulas == 1 {
        ("One formula", "predicts")
    } else {
        ("Several formulas together", "predict")
    };
    let summary = format!(
        "Mostly {}. {subject} of the catalogue {verb} the held-out runs to {left_mv:.2} mV; the form \
        of none is certain.",
        parts.join(", with ")
    );
    let before = std::mem::replace(&mut d.summary, summary);
    d.notes
        .push(format!("without the mechanisms the verdict was: {before}"));
    d.verdict = Verdict::Mostly;
    // A formula that leaves more than its mechanism does is not the name.
    d.effects.clear();
    d.rivals.clear();
    true
}
