//! A page of text and tables, formatted as plain text for a terminal or as Markdown.

use super::Picture;
use super::pictures::Kind;
use analysis_plot::{
    PlotError,
    report::{self, Figure, Part, Table},
};

/// Characters of a line on a terminal.
const WIDTH: usize = 100;
const COLUMN_GAP: &str = "  ";
/// Narrowest that a column is squeezed to.
const NARROW: usize = 10;

/// A page.
#[derive(Debug, Default)]
pub(super) struct Page {
    /// First line.
    pub(super) title: String,
    /// From the top.
    pub(super) sections: Vec<Section>,
}

/// A heading and its contents.
#[derive(Debug, Default)]
pub(super) struct Section {
    pub(super) heading: &'static str,
    pub(super) items: Vec<Item>,
    /// True if a new page begins in print.
    pub(super) new_page: bool,
}

/// A piece of a page.
#[derive(Debug)]
pub(super) enum Item {
    /// A paragraph.
    Text(String),
    /// Points of a list.
    List(Vec<String>),
    /// A table: header and rows.
    Table(Vec<&'static str>, Vec<Vec<String>>),
    /// A name, which may be empty, with its properties: property, text.
    Fields(String, Vec<(&'static str, String)>),
    /// Text set as it is.
    Verbatim(String),
    /// The place of pictures; a terminal shows none.
    Pictures(Kind),
}

impl Section {
    pub(super) fn new(heading: &'static str, items: Vec<Item>) -> Self {
        Self {
            heading,
            items,
            new_page: false,
        }
    }

    /// Returns a section that begins a new page in print.
    pub(super) fn on_new_page(heading: &'static str, items: Vec<Item>) -> Self {
        Self {
            new_page: true,
            ..Self::new(heading, items)
        }
    }

    /// For a page of HTML, with the pictures in their places.
    pub(super) fn html(&self, pictures: &[Picture]) -> Result<report::Section, PlotError> {
        let mut parts = Vec::new();
        for item in &self.items {
            item.html(&mut parts, pictures)?;
        }
        Ok(report::Section {
            heading: self.heading.to_owned(),
            parts,
            new_page: self.new_page,
        })
    }
}

impl Page {
    /// For a terminal.
    pub(super) fn text(&self) -> String {
        let mut out = format!("{}\n", self.title);
        for section in self.sections.iter().filter(|s| !s.items.is_empty()) {
            out.push_str(if out.ends_with("\n\n") { "" } else { "\n" });
            if section.new_page {
                out.push_str(&format!("{}\n\n", "─".repeat(WIDTH)));
            }
            out.push_str(&format!("{}\n", section.heading.to_uppercase()));
            for item in &section.items {
                item.text(&mut out);
            }
        }
        out
    }

    /// As Markdown, with the pictures in their places.
    pub(super) fn markdown(&self, pictures: &[Picture]) -> String {
        let mut out = format!("# {}\n", escaped(&self.title));
        for section in self.sections.iter().filter(|s| !s.items.is_empty()) {
            let rule = if section.new_page { "\n---\n" } else { "" };
            out.push_str(&format!("{rule}\n## {}\n", section.heading));
            for item in &section.items {
                item.markdown(&mut out, pictures);
            }
        }
        out
    }
}

impl Item {
    fn text(&self, out: &mut String) {
        match self {
            Self::Table(header, rows) => {
                if !out.ends_with("\n\n") {
                    out.push('\n');
                }
                push_table(out, header, rows);
                out.push('\n');
            }
            Self::Text(text) => push_wrapped(out, text, Indents::TEXT),
            Self::List(points) => points
                .iter()
                .for_each(|point| push_wrapped(out, point, Indents::POINT)),
            Self::Fields(name, fields) => {
                if !name.is_empty() {
                    out.push_str(if out.ends_with("\n\n") { "" } else { "\n" });
                    out.push_str(&format!("  {name}\n"));
                }
                let most = fields
                    .iter()
                    .map(|f| f.0.chars().count())
                    .max()
                    .unwrap_or(0);
                for (field, text) in fields {
                    push_wrapped(
                        out,
                        text,
                        Indents {
                            first: &format!("    {field:<most$}  "),
                            other: &" ".repeat(most + 6),
                        },
                    );
                }
            }
            Self::Verbatim(text) => text
                .lines()
                .for_each(|line| out.push_str(&format!("{}\n", format!("  {line}").trim_end()))),
            Self::Pictures(_) => {}
        }
    }

    fn html(&self, parts: &mut Vec<Part>, pictures: &[Picture]) -> Result<(), PlotError> {
        let owned = |words: &[&'static str]| words.iter().map(|word| (*word).to_owned()).collect();
        parts.push(match self {
            Self::Text(text) => Part::Text(text.clone()),
            Self::List(points) => Part::List(points.clone()),
            Self::Table(header, rows) => Part::Table(Table {
                caption: String::new(),
                header: owned(header),
                rows: rows.clone(),
            }),
            Self::Fields(name, fields) => Part::Fields(
                name.clone(),
                fields
                    .iter()
                    .map(|(field, text)| ((*field).to_owned(), text.clone()))
                    .collect(),
            ),
            Self::Verbatim(text) => Part::Verbatim(text.clone()),
            Self::Pictures(kind) => {
                for picture in pictures.iter().filter(|picture| picture.kind == *kind) {
                    parts.push(Part::Figure(Figure {
                        svg: picture.drawing.svg()?,
                        caption: picture.caption.clone(),
                    }));
                }
                return Ok(());
            }
        });
        Ok(())
    }

    fn markdown(&self, out: &mut String, pictures: &[Picture]) {
        match self {
            Self::Text(text) => out.push_str(&format!("\n{}\n", escaped(text))),
            Self::List(points) => {
                out.push('\n');
                points
                    .iter()
                    .for_each(|point| out.push_str(&format!("- {}\n", escaped(point))));
            }
            Self::Table(header, rows) => {
                let line = |cells: &mut dyn Iterator<Item = String>| {
                    format!("| {} |\n", cells.collect::<Vec<_>>().join(" | "))
                };
                out.push('\n');
                out.push_str(&line(&mut header.iter().map(|h| escaped(h))));
                out.push_str(&line(&mut header.iter().map(|_| "---".to_owned())));
                rows.iter()
                    .for_each(|row| out.push_str(&line(&mut row.iter().map(|c| escaped(c)))));
            }
            Self::Fields(name, fields) => {
                if !name.is_empty() {
                    out.push_str(&format!("\n### {}\n", escaped(name)));
                }
                out.push('\n');
                fields.iter().for_each(|(field, text)| {
                    out.push_str(&format!("- **{field}:** {}\n", escaped(text)));
                });
            }
            Self::Verbatim(text) => out.push_str(&format!("\n```text\n{}\n```\n", text.trim_end())),
            Self::Pictures(kind) => {
                for picture in pictures.iter().filter(|p| p.kind == *kind) {
                    let caption = escaped(&picture.caption);
                    out.push_str(&format!(
                        "\n![{caption}]({}.png)\n\n*{caption}*\n",
                        picture.name
                    ));
                }
            }
        }
    }
}

/// Returns the text in which Markdown finds no marks.
fn escaped(text: &str) -> String {
    text.chars()
        .fold(String::with_capacity(text.len()), |mut out, c| {
            match c {
                '&' => out.push_str("&amp;"),
                '<' => out.push_str("&lt;"),
                '|' | '*' | '_' | '[' | ']' | '`' | '#' => out.extend(['\\', c]),
                _ => out.push(c),
            }
            out
        })
}

/// Indents of the first line of a text and of the others.
#[derive(Debug, Clone, Copy)]
struct Indents<'a> {
    first: &'a str,
    other: &'a str,
}

impl Indents<'static> {
    const TEXT: Self = Self {
        first: "  ",
        other: "  ",
    };
    const POINT: Self = Self {
        first: "  - ",
        other: "    ",
    };
}

fn push_wrapped(out: &mut String, text: &str, indents: Indents<'_>) {
    let Indents { first, other } = indents;
    let room = WIDTH.saturating_sub(other.chars().count()).max(NARROW);
    for (k, line) in wrapped(text, room).iter().enumerate() {
        out.push_str(if k == 0 { first } else { other });
        out.push_str(line);
        out.push('\n');
    }
}

/// Wraps text at blanks into lines of at most `width` characters; a longer word keeps its own line.
fn wrapped(text: &str, width: usize) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split_whitespace() {
        match lines.last_mut() {
            Some(line) if line.chars().count() + 1 + word.chars().count() <= width => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.to_owned()),
        }
    }
    lines
}

