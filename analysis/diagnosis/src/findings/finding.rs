//! A finding on the data, as it is written and reported.

use serde::Serialize;

use crate::thresholds::{GAP_AROUND, GAP_TIMES_EVEN};

/// Kind of a finding.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum FindingKind {
    /// A held-out run holds rows of a training run.
    Leakage,
    /// Two runs of one role contain the same rows.
    Copy,
    /// The voltage at rest is not that of the stated start.
    RestVoltage,
    /// A record ends before its stated end.
    EndsEarly,
    /// Rows without a number of the voltage or the current.
    RowsNotMeasured,
    /// Rows that are missing within a record.
    RowsMissing,
    /// Rows that repeat the one before them.
    RowsRepeated,
    /// Time stamps that are rounded to more than the record is sampled at.
    StampsRounded,
    /// Samples too far apart for the model's fast branches.
    SamplingSlow,
    /// A current that changes faster than it is logged.
    CurrentUnseen,
    /// Codes of a channel that are coarser than stated.
    Resolution,
    /// A factor between model and records.
    Scale,
    /// A filter of the logged current.
    CurrentFilter,
}

impl FindingKind {
    /// Returns the title as text.
    pub fn title(self) -> &'static str {
        match self {
            Self::Leakage => "held-out rows among the training rows",
            Self::Copy => "the same rows in two runs",
            Self::RestVoltage => "rest voltage off the OCV curve",
            Self::EndsEarly => "record ends early",
            Self::RowsNotMeasured => "rows without a number",
            Self::RowsMissing => "missing rows",
            Self::RowsRepeated => "repeated rows",
            Self::StampsRounded => "rounded time stamps",
            Self::SamplingSlow => "slow sampling",
            Self::CurrentUnseen => "current faster than its log",
            Self::Resolution => "coarse codes",
            Self::Scale => "factor between model and records",
            Self::CurrentFilter => "filter of the logged current",
        }
    }
}

/// One oddity of the data, found before any physics.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Finding {
    /// Kind.
    pub kind: FindingKind,
    /// The runs concerned.
    pub runs: Vec<String>,
    /// Oddity and place, with numbers.
    pub text: String,
    /// How sure it is: a number of standard deviations, or a count.
    pub how_sure: String,
    /// Effect on the diagnosis.
    pub effect: String,
    /// True if corrected data can replace the raw data.
    pub correctable: bool,
}

impl Finding {
    /// Returns the finding of a record that ends before its stated end; its stamps are those of the
    /// file, s. Returns `None` if it ends there within a few samples.
    pub fn ends_early(run: &str, time_s: &[f64], stated_s: f64) -> Option<Self> {
        let last_s = time_s.last().copied()?;
        let steps = time_s.windows(2).map(|w| w[1] - w[0]);
        let typical_s = steps.rev().take(GAP_AROUND).fold(0.0, f64::max);
        let missing_s = stated_s - last_s;
        (missing_s > GAP_TIMES_EVEN * typical_s).then(|| Self {
            kind: FindingKind::EndsEarly,
            runs: vec![run.to_owned()],
            text: format!(
                "{run} ends at {last_s} s, {missing_s:.3} s before its `to_s` of {stated_s} s"
            ),
            how_sure: format!(
                "certain: the last stamp; its last samples are {typical_s:.3} s apart"
            ),
            effect: "What happened in the missing time is neither fitted nor compared. Where the \
                record was cut off, its last rows may be damaged too."
                .to_owned(),
            correctable: false,
        })
    }

    /// Returns the finding of rows of a file without a number for the voltage or the current, by
    /// their lines or rows in the file, and their fraction of the run's rows.
    pub fn rows_not_measured(run: &str, lines: &[usize], of: usize) -> Self {
        let mut shown: Vec<String> = lines.iter().take(8).map(usize::to_string).collect();
        if lines.len() > 8 {
            shown.push(format!("{} more", lines.len() - 8));
        }
        let rows = if lines.len() == 1 { "row" } else { "rows" };
        Self {
            kind: FindingKind::RowsNotMeasured,
            runs: vec![run.to_owned()],
            text: format!(
                "{run}: {} {rows} of its part of the file without a voltage or a current (line {})",
                lines.len(),
                shown.join(", ")
            ),
            how_sure: format!(
                "certain: {} of {} rows",
                lines.len(),
                of.saturating_add(lines.len())
            ),
            effect: "They are left out. The current is interpolated across them, so that an edge \
                there comes at the wrong time."
                .to_owned(),
            correctable: false,
        }
    }
}

/// Returns names of runs for a sentence: all names if there are few, otherwise the first and the
/// number of the others.
pub(super) fn names(runs: &[String]) -> String {
    match runs {
        [] => String::new(),
        [one] => one.clone(),
        all if all.len() <= 4 => {
            let (last, first) = all.split_at(all.len() - 1);
            format!("{} and {}", last.join(", "), first.join(""))
        }
        all => format!("{} and {} more", all[..3].join(", "), all.len() - 3),
    }
}
