//! Sections of a diagnosis: the place of the misfit, the named effects, their certainty, their
//! rivals, and the remaining gap.

use super::numbers::{Unit, percent, plain, probability, times};
use super::page::{Item, Page, Section};
use super::pictures::Kind;
use super::{
    after, counted, findings, first_page, is_significant, misfit, predictive, reserve, shares,
    titled,
};
use crate::{
    attempts::is_outside,
    outcome::{Block, Diagnosis, Gap, NamedEffect, SpectrumGap, Verdict},
    thresholds::{LEAST_SCORE, SIGNIFICANT_P},
};
use analysis_effects::{contract::Group, effects};

/// Maximum number of blocks listed in text; the picture shows all.
const MOST_BLOCKS: usize = 8;
/// Maximum number of candidates listed in text.
const MOST_CANDIDATES: usize = 6;

pub(super) fn page(d: &Diagnosis) -> Page {
    let title = format!(
        "{}: {} against model {}",
        verdict_words(d),
        d.data_set,
        d.model
    );
    let mut sections = first_page::sections(d);
    sections.push(first_page::details());
    sections.push(findings::details(d));
    if d.verdict != Verdict::Invalid {
        sections.extend([
            location(d),
            what(d),
            how_sure(d),
            what_else(d),
            gap(d),
            predictive::section(d),
            reserve::falsifiers(d),
        ]);
    }
    sections.push(reserve::next_experiment(d));
    if d.verdict != Verdict::Invalid {
        sections.extend([reserve::unexplained(d), reserve::not_claimed(d)]);
    }
    sections.extend([reserve::noise(d), reserve::notes(d)]);
    Page { title, sections }
}

fn verdict_words(d: &Diagnosis) -> &'static str {
    match d.verdict {
        Verdict::AtNoiseFloor if !d.noise.from_repeats => "Nothing found beyond the assumed noise",
        Verdict::AtNoiseFloor => "At the noise floor",
        Verdict::Explained => "Explained",
        Verdict::Mostly => "Mostly explained",
        Verdict::Ambiguous => "Ambiguous",
        Verdict::Unexplained => "Unexplained",
        Verdict::Invalid => "Data not usable",
    }
}

fn location(d: &Diagnosis) -> Section {
    let significant: Vec<&Block> = d.blocks.iter().filter(|b| is_significant(b)).collect();
    if d.blocks.is_empty() {
        return Section::default();
    }
    let rule = format!(
        "p < {SIGNIFICANT_P} by noise alone, after Holm's correction for the number of blocks"
    );
    let blocks = counted(d.blocks.len(), "block", "blocks");
    let mut items = vec![match significant.first() {
        None => Item::Text(format!(
            "None of {blocks} of residuals lies outside the noise ({rule})."
        )),
        Some(worst) => Item::Text(format!(
            "The base model misses {} of {blocks} of residuals by more than noise ({rule}). Most \
            significant: {}, {}.{}",
            significant.len(),
            worst.dimension,
            worst.part,
            left_over(d, &significant)
        )),
    }];
    if !significant.is_empty() {
        items.push(block_table(d, &significant));
        items.push(Item::Text(
            "Misfit / noise is the root of χ² over its expectation, outside what the model's own \
            parameters can take up: 1 is noise alone. The mean residual is in standard deviations \
            of that mean."
                .into(),
        ));
    }
    items.extend([Kind::Map, Kind::Time, Kind::Spectrum].map(Item::Pictures));
    Section::new("Where", items)
}

/// Returns the number of blocks outside the noise with the named effects, and why it may be more
/// than before.
fn left_over(d: &Diagnosis, before: &[&Block]) -> String {
    if !d.has_additions() {
        return String::new();
    }
    let left: Vec<&Block> = d.where_after.iter().filter(|b| is_significant(b)).collect();
    let were = |b: &&&Block| {
        before
            .iter()
            .any(|a| (a.dimension, &a.part) == (b.dimension, &b.part))
    };
    let stay = left.iter().filter(were).count();
    let come = left.len() - stay;
    let is_are = |count: usize| if count == 1 { "is" } else { "are" };
    let mut text = match stay {
        0 => " With the named effects none of them is left.".to_owned(),
        _ => format!(
            " With the named effects {stay} of them {} left.",
            is_are(stay)
        ),
    };
    if come > 0 {
        text.push_str(&format!(
            " {come} {} outside then that {} not before: another model takes other residuals up, \
            and what the refitted base had spread over many blocks can show in one.",
            if come == 1 { "other is" } else { "others are" },
            if come == 1 { "was" } else { "were" }
        ));
    }
    text
}

