//! An incomplete `dataset.toml`, and whether it may be overwritten.

use std::path::Path;

use bench_plan::support::hash::sha256;

/// Beginning of the last line of an incomplete file.
const MARK: &str =
    "# It lacks what FILL IN says. `dataset init` writes over it as long as it is unchanged: ";

/// Appends the mark of an incomplete file, with the hash of the text before it.
pub(super) fn mark_incomplete(text: &mut String) {
    let hash = sha256(text.as_bytes());
    *text += &format!("{MARK}{hash}\n");
}

/// Returns whether a file is incomplete and unchanged since it was written.
pub(super) fn may_be_replaced(path: &Path) -> bool {
    let Ok(text) = std::fs::read_to_string(path) else {
        return false;
    };
    let marked = text.trim_end().rsplit_once(MARK);
    marked.is_some_and(|(before, hash)| sha256(before.as_bytes()) == hash)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_that_a_person_has_changed_is_kept() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("dataset.toml");
        let mut text = "name = \"cell\"\n# temperature_c =\n".to_owned();
        mark_incomplete(&mut text);
        std::fs::write(&path, &text).unwrap();
        assert!(may_be_replaced(&path));
        std::fs::write(
            &path,
            text.replace("# temperature_c =", "temperature_c = 25"),
        )
        .unwrap();
        assert!(!may_be_replaced(&path));
        std::fs::write(&path, "name = \"cell\"\n").unwrap();
        assert!(!may_be_replaced(&path));
    }
}
