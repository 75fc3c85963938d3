//! Circuit strings in impedance.py's form → a circuit; lists of assignments → values of its
//! parameters.
//!
//! ```text
//! series  = block { "-" block }
//! block   = "p(" series "," series { "," series } ")"  |  element
//! element = kind [ "_" ] digits            R0, CPE1, Wo_2
//! ```
//! Blanks are allowed between any of them. A name must not occur twice, because parameters are
//! named after it.

use super::element::ElementKind;
use super::{Circuit, Element, Node};

/// Deepest nesting of `p(…)`.
pub const MAX_DEPTH: usize = 32;
/// Most elements of a circuit.
pub const MAX_ELEMENTS: usize = 64;
/// Characters shown on each side of the place of an error.
const EXCERPT: usize = 30;

/// Why a text is not a valid circuit, or not a valid list of its parameters' values, with the
/// position.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{what}, character {position}: expected {expected}, met {met}\n  {excerpt}\n  \
{caret:>column$}", position = self.index + 1, caret = '^', column = self.column)]
pub struct ParseError {
    /// Kind of text that was read.
    what: &'static str,
    /// Place, in characters from 0.
    index: usize,
    expected: String,
    met: String,
    excerpt: String,
    column: usize,
}

impl ParseError {
    /// Place of the error in characters from 0.
    pub fn index(&self) -> usize {
        self.index
    }

    fn at(what: &'static str, text: &[char], index: usize, expected: &str, met: String) -> Self {
        let from = index.saturating_sub(EXCERPT);
        let to = (index + EXCERPT).min(text.len());
        let shown = |c: &char| if c.is_control() { ' ' } else { *c };
        let left = if from > 0 { "…" } else { "" };
        let right = if to < text.len() { "…" } else { "" };
        let excerpt = format!(
            "{left}{}{right}",
            text[from..to].iter().map(shown).collect::<String>()
        );
        Self {
            what,
            index,
            expected: expected.to_owned(),
            met,
            excerpt,
            column: index - from + left.chars().count() + 1,
        }
    }
}

/// A place in a text.
pub(super) struct Cursor {
    what: &'static str,
    text: Vec<char>,
    pub(super) index: usize,
}

impl Cursor {
    pub(super) fn new(what: &'static str, text: &str) -> Self {
        Self {
            what,
            text: text.chars().collect(),
            index: 0,
        }
    }

    pub(super) fn peek(&self) -> Option<char> {
        self.text.get(self.index).copied()
    }

    pub(super) fn skip_blanks(&mut self) {
        while self.peek().is_some_and(char::is_whitespace) {
            self.index += 1;
        }
    }

    /// Takes the next character if it is the one wanted, blanks before it passed over.
    pub(super) fn take(&mut self, wanted: char) -> bool {
        self.skip_blanks();
        let found = self.peek() == Some(wanted);
        self.index += usize::from(found);
        found
    }

    /// Returns whether a word comes next.
    pub(super) fn comes(&self, word: &str) -> bool {
        let mut rest = self.text[self.index..].iter();
        word.chars().all(|c| rest.next() == Some(&c))
    }

    /// Takes the longest run of characters of a class.
    pub(super) fn run(&mut self, class: impl Fn(char) -> bool) -> String {
        let start = self.index;
        while self.peek().is_some_and(&class) {
            self.index += 1;
        }
        self.text[start..self.index].iter().collect()
    }

    pub(super) fn fail(&self, expected: &str) -> ParseError {
        let met = match self.peek() {
            None => "the end of the text".to_owned(),
            Some(c) => format!("{c:?}"),
        };
        ParseError::at(self.what, &self.text, self.index, expected, met)
    }

    pub(super) fn fail_at(&self, index: usize, expected: &str, met: String) -> ParseError {
        ParseError::at(self.what, &self.text, index, expected, met)
    }
}

/// The parser: a cursor and the elements met so far.
struct Parser {
    cursor: Cursor,
    names: Vec<String>,
    parameters: usize,
}