fn block_table(d: &Diagnosis, blocks: &[&Block]) -> Item {
    let mut header = vec![
        "Block",
        "Misfit / noise",
        "Mean",
        "p",
        "RMS",
        "Misfit after",
        "p after",
    ];
    header.truncate(if d.has_additions() { 7 } else { 5 });
    let row = |b: &&Block| {
        let part = format!("{}: {}", b.dimension, b.part);
        let later = after(d, b).filter(|_| d.has_additions());
        let unit = if matches!(b.dimension, "frequency" | "harmonic") {
            "‰ of |Z|"
        } else {
            "mV"
        };
        let before = [
            part,
            times(misfit(b)),
            format!("{} σ", times(b.mean_z)),
            probability(b.p_value),
            format!("{} {unit}", plain(b.rms)),
        ];
        let later = [
            later.map_or("–".to_owned(), |a| times(misfit(a))),
            later.map_or("–".to_owned(), |a| probability(a.p_value)),
        ];
        before.into_iter().chain(later).take(header.len()).collect()
    };
    let rows = blocks.iter().take(MOST_BLOCKS).map(row).collect();
    Item::Table(header.clone(), rows)
}

fn what(d: &Diagnosis) -> Section {
    let one = |e: &NamedEffect| {
        let place = match e.group {
            Group::Cell => "Physics of the cell: belongs into predictions.",
            Group::Bench => {
                "An artefact of the bench: explains the measurement, has no place in predictions."
            }
        };
        let mechanism = effects::find(e.name).map_or("", |effect| effect.card().mechanism);
        let name = format!("{} ({}).", e.title, e.name);
        [name.as_str(), mechanism, place]
            .into_iter()
            .filter(|s| !s.is_empty())
            .collect::<Vec<_>>()
            .join(" ")
    };
    let lead = match d.verdict {
        Verdict::Explained => "Missing in the base model and added:",
        Verdict::Ambiguous => {
            "Something is missing. The best representative of what fits, not the only one \
            (see \"What else it could be\"):"
        }
        Verdict::Mostly if d.effects.is_empty() => {
            "Mechanisms are named, not formulas: those of the catalogue that stand for them predict the \
            runs, and the form of none is certain."
        }
        Verdict::Mostly => {
            "Missing in the base model and added; what is left is far smaller, and has no name:"
        }
        _ if d.effects.is_empty() => "No effect is named.",
        _ => "Added so far; it does not explain everything:",
    };
    let mut items = vec![Item::Text(lead.to_owned())];
    if !d.effects.is_empty() {
        items.push(Item::List(d.effects.iter().map(one).collect()));
    }
    items.extend(shares::table(d));
    Section::new("What", items)
}

fn how_sure(d: &Diagnosis) -> Section {
    let mut items = Vec::new();
    if !d.effects.is_empty() {
        items.push(Item::Text(
            "Parameters with standard uncertainty, and why they were added:".into(),
        ));
        items.push(parameters(&d.effects));
        items.push(evidence(&d.effects));
        items.push(Item::Text(format!(
            "λ is the χ² that the effect removes from the training runs. The score is λ less k·ln \
            N for its k parameters; {LEAST_SCORE} are needed. The excess is χ² less its \
            degrees of freedom."
        )));
    }
    let q = &d.quality;
    let mut fit = format!("Fit to the training runs: χ² {}", plain(q.base_chi2));
    if d.has_additions() {
        fit.push_str(&format!(
            " without and {} with the named effects",
            plain(q.augmented_chi2)
        ));
    }
    fit.push_str(&format!(
        " for {} degrees of freedom, {} σ",
        plain(q.degrees_of_freedom),
        times(q.base_z)
    ));
    if d.has_additions() {
        fit.push_str(&format!(" and {} σ", times(q.augmented_z)));
    }
    fit.push_str(" above what noise alone would give.");
    items.push(Item::Text(fit));
    Section::new("How sure", items)
}

