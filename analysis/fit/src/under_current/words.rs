//! The comparison in sentences.

use analysis_numeric::significant::format_significant;

use super::result::{BranchChange, Compared, CurrentChange, PointChange, UnderCurrent};

/// Standard uncertainties of repeats beyond which two opposite changes are reported.
const OPPOSITE: f64 = 2.0;

/// Returns the change of one resistance: `R1 −8.9 % ± 4.5 % (p 0.12)`.
pub fn branch_in_words(branch: &BranchChange) -> String {
    let percent = |v: f64| format_significant(100.0 * v, 2);
    if !branch.measured {
        return format!("{} not determined", branch.name);
    }
    let sign = if branch.share < 0.0 { "−" } else { "+" };
    format!(
        "{} {sign}{} % ± {} % (p {})",
        branch.name,
        percent(branch.share.abs()),
        percent(branch.sigma),
        format_significant(branch.p_adjusted, 2)
    )
}

/// Returns the time constant of the branch with this index of [`CurrentChange::branches`], or nothing
/// for the series resistance.
pub fn tau_in_words(found: &UnderCurrent, index: usize) -> String {
    let branch = index
        .checked_sub(1)
        .and_then(|k| found.model.branches.get(k));
    branch.map_or_else(String::new, |b| {
        format!("τ {} s", format_significant(b.time_constant_s(), 2))
    })
}

/// Returns the outcome: one sentence for each sweep, for each pair, and the remarks.
pub fn in_words(found: &UnderCurrent) -> Vec<String> {
    let change = |change: &CurrentChange| {
        let with = match &change.compared {
            Compared::OwnCell { cell } => format!("{cell} at rest"),
            Compared::AllCells { cells } => {
                format!("{cells} cells at rest, none known to be its own")
            }
        };
        let what = outcome(&change.branches);
        format!(
            "{:+} A ({}), against {with}: {what}",
            change.bias_a, change.name
        )
    };
    let changes = found.changes.iter().map(change);
    let pairs = found.pairs.iter().map(|pair| {
        let what = outcome(&pair.branches);
        format!(
            "{} against {}, taken as one cell: {what}",
            pair.to, pair.from
        )
    });
    changes.chain(pairs).chain(found.remarks.clone()).collect()
}

fn outcome(branches: &[BranchChange]) -> String {
    let certain: Vec<&BranchChange> = branches.iter().filter(|b| b.is_certain()).collect();
    let list = |of: Vec<&BranchChange>| {
        of.into_iter()
            .map(branch_in_words)
            .collect::<Vec<_>>()
            .join(", ")
    };
    if certain.is_empty() {
        format!(
            "no change that is certain; {}",
            list(branches.iter().collect())
        )
    } else {
        list(certain)
    }
}

/// Returns a remark on the lowest point of two opposite currents if its imaginary part changes with
/// opposite signs, as a drift of the record makes it.
pub(super) fn opposite(changes: &[CurrentChange]) -> Vec<String> {
    let lowest = |change: &CurrentChange| change.points.first().copied();
    let strong = |p: &PointChange| p.im.abs() > OPPOSITE * p.sigma_im;
    let pair = |a: &CurrentChange| {
        let b = changes.iter().find(|b| b.bias_a == -a.bias_a)?;
        let (p, q) = (lowest(a)?, lowest(b)?);
        let found = a.bias_a < 0.0 && p.freq_hz == q.freq_hz && p.im * q.im < 0.0;
        (found && (strong(&p) || strong(&q))).then(|| {
            format!(
                "at {} Hz Im Z changes by {:+.1} % of |Z| under {:+} A and by {:+.1} % under {:+} A: a drift \
                of the record does that, and so would a slow branch; the sweeps do not separate them",
                format_significant(p.freq_hz, 3),
                100.0 * p.im,
                a.bias_a,
                100.0 * q.im,
                b.bias_a
            )
        })
    };
    changes.iter().filter_map(pair).collect()
}
