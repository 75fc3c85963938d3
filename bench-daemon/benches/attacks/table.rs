//! Rows of results, and the table made from them.

use std::collections::BTreeMap;

use super::{
    deed::{Attack, Deed},
    window::Window,
};

/// Result of one attack.
#[derive(Debug, Clone)]
pub(crate) struct Row {
    pub(crate) attack: Attack,
    /// Charge beyond the envelope of the step and its margin, A·s.
    pub(crate) beyond_as: f64,
    /// The longest interval beyond it, s.
    pub(crate) beyond_s: f64,
    /// The bound that the program's plan prints for late answers, s.
    pub(crate) bound_s: Option<f64>,
    pub(crate) deadline_s: f64,
    /// The least and greatest voltage, V, and the greatest temperature, °C, of the cell.
    pub(crate) worst: (f64, f64, f64),
    /// Time from the attack to the last current, s; `None` if the run completed.
    pub(crate) zero_s: Option<f64>,
    pub(crate) still: bool,
    pub(crate) happened: bool,
    /// Whether the run has taken the bench: it reported everything off before its first step.
    pub(crate) began: bool,
    /// Whether the run had to be asked to end.
    pub(crate) hung: bool,
    pub(crate) code: Option<i32>,
    pub(crate) message: String,
    /// Number of wrong points without a flag, number of points of the spectrum, and its expected
    /// number.
    pub(crate) wrong_points: usize,
    pub(crate) points: usize,
    pub(crate) usual: usize,
    /// Messages of the program that were false when they were written.
    pub(crate) false_words: Vec<String>,
    /// Time from the attack to the end of the run, s.
    pub(crate) went_on_s: f64,
    /// Length of the run, s.
    pub(crate) took_s: f64,
    /// The greatest delay of the trial itself, s.
    pub(crate) lag_s: f64,
    pub(crate) resumed: String,
}

/// Groups of attacks, one column each.
const GROUPS: [&str; 8] = [
    "foreign hand",
    "hanging exchange",
    "frozen meter",
    "late answers",
    "network gone",
    "process",
    "folder, offset",
    "other faults",
];

fn group(deed: Deed) -> Option<usize> {
    use instruments::mock::Fault;
    match deed {
        Deed::Nothing => None,
        Deed::Hand(_) => Some(0),
        Deed::Hang(..) => Some(1),
        Deed::Fault(_, Fault::FrozenMeter) => Some(2),
        Deed::Slow(..) => Some(3),
        Deed::Gone(..) => Some(4),
        Deed::Signal(..) => Some(5),
        Deed::FolderGone | Deed::Offset(_) => Some(6),
        Deed::Fault(..) => Some(7),
    }
}

impl Row {
    pub(crate) const HEAD: &'static str = "| attack | beyond the step, A·s (longest, s) | \
    deadline, s | V, °C | to zero, s | code | run, s (lag, s) | message | wrong | resumed |\n\
    |---|---|---|---|---|---|---|---|---|---|\n";

    pub(crate) fn line(&self) -> String {
        let zero = match (self.still, self.zero_s) {
            (true, _) => "STILL FLOWS".to_owned(),
            (false, Some(zero_s)) => format!("{zero_s:.1}"),
            (false, None) => "–".to_owned(),
        };
        let code = self.code.map_or("none".to_owned(), |code| code.to_string());
        let cut = |text: &str| -> String {
            text.replace(|letter: char| letter == '|' || letter.is_control(), "/")
                .chars()
                .take(220)
                .collect()
        };
        let happened = if self.happened {
            ""
        } else {
            " (did not happen)"
        };
        let bound = self
            .bound_s
            .map_or(String::new(), |bound_s| format!(" (printed: {bound_s:.1})"));
        let (least_v, most_v, most_degc) = self.worst;
        format!(
            "| {}{happened} | {:.2} ({:.1}) | {:.1}{bound} | {least_v:.3}…{most_v:.3}, {most_degc:.1} \
            | {zero} | {code} | {:.0} ({:.1}) | {} | {} | {} |",
            self.attack.name(),
            self.beyond_as,
            self.beyond_s,
            self.deadline_s,
            self.took_s,
            self.lag_s,
            cut(&self.message),
            cut(&self.wrong().join("; ")),
            cut(&self.resumed),
        )
    }
}

