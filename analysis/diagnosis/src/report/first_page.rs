//! First page of a report, for an engineer who does not know the method: what disagrees, what is
//! missing or unreliable, and what to do next. It contains no names of the code and no statistics;
//! both are in the details.

use super::numbers::{plain, times, with_values};
use super::page::{Item, Section};
use super::pictures::Kind;
use super::{by_hand, counted, findings, is_significant, misfit, named_title, predictive, shares};
use crate::outcome::{Block, Diagnosis, Gap, SpectrumGap, Verdict};
use analysis_effects::contract::Group;

/// Words for the model file without any change.
pub(super) const AS_GIVEN: &str = "model as given";
/// Words for its parameters fitted again.
pub(super) const REFITTED: &str = "fitted again";

pub(super) fn sections(d: &Diagnosis) -> Vec<Section> {
    let answers = [
        ("What is odd in the data", findings::in_short(d)),
        ("What disagrees", disagreement(d)),
        ("What is missing", missing(d)),
        ("What to distrust", distrust(d)),
        ("What to do next", next(d)),
        ("To predict now", predictive::sentences(d)),
    ];
    let points = answers
        .into_iter()
        .filter(|(_, sentences)| !sentences.is_empty())
        .map(|(question, sentences)| (question, sentences.join(" ")))
        .collect();
    vec![
        Section::new("Verdict", vec![Item::Text(d.summary.clone())]),
        Section::new("In short", vec![Item::Fields(String::new(), points)]),
        held_out(d),
        by_hand::section(d),
    ]
}

/// Returns the misfit of the worst held-out run, and the place of the misfit in the fitted runs.
fn disagreement(d: &Diagnosis) -> Vec<String> {
    if d.verdict == Verdict::Invalid {
        return Vec::new();
    }
    let records: Vec<Row> = d.gap.iter().map(Row::beside_edges).collect();
    let spectra: Vec<Row> = d.gap_spectra.iter().map(Row::of_spectrum).collect();
    let run = worst(&records).or(worst(&spectra));
    let mut sentences: Vec<String> = run.map(|row| row.sentence(d)).into_iter().collect();
    if sentences.is_empty() {
        sentences.push("No run was held out, so that no prediction was tested.".to_owned());
    }
    sentences.push(match outstanding(&d.blocks).as_slice() {
        [] => "In the runs that were fitted, nothing stands out from the noise.".to_owned(),
        places => format!(
            "In the runs that were fitted, the disagreement stands out most {}.",
            places.join(", and ")
        ),
    });
    if d.has_additions() {
        sentences.push(match outstanding(&d.where_after).as_slice() {
            [] => format!("With {} nothing stands out any more.", titles(d)),
            places => format!(
                "With {} it still stands out {}{}.",
                titles(d),
                places.join(", and "),
                if d.verdict.leaves_a_rest() {
                    ""
                } else {
                    ", which is no more than chance and the error of the effects' formulas allow"
                }
            ),
        });
    }
    sentences
}

/// Returns the block of each dimension of time and frequency that exceeds the noise most.
fn outstanding(blocks: &[Block]) -> Vec<String> {
    let of = |dimension: &str| {
        blocks
            .iter()
            .filter(|b| b.dimension == dimension && is_significant(b))
            .max_by(|a, b| misfit(a).total_cmp(&misfit(b)))
    };
    let places: Vec<String> = [of("time since edge"), of("frequency")]
        .into_iter()
        .flatten()
        .map(place)
        .collect();
    if !places.is_empty() {
        return places;
    }
    // A deviation that shows in neither is described by the blocks in which it shows.
    let other = blocks.iter().find(|b| is_significant(b));
    other.map(place).into_iter().collect()
}

