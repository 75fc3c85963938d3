//! The registry of the diagnosis' thresholds, and its page in the book.

use std::{collections::BTreeSet, path::Path};

use analysis::diagnosis::thresholds::{THRESHOLDS, markdown};

#[test]
fn the_page_of_the_book_holds_the_registry() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/thresholds.md");
    let page = std::fs::read_to_string(path).unwrap();
    let table: String = page
        .lines()
        .skip_while(|line| !line.starts_with("| name |"))
        .take_while(|line| line.starts_with('|'))
        .map(|line| format!("{line}\n"))
        .collect();
    for (row, expected) in table.lines().zip(markdown().lines()) {
        assert_eq!(row, expected, "`eis-bench effects --thresholds` prints it");
    }
    assert_eq!(table.lines().count(), markdown().lines().count());
}

#[test]
fn every_threshold_has_a_unit_a_meaning_and_a_source() {
    let bare: Vec<&str> = THRESHOLDS
        .iter()
        .filter(|t| {
            [t.unit, t.meaning, t.source.text()]
                .iter()
                .any(|text| text.trim().is_empty() || text.contains(['|', '\n']))
        })
        .map(|t| t.name)
        .collect();
    assert_eq!(bare, [""; 0]);
}

#[test]
fn the_names_of_thresholds_are_unique() {
    let names: BTreeSet<&str> = THRESHOLDS.iter().map(|t| t.name).collect();
    assert_eq!(names.len(), THRESHOLDS.len());
}
