//! Counts of hits and misses, and their table.

use std::collections::BTreeMap;
use std::fmt::Write as _;

/// Standard deviations that hold 68.27 % and 95 % of a normal distribution.
const LEVELS: [f64; 2] = [1.0, 1.959_964];

/// Probability below which a share is not due to chance: a table has some sixty quantities, so one
/// in sixteen sound tables contains such a row.
const REFUTED: f64 = 0.001;

/// Deviations of one stated quantity from its truth, each over its stated standard deviation.
#[derive(Debug, Default, Clone)]
pub(crate) struct Row {
    /// One per seed and part.
    deviations: Vec<f64>,
    /// Number of values without an uncertainty.
    unstated: usize,
}

/// Rows by their names, in the order of their keys.
#[derive(Debug, Default)]
pub(crate) struct Tally {
    rows: BTreeMap<(usize, String), Row>,
    failed: Vec<String>,
    /// Further counts: name, hits, total.
    counts: BTreeMap<String, (usize, usize)>,
}

impl Tally {
    /// Adds a deviation; `order` sorts the rows.
    pub(crate) fn add(&mut self, order: usize, name: &str, error: f64, sigma: Option<f64>) {
        let row = self.rows.entry((order, name.to_owned())).or_default();
        match sigma {
            Some(sigma) if sigma > 0.0 => row.deviations.push(error / sigma),
            _ => row.unstated += 1,
        }
    }

    /// Counts one trial with two outcomes.
    pub(crate) fn count(&mut self, name: &str, hit: bool) {
        let (hits, of) = self.counts.entry(name.to_owned()).or_default();
        *hits += usize::from(hit);
        *of += 1;
    }

    /// Adds a seed that ended without a result.
    pub(crate) fn fail(&mut self, what: String) {
        self.failed.push(what);
    }

    /// Combines two tallies.
    pub(crate) fn join(mut self, other: Self) -> Self {
        for (key, row) in other.rows {
            let own = self.rows.entry(key).or_default();
            own.deviations.extend(row.deviations);
            own.unstated += row.unstated;
        }
        for (name, (hits, of)) in other.counts {
            let own = self.counts.entry(name).or_default();
            *own = (own.0 + hits, own.1 + of);
        }
        self.failed.extend(other.failed);
        self
    }

    /// Returns quantities and their deviations over the stated standard deviations, in the order
    /// of the seeds.
    pub(crate) fn rows(&self) -> impl Iterator<Item = (&str, &[f64])> {
        self.rows
            .iter()
            .map(|((_, name), row)| (name.as_str(), row.deviations.as_slice()))
    }

    /// Returns quantities whose stated 95 % interval contains the truth so rarely that chance does
    /// not explain it, those without an interval, and failures.
    pub(crate) fn refuted(&self) -> Vec<String> {
        let rare = |(name, deviations): (&str, &[f64])| {
            let inside = hits(deviations, LEVELS[1]);
            let chance: f64 = (0..=inside)
                .map(|k| probability(k, deviations.len(), 0.95))
                .sum();
            (chance < REFUTED).then(|| format!("{name}: {inside} of {}", deviations.len()))
        };
        let without = |((_, name), row): (&(usize, String), &Row)| {
            (row.unstated > 0).then(|| format!("{name}: {} without σ", row.unstated))
        };
        self.rows()
            .filter_map(rare)
            .chain(self.rows.iter().filter_map(without))
            .chain(self.failed.iter().cloned())
            .collect()
    }

    /// Returns the table in Markdown.
    pub(crate) fn table(&self, title: &str) -> String {
        let mut text = format!(
            "## {title}\n\n| quantity | n | bias / σ | 68 % | 95 % (Clopper–Pearson 95 %) | χ²/n | \
            worst / σ |\n|---|---|---|---|---|---|---|\n"
        );
        for ((_, name), row) in &self.rows {
            let n = row.deviations.len();
            let mean = row.deviations.iter().sum::<f64>() / n as f64;
            let chi2 = row.deviations.iter().map(|d| d * d).sum::<f64>() / n as f64;
            let worst = row.deviations.iter().map(|d| d.abs()).fold(0.0, f64::max);
            let inside = LEVELS.map(|level| hits(&row.deviations, level));
            let (low, high) = clopper_pearson(inside[1], n);
            let percent = |hits: usize| 100.0 * hits as f64 / n as f64;
            let unstated = if row.unstated > 0 {
                format!(" ({} without σ)", row.unstated)
            } else {
                String::new()
            };
            // Writing to a string cannot fail.
            let _ = writeln!(
                text,
                "| {name}{unstated} | {n} | {mean:+.2} | {:.0} % | {:.1} % ({:.0}…{:.0}) | \
                {chi2:.2} | {worst:.1} |",
                percent(inside[0]),
                percent(inside[1]),
                100.0 * low,
                100.0 * high
            );
        }
        for (name, (hits, of)) in &self.counts {
            let _ = writeln!(text, "\n{name}: {hits} of {of}");
        }
        for failed in &self.failed {
            let _ = writeln!(text, "\nfailed: {failed}");
        }
        text
    }
}

fn hits(deviations: &[f64], level: f64) -> usize {
    deviations.iter().filter(|d| d.abs() <= level).count()
}

/// Returns the 95 % interval of a share by Clopper and Pearson (Biometrika 26, 1934): the shares
/// at which this number of hits or fewer, or this number or more, has a probability of 2.5 %.
fn clopper_pearson(hits: usize, of: usize) -> (f64, f64) {
    let solve = |wanted: &dyn Fn(f64) -> bool| {
        let (mut low, mut high) = (0.0, 1.0);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if wanted(middle) {
                high = middle;
            } else {
                low = middle;
            }
        }
        0.5 * (low + high)
    };
    let at_least = |p: f64| (hits..=of).map(|k| probability(k, of, p)).sum::<f64>();
    let at_most = |p: f64| (0..=hits).map(|k| probability(k, of, p)).sum::<f64>();
    let low = if hits == 0 {
        0.0
    } else {
        solve(&|p| at_least(p) > 0.025)
    };
    let high = if hits == of {
        1.0
    } else {
        solve(&|p| at_most(p) < 0.025)
    };
    (low, high)
}

fn probability(k: usize, n: usize, p: f64) -> f64 {
    let choose: f64 = (1..=k)
        .map(|i| (((n - k + i) as f64) / i as f64).ln())
        .sum();
    (choose + k as f64 * p.max(1e-300).ln() + (n - k) as f64 * (1.0 - p).max(1e-300).ln()).exp()
}