/// Describes a block as text: "5 to 60 s after a change of the current, at rest (3.2 mV)".
fn place(block: &Block) -> String {
    let part = shortened(&block.part);
    let size = match block.dimension {
        "frequency" | "harmonic" => format!("{} % of |Z|", plain(0.1 * block.rms)),
        _ => format!("{} mV", plain(block.rms)),
    };
    let words = match (block.dimension, part.rsplit_once(", ")) {
        ("time since edge", Some((span, phase))) => {
            let phase = if phase == "rest" { "at rest" } else { phase };
            format!("{span} after a change of the current, {phase}")
        }
        ("time since edge", None) => format!("{part} after a change of the current"),
        ("frequency", _) => format!("in the spectra, {part}"),
        ("harmonic", Some((order, band))) => format!("in the {order} harmonic, {band}"),
        ("sign", _) => format!("under {part}"),
        (dimension, _) => format!("at {dimension} {part}"),
    };
    format!("{words} ({size} rms)")
}

/// Returns a text whose numbers have three significant digits.
fn shortened(text: &str) -> String {
    let word = |word: &str| match word.parse::<f64>() {
        Ok(value) if word.contains('.') => plain(value),
        _ => word.to_owned(),
    };
    text.split(' ').map(word).collect::<Vec<_>>().join(" ")
}

fn missing(d: &Diagnosis) -> Vec<String> {
    let named: Vec<String> = d
        .effects
        .iter()
        .map(|effect| with_values(effect.title, &effect.parameters))
        .collect();
    let named = named.join("; and ");
    match d.verdict {
        Verdict::Invalid => Vec::new(),
        Verdict::AtNoiseFloor => {
            vec!["Nothing that these runs could show; a weaker effect stays hidden.".to_owned()]
        }
        Verdict::Explained => vec![format!("{named}.")],
        Verdict::Mostly if d.effects.is_empty() => shares::sentences(d),
        Verdict::Mostly => {
            let mut sentences = vec![format!("Mostly {named}.")];
            sentences.extend(as_well(d));
            sentences.push(
                "Its form differs from the formula, or something smaller is missing beside it."
                    .to_owned(),
            );
            sentences
        }
        Verdict::Ambiguous => {
            let mut sentences = vec![format!("Something. What fits best is {named}.")];
            sentences.extend(as_well(d));
            sentences
        }
        Verdict::Unexplained if d.effects.is_empty() => {
            vec!["No effect of the catalogue passes every test, so that none is named.".to_owned()]
        }
        Verdict::Unexplained => vec![
            format!("A part of it is {named}."),
            "No effect of the catalogue explains the rest.".to_owned(),
        ],
    }
}

/// Returns the effects that do as well as the named ones.
fn as_well(d: &Diagnosis) -> Option<String> {
    let rivals: Vec<String> = d.rivals.iter().map(|r| named_title(r.name)).collect();
    let or = rivals.join(", or ");
    (!or.is_empty()).then(|| format!("It could equally be {or}: these runs cannot decide."))
}

fn distrust(d: &Diagnosis) -> Vec<String> {
    if d.verdict == Verdict::Invalid {
        return vec!["The runs that the verdict names. Nothing was compared.".to_owned()];
    }
    let mut sentences = Vec::new();
    if !d.noise.from_repeats {
        sentences.push(
            "The noise: it is assumed because too few runs were repeated, and every judgement here \
            depends on it."
                .to_owned(),
        );
    }
    let of_bench = d.effects.iter().filter(|e| e.group == Group::Bench);
    sentences.extend(of_bench.map(|e| {
        format!(
            "The bench: {} belongs to the measurement and not to the cell.",
            e.title
        )
    }));
    let open = d
        .effects
        .iter()
        .filter(|e| e.parameters.iter().any(|p| p.sigma.is_none()));
    sentences.extend(open.map(|e| format!("One value of {}: these runs leave it open.", e.title)));
    if !d.mechanisms().is_empty() {
        sentences.push(
            "Values of the formulas: several formulas describe one mechanism, and none exactly."
                .to_owned(),
        );
    } else if d.verdict.leaves_a_rest() {
        sentences.push(
            "Predictions of the model for other runs: what it lacks is not known.".to_owned(),
        );
    }
    sentences
}

