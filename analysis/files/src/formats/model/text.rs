//! Text of generated files.

/// Removes characters that would end a comment or a string.
pub(super) fn harmless(text: &str) -> String {
    text.replace(['\n', '\r', '"', '\\', '*'], " ")
}

/// Formats numbers with commas, several per line.
pub(super) fn rows(values: &mut dyn Iterator<Item = f64>, indent: &str) -> String {
    let values: Vec<String> = values.map(|value| format!("{value:?}")).collect();
    let lines: Vec<String> = values
        .chunks(6)
        .map(|chunk| format!("{indent}{}", chunk.join(", ")))
        .collect();
    lines.join(",\n")
}