fn push_table(out: &mut String, header: &[&'static str], rows: &[Vec<String>]) {
    let widths = widths(header, rows);
    let mut push = |cells: &[&str]| {
        let cells: Vec<Vec<String>> = cells
            .iter()
            .zip(&widths)
            .map(|(c, w)| wrapped(c, *w))
            .collect();
        for k in 0..cells.iter().map(Vec::len).max().unwrap_or(0) {
            let pieces = cells
                .iter()
                .zip(&widths)
                .map(|(c, w)| format!("{:<w$}", c.get(k).map_or("", String::as_str)));
            out.push_str(format!("  {}", pieces.collect::<Vec<_>>().join(COLUMN_GAP)).trim_end());
            out.push('\n');
        }
    };
    push(header);
    let rules: Vec<String> = widths.iter().map(|w| "─".repeat(*w)).collect();
    push(&rules.iter().map(String::as_str).collect::<Vec<_>>());
    rows.iter()
        .for_each(|row| push(&row.iter().map(String::as_str).collect::<Vec<_>>()));
}

/// Widths of the columns; the widest give way until the table fits.
fn widths(header: &[&'static str], rows: &[Vec<String>]) -> Vec<usize> {
    let of = |k: usize| {
        rows.iter()
            .filter_map(|r| r.get(k))
            .map(|c| c.chars().count())
            .max()
            .unwrap_or(0)
    };
    let mut widths: Vec<usize> = header
        .iter()
        .enumerate()
        .map(|(k, h)| of(k).max(h.chars().count()))
        .collect();
    let gaps = 2 + COLUMN_GAP.len() * header.len().saturating_sub(1);
    while widths.iter().sum::<usize>() + gaps > WIDTH {
        match widths.iter_mut().filter(|w| **w > NARROW).max() {
            Some(widest) => *widest -= 1,
            None => break,
        }
    }
    widths
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wide_table_is_squeezed_and_loses_no_word() {
        let words =
            "many words that cannot stand on one line of a terminal beside the others ".repeat(3);
        let mut out = String::new();
        push_table(
            &mut out,
            &["name", "remark", "value"],
            &[vec!["a".into(), words, "1".into()]],
        );
        assert!(out.lines().all(|l| l.chars().count() <= WIDTH), "{out}");
        assert_eq!(out.matches("terminal").count(), 3);
    }

    #[test]
    fn markdown_marks_in_names_are_only_letters() {
        assert_eq!(
            escaped("rc_slow: |Z| < 1 & a*b"),
            "rc\\_slow: \\|Z\\| &lt; 1 &amp; a\\*b"
        );
    }
}