fn next(d: &Diagnosis) -> Vec<String> {
    if let Some(next) = &d.next_experiment {
        let mut sentences = vec![format!(
            "Measure this: {} ({} min, {} Ah in either direction).",
            next.description.trim_end_matches('.'),
            plain(next.duration_min),
            plain(next.charge_ah)
        )];
        let names: Vec<String> = next.separates.iter().map(|n| named_title(n)).collect();
        match (names.as_slice(), next.settles) {
            ([], _) => {}
            ([one], true) => sentences.push(format!("It should settle whether it is {one}.")),
            ([one], false) => sentences.push(format!("It helps to decide whether it is {one}.")),
            ([names @ .., last], settles) => sentences.push(format!(
                "It {} separate {} and {last}.",
                if settles { "should" } else { "helps to" },
                names.join(", ")
            )),
        }
        return sentences;
    }
    let text = match d.verdict {
        Verdict::Invalid => "Repair what is named above and measure these runs again.",
        Verdict::AtNoiseFloor => {
            "Use the model, within the currents, frequencies, states of charge and temperatures of \
            these runs."
        }
        Verdict::Explained => {
            "Use the model with what was added, within the currents, frequencies, states of charge \
            and temperatures of these runs. The details name a run that could contradict it."
        }
        Verdict::Mostly | Verdict::Ambiguous | Verdict::Unexplained => {
            "No run that the program can plan would add information. Look at the details: where it \
            disagrees, and what was refused for which reason."
        }
    };
    vec![text.to_owned()]
}

/// One held-out run: the error of every model over the same rows, and their noise.
pub(super) struct Row {
    pub(super) run: String,
    /// Rows that are compared; empty without a choice.
    pub(super) rows: &'static str,
    pub(super) alone: f64,
    pub(super) base: f64,
    pub(super) augmented: f64,
    pub(super) floor: f64,
    pub(super) unit: &'static str,
}

impl Row {
    /// Over the rows beside the edges of the current.
    pub(super) fn beside_edges(gap: &Gap) -> Self {
        Self {
            run: gap.run.clone(),
            rows: if gap.edge_samples > 0 {
                "between edges"
            } else {
                ""
            },
            alone: gap.eis_only_mv,
            base: gap.base_mv,
            augmented: gap.augmented_mv,
            floor: gap.floor_mv,
            unit: "mV",
        }
    }

    /// Creates the row over all rows, or `None` if it is equal.
    pub(super) fn with_edges(gap: &Gap) -> Option<Self> {
        (gap.edge_samples > 0).then(|| Self {
            run: gap.run.clone(),
            rows: "with edges",
            alone: gap.eis_only_with_edges_mv,
            base: gap.base_with_edges_mv,
            augmented: gap.augmented_with_edges_mv,
            floor: gap.floor_with_edges_mv,
            unit: "mV",
        })
    }

    pub(super) fn of_spectrum(gap: &SpectrumGap) -> Self {
        Self {
            run: gap.run.clone(),
            rows: "",
            alone: gap.eis_only_percent,
            base: gap.base_percent,
            augmented: gap.augmented_percent,
            floor: gap.floor_percent,
            unit: "%",
        }
    }

    fn value(&self, value: f64) -> String {
        format!("{} {}", plain(value), self.unit)
    }