impl Circuit {
    /// Parses `name = value, …` into the indices of the parameters and their values; `what` names
    /// the list in messages.
    ///
    /// # Errors
    /// [`ParseError`] for another form, a name that is not a parameter or is repeated, or a value
    /// beyond the physical range.
    pub fn assignments(
        &self,
        what: &'static str,
        text: &str,
    ) -> Result<Vec<(usize, f64)>, ParseError> {
        assignments(self, what, text)
    }
}

/// Reads a circuit.
pub(super) fn circuit(text: &str) -> Result<Circuit, ParseError> {
    let mut parser = Parser {
        cursor: Cursor::new("circuit", text),
        names: Vec::new(),
        parameters: 0,
    };
    let root = parser.series(0)?;
    parser.cursor.skip_blanks();
    match parser.cursor.peek() {
        None => Ok(Circuit::new(root)),
        Some(_) => Err(parser.cursor.fail("\"-\" and another block, or the end")),
    }
}

impl Parser {
    fn series(&mut self, depth: usize) -> Result<Node, ParseError> {
        let mut blocks = vec![self.block(depth)?];
        while self.cursor.take('-') {
            blocks.push(self.block(depth)?);
        }
        Ok(if blocks.len() == 1 {
            blocks.remove(0)
        } else {
            Node::Series(blocks)
        })
    }

    fn block(&mut self, depth: usize) -> Result<Node, ParseError> {
        self.cursor.skip_blanks();
        let start = self.cursor.index;
        if self.cursor.peek() == Some('p') {
            self.cursor.index += 1;
            if self.cursor.take('(') {
                return self.parallel(start, depth + 1);
            }
            self.cursor.index = start;
        }
        self.element()
    }

    fn parallel(&mut self, start: usize, depth: usize) -> Result<Node, ParseError> {
        if depth > MAX_DEPTH {
            return Err(self.cursor.fail_at(
                start,
                &format!("at most {MAX_DEPTH} levels of p(…)"),
                "one more".to_owned(),
            ));
        }
        let mut branches = vec![self.series(depth)?];
        while self.cursor.take(',') {
            branches.push(self.series(depth)?);
        }
        if branches.len() < 2 {
            return Err(self.cursor.fail("\",\" and a second branch of p(…)"));
        }
        if !self.cursor.take(')') {
            return Err(self.cursor.fail("\",\", \"-\" or \")\""));
        }
        Ok(Node::Parallel(branches))
    }

    fn element(&mut self) -> Result<Node, ParseError> {
        let start = self.cursor.index;
        let letters = self.cursor.run(char::is_alphabetic);
        if letters.is_empty() {
            return Err(self.cursor.fail("an element such as R0, or p(…)"));
        }
        let Some(kind) = ElementKind::ALL
            .into_iter()
            .find(|kind| kind.name() == letters)
        else {
            return Err(self.unknown(start, &letters));
        };
        let underscore = if self.cursor.peek() == Some('_') {
            "_"
        } else {
            ""
        };
        self.cursor.index += underscore.len();
        let digits = self.cursor.run(|c| c.is_ascii_digit());
        if digits.is_empty() {
            return Err(self.cursor.fail(&format!(
                "a number after the element's kind, such as {letters}{}",
                self.names.len()
            )));
        }
        let name = format!("{letters}{underscore}{digits}");
        if self.names.contains(&name) {
            return Err(self.cursor.fail_at(
                start,
                "a name that no other element has",
                format!("{name:?} again"),
            ));
        }
        if self.names.len() == MAX_ELEMENTS {
            return Err(self.cursor.fail_at(
                start,
                &format!("at most {MAX_ELEMENTS} elements"),
                "one more".to_owned(),
            ));
        }
        self.names.push(name.clone());
        let first = self.parameters;
        self.parameters += kind.parameters().len();
        Ok(Node::Element(Element { kind, name, first }))
    }

