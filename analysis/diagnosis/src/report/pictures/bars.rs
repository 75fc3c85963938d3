//! Pictures of bars: the map of the misfit, the ranking of the candidates, the gaps.

use super::super::numbers::{percent, plain, probability, times};
use super::super::{after, counted};
use super::{
    AFTER, ALONE, BEFORE, Kind, NOISE, Picture, effect_names, has_after, is_significant, misfit,
};
use crate::outcome::{Block, Candidate, Diagnosis};
use crate::thresholds::LEAST_SCORE;
use analysis_plot::{AxisSpec, Bar, BarChart, BarGroup, BarPanel, BarRow, Drawing, Reference};

const WIDTH_PX: u32 = 900;
/// Most candidates in the ranking.
const MOST_CANDIDATES: usize = 16;

/// Draws blocks of residuals by their dimension, before and after.
pub(super) fn map(d: &Diagnosis) -> Option<Picture> {
    if d.blocks.is_empty() {
        return None;
    }
    let mut groups: Vec<BarGroup> = Vec::new();
    for block in &d.blocks {
        let row = map_row(d, block);
        match groups.iter_mut().find(|g| g.heading == block.dimension) {
            Some(group) => group.rows.push(row),
            None => groups.push(BarGroup {
                heading: block.dimension.to_owned(),
                rows: vec![row],
            }),
        }
    }
    let sizes = || {
        d.blocks
            .iter()
            .chain(&d.where_after)
            .map(misfit)
            .filter(|m| *m > 0.0 && m.is_finite())
    };
    let (lowest, highest) = (sizes().fold(0.9, f64::min), sizes().fold(2.2, f64::max));
    let legend = if has_after(d) {
        vec![
            ("base model".to_owned(), BEFORE),
            (format!("with {}", effect_names(d)), AFTER),
        ]
    } else {
        vec![("base model".to_owned(), BEFORE)]
    };
    let panel = BarPanel {
        axis: AxisSpec::logarithmic("Misfit as a multiple of the noise").between(lowest, highest),
        baseline: 1.0,
        reference: Some(Reference {
            value: 1.0,
            label: "noise alone".into(),
        }),
        groups,
        note_heading: "probability by noise alone".into(),
    };
    let blocks = counted(d.blocks.len(), "block", "blocks");
    let subtitle = match d.blocks.iter().filter(|b| is_significant(b)).count() {
        0 => format!("None of {blocks} lies outside the noise"),
        significant => format!(
            "{significant} of {blocks} lie outside the noise: those in bold and full colour"
        ),
    };
    let chart = BarChart {
        title: "Where model and measurement disagree".into(),
        subtitle,
        legend,
        panels: vec![panel],
        width_px: WIDTH_PX,
    };
    let caption = "Where model and measurement disagree: residuals divided by frequency, time, \
    current and so on; bars show how many times larger they are than noise.";
    Some(Picture {
        name: "where".into(),
        kind: Kind::Map,
        caption: caption.into(),
        drawing: Drawing::Bars(chart),
    })
}

fn map_row(d: &Diagnosis, block: &Block) -> BarRow {
    let bar = |b: &Block, colour| Bar {
        value: misfit(b),
        colour,
        faint: !is_significant(b),
        text: format!("{}×", times(misfit(b))),
    };
    let later = after(d, block).filter(|_| has_after(d));
    let note = match later {
        Some(a) => format!(
            "{} → {}",
            probability(block.p_value),
            probability(a.p_value)
        ),
        None => probability(block.p_value),
    };
    let bars = [Some(bar(block, BEFORE)), later.map(|a| bar(a, AFTER))]
        .into_iter()
        .flatten()
        .collect();
    BarRow {
        label: block.part.clone(),
        marked: is_significant(block),
        bars,
        note,
    }
}