    fn sentence(&self, d: &Diagnosis) -> String {
        let of = if self.unit == "%" { " of |Z|" } else { "" };
        let mut text = format!(
            "In {}, which no fit has seen, the {AS_GIVEN} is wrong by {}{of} (rms), {REFITTED} by {}",
            self.run,
            self.value(self.alone),
            self.value(self.base)
        );
        if d.has_additions() {
            let added = format!(", with what was added by {}", self.value(self.augmented));
            text.push_str(&added);
        }
        let noise = if d.noise.from_repeats {
            "noise"
        } else {
            "the assumed noise"
        };
        text.push_str(&format!(
            "; {noise} alone makes {}.",
            self.value(self.floor)
        ));
        let last = if d.has_additions() {
            self.augmented
        } else {
            self.base
        };
        if last > self.floor && self.floor > 0.0 {
            text.push_str(&format!(
                " What is left is {} times the noise.",
                times(last / self.floor)
            ));
        }
        text
    }
}

/// Returns the run that the model as given misses most.
fn worst(rows: &[Row]) -> Option<&Row> {
    rows.iter().max_by(|a, b| a.alone.total_cmp(&b.alone))
}

/// Pictures and a table of all held-out runs.
fn held_out(d: &Diagnosis) -> Section {
    let records = d.gap.iter().flat_map(|gap| {
        let beside = Row::beside_edges(gap);
        std::iter::once(beside).chain(Row::with_edges(gap))
    });
    let rows: Vec<Row> = records
        .chain(d.gap_spectra.iter().map(Row::of_spectrum))
        .collect();
    if rows.is_empty() {
        return Section::default();
    }
    let edges = rows.iter().any(|row| !row.rows.is_empty());
    let noise = if d.noise.from_repeats {
        "Noise"
    } else {
        "Assumed noise"
    };
    let mut header = vec![
        "Run",
        "Rows",
        "Model as given",
        "Fitted again",
        "With additions",
        noise,
    ];
    if !d.has_additions() {
        header.remove(4);
    }
    if !edges {
        header.remove(1);
    }
    let cells = |row: &Row| {
        let mut cells = vec![row.run.clone()];
        if edges {
            cells.push(if row.rows.is_empty() {
                "all".to_owned()
            } else {
                row.rows.to_owned()
            });
        }
        cells.extend([row.value(row.alone), row.value(row.base)]);
        if d.has_additions() {
            cells.push(row.value(row.augmented));
        }
        cells.push(row.value(row.floor));
        cells
    };
    let mut text = "Prediction less measurement, root mean square, and what noise alone makes of \
        the same rows."
        .to_owned();
    if edges {
        text.push_str(
            " Where a logger does not record when the current changed, the rows at that edge say \
            little about the model: they are counted apart.",
        );
    }
    let table = Item::Table(header, rows.iter().map(cells).collect());
    let runs = counted(d.gap.len() + d.gap_spectra.len(), "run", "runs");
    Section::new(
        "Held-out runs",
        vec![
            Item::Text(format!("{runs} that no fit has seen. {text}")),
            Item::Pictures(Kind::HeldOut),
            table,
        ],
    )
}

/// Returns the named effects, or mechanisms, as text.
pub(super) fn titles(d: &Diagnosis) -> String {
    let effects = d.effects.iter().map(|e| e.title);
    let mechanisms = d.mechanisms().into_iter().map(|share| share.title);
    let titles: Vec<&str> = effects.chain(mechanisms).collect();
    titles.join(" and ")
}

/// First section of the details: the terms that the first page does without.
pub(super) fn details() -> Section {
    let terms = [
        "Residual: measured less predicted. Whitened residuals are divided by their noise, so that \
        noise alone gives independent numbers of standard deviation 1 (σ).",
        "χ²: the sum of squares of whitened residuals. Noise alone gives about as much as there are \
        degrees of freedom: rows less fitted parameters.",
        "Block: residuals that have something in common, such as a band of frequencies. A block is \
        judged without what a change of the fitted parameters could take up.",
        "λ: the part of χ² that an effect takes away. Score: λ less what as many free parameters \
        take from noise.",
        "p: probability that noise alone gives as much.",
    ];
    let items = vec![Item::List(terms.map(str::to_owned).to_vec())];
    Section::on_new_page("Details", items)
}
