//! Text of generated files.

/// Mark of a template, and the text that replaces it.
pub(super) type Mark = (&'static str, String);

/// How a language writes lists and comments.
#[derive(Debug, Clone, Copy)]
pub(super) struct Style {
    /// Start of a line of a comment.
    pub(super) comment: &'static str,
    /// End of a line of a list that goes on.
    pub(super) going_on: &'static str,
    /// A list without numbers.
    pub(super) none: &'static str,
}

impl Style {
    /// Formats numbers with commas, several per line.
    pub(super) fn list(self, values: impl IntoIterator<Item = f64>) -> String {
        let values: Vec<String> = values.into_iter().map(number).collect();
        if values.is_empty() {
            return self.none.to_owned();
        }
        let lines: Vec<String> = values
            .chunks(6)
            .map(|chunk| format!("    {}", chunk.join(", ")))
            .collect();
        lines.join(self.going_on)
    }

    /// Formats sentences as comments.
    pub(super) fn notes(self, notes: &[String]) -> String {
        let line = |note: &String| format!("{} note: {}\n", self.comment, harmless(note));
        notes.iter().map(line).collect()
    }
}

/// Formats a number with all its digits.
pub(super) fn number(value: f64) -> String {
    format!("{value:?}")
}

/// Replaces the marks of a template, in their order.
pub(super) fn fill(template: &str, marks: &[Mark]) -> String {
    let replace = |text: String, (mark, value): &Mark| text.replace(mark, value);
    marks.iter().fold(template.to_owned(), replace)
}

/// Removes characters that would end a comment, a string or an attribute.
pub(super) fn harmless(text: &str) -> String {
    text.replace(['\n', '\r', '"', '\\', '*', '<', '>', '&', '@'], " ")
}

/// Returns a name that C and Modelica take, made of a text.
pub(super) fn identifier(text: &str) -> String {
    let mut name: String = text
        .chars()
        .map(|c| if c.is_ascii_alphanumeric() { c } else { '_' })
        .collect();
    if !name.starts_with(|c: char| c.is_ascii_alphabetic()) {
        name.insert_str(0, "cell_");
    }
    name
}
