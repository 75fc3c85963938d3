//! Scores of many trials in tables.

use std::{collections::BTreeMap, fmt::Write as _};

use super::trial::{End, Recommended, Score};
use analysis::diagnosis::Verdict;

/// Limits of the classes of λ.
const CLASSES: [f64; 7] = [0.0, 10.0, 20.0, 40.0, 100.0, 1000.0, f64::INFINITY];
/// λ from which on a name is certain whatever the noise does: five standard deviations above what
/// certainty asks for.
const UNCHOSEN: f64 = 300.0;
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
        let _ = writeln!(
            out,
            "{:<22}{}",
            "λ",
            ENDS.map(|(_, name)| format!("{name:>9}")).concat()
        );
        for class in CLASSES.windows(2) {
            let of: Vec<&&Score> = scores
                .iter()
                .filter(|s| s.lambda.is_some_and(|l| l >= class[0] && l < class[1]))
                .collect();
            if !of.is_empty() {
                let _ = writeln!(
                    out,
                    "{:<22}{}",
                    format!("{} … {}", class[0], class[1]),
                    columns(of.iter().map(|s| s.end))
                );
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
    coverage(scores, &mut out);
    let mut closed: Vec<f64> = scores
        .iter()
        .filter(|s| s.lambda.is_some_and(|l| l >= 100.0))
        .filter_map(|s| s.closed)
        .collect();
    closed.sort_by(f64::total_cmp);
    if !closed.is_empty() {
        let at = |q: f64| 100.0 * closed[((closed.len() - 1) as f64 * q) as usize];
        let _ = writeln!(
            out,
            "\noracle's held-out gap closed at λ ≥ 100 ({} trials): median {:.1} %, worst \
            twentieth {:.1} %",
            closed.len(),
            at(0.5),
            at(0.05)
        );
    }
    out.push_str(&settled(scores));
    out
}

/// How many of the ambiguous cases the recommended runs settle, one after the other, and by the
/// first run.
fn settled(scores: &[Score]) -> String {
    let ambiguous: Vec<&Score> = scores
        .iter()
        .filter(|s| {
            matches!(s.end, End::Twin | End::Part | End::Misled) && s.verdict == Verdict::Ambiguous
        })
        .collect();
    if ambiguous.is_empty() {
        return String::new();
    }
    if ambiguous.iter().all(|s| s.recommended.is_empty()) {
        return format!(
            "\nambiguous cases: {}; the recommended runs were not played\n",
            ambiguous.len()
        );
    }
    let mut out = format!("\nambiguous cases: {}; settled by\n", ambiguous.len());
    for most in 1..=ambiguous
        .iter()
        .map(|s| s.recommended.len())
        .max()
        .unwrap_or(0)
    {
        let ends: Vec<End> = ambiguous
            .iter()
            .filter_map(|s| s.recommended.iter().take(most).next_back())
            .map(|r| r.settled)
            .collect();
        let right = ends.iter().filter(|e| **e == End::Right).count();
        let _ = writeln!(
            out,
            "  {:<26}{right:>4} of {:<4}{}",
            format!("up to {most} recommended"),
            ambiguous.len(),
            columns(ends.into_iter())
        );
    }
    // After the first run, or at once where none was asked for.
    let declared = |s: &&&Score| {
        let (end, said) = s
            .recommended
            .first()
            .map_or((s.end, &s.inseparable), |r| (r.settled, &r.inseparable));
        end == End::Twin && !said.is_empty()
    };
    let _ = writeln!(
        out,
        "  left open by the first, and said that no run of the menu can tell: {}",
        ambiguous.iter().filter(declared).count()
    );
    let nothing: Vec<End> = ambiguous.iter().filter_map(|s| s.placebo).collect();
    let _ = writeln!(
        out,
        "  {:<38}{}",
        format!("the first with nothing hidden ({})", nothing.len()),
        columns(nothing.into_iter())
    );
    let first: Vec<&Recommended> = ambiguous
        .iter()
        .filter_map(|s| s.recommended.first())
        .collect();
    let mut runs: BTreeMap<(bool, &str), Vec<&Recommended>> = BTreeMap::new();
    first
        .into_iter()
        .for_each(|r| runs.entry((!r.settles, r.name)).or_default().push(r));
    for ((short, name), of) in runs {
        let right = of.iter().filter(|r| r.settled == End::Right).count();
        let expected = if short { "helps" } else { "settles" };
        let _ = writeln!(
            out,
            "  {name:<24}{expected:>8} {right:>4} of {:<4}{}",
            of.len(),
            columns(of.iter().map(|r| r.settled))
        );
    }
    out
}

/// How often the 95 % interval of a strength holds the truth where the effect is certain, and how
/// large its error is.
fn coverage(scores: &[Score], out: &mut String) {
    let certain = scores.iter().filter(|s| s.end == End::Right);
    let mut kinds: BTreeMap<&str, Vec<(bool, f64)>> = BTreeMap::new();
    for p in certain.flat_map(|s| &s.parameters) {
        kinds
            .entry(&p.name)
            .or_default()
            .push((p.covered, (p.value / p.truth - 1.0).abs()));
    }
    let all: Vec<bool> = kinds
        .values()
        .flatten()
        .map(|(covered, _)| *covered)
        .collect();
    if all.is_empty() {
        return;
    }
    let held = |of: &[bool]| of.iter().filter(|c| **c).count();
    let _ = writeln!(
        out,
        "\n95 % intervals of strengths of effects named for certain: {} of {} hold the truth",
        held(&all),
        all.len()
    );
    // Near the λ that certainty asks for only what came out too strong is named for certain: there
    // intervals miss by choice, not by width.
    let strong = scores
        .iter()
        .filter(|s| s.lambda.is_some_and(|l| l >= UNCHOSEN))
        .flat_map(|s| &s.parameters);
    let strong: Vec<bool> = strong.map(|p| p.covered).collect();
    let _ = writeln!(
        out,
        "of effects with λ ≥ {UNCHOSEN}, certain or not: {} of {}",
        held(&strong),
        strong.len()
    );
    for (name, of) in kinds {
        let covered: Vec<bool> = of.iter().map(|(c, _)| *c).collect();
        let mut errors: Vec<f64> = of.iter().map(|(_, e)| *e).collect();
        errors.sort_by(f64::total_cmp);
        let _ = writeln!(
            out,
            "  {name:<40}{:>4} of {:<4} median error {:.1} %",
            held(&covered),
            covered.len(),
            100.0 * errors[errors.len() / 2]
        );
    }
}

fn columns(ends: impl Iterator<Item = End>) -> String {
    let mut counts: BTreeMap<End, usize> = BTreeMap::new();
    ends.for_each(|e| *counts.entry(e).or_default() += 1);
    ENDS.map(|(end, _)| {
        counts
            .get(&end)
            .map_or_else(|| format!("{:>9}", "·"), |n| format!("{n:>9}"))
    })
    .concat()
}
