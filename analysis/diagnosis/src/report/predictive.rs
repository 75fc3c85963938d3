//! The augmentation for predictions: its terms, its gaps, and its range of validity.

use super::numbers::{plain, with_values};
use super::page::{Item, Section};
use crate::gap::rms_mv;
use crate::outcome::{Diagnosis, Gap, Predictive};

/// The model to predict with while no name is certain, for the first page.
pub(super) fn sentences(d: &Diagnosis) -> Vec<String> {
    let Some(predictive) = &d.predictive else {
        return Vec::new();
    };
    let titles: Vec<&str> = predictive.terms.iter().map(|t| t.title).collect();
    let mut sentences = vec![format!(
        "Use the model with predictive terms, for predictions only. They have the form of {}: the \
        form fits, and nothing is claimed about the cause.",
        titles.join(" and of ")
    )];
    let [before, after, floor] = [
        |gap: &Gap| gap.base_mv,
        |gap: &Gap| gap.augmented_mv,
        |gap: &Gap| gap.floor_mv,
    ]
    .map(|of| rms_mv(&predictive.gap, of));
    sentences.push(format!(
        "Over the held-out records it is wrong by {} mV (rms) instead of {} mV; noise alone \
        makes {} mV.",
        plain(after),
        plain(before),
        plain(floor)
    ));
    sentences.push(range(predictive));
    sentences
}

/// Returns the range in which it was fitted and tested.
fn range(predictive: &Predictive) -> String {
    let range = &predictive.range;
    format!(
        "It holds up to {} A, for {} s, within {} % of the capacity about a state of charge of {}, \
        at {} °C.",
        plain(range.greatest_a),
        plain(range.longest_s),
        plain(100.0 * range.widest_soc),
        plain(range.soc),
        plain(range.temperature_degc)
    )
}

/// Its terms and gaps, for the details.
pub(super) fn section(d: &Diagnosis) -> Section {
    let Some(predictive) = &d.predictive else {
        return Section::default();
    };
    let terms = predictive
        .terms
        .iter()
        .map(|term| {
            vec![
                with_values(&format!("as {}", term.title), &term.parameters),
                term.stands_for.to_owned(),
            ]
        })
        .collect();
    let value = |v: f64| format!("{} mV", plain(v));
    let gaps = predictive
        .gap
        .iter()
        .map(|gap| {
            vec![
                gap.run.clone(),
                value(gap.eis_only_mv),
                value(gap.base_mv),
                value(gap.augmented_mv),
                value(gap.floor_mv),
            ]
        })
        .collect();
    let lead = "No name is certain, and a prediction is wanted all the same. These terms were chosen \
        because they predict, each against the price of its parameters, and none makes a held-out \
        record worse. They are not physics: other terms may do as well.";
    Section::new(
        "For predictions only",
        vec![
            Item::Text(lead.to_owned()),
            Item::Table(vec!["Predictive term", "Form that it stands for"], terms),
            Item::Table(
                vec!["Run", "Spectra alone", "Refit", "With these terms", "Floor"],
                gaps,
            ),
            Item::Text(range(predictive)),
        ],
    )
}