fn parameters(effects: &[NamedEffect]) -> Item {
    let rows = effects.iter().flat_map(|e| {
        e.parameters.iter().map(|p| {
            let (low, high) = p.interval;
            let unit = Unit::of(p.value, p.sigma.unwrap_or((high - low).abs() / 4.0), p.unit);
            let sigma = p
                .sigma
                .map_or("not fixed by the data".to_owned(), |s| unit.with_unit(s));
            let interval = format!("{} … {}", unit.number(low), unit.with_unit(high));
            vec![
                e.name.to_owned(),
                p.name.to_owned(),
                unit.with_unit(p.value),
                sigma,
                interval,
            ]
        })
    });
    Item::Table(
        vec!["Effect", "Parameter", "Value", "σ", "95 % interval"],
        rows.collect(),
    )
}

fn evidence(effects: &[NamedEffect]) -> Item {
    let row = |e: &NamedEffect| {
        let v = &e.evidence;
        vec![
            e.name.to_owned(),
            plain(v.lambda),
            plain(v.score),
            percent(v.share_of_excess),
            plain(v.held_out_change),
            format!("{} % of the noise", plain(100.0 * v.integration_error)),
        ]
    };
    let header = vec![
        "Effect",
        "λ",
        "Score",
        "Part of the excess removed",
        "Change of held-out χ²",
        "Error of integration",
    ];
    Item::Table(header, effects.iter().map(row).collect())
}

fn what_else(d: &Diagnosis) -> Section {
    let mut items = Vec::new();
    if !d.rivals.is_empty() {
        let row = |r: &crate::Rival| {
            vec![
                titled(r.name),
                titled(r.instead_of),
                plain(r.score_gap),
                format!("{:.3}", r.discriminability),
            ]
        };
        items.push(Item::Text(
            "These effects explain the data about as well:".into(),
        ));
        items.push(Item::Table(
            vec![
                "Rival",
                "Instead of",
                "Score less that of the named one",
                "r",
            ],
            d.rivals.iter().map(row).collect(),
        ));
        items.push(Item::Text(
            "r is the part of the named effect's λ that the rival cannot imitate on these data: 0 \
            identical, 1 distinct."
                .into(),
        ));
    } else if !d.effects.is_empty() {
        let text = if d.verdict == Verdict::Explained {
            "No other effect of the catalogue explains these data as well."
        } else {
            "No other effect does as well as a named one. The verdict states why the names are not \
            the whole truth."
        };
        items.push(Item::Text(text.into()));
    }
    if !d.ranking.is_empty() {
        let row = |c: &crate::Candidate| {
            let outcome = if c.refused_because.is_empty() {
                "taken"
            } else {
                &c.refused_because
            };
            let number = |v: Option<f64>| v.map_or("–".to_owned(), plain);
            vec![
                c.name.to_owned(),
                plain(c.lagrange),
                number(c.lambda),
                number(c.score),
                outcome.to_owned(),
            ]
        };
        let rows: Vec<_> = d.ranking.iter().take(MOST_CANDIDATES).map(row).collect();
        let of = if rows.len() < d.ranking.len() {
            format!("the best {} of {}", rows.len(), d.ranking.len())
        } else {
            "best first".to_owned()
        };
        items.push(Item::Text(format!(
            "Candidates of the first round, {of}{}:",
            laws(d)
        )));
        items.push(Item::Table(
            vec!["Candidate", "Lagrange score", "λ", "Score", "Outcome"],
            rows,
        ));
    }
    items.push(Item::Pictures(Kind::Ranking));
    Section::new("What else it could be", items)
}

/// Sentence on the number of candidates that are in the catalogue, and on the use of the others.
fn laws(d: &Diagnosis) -> String {
    let outside = d.ranking.iter().filter(|c| is_outside(c.name)).count();
    if outside == 0 {
        return String::new();
    }
    format!(
        "; {} of the catalogue and {} outside it (`outside_…`), never named: where one of these \
        explains the data better, a name is withdrawn",
        d.ranking.len() - outside,
        counted(outside, "law", "laws")
    )
}

