//! Oddities of the data themselves: in short on the first page, in full in the details.

use super::page::{Item, Section};
use crate::findings::Finding;
use crate::outcome::Diagnosis;

/// Sentences of the first page.
pub(super) fn in_short(d: &Diagnosis) -> Vec<String> {
    let sentences: Vec<String> = d
        .findings
        .iter()
        .take(3)
        .map(|finding| sentence(finding, d))
        .collect();
    let more = d.findings.len() - sentences.len();
    let rest = (more > 0).then(|| format!("The details list {more} more."));
    sentences.into_iter().chain(rest).collect()
}

fn sentence(finding: &Finding, d: &Diagnosis) -> String {
    let corrected = if d.accepted.contains(&finding.kind) {
        " The corrected data were used, as accepted: all that follows depends on them."
    } else {
        ""
    };
    let title = capital(finding.kind.title());
    format!("{title}: {}.{corrected}", finding.text)
}

fn capital(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| {
        first.to_uppercase().chain(letters).collect()
    })
}

/// Returns all findings, each with its effect.
pub(super) fn details(d: &Diagnosis) -> Section {
    let field = |finding: &Finding| {
        let mut properties = vec![
            ("What", format!("{}.", finding.text)),
            ("How sure", format!("{}.", finding.how_sure)),
            ("Effect", finding.effect.clone()),
        ];
        if finding.correctable {
            let text = if d.accepted.contains(&finding.kind) {
                "The corrected data were used instead of the raw ones, as accepted."
            } else {
                "Corrected data can be used instead of the raw ones: `--accept current_filter`, or \
                `accept` in dataset.toml."
            };
            properties.push(("Correction", text.to_owned()));
        }
        Item::Fields(capital(finding.kind.title()), properties)
    };
    Section::new(
        "The data themselves",
        d.findings.iter().map(field).collect(),
    )
}
