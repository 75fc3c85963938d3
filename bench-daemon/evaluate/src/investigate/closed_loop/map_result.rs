//! The result of an investigation for a map, and its files.

use std::{
    fmt::Write as _,
    path::{Path, PathBuf},
};

use analysis::{
    map::MapFit,
    ocv::OcvCurve,
    report::{Report, Table},
    run_folder::{JOURNAL, MAP},
};
use bench_core::safety::failure::Failure;
use serde::Serialize;

use super::{
    played::run_folder,
    rule::{Budget, End},
};
use crate::{files::write_text, investigate::cell_map};

/// Last part of the name of the folder of a run.
pub(super) const NAME: &str = "map";

/// One run and what it has made of the error of the loads.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Round {
    /// Run folder beside the files of the investigation.
    pub folder: String,
    /// Points that were measured, in words.
    pub measured: Vec<String>,
    /// Time that it took on the bench, min; none for the first run, which the budget does not pay for.
    pub minutes: Option<f64>,
    /// Predicted error of the voltage under the loads before it, one standard deviation, V.
    pub error_before_v: Option<f64>,
    /// Error that was expected after it, V.
    pub error_expected_v: Option<f64>,
    /// Error after it, V; none if nothing was fitted to it.
    pub error_after_v: Option<f64>,
}

impl Round {
    /// The round in one line.
    pub fn line(&self) -> String {
        let mut text = format!("{}: {}", self.folder, self.measured.join("; "));
        // Writing into a string cannot fail.
        if let Some(minutes) = self.minutes {
            let _ = write!(text, "; {minutes:.0} min");
        }
        match (self.error_before_v, self.error_after_v) {
            (Some(before_v), Some(after_v)) => {
                let _ = write!(
                    text,
                    "; error of the loads {:.2} mV, before it {:.2} mV",
                    1e3 * after_v,
                    1e3 * before_v
                );
            }
            (None, Some(after_v)) => {
                let _ = write!(text, "; error of the loads {:.2} mV", 1e3 * after_v);
            }
            (_, None) => {}
        }
        text
    }

    fn cells(&self) -> Vec<String> {
        let number = |value: Option<f64>, factor: f64, digits: usize| {
            value.map_or_else(
                || "–".to_owned(),
                |value| format!("{:.digits$}", factor * value),
            )
        };
        vec![
            self.folder.clone(),
            self.measured.join("; "),
            number(self.minutes, 1.0, 0),
            number(self.error_before_v, 1e3, 2),
            number(self.error_expected_v, 1e3, 2),
            number(self.error_after_v, 1e3, 2),
        ]
    }
}

/// How an investigation for a map ended.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MapEnd {
    /// Kind of the end; none while the investigation is in progress.
    pub end: Option<End>,
    /// The end in one sentence.
    pub end_text: String,
    /// Predicted error of the voltage under the loads, one standard deviation, V; not a number before the
    /// first prediction.
    pub error_v: f64,
    /// Points that the quality gate has refused to the end, of all runs.
    pub refused_points: usize,
}

/// An investigation for a map as it is written.
#[derive(Debug, Serialize)]
pub struct MapInvestigation {
    /// Name of the schema.
    pub schema: &'static str,
    /// Name of the experiment.
    pub name: String,
    /// Budget that might be spent.
    pub budget: Budget,
    /// Part of it that was spent.
    pub spent: Budget,
    /// The runs in order.
    pub rounds: Vec<Round>,
    /// How it ended.
    #[serde(flatten)]
    pub ended: MapEnd,
    /// The last map; none if nothing was fitted.
    #[serde(skip)]
    pub fit: Option<MapFit>,
    /// Error that ended the investigation, such as that of a run that ended early.
    #[serde(skip)]
    pub failure: Option<Failure>,
}

/// Columns of the table of rounds.
const ROUNDS: [&str; 6] = [
    "Run",
    "Measured",
    "min",
    "Error before / mV",
    "Expected / mV",
    "After / mV",
];

impl MapInvestigation {
    /// Writes `investigation.json`, `.md` and `.html`, and the files of the map.
    ///
    /// # Errors
    /// A folder that cannot be written.
    pub(super) fn write(&self, folder: &Path, curve: &OcvCurve) -> Result<(), Failure> {
        let fail = |error: &dyn std::fmt::Display| Failure::Analysis(error.to_string());
        let json = serde_json::to_string_pretty(self).map_err(|error| fail(&error))? + "\n";
        let html = self.page().to_html().map_err(|error| fail(&error))?;
        if let Some(fit) = &self.fit {
            cell_map::files::write(folder, &self.name, curve, fit)?;
        }
        write_text(folder, "investigation.json", &json)?;
        write_text(folder, "investigation.md", &self.to_markdown())?;
        write_text(folder, "investigation.html", &html)
    }

    /// Formats the investigation as Markdown.
    pub fn to_markdown(&self) -> String {
        let mut text = format!(
            "# Investigation {}\n\n**Ended: {}**\n\n{}\n\n| {} |\n|{}\n",
            self.name,
            self.ended.end_text,
            self.spent_text(),
            ROUNDS.join(" | "),
            "---|".repeat(ROUNDS.len())
        );
        for round in &self.rounds {
            let _ = writeln!(text, "| {} |", round.cells().join(" | "));
        }
        text
    }

    /// The folder of a run that ended early, if there is one: that after the last round.
    pub fn unfinished(&self, out: &Path) -> Option<PathBuf> {
        let folder = run_folder(out, self.rounds.len(), NAME);
        folder.join(JOURNAL).is_file().then_some(folder)
    }

    /// What was spent, in one sentence.
    pub fn spent_text(&self) -> String {
        let left = self.budget.less(self.spent);
        format!(
            "Spent after the first run: {:.0} of {:.0} min, {:.2} of {:.2} Ah; left are {:.0} min and {:.2} Ah.",
            self.spent.minutes,
            self.budget.minutes,
            self.spent.charge_ah,
            self.budget.charge_ah,
            left.minutes.max(0.0),
            left.charge_ah.max(0.0)
        )
    }

    fn page(&self) -> Report {
        Report {
            title: format!("Investigation {}: {}", self.name, self.ended.end_text),
            tables: vec![Table {
                caption: self.spent_text(),
                header: ROUNDS.map(str::to_owned).to_vec(),
                rows: self.rounds.iter().map(Round::cells).collect(),
            }],
            provenance: vec![
                (
                    "program".to_owned(),
                    format!("eis-bench {}", env!("CARGO_PKG_VERSION")),
                ),
                (
                    "everything in numbers".to_owned(),
                    format!("investigation.json and {MAP} beside this page"),
                ),
            ],
            ..Report::default()
        }
    }
}
