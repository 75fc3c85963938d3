//! A page of keys: a section for each table of a file.

use super::{
    super::book::{LONGEST, sentences, words},
    ranges::Ranges,
    sources::{Library, Structure, Value},
};

/// Text of a doc comment before the effect of an omitted key.
const LEFT_OUT: &str = " Left out: ";
/// Greatest number of tables that a heading names.
const MOST_IN_A_HEADING: usize = 3;

/// A file on a page.
pub(super) struct Part<'a> {
    /// Its name in headings.
    pub(super) name: &'static str,
    /// Paragraph below its heading.
    pub(super) about: &'static str,
    /// Structure of the whole file.
    pub(super) top: Structure<'a>,
}

/// A structure and the tables that it describes.
pub(super) struct Section<'a> {
    /// Paths of the tables, such as `eis.quality`; that of the whole file is empty.
    paths: Vec<String>,
    /// Headings of the tables, such as `[eis.quality]`.
    titles: Vec<String>,
    pub(super) structure: Structure<'a>,
}

impl Section<'_> {
    /// Path of its first table; empty for the whole file.
    pub(super) fn name(&self) -> &str {
        self.paths.first().map_or("", String::as_str)
    }
}

/// Returns the tables of a file; the first is the whole file.
pub(super) fn sections<'a>(library: &'a Library, part: &Part<'a>) -> Vec<Section<'a>> {
    let mut sections = Vec::new();
    collect(library, part.top, ("", ""), &mut sections);
    sections
}

/// Returns the units of all quantities.
pub(super) fn quantities(library: &Library) -> String {
    let mut text =
        "A quantity is a text of a number and its unit; a number without its unit is an \
        error.\n\n| quantity | example | units |\n|---|---|---|\n"
            .to_owned();
    for quantity in library.quantities.values() {
        let mut units: Vec<String> = Vec::new();
        for (unit, _) in &quantity.units {
            // Characters that appear identical.
            let unit = unit.replace('\u{2126}', "Ω").replace('\u{3bc}', "µ");
            let unit = format!("`{unit}`");
            if !units.contains(&unit) {
                units.push(unit);
            }
        }
        let (name, example) = (&quantity.name, &quantity.example);
        text.push_str(&format!(
            "| {name} | `\"{example}\"` | {} |\n",
            units.join(", ")
        ));
    }
    text
}

/// Returns the sections of a file.
pub(super) fn part(library: &Library, part: &Part<'_>) -> String {
    let sections = sections(library, part);
    let heading = |section: &Section<'_>| {
        let titles = match section.titles.as_slice() {
            [first, others @ ..] if section.titles.len() > MOST_IN_A_HEADING => {
                format!("`{first}` and {} more", others.len())
            }
            titles => quoted(titles),
        };
        format!("{}: {titles}", part.name)
    };
    let ranges = Ranges::read();
    let mut text = String::new();
    for section in &sections {
        let about = section.structure.about();
        if section.titles.is_empty() {
            text.push_str(&format!("\n## {}\n\n{}\n\n", part.name, part.about));
        } else {
            short(&about);
            assert!(!about.is_empty(), "{}: no doc comment", heading(section));
            text.push_str(&format!("\n### {}\n\n{about}\n", heading(section)));
            if section.titles.len() > MOST_IN_A_HEADING {
                let titles = quoted(&section.titles);
                text.push_str(&format!("The same keys are in {titles}.\n"));
            }
            text.push('\n');
        }
        text.push_str("| key | value | needed | meaning |\n|---|---|---|---|\n");
        let mut lists = String::new();
        for key in library.keys(section.structure) {
            let linked = |structure: Structure<'_>| {
                let section = sections
                    .iter()
                    .find(|section| section.structure.same_as(structure));
                slug(&heading(section.unwrap()))
            };
            let mut value = match key.value {
                Value::Plain(plain) => plain,
                Value::Table(structure) => format!("[table](#{})", linked(structure)),
                Value::Tables(structure) => format!("[list of tables](#{})", linked(structure)),
                Value::Words(many, words) => {
                    let (mut all, mut meanings) = (Vec::new(), String::new());
                    for (word, meaning) in words {
                        assert!(!meaning.is_empty(), "{}: {word}: no doc comment", key.name);
                        short(&meaning);
                        meanings.push_str(&format!("* `{word}`: {meaning}\n"));
                        all.push(format!("`{word}`"));
                    }
                    lists.push_str(&format!("\nValues of `{}`:\n\n{meanings}", key.name));
                    format!("{many}one of {}", all.join(", ")).replace("list of one of", "list of")
                }
            };
            if part.name == "Scenario" {
                let path = format!("{}.{}", section.paths[0], key.name);
                value.push_str(&ranges.words(path.trim_start_matches('.')));
            }
            short(&key.meaning);
            let (needed, meaning) = match key.meaning.split_once(LEFT_OUT) {
                Some((meaning, then)) if key.needed.starts_with("no") => {
                    (format!("no: {}", then.trim_end_matches('.')), meaning)
                }
                Some(_) => panic!("{} has another default, {}", key.name, key.needed),
                None => (key.needed, key.meaning.as_str()),
            };
            let meaning = meaning.replace('|', "\\|");
            text.push_str(&format!(
                "| `{}` | {value} | {needed} | {meaning} |\n",
                key.name
            ));
        }
        text.push_str(&lists);
    }
    text
}

/// The sections of a table and of the tables in it, in the order of their keys.
fn collect<'a>(
    library: &'a Library,
    structure: Structure<'a>,
    (path, title): (&str, &str),
    sections: &mut Vec<Section<'a>>,
) {
    let known = sections
        .iter_mut()
        .find(|section| section.structure.same_as(structure));
    let titles = (!title.is_empty()).then(|| title.to_owned());
    match known {
        Some(section) => {
            section.paths.push(path.to_owned());
            section.titles.extend(titles);
        }
        None => sections.push(Section {
            paths: vec![path.to_owned()],
            titles: titles.into_iter().collect(),
            structure,
        }),
    }
    for key in library.keys(structure) {
        let path = format!("{path}.{}", key.name);
        let path = path.trim_start_matches('.');
        match key.value {
            Value::Table(inner) => collect(library, inner, (path, &format!("[{path}]")), sections),
            Value::Tables(inner) => {
                collect(library, inner, (path, &format!("[[{path}]]")), sections);
            }
            Value::Plain(_) | Value::Words(..) => {}
        }
    }
}

fn quoted(titles: &[String]) -> String {
    let titles: Vec<String> = titles.iter().map(|title| format!("`{title}`")).collect();
    titles.join(", ")
}

/// Refuses a doc comment with a sentence that is too long for a page.
fn short(meaning: &str) {
    for sentence in sentences(meaning) {
        let words = words(&sentence);
        assert!(words <= LONGEST, "{words} words: {sentence}");
    }
}

/// Anchor of a heading, as GitHub and mdBook make it.
fn slug(heading: &str) -> String {
    heading
        .to_lowercase()
        .chars()
        .filter(|c| c.is_alphanumeric() || " -_".contains(*c))
        .map(|c| if c == ' ' { '-' } else { c })
        .collect()
}
