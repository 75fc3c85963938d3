//! Scores of many trials in tables.

use std::{collections::BTreeMap, fmt::Write as _};

use super::trial::{End, Recommended, Score};
use analysis::diagnosis::Verdict;

/// Limits of the classes of λ.
const CLASSES: [f64; 7] = [0.0, 10.0, 20.0, 40.0, 100.0, 1000.0, f64::INFINITY];
/// All ends in the order of columns.
const ENDS: [(End, &str); 9] = [
    (End::None, "none"),
    (End::Right, "right"),
    (End::Twin, "twin"),
    (End::Part, "part"),
    (End::Extra, "extra"),
    (End::Unexplained, "unexpl."),
    (End::Invalid, "invalid"),
    (End::Misled, "misled"),
    (End::Wrong, "WRONG"),
];

/// The tables as text.
pub fn tables(scores: &[Score]) -> String {
    let mut out = String::new();
    let mut strata: BTreeMap<&str, Vec<&Score>> = BTreeMap::new();
    for s in scores {
        strata.entry(s.stratum).or_default().push(s);
    }
    for (stratum, scores) in &strata {
        let _ = writeln!(out, "\n{stratum} ({} trials)", scores.len());
        let _ = writeln!(out, "{:<22}{}", "λ", ENDS.map(|(_, name)| format!("{name:>9}")).concat());
        for class in CLASSES.windows(2) {
            let of: Vec<&&Score> = scores.iter().filter(|s| s.lambda.is_some_and(|l| l >= class[0] && l < class[1])).collect();
            if !of.is_empty() {
                let _ = writeln!(out, "{:<22}{}", format!("{} … {}", class[0], class[1]), columns(of.iter().map(|s| s.end)));
            }
        }
        let without: Vec<&&Score> = scores.iter().filter(|s| s.lambda.is_none()).collect();
        if !without.is_empty() {
            let _ = writeln!(out, "{:<22}{}", "–", columns(without.iter().map(|s| s.end)));
        }
        let mut kinds: BTreeMap<String, Vec<&Score>> = BTreeMap::new();
        for s in scores.iter().filter(|s| s.lambda.is_none_or(|l| l >= 40.0)) {
            kinds.entry(s.hidden.join(" + ")).or_default().push(s);
        }
        if kinds.len() > 1 && kinds.len() < 60 {
            let _ = writeln!(out, "by what was hidden, λ ≥ 40:");
            for (kind, of) in kinds {
                let _ = writeln!(out, "  {kind:<26}{}", columns(of.iter().map(|s| s.end)));
            }
        }
    }
    let mut closed: Vec<f64> = scores.iter().filter(|s| s.lambda.is_some_and(|l| l >= 100.0)).filter_map(|s| s.closed).collect();
    closed.sort_by(f64::total_cmp);
    if !closed.is_empty() {
        let at = |q: f64| 100.0 * closed[((closed.len() - 1) as f64 * q) as usize];
        let _ = writeln!(
            out,
            "\noracle's held-out gap closed at λ ≥ 100 ({} trials): median {:.1} %, worst twentieth {:.1} %",
            closed.len(),
            at(0.5),
            at(0.05)
        );
    }
    out.push_str(&settled(scores));
    out
}

/// How many of the ambiguous cases the recommended run settles, by the run.
fn settled(scores: &[Score]) -> String {
    let ambiguous =
        scores.iter().filter(|s| matches!(s.end, End::Twin | End::Part | End::Misled) && s.verdict == Verdict::Ambiguous).count();
    let asked: Vec<&Recommended> = scores.iter().filter_map(|s| s.recommended.as_ref()).collect();
    if ambiguous == 0 {
        return String::new();
    }
    let right = |of: &[&Recommended]| of.iter().filter(|r| r.settled == End::Right).count();
    let mut out = format!("\nambiguous cases settled by the recommended run: {} of {ambiguous}", right(&asked));
    let _ = writeln!(out, " ({} without a recommendation)", ambiguous - asked.len());
    let mut runs: BTreeMap<&str, Vec<&Recommended>> = BTreeMap::new();
    asked.into_iter().for_each(|r| runs.entry(r.name).or_default().push(r));
    for (name, of) in runs {
        let _ = writeln!(out, "  {name:<26}{:>4} of {:<4}{}", right(&of), of.len(), columns(of.iter().map(|r| r.settled)));
    }
    out
}

fn columns(ends: impl Iterator<Item = End>) -> String {
    let mut counts: BTreeMap<End, usize> = BTreeMap::new();
    ends.for_each(|e| *counts.entry(e).or_default() += 1);
    ENDS.map(|(end, _)| counts.get(&end).map_or_else(|| format!("{:>9}", "·"), |n| format!("{n:>9}"))).concat()
}
