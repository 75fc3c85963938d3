//! Writes an investigation as files: `investigation.json` for programs, `investigation.md` and
//! `investigation.html` with their pictures for people.

use std::{fmt::Write as _, path::Path};

use analysis::{
    diagnosis::{RunCurves, report},
    effects,
    report::{Part, Section, Table},
};

use super::{FollowUpRun, Investigation, NotPlayed, Step};
use crate::{
    files::{write_pictures, write_text},
    support::present::significant,
};
use bench_core::safety::failure::Failure;

/// Columns of the table of runs that were not executed.
pub(crate) const NOT_PLAYED: [&str; 3] = ["Run", "Why not", "Detail"];

/// Writes all files.
pub(super) fn write(
    folder: &Path,
    investigation: &Investigation,
    curves: &[RunCurves],
) -> Result<(), Failure> {
    let fail = |error: &dyn std::fmt::Display| Failure::Analysis(error.to_string());
    let json = serde_json::to_string_pretty(investigation).map_err(|error| fail(&error))? + "\n";
    let pictures = report::pictures(&investigation.diagnosis, curves);
    write_pictures(folder, &pictures)?;
    write_text(folder, "investigation.json", &json)?;
    write_text(folder, "investigation.md", &investigation.to_markdown())?;
    write_text(
        folder,
        "investigation.html",
        &investigation.to_html(&pictures)?,
    )
}

impl Investigation {
    /// Formats the investigation as Markdown.
    pub fn to_markdown(&self) -> String {
        let mut text = format!(
            "# Investigation {}\n\n**Ended: {}**\n\n",
            self.name, self.end_text
        );
        // Writing into a string cannot fail.
        let _ = writeln!(text, "{}\n", self.diagnosis.summary);
        let _ = writeln!(
            text,
            "Spent after the campaign: {:.0} of {:.0} min, {:.2} of {:.2} Ah.\n",
            self.spent.minutes, self.budget.minutes, self.spent.charge_ah, self.budget.charge_ah
        );
        text += "## Steps\n\n| measured | bought | verdict | effects | rivals |\n\
        |---|---|---|---|---|\n";
        self.steps.iter().for_each(|step| text += &row(step));
        if !self.not_played.is_empty() {
            let _ = write!(
                text,
                "\n## Runs that were not played\n\n| {} |\n|---|---|---|\n",
                NOT_PLAYED.join(" | ")
            );
        }
        for run in &self.not_played {
            let _ = writeln!(text, "| {} |", run.cells().join(" | "));
        }
        if !self.diagnosis.effects.is_empty() {
            text += "\n## Effects\n\n";
        }
        for effect in &self.diagnosis.effects {
            let _ = writeln!(
                text,
                "- **{}** ({}): {}",
                effect.title, effect.name, effect.falsified_by
            );
            for p in &effect.parameters {
                let sigma = p.sigma.map_or_else(
                    || "not fixed by these data".to_owned(),
                    |sigma| format!("± {}", significant(sigma, 2)),
                );
                let _ = writeln!(
                    text,
                    "  - {} = {} {} {sigma}",
                    p.name,
                    significant(p.value, 4),
                    p.unit
                );
            }
        }
        if !self.diagnosis.gap.is_empty() {
            text += "\n## Held-out runs, mV rms\n\n| run | model from sweeps | refitted | with the \
            effects | floor |\n|---|---|---|---|---|\n";
        }
        for gap in &self.diagnosis.gap {
            let _ = writeln!(
                text,
                "| {} | {:.3} | {:.3} | {:.3} | {:.3} |",
                gap.run, gap.eis_only_mv, gap.base_mv, gap.augmented_mv, gap.floor_mv
            );
        }
        text
    }

