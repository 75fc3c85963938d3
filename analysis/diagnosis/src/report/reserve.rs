//! Reservations of a diagnosis: observations that would falsify it, the next measurement, open
//! questions, claims that are not made, and the noise behind it.

use super::is_significant;
use super::numbers::{percent, plain, quantity, times};
use super::page::{Item, Section};
use super::titled;
use crate::outcome::{Block, Diagnosis, NoiseTerm, Verdict};
use crate::thresholds::GOOD_FIT_Z;
use analysis_effects::contract::Group;

/// Largest number of listed blocks with a residual.
const MOST_BLOCKS: usize = 5;

pub(super) fn falsifiers(d: &Diagnosis) -> Section {
    let mut points: Vec<String> = d
        .effects
        .iter()
        .filter(|e| !e.falsified_by.is_empty())
        .map(|e| format!("{}: {}", e.title, e.falsified_by))
        .collect();
    if d.verdict == Verdict::AtNoiseFloor {
        points.push(
            "A further run of these currents, frequencies and temperatures whose gap is \
        larger than its noise."
                .into(),
        );
    }
    let items = if points.is_empty() {
        Vec::new()
    } else {
        vec![Item::List(points)]
    };
    Section::new("What would falsify it", items)
}

pub(super) fn next_experiment(d: &Diagnosis) -> Section {
    let Some(next) = &d.next_experiment else {
        return Section::default();
    };
    let mut points = Vec::new();
    if !next.separates.is_empty() {
        let names: Vec<String> = next.separates.iter().map(|n| titled(n)).collect();
        points.push(format!("Tells apart: {}.", names.join(", ")));
        let (now, then) = (
            times(next.separation_now_sigma),
            times(next.separation_sigma),
        );
        points.push(format!(
            "Expected separation of the closest pair: {then} σ; with the present data {now} σ."
        ));
    }
    points.push(format!(
        "Takes {} min on the bench and moves {} Ah in either direction.",
        plain(next.duration_min),
        plain(next.charge_ah)
    ));
    Section::new(
        "Next experiment",
        vec![
            Item::Text(format!("{}: {}", next.name, next.description)),
            Item::List(points),
        ],
    )
}

pub(super) fn unexplained(d: &Diagnosis) -> Section {
    let (blocks, z) = if d.has_additions() {
        (&d.where_after, d.quality.augmented_z)
    } else {
        (&d.blocks, d.quality.base_z)
    };
    let remaining: Vec<&Block> = blocks.iter().filter(|b| is_significant(b)).collect();
    let mut points: Vec<String> = remaining
        .iter()
        .take(MOST_BLOCKS)
        .map(|b| format!("{}: {}", b.dimension, b.part))
        .collect();
    if remaining.len() > MOST_BLOCKS {
        points.push(format!("and {} more blocks", remaining.len() - MOST_BLOCKS));
    }
    let lead = match (remaining.is_empty(), z >= GOOD_FIT_Z) {
        (true, false) if d.verdict.leaves_a_rest() => {
            "No block of the fitted runs lies outside the noise. What speaks against the model is in \
            the verdict and the notes."
                .to_owned()
        }
        (true, false) => "Nothing beyond the noise.".to_owned(),
        (true, true) => format!(
            "χ² is still {} σ above noise, spread over all blocks.",
            times(z)
        ),
        (false, _) => format!("Still outside the noise (χ² {} σ above it):", times(z)),
    };
    let mut items = vec![Item::Text(lead)];
    if !points.is_empty() {
        items.push(Item::List(points));
    }
    if d.verdict.leaves_a_rest() {
        items.extend(hint(d));
    }
    Section::new("What stays unexplained", items)
}

/// Returns the candidate that helps most without explaining.
fn hint(d: &Diagnosis) -> Option<Item> {
    let excess = d.quality.base_chi2 - d.quality.degrees_of_freedom;
    let helped = d
        .ranking
        .iter()
        .filter(|c| !d.effects.iter().any(|e| e.name == c.name))
        .filter_map(|c| c.lambda.map(|l| (c, l)));
    let (best, lambda) = helped
        .max_by(|a, b| a.1.total_cmp(&b.1))
        .filter(|(_, l)| *l > 0.0 && excess > 0.0)?;
    Some(Item::Text(format!(
        "A hint, not a name: {} helps most; alone it would remove {} of an excess χ² of {} ({}).",
        titled(best.name),
        plain(lambda),
        plain(excess),
        percent(lambda / excess)
    )))
}

pub(super) fn not_claimed(d: &Diagnosis) -> Section {
    let mut points = Vec::new();
    if !d.noise.from_repeats {
        points.push(
            "That the model is at the noise floor: without repeats the floor is unknown."
                .to_owned(),
        );
    }
    if d.verdict == Verdict::AtNoiseFloor {
        points.push("That no effect acts: one too weak for these runs stays hidden.".to_owned());
    }
    if d.verdict == Verdict::Unexplained {
        points.push("A name for what is missing.".to_owned());
    }
    if !d.mechanisms().is_empty() {
        points.push(
            "That the cell follows one of the formulas, nor a value of their parameters."
                .to_owned(),
        );
    } else if d.verdict == Verdict::Mostly {
        points.push("A name for what is left, nor that the cell follows the formula.".to_owned());
    }
    let rivals = d.rivals.iter().map(|r| {
        format!(
            "That it is {} and not {}.",
            titled(r.instead_of),
            titled(r.name)
        )
    });
    points.extend(rivals.filter(|_| matches!(d.verdict, Verdict::Mostly | Verdict::Ambiguous)));
    points.extend(
        d.effects
            .iter()
            .filter(|e| e.group == Group::Bench)
            .map(|e| format!("That the cell has changed: {} sits in the bench.", e.title)),
    );
    let loose = d.effects.iter().flat_map(|e| {
        e.parameters
            .iter()
            .filter(|p| p.sigma.is_none())
            .map(move |p| (e, p))
    });
    points.extend(loose.map(|(e, p)| {
        format!(
            "A value of {} of {}: the data leave it open.",
            p.name, e.name
        )
    }));
    if d.gap.is_empty() && d.gap_spectra.is_empty() {
        points.push("Any better prediction: no run was held out.".to_owned());
    }
    points.push(
        "Anything beyond the currents, frequencies, states of charge and temperatures of \
    this data set."
            .to_owned(),
    );
    Section::new("Not claimed", vec![Item::List(points)])
}

pub(super) fn noise(d: &Diagnosis) -> Section {
    if d.noise.terms.is_empty() {
        return Section::default();
    }
    let source = match d.noise.from_repeats {
        true => {
            "Measured on repeated runs, with the bench's history as prior; never taken from the \
            misfit."
        }
        false => {
            "Assumed, not measured: the data hold no repeats. All significances and scores above \
            stand and fall with it."
        }
    };
    let row = |t: &NoiseTerm| {
        let z = t.z.map_or("–".to_owned(), |z| format!("{} σ", times(z)));
        vec![
            t.name.to_owned(),
            quantity(t.sigma, ""),
            t.history.map_or("–".to_owned(), |h| quantity(h, "")),
            z,
        ]
    };
    let table = Item::Table(
        vec!["Term", "Used", "History of the bench", "Distance from it"],
        d.noise.terms.iter().map(row).collect(),
    );
    Section::new("Noise", vec![Item::Text(source.into()), table])
}

pub(super) fn notes(d: &Diagnosis) -> Section {
    Section::new(
        "Notes",
        if d.notes.is_empty() {
            Vec::new()
        } else {
            vec![Item::List(d.notes.clone())]
        },
    )
}
