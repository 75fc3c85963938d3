//! The registry of the diagnosis' thresholds.

use std::collections::BTreeSet;

use analysis::diagnosis::thresholds::THRESHOLDS;

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
