//! Shares of the mechanisms in the gap, as sentences and as a table.

use super::numbers::plain;
use super::page::Item;
use crate::outcome::{Diagnosis, Share};

/// Returns the mechanisms that are missing, for the first page.
pub(super) fn sentences(d: &Diagnosis) -> Vec<String> {
    let named = d.mechanisms();
    let parts: Vec<String> = named.iter().map(|share| share.in_words()).collect();
    let mut sentences = vec![format!("Mostly {}.", parts.join(", with "))];
    sentences.extend(named.iter().map(|share| {
        format!(
            "Without {} the gap would be {} mV instead of {} mV.",
            share.title,
            plain(share.without_mv),
            plain(share.with_mv)
        )
    }));
    sentences.push(
        "The form of no formula of the catalogue is certain, so that no value is.".to_owned(),
    );
    sentences
}

/// Returns the table of all mechanisms.
pub(super) fn table(d: &Diagnosis) -> Vec<Item> {
    if d.shares.is_empty() {
        return Vec::new();
    }
    let row = |share: &Share| {
        vec![
            share.title.to_owned(),
            share.effects.join(", "),
            share.percents(),
            format!("{} mV", plain(share.without_mv)),
            if share.partners.is_empty() {
                "–".to_owned()
            } else {
                share.partners.join(", ")
            },
        ]
    };
    let with_mv = d.shares.first().map_or(f64::NAN, |share| share.with_mv);
    vec![
        Item::Text(format!(
            "Shares of the mechanisms in the gap that the refit leaves on the held-out runs. Each \
            is switched off with all else fitted again, in every combination; with all of them the \
            gap is {} mV:",
            plain(with_mv)
        )),
        Item::Table(
            vec![
                "Mechanism",
                "Formulas that stand for it",
                "Share of the gap",
                "Gap without it",
                "Would do as well",
            ],
            d.shares.iter().map(row).collect(),
        ),
    ]
}