/// Returns the worst of the attacks in one cell of the table.
fn worst(rows: &[&Row]) -> String {
    let played: Vec<&&Row> = rows.iter().filter(|row| row.happened).collect();
    if played.is_empty() {
        return "–".to_owned();
    }
    let most = |value: fn(&Row) -> f64| played.iter().map(|row| value(row)).fold(0.0, f64::max);
    let wrong = played.iter().filter(|row| !row.wrong().is_empty()).count();
    let wrong = if wrong == 0 {
        String::new()
    } else {
        format!(", **{wrong} wrong**")
    };
    format!(
        "{:.1} A·s, {:.1} s of {}{wrong}",
        most(|row| row.beyond_as),
        most(|row| row.beyond_s),
        played.len()
    )
}

/// Returns one line per window, with one column per group of attacks: the greatest charge, the
/// longest interval, the number of trials, and the number of failures.
pub(crate) fn summary(rows: &[Row]) -> String {
    let mut cells: BTreeMap<(Window, usize), Vec<&Row>> = BTreeMap::new();
    for row in rows {
        if let Some(group) = group(row.attack.deed) {
            cells
                .entry((row.attack.window, group))
                .or_default()
                .push(row);
        }
    }
    let mut text = format!(
        "| window | {} |\n|---{}|\n",
        GROUPS.join(" | "),
        "|---".repeat(8)
    );
    for window in Window::ALL {
        let line: Vec<String> = (0..GROUPS.len())
            .map(|group| worst(cells.get(&(window, group)).map_or(&[][..], Vec::as_slice)))
            .collect();
        text.push_str(&format!("| {} | {} |\n", window.name(), line.join(" | ")));
    }
    text
}

/// Returns totals over all rows.
pub(crate) fn totals(rows: &[Row]) -> String {
    let played: Vec<&Row> = rows.iter().filter(|row| row.happened).collect();
    let counted = |fits: &dyn Fn(&Row) -> bool| played.iter().filter(|row| fits(row)).count();
    let late = counted(&|row| {
        row.attack.window.is_watched() && row.began && (row.beyond_s > row.deadline_s || row.still)
    });
    let numbers = counted(&|row| row.wrong_points > 0 && row.code == Some(0));
    let words = counted(&|row| !row.false_words.is_empty());
    let outages = counted(&|row| row.attack.deed.is_transient());
    let survived = counted(&|row| row.attack.deed.is_transient() && row.wrong().is_empty());
    let charge: f64 = played.iter().map(|row| row.beyond_as).sum();
    let least_lag = played.iter().map(|row| row.lag_s).fold(0.0, f64::max);
    format!(
        "{} combinations, {} happened. Beyond the envelope for longer than the deadline: {late}. \
        Wrong numbers with exit 0 and no flag: {numbers}. False words: {words}. Outages of 7 s and \
        10 s that the run outlived: {survived} of {outages}. With something that must not be: {}. \
        Charge beyond the envelope in all: {charge:.0} A·s. Greatest delay of a trial itself: \
        {least_lag:.1} s.\n",
        rows.len(),
        played.len(),
        counted(&|row| !row.wrong().is_empty()),
    )
}

/// Compares the measured time beyond the envelope for slow instruments with the bound that the
/// plan prints.
pub(crate) fn slow(rows: &[Row]) -> String {
    let mut text = "| answers late by, s | longest beyond the envelope, s | printed bound, s | \
    played |\n|---|---|---|---|\n"
        .to_owned();
    let mut by_latency: BTreeMap<u64, Vec<&Row>> = BTreeMap::new();
    for row in rows.iter().filter(|row| row.happened) {
        if let Deed::Slow(late_s, _) = row.attack.deed {
            by_latency
                .entry((late_s * 1e3) as u64)
                .or_default()
                .push(row);
        }
    }
    for (late_ms, rows) in by_latency {
        let watched = rows
            .iter()
            .filter(|row| row.attack.window.is_watched() && row.began);
        let longest = watched.map(|row| row.beyond_s).fold(0.0, f64::max);
        let bounds = rows.iter().filter_map(|row| row.bound_s);
        let bound = bounds.fold(f64::NAN, f64::max);
        let bound = if bound.is_nan() {
            "none".to_owned()
        } else {
            format!("{bound:.1}")
        };
        text.push_str(&format!(
            "| {:.1} | {longest:.1} | {bound} | {} |\n",
            late_ms as f64 / 1e3,
            rows.len()
        ));
    }
    text
}