fn gap(d: &Diagnosis) -> Section {
    if d.gap.is_empty() && d.gap_spectra.is_empty() {
        return Section::new(
            "Gap on held-out runs",
            vec![Item::Text(
                "No run was held out: nothing is said about other runs than those fitted.".into(),
            )],
        );
    }
    let mut items = Vec::new();
    let mut table = |rows: Vec<GapRow<'_>>, unit: &str, lead: &str| {
        if !rows.is_empty() {
            items.push(Item::Text(lead.to_owned()));
            items.push(gap_table(d, &rows, unit));
            items.extend(gap_sentence(d, &rows, unit));
        }
    };
    table(
        d.gap.iter().map(GapRow::from).collect(),
        "mV",
        "Records in time:",
    );
    table(
        d.gap_spectra.iter().map(GapRow::from).collect(),
        "%",
        "Spectra, |ΔZ| as a part of |Z|:",
    );
    let floor = match d.noise.from_repeats {
        true => {
            "The floor is what noise and repeatability, measured on repeats, leave to any model."
        }
        false => "The data hold no repeats: the noise is assumed, and no floor is claimed.",
    };
    items.push(Item::Text(format!(
        "Root mean square of prediction less measurement. \"Spectra alone\" is the model file as \
        it came, \"refit\" its parameters fitted again to spectra and training runs. \"Closed\" is \
        the part of the gap of spectra alone. {floor}"
    )));
    items.push(Item::Pictures(Kind::Gap));
    Section::new("Gap on held-out runs", items)
}

/// A gap in time or frequency, in its unit.
struct GapRow<'a> {
    run: &'a str,
    alone: f64,
    base: f64,
    augmented: f64,
    floor: f64,
}

impl<'a> From<&'a Gap> for GapRow<'a> {
    fn from(g: &'a Gap) -> Self {
        Self {
            run: &g.run,
            alone: g.eis_only_mv,
            base: g.base_mv,
            augmented: g.augmented_mv,
            floor: g.floor_mv,
        }
    }
}

impl<'a> From<&'a SpectrumGap> for GapRow<'a> {
    fn from(g: &'a SpectrumGap) -> Self {
        Self {
            run: &g.run,
            alone: g.eis_only_percent,
            base: g.base_percent,
            augmented: g.augmented_percent,
            floor: g.floor_percent,
        }
    }
}

fn gap_table(d: &Diagnosis, rows: &[GapRow<'_>], unit: &str) -> Item {
    let floor = if d.noise.from_repeats {
        "Floor"
    } else {
        "Assumed noise"
    };
    let value = |v: f64| format!("{} {unit}", plain(v));
    if !d.has_additions() {
        let row = |r: &GapRow<'_>| {
            vec![
                r.run.to_owned(),
                value(r.alone),
                value(r.base),
                value(r.floor),
                closed(r.alone, r.base),
            ]
        };
        return Item::Table(
            vec![
                "Run",
                "Spectra alone",
                "Refit",
                floor,
                "Closed by the refit",
            ],
            rows.iter().map(row).collect(),
        );
    }
    let row = |r: &GapRow<'_>| {
        let ends = [
            value(r.alone),
            value(r.base),
            value(r.augmented),
            value(r.floor),
            closed(r.alone, r.augmented),
            closed(r.base, r.augmented),
        ];
        [r.run.to_owned()].into_iter().chain(ends).collect()
    };
    let header = vec![
        "Run",
        "Spectra alone",
        "Refit",
        "With effects",
        floor,
        "Closed",
        "of refit",
    ];
    Item::Table(header, rows.iter().map(row).collect())
}

fn gap_sentence(d: &Diagnosis, rows: &[GapRow<'_>], unit: &str) -> Option<Item> {
    let together = |of: &dyn Fn(&GapRow<'_>) -> f64| {
        (rows.iter().map(|r| of(r).powi(2)).sum::<f64>() / rows.len() as f64).sqrt()
    };
    let (alone, augmented) = (together(&|r| r.alone), together(&|r| r.augmented));
    let runs = counted(rows.len(), "run", "runs");
    (d.has_additions() && rows.len() > 1).then(|| {
        let (before, later, part) = (plain(alone), plain(augmented), closed(alone, augmented));
        Item::Text(format!(
            "The {runs} together: {before} → {later} {unit}, {part} of the gap of \
        spectra alone closed."
        ))
    })
}

/// Part of a gap that is closed; a gap that grew has a minus.
fn closed(before: f64, after: f64) -> String {
    if before > 0.0 {
        percent(1.0 - after / before)
    } else {
        "–".to_owned()
    }
}
