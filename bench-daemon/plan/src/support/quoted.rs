//! Paths as a person can paste them into a shell.

use std::path::Path;

/// Formats a path for a shell: quoted if it contains a character with a special meaning.
pub fn quoted(path: &Path) -> String {
    let text = path.display().to_string();
    let plain = |c: char| {
        c.is_ascii_alphanumeric()
            || matches!(c, '/' | '.' | '_' | '-' | '+' | '=' | ':' | ',' | '@' | '%')
    };
    if !text.is_empty() && text.chars().all(plain) {
        text
    } else {
        format!("'{}'", text.replace('\'', r"'\''"))
    }
}

#[cfg(test)]
mod tests {
    #[test]
    fn a_path_with_blanks_is_one_word_of_a_shell() {
        for (path, word) in [
            ("runs/a_1/x.toml", "runs/a_1/x.toml"),
            ("my runs/a", "'my runs/a'"),
            ("it's", r"'it'\''s'"),
            ("", "''"),
            ("a;b", "'a;b'"),
        ] {
            assert_eq!(super::quoted(std::path::Path::new(path)), word);
        }
    }
}