    /// Formats the investigation as one page: the diagnosis, the measurements, and why it ended.
    fn to_html(&self, pictures: &[report::Picture]) -> Result<String, Failure> {
        let failed = |error: &dyn std::fmt::Display| Failure::Analysis(error.to_string());
        let mut page = report::html(&self.diagnosis, pictures).map_err(|error| failed(&error))?;
        page.title = format!(
            "Investigation {}: {}",
            self.name,
            self.diagnosis.verdict.label()
        );
        // The summary comes first, the gaps follow.
        let place = page.sections.len().min(1);
        let own = [self.measured(), self.ended()];
        page.sections.splice(place..place, own);
        page.provenance = vec![
            (
                "program".to_owned(),
                format!("eis-bench {}", env!("CARGO_PKG_VERSION")),
            ),
            (
                "everything in numbers".to_owned(),
                "investigation.json beside this page".to_owned(),
            ),
        ];
        page.to_html().map_err(|error| failed(&error))
    }

    fn measured(&self) -> Section {
        let header = ["Measured", "Time", "Verdict", "Names"];
        let cells = |step: &Step| {
            let (what, minutes) = step.bought.as_ref().map_or_else(
                || ("the campaign".to_owned(), "–".to_owned()),
                |b| {
                    let minutes = format!("{:.0} min", b.minutes);
                    (b.experiment.description.clone(), minutes)
                },
            );
            let names: Vec<&str> = step
                .effects
                .iter()
                .map(|name| effects::title(name).unwrap_or(name))
                .collect();
            let names = if names.is_empty() {
                "–".to_owned()
            } else {
                names.join(", ")
            };
            vec![what, minutes, step.verdict.label().to_owned(), names]
        };
        Section {
            heading: "What was measured".to_owned(),
            parts: vec![Part::Table(Table {
                caption: String::new(),
                header: header.map(str::to_owned).to_vec(),
                rows: self.steps.iter().map(cells).collect(),
            })],
            new_page: false,
        }
    }

    fn ended(&self) -> Section {
        let mut parts = vec![Part::Text(format!("It ended because {}.", self.end_text))];
        if !self.not_played.is_empty() {
            parts.push(Part::Table(Table {
                caption: "Runs that were not played".to_owned(),
                header: NOT_PLAYED.map(str::to_owned).to_vec(),
                rows: self
                    .not_played
                    .iter()
                    .map(|run| run.cells().to_vec())
                    .collect(),
            }));
        }
        Section {
            heading: "Why it ended".to_owned(),
            parts,
            new_page: false,
        }
    }
}

/// Formats the runs that were not executed, for a terminal.
pub fn not_played_text(runs: &[NotPlayed]) -> String {
    let rows: Vec<[String; 3]> = std::iter::once(NOT_PLAYED.map(str::to_owned))
        .chain(runs.iter().map(NotPlayed::cells))
        .collect();
    let width = |k: usize| {
        rows.iter()
            .map(|row| row[k].chars().count())
            .max()
            .unwrap_or(0)
    };
    let (run, why) = (width(0), width(1));
    rows.iter()
        .map(|row| format!("  {:<run$}  {:<why$}  {}\n", row[0], row[1], row[2]))
        .collect()
}

fn row(step: &Step) -> String {
    let bought = |b: &FollowUpRun| {
        let next = &b.experiment;
        let (what, minutes, ah) = (&next.description, b.minutes, next.charge_ah);
        let (now, then) = (next.separation_now_sigma, next.separation_sigma);
        format!(
            "{what}; {minutes:.0} min, {ah:.2} Ah, expected separation {then:.1} σ instead of \
            {now:.1} σ"
        )
    };
    let or_none = |names: &[&str]| {
        if names.is_empty() {
            "–".to_owned()
        } else {
            names.join(", ")
        }
    };
    let verdict = step.verdict.label();
    let bought = step
        .bought
        .as_ref()
        .map_or_else(|| "the campaign".to_owned(), bought);
    format!(
        "| {} | {bought} | {verdict} | {} | {} |\n",
        step.folder,
        or_none(&step.effects),
        or_none(&step.rivals)
    )
}