/// Scores of the candidates with the threshold.
pub(super) fn ranking(d: &Diagnosis) -> Option<Picture> {
    if d.ranking.is_empty() {
        return None;
    }
    let rows = d
        .ranking
        .iter()
        .take(MOST_CANDIDATES)
        .map(ranking_row)
        .collect();
    let title = if d.ranking.iter().any(|c| c.refused_because.is_empty()) {
        "Which effect explains it"
    } else {
        "No effect passes"
    };
    // Words right of the threshold need room even if nothing reaches it.
    let highest = d
        .ranking
        .iter()
        .filter_map(|c| c.score)
        .filter(|s| s.is_finite())
        .fold(5.0 * LEAST_SCORE, f64::max);
    let more = d.ranking.len().saturating_sub(MOST_CANDIDATES);
    let subtitle = match more {
        0 => "First round: what each effect of the catalogue alone gains on the training runs"
            .to_owned(),
        _ => format!(
            "First round: what each effect alone gains on the training runs; {more} more ranked \
            below"
        ),
    };
    let panel = BarPanel {
        axis: AxisSpec::logarithmic("Score λ − k·ln N").between(1.0, highest),
        baseline: 1.0,
        reference: Some(Reference {
            value: LEAST_SCORE,
            label: format!("needed: {LEAST_SCORE}"),
        }),
        groups: vec![BarGroup {
            heading: String::new(),
            rows,
        }],
        note_heading: "outcome".into(),
    };
    let chart = BarChart {
        title: title.into(),
        subtitle,
        legend: Vec::new(),
        panels: vec![panel],
        width_px: WIDTH_PX,
    };
    let caption = "Ranking of the candidates: the score of each, what was needed, and why the \
    others were refused.";
    Some(Picture {
        name: "ranking".into(),
        kind: Kind::Ranking,
        caption: caption.into(),
        drawing: Drawing::Bars(chart),
    })
}

fn ranking_row(candidate: &Candidate) -> BarRow {
    let taken = candidate.refused_because.is_empty();
    let (value, text) = match candidate.score {
        Some(score) => (score, plain(score)),
        None => (f64::NAN, "not fitted".to_owned()),
    };
    let bar = Bar {
        value,
        colour: if taken { AFTER } else { ALONE },
        faint: !taken,
        text,
    };
    let note = if taken {
        "taken".to_owned()
    } else {
        candidate.refused_because.clone()
    };
    BarRow {
        label: candidate.name.to_owned(),
        marked: taken,
        bars: vec![bar],
        note,
    }
}

/// Gaps of the held-out runs.
pub(super) fn gap(d: &Diagnosis) -> Option<Picture> {
    let records = d.gap.iter().map(|g| {
        gap_row(
            d,
            &g.run,
            [g.eis_only_mv, g.base_mv, g.augmented_mv, g.floor_mv],
        )
    });
    let spectra = d.gap_spectra.iter().map(|g| {
        gap_row(
            d,
            &g.run,
            [
                g.eis_only_percent,
                g.base_percent,
                g.augmented_percent,
                g.floor_percent,
            ],
        )
    });
    let panel = |rows: Vec<BarRow>, name: &str| BarPanel {
        axis: AxisSpec::linear(name),
        baseline: 0.0,
        reference: None,
        groups: vec![BarGroup {
            heading: String::new(),
            rows,
        }],
        note_heading: if has_after(d) {
            "gap of spectra alone closed".into()
        } else {
            String::new()
        },
    };
    let panels: Vec<BarPanel> = [
        (records.collect(), "Voltage, rms / mV"),
        (spectra.collect(), "Impedance, rms of |ΔZ| / % of |Z|"),
    ]
    .into_iter()
    .filter(|(rows, _): &(Vec<BarRow>, _)| !rows.is_empty())
    .map(|(rows, name)| panel(rows, name))
    .collect();
    if panels.is_empty() {
        return None;
    }
    let floor = if d.noise.from_repeats {
        "floor: noise and repeatability"
    } else {
        "noise as assumed, no floor"
    };
    let mut legend = vec![
        ("spectra alone".to_owned(), ALONE),
        ("refit".to_owned(), BEFORE),
    ];
    if has_after(d) {
        legend.push((format!("with {}", effect_names(d)), AFTER));
    }
    legend.push((floor.to_owned(), NOISE));
    let subtitle = "Prediction less measurement on runs that no fit has seen".to_owned();
    let chart = BarChart {
        title: "Gap on held-out runs".into(),
        subtitle,
        legend,
        panels,
        width_px: WIDTH_PX,
    };
    let caption = "Gap between prediction and measurement on the held-out runs, against what noise \
    leaves to any model.";
    Some(Picture {
        name: "gap".into(),
        kind: Kind::Gap,
        caption: caption.into(),
        drawing: Drawing::Bars(chart),
    })
}

fn gap_row(d: &Diagnosis, run: &str, [alone, base, augmented, floor]: [f64; 4]) -> BarRow {
    let bar = |value: f64, colour| Bar {
        value,
        colour,
        faint: false,
        text: plain(value),
    };
    let mut bars = vec![bar(alone, ALONE), bar(base, BEFORE)];
    if has_after(d) {
        bars.push(bar(augmented, AFTER));
    }
    bars.push(bar(floor, NOISE));
    let note = if has_after(d) && alone > 0.0 {
        percent(1.0 - augmented / alone)
    } else {
        String::new()
    };
    BarRow {
        label: run.to_owned(),
        marked: false,
        bars,
        note,
    }
}
