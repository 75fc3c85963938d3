//! Numbers and texts that the sections of a report have in common.

use analysis_effects::effects;

use super::super::outcome::{Block, Diagnosis};
use crate::thresholds::SIGNIFICANT_P;

pub(super) fn is_significant(block: &Block) -> bool {
    block.p_value < SIGNIFICANT_P
}

/// Returns the root of χ² over its expectation: 1 is noise alone.
pub(super) fn misfit(block: &Block) -> f64 {
    (block.chi2 / block.expected_chi2).sqrt()
}

/// Returns the same block with the named effects added.
pub(super) fn after<'a>(d: &'a Diagnosis, block: &Block) -> Option<&'a Block> {
    d.where_after
        .iter()
        .find(|b| b.dimension == block.dimension && b.part == block.part)
}

/// Returns the title of an effect, or its name as text if the catalogue does not contain it.
pub(super) fn named_title(name: &str) -> String {
    effects::title(name).map_or_else(|| name.replace('_', " "), str::to_owned)
}

/// Returns the title and name of an effect.
pub(super) fn titled(name: &str) -> String {
    effects::find(name).map_or_else(
        || name.to_owned(),
        |effect| format!("{} ({name})", effect.card().title),
    )
}

/// Returns a number and a noun in its number.
pub(super) fn counted(count: usize, one: &str, many: &str) -> String {
    format!("{count} {}", if count == 1 { one } else { many })
}
