//! Writes an investigation as files: `investigation.json` for programs, `investigation.md` for
//! people.

use std::{fmt::Write as _, path::Path};

use analysis::dataset::write_atomically;

use super::{FollowUpRun, Investigation, Step};
use crate::{safety::failure::Failure, support::present::significant};

/// Writes both.
pub(super) fn write(folder: &Path, investigation: &Investigation) -> Result<(), Failure> {
    let fail = |error: &dyn std::fmt::Display| Failure::Analysis(error.to_string());
    let json = serde_json::to_string_pretty(investigation).map_err(|error| fail(&error))? + "\n";
    for (name, text) in [
        ("investigation.json", json),
        ("investigation.md", investigation.to_markdown()),
    ] {
        write_atomically(&folder.join(name), text.as_bytes()).map_err(|error| fail(&error))?;
    }
    Ok(())
}

impl Investigation {
    /// The investigation in words.
    pub fn to_markdown(&self) -> String {
        let mut text = format!("# Investigation {}\n\n**{}**\n\n", self.name, self.end_text);
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
