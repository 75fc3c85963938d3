//! Catalogue of effects as text, and the effects that a data set can separate.

use super::Picture;
use super::page::{Item, Page, Section};
use crate::thresholds::{APART_SIGMA, HARD_TO_TELL_R};
use analysis_effects::contract::{Card, Group};
use analysis_plot::{Drawing, HeatMap, HeatScale};

/// Maximum number of columns of the matrix side by side in text.
const COLUMNS: usize = 14;

/// Distinguishability of effects by a data set. Row: the effect that acts; column: the one that
/// tries to imitate it.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Distinguishability {
    /// Names of the effects.
    pub labels: Vec<String>,
    /// r: part of the row's λ that the column cannot imitate; 0 identical, 1 distinct; not a number
    /// where unknown.
    pub r: Vec<Vec<f64>>,
    /// √λ that remains to separate the row from the column, σ, at the assumed strength of each
    /// effect.
    pub separation_sigma: Vec<Vec<f64>>,
}

/// Returns the catalogue for a terminal, with the matrix of a data set if there is one.
pub fn catalogue_text(cards: &[&Card], matrix: Option<&Distinguishability>) -> String {
    page(cards, matrix).text()
}

/// Returns the catalogue as Markdown; `pictures` are those of [`Distinguishability::pictures`],
/// expected as `NAME.png` beside the text.
pub fn catalogue_markdown(
    cards: &[&Card],
    matrix: Option<&Distinguishability>,
    pictures: &[Picture],
) -> String {
    page(cards, matrix).markdown(pictures)
}

impl Distinguishability {
    /// Returns the matrix of r, and that of the separation if one is given; empty for an empty
    /// matrix.
    pub fn pictures(&self) -> Vec<Picture> {
        let r = Shown {
            name: "distinguishability",
            title: "Which effects these data can separate",
            subtitle: "r: part of the row's effect that the column's cannot imitate",
            scale: HeatScale {
                ends: (0.0, 1.0),
                end_labels: ("identical".into(), "distinct".into()),
                decimals: 2,
            },
        };
        let separation = Shown {
            name: "separation",
            title: "Separation of effects in standard deviations",
            subtitle: "√λ that is left to separate the row's effect from the column's",
            scale: HeatScale {
                ends: (0.0, 10.0),
                end_labels: ("σ, not separated".into(), "σ or more, separated".into()),
                decimals: 1,
            },
        };
        let shown = [(r, &self.r), (separation, &self.separation_sigma)];
        shown
            .into_iter()
            .filter(|(_, values)| values.iter().flatten().any(|v| v.is_finite()))
            .map(|(s, values)| self.picture(s, values))
            .collect()
    }

    fn picture(&self, shown: Shown, values: &[Vec<f64>]) -> Picture {
        // An effect imitates itself, so the diagonal has no information.
        let off = |(a, row): (usize, &Vec<f64>)| {
            row.iter()
                .enumerate()
                .map(|(b, v)| if a == b { f64::NAN } else { *v })
                .collect()
        };
        let map = HeatMap {
            title: shown.title.to_owned(),
            subtitle: shown.subtitle.to_owned(),
            labels: (self.labels.clone(), self.labels.clone()),
            values: values.iter().enumerate().map(off).collect(),
            scale: shown.scale,
        };
        let caption = format!("{}. {}.", shown.title, shown.subtitle);
        Picture {
            name: shown.name.to_owned(),
            kind: super::Kind::Matrix,
            caption,
            drawing: Drawing::Heat(map),
        }
    }

    fn at(values: &[Vec<f64>], a: usize, b: usize) -> Option<f64> {
        values
            .get(a)
            .and_then(|row| row.get(b))
            .copied()
            .filter(|v| v.is_finite())
    }

    /// Returns the pairs that are hard to separate, the hardest first.
    fn hard_pairs(&self) -> Vec<Vec<String>> {
        let all = (0..self.labels.len()).flat_map(|a| (0..self.labels.len()).map(move |b| (a, b)));
        let mut pairs: Vec<(usize, usize, f64)> = all
            .filter(|(a, b)| a != b)
            .filter_map(|(a, b)| Self::at(&self.r, a, b).map(|r| (a, b, r)))
            .filter(|p| p.2 < HARD_TO_TELL_R)
            .collect();
        pairs.sort_by(|x, y| x.2.total_cmp(&y.2));
        let row = |(a, b, r): &(usize, usize, f64)| {
            let separation = Self::at(&self.separation_sigma, *a, *b);
            let sigma = separation.map_or("–".to_owned(), |s| format!("{s:.1} σ"));
            let separated = separation.map_or("–", |s| if s >= APART_SIGMA { "yes" } else { "no" });
            vec![
                self.labels[*a].clone(),
                self.labels[*b].clone(),
                format!("{r:.3}"),
                sigma,
                separated.to_owned(),
            ]
        };
        pairs.iter().map(row).collect()
    }

