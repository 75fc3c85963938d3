//! The doctor's report: JSON for the program, Markdown and HTML for people. It contains a hash of
//! its own content, so that an edited report is invalid.

use std::{fmt::Write, path::Path};

use analysis::{
    dataset::write_atomically,
    report::{Level, Report as Page, Table, Verdict as Line},
};
use serde::{Deserialize, Serialize};

use super::{Check, Verdict};
use bench_core::safety::failure::Failure;
use bench_plan::support::hash;

/// Outcome of the checks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// All checks were made, and nothing failed.
    Passed,
    /// Nothing failed, but the checks that need a fixture in the jig were not made.
    Incomplete,
    /// A check failed.
    Failed,
}

/// One instrument as it was found.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Instrument {
    /// Its role.
    pub role: String,
    /// Its model in the bench file.
    pub model: String,
    /// Its address.
    pub address: String,
    /// Its whole identity.
    pub identity: String,
}

/// The whole report.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// Version of the program.
    pub version: String,
    /// The bench.
    pub bench: String,
    /// SHA-256 of the bench file.
    pub config_sha256: String,
    /// Person who signs for it.
    pub operator: String,
    /// Date, UTC.
    pub date: String,
    /// The date, s since 1970.
    pub unix_s: f64,
    /// Fixture in the jig, as stated by the operator.
    pub fixture: Option<String>,
    /// The instruments.
    pub instruments: Vec<Instrument>,
    /// Outcome of the checks.
    pub outcome: Outcome,
    /// The checks.
    pub checks: Vec<Check>,
    /// SHA-256 of the report, with this field empty.
    pub sha256: String,
}

impl Report {
    /// Seals the report with its hash.
    #[must_use]
    pub fn sealed(self) -> Self {
        Self {
            sha256: self.digest(),
            ..self
        }
    }

    /// Checks that the report was not changed since.
    pub fn is_whole(&self) -> bool {
        self.sha256 == self.digest()
    }

    fn digest(&self) -> String {
        hash::sha256(
            serde_json::to_vec(&Self {
                sha256: String::new(),
                ..self.clone()
            })
            .unwrap_or_default(),
        )
    }

    fn title(&self) -> String {
        let outcome = match self.outcome {
            Outcome::Passed => "passed",
            Outcome::Incomplete => "incomplete",
            Outcome::Failed => "FAILED",
        };
        format!("Doctor's report of the bench {}: {outcome}", self.bench)
    }

    fn provenance(&self) -> Vec<(String, String)> {
        let mut lines = vec![
            ("operator".to_owned(), self.operator.clone()),
            ("date".to_owned(), self.date.clone()),
            ("eis-bench".to_owned(), self.version.clone()),
            ("bench file, SHA-256".to_owned(), self.config_sha256.clone()),
            (
                "fixture".to_owned(),
                self.fixture.clone().unwrap_or_else(|| "none".to_owned()),
            ),
        ];
        lines.extend(self.instruments.iter().map(|one| {
            (
                one.role.clone(),
                format!("{} at {}: {}", one.model, one.address, one.identity),
            )
        }));
        lines.push(("this report, SHA-256".to_owned(), self.sha256.clone()));
        lines
    }

    /// Returns the report as text for people.
    pub fn markdown(&self) -> String {
        let mut text = format!("# {}\n\n", self.title());
        for (name, value) in self.provenance() {
            let _ = writeln!(text, "* {name}: {value}");
        }
        text.push_str(
            "\n| check | verdict | expected | met | what to do |\n|---|---|---|---|---|\n",
        );
        let cell = |text: &str| text.replace('|', "\\|").replace('\n', " ");
        for check in &self.checks {
            let Check {
                id,
                expected,
                met,
                verdict,
                advice,
            } = check;
            let _ = writeln!(
                text,
                "| {id} | {} | {} | {} | {} |",
                verdict.label(),
                cell(expected),
                cell(met),
                cell(advice)
            );
        }
        let _ = writeln!(text, "\nSigned off by {} on {}.", self.operator, self.date);
        text
    }

    fn page(&self) -> Page {
        let line = |check: &Check| {
            let level = if check.verdict == Verdict::Fail {
                Level::Bad
            } else {
                Level::Note
            };
            Line {
                level,
                text: format!("{}: {}. {}", check.id, check.met, check.advice),
            }
        };
        let good = Line {
            level: Level::Good,
            text: "every check that was done ended well".to_owned(),
        };
        let mut verdicts: Vec<Line> = self
            .checks
            .iter()
            .filter(|check| matches!(check.verdict, Verdict::Fail | Verdict::Warn))
            .map(line)
            .collect();
        if verdicts.is_empty() {
            verdicts.push(good);
        }
        let row = |check: &Check| {
            vec![
                check.id.clone(),
                check.verdict.label().to_owned(),
                check.expected.clone(),
                check.met.clone(),
                check.advice.clone(),
            ]
        };
        let header = ["check", "verdict", "expected", "met", "what to do"]
            .map(str::to_owned)
            .to_vec();
        let table = Table {
            caption: "Checks".to_owned(),
            header,
            rows: self.checks.iter().map(row).collect(),
        };
        Page {
            title: self.title(),
            verdicts,
            tables: vec![table],
            provenance: self.provenance(),
            ..Page::default()
        }
    }
}

/// Writes the report into its folder: `doctor.json`, `doctor.md`, `doctor.html`.
///
/// # Errors
/// Fails if a file cannot be written.
pub fn write(report: &Report, folder: &Path) -> Result<(), Failure> {
    let fail = |error: &dyn std::fmt::Display| {
        Failure::Analysis(format!(
            "{}: the report cannot be written: {error}",
            folder.display()
        ))
    };
    let json = serde_json::to_string_pretty(report).map_err(|error| fail(&error))?;
    let html = report.page().to_html().map_err(|error| fail(&error))?;
    for (name, text) in [
        ("doctor.json", format!("{json}\n")),
        ("doctor.md", report.markdown()),
        ("doctor.html", html),
    ] {
        write_atomically(&folder.join(name), text.as_bytes()).map_err(|error| fail(&error))?;
    }
    Ok(())
}