    fn unknown(&self, start: usize, letters: &str) -> ParseError {
        let known = ElementKind::ALL.map(ElementKind::name).join(", ");
        let nearest = nearest(letters).map_or_else(String::new, |kind| {
            format!(" (did you mean {}?)", kind.name())
        });
        let shown: String = letters.chars().take(EXCERPT).collect();
        self.cursor.fail_at(
            start,
            &format!("one of the elements {known}, or p(…)"),
            format!("{shown:?}{nearest}"),
        )
    }
}

/// Returns the kind that the user may have meant, or `None` if no kind is similar.
fn nearest(letters: &str) -> Option<ElementKind> {
    let lower = letters.to_lowercase();
    let other_programs = match lower.as_str() {
        "q" | "y" => Some(ElementKind::Cpe),
        "o" | "fsw" | "wfs" => Some(ElementKind::Wo),
        "flw" | "wfl" => Some(ElementKind::Ws),
        "ger" => Some(ElementKind::G),
        "tlm" | "tlmbo" => Some(ElementKind::Tlmq),
        "tlmno" => Some(ElementKind::Ls),
        _ => None,
    };
    let distance = |kind: &ElementKind| edit_distance(&lower, &kind.name().to_lowercase());
    other_programs.or_else(|| {
        ElementKind::ALL
            .into_iter()
            .min_by_key(distance)
            .filter(|kind| distance(kind) <= 1)
    })
}

/// Returns the least number of characters to insert, delete or replace (Levenshtein).
fn edit_distance(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, c) in a.chars().take(EXCERPT).enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, d) in b.iter().enumerate() {
            let replaced = diagonal + usize::from(c != *d);
            diagonal = row[j + 1];
            row[j + 1] = replaced.min(row[j] + 1).min(diagonal + 1);
        }
    }
    row[b.len()]
}

/// Reads `name = value, name = value, …` into pairs of the parameter's index and its value; `what`
/// names the list in messages.
fn assignments(
    circuit: &Circuit,
    what: &'static str,
    text: &str,
) -> Result<Vec<(usize, f64)>, ParseError> {
    let mut cursor = Cursor::new(what, text);
    let mut found: Vec<(usize, f64)> = Vec::new();
    loop {
        cursor.skip_blanks();
        let start = cursor.index;
        let index = parameter(&mut cursor, circuit)?;
        if found.iter().any(|(known, _)| *known == index) {
            let name = &circuit.parameter_names()[index];
            return Err(cursor.fail_at(start, "each parameter once", format!("{name:?} again")));
        }
        if !cursor.take('=') {
            return Err(cursor.fail("\"=\" and a value"));
        }
        found.push((index, value(&mut cursor, circuit, index)?));
        if !cursor.take(',') {
            break;
        }
    }
    match cursor.peek() {
        None => Ok(found),
        Some(_) => Err(cursor.fail("\",\" or the end")),
    }
}

/// Returns the index of the parameter whose name comes next.
fn parameter(cursor: &mut Cursor, circuit: &Circuit) -> Result<usize, ParseError> {
    let start = cursor.index;
    let name = cursor.run(|c| c.is_alphanumeric() || c == '_');
    let known = circuit.parameter_names();
    known
        .iter()
        .position(|known| *known == name)
        .ok_or_else(|| {
            let expected = format!("one of the parameters {}", known.join(", "));
            if name.is_empty() {
                cursor.fail(&expected)
            } else {
                cursor.fail_at(start, &expected, format!("{name:?}"))
            }
        })
}

/// Returns the value of a parameter, within its physical range.
fn value(cursor: &mut Cursor, circuit: &Circuit, index: usize) -> Result<f64, ParseError> {
    cursor.skip_blanks();
    let start = cursor.index;
    let digits = cursor.run(|c| c != ',' && !c.is_whitespace());
    let kind = &circuit.parameter_kinds()[index];
    let (lower, upper) = kind.bounds;
    digits
        .parse::<f64>()
        .ok()
        .filter(|value| (lower..=upper).contains(value))
        .ok_or_else(|| {
            let expected = format!(
                "a value of {} from {lower:e} to {upper:e} {}",
                circuit.parameter_names()[index],
                kind.unit
            );
            cursor.fail_at(start, expected.trim_end(), format!("{digits:?}"))
        })
}