    /// Returns the matrix in columns of numbers, as many beside each other as a terminal holds.
    fn numbers(&self) -> String {
        let most = self
            .labels
            .iter()
            .map(|l| l.chars().count())
            .max()
            .unwrap_or(0);
        let mut out = String::new();
        let columns: Vec<usize> = (0..self.labels.len()).collect();
        for part in columns.chunks(COLUMNS) {
            let head: String = part.iter().map(|b| format!("{:>5}", b + 1)).collect();
            out.push_str(&format!("{:most$}    {head}\n", ""));
            for (a, label) in self.labels.iter().enumerate() {
                let cell = |b: &usize| match Self::at(&self.r, a, *b) {
                    _ if a == *b => "    ·".to_owned(),
                    Some(r) => format!("{r:5.2}"),
                    None => "    –".to_owned(),
                };
                out.push_str(&format!(
                    "{label:<most$} {:>3}{}\n",
                    a + 1,
                    part.iter().map(cell).collect::<String>()
                ));
            }
            out.push('\n');
        }
        out
    }
}

/// Format of one matrix.
struct Shown {
    name: &'static str,
    title: &'static str,
    subtitle: &'static str,
    scale: HeatScale,
}

fn page(cards: &[&Card], matrix: Option<&Distinguishability>) -> Page {
    let mut sections = Vec::new();
    for (group, heading) in [
        (Group::Cell, "Cell: physics that a prediction needs"),
        (
            Group::Bench,
            "Bench: artefacts that a prediction must not have",
        ),
    ] {
        let inside: Vec<&Card> = cards.iter().copied().filter(|c| c.group == group).collect();
        if inside.is_empty() {
            continue;
        }
        let overview = inside
            .iter()
            .map(|c| {
                vec![
                    c.name.to_owned(),
                    c.title.to_owned(),
                    c.signature.to_owned(),
                ]
            })
            .collect();
        let mut items = vec![Item::Table(
            vec!["Effect", "In words", "Signature"],
            overview,
        )];
        items.extend(inside.iter().map(|c| card(c)));
        sections.push(Section::new(heading, items));
    }
    sections.extend(
        matrix
            .filter(|m| !m.labels.is_empty())
            .map(separation_section),
    );
    Page {
        title: format!(
            "{} that a model may lack",
            super::counted(cards.len(), "effect", "effects")
        ),
        sections,
    }
}

fn card(c: &Card) -> Item {
    let fields = vec![
        ("mechanism", c.mechanism.to_owned()),
        ("state equation", c.state_equation.to_owned()),
        ("impedance", c.impedance.to_owned()),
        ("source", c.source.to_owned()),
        ("signature", c.signature.to_owned()),
        (
            "looks like",
            if c.confounders.is_empty() {
                "nothing else here".to_owned()
            } else {
                c.confounders.join(", ")
            },
        ),
        (
            "contains",
            if c.contains.is_empty() {
                "none".to_owned()
            } else {
                c.contains.join(", ")
            },
        ),
        ("decided by", c.experiment.to_owned()),
    ];
    Item::Fields(format!("{}: {}", c.name, c.title), fields)
}

fn separation_section(matrix: &Distinguishability) -> Section {
    let mut items = vec![Item::Text(
        "r is the part of an effect's λ that another effect, fitted with all parameters of the \
        base model, cannot imitate on these data: 0 identical, 1 distinct. √λ is what is left to \
        separate them, in standard deviations."
            .into(),
    )];
    let pairs = matrix.hard_pairs();
    if pairs.is_empty() {
        items.push(Item::Text(format!(
            "Every pair has r of {HARD_TO_TELL_R} or more."
        )));
    } else {
        items.push(Item::Table(
            vec!["Acting", "Imitating", "r", "√λ left", "Separated"],
            pairs,
        ));
    }
    items.push(Item::Text(
        "All values of r; rows act, columns of the same numbers imitate:".into(),
    ));
    items.push(Item::Verbatim(matrix.numbers()));
    items.push(Item::Pictures(super::Kind::Matrix));
    Section::new("What these data can separate", items)
}
