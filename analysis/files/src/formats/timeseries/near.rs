//! Describes what the line most similar to the names of a record lacks.

use super::super::text;
use super::columns::{HEAD_LINES, Parted, any, come_before_rows, parted, row};
use super::names::{CURRENT, Names, TIME, VOLTAGE};
use super::raw::Quantity;

/// Returns the line (from 0) that names most quantities of a record and a description of what it
/// lacks; `None` if no line names two quantities of a record, or one before rows of numbers.
pub(super) fn near_miss(lines: &[&str]) -> Option<(usize, String)> {
    let of = |at: usize| {
        let (names, units) = row(lines, at);
        let columns = any(&names, units.as_deref());
        let before_rows = come_before_rows(lines, at);
        let all: Vec<Parted> = names.iter().map(|name| parted(name)).collect();
        let by_unit = |names: &Names| before_rows && !names.as_units(&all).is_empty();
        let has = [
            ("a time", !columns.times.is_empty() || by_unit(&TIME)),
            (
                "a voltage",
                columns.get(Quantity::Voltage).is_some() || by_unit(&VOLTAGE),
            ),
            (
                "a current",
                columns.get(Quantity::Current).is_some() || by_unit(&CURRENT),
            ),
        ];
        let count = has.iter().filter(|(_, there)| *there).count();
        let unknown = [&TIME, &VOLTAGE, &CURRENT]
            .iter()
            .find_map(|names_of| names_of.unknown_unit(&names));
        let near = count == 2 || count == 1 && (before_rows || unknown.is_some());
        // Prose may mention a voltage and a current.
        near.then(|| (before_rows, count, at, words(&has, unknown)))
    };
    let all = (0..lines.len().min(HEAD_LINES)).filter_map(of);
    let (.., at, words) = all
        .max_by_key(|(before_rows, count, at, _)| (*before_rows, *count, std::cmp::Reverse(*at)))?;
    Some((at, words))
}

fn words(has: &[(&str, bool)], unknown: Option<String>) -> String {
    let list = |there: bool| {
        let names = has.iter().filter(|(_, met)| *met == there);
        names
            .map(|(name, _)| *name)
            .collect::<Vec<_>>()
            .join(" and ")
    };
    let unit = unknown.map_or_else(String::new, |name| {
        format!(
            "; the unit in {} is not known (s, min, h; V, mV; A, mA)",
            text::shorten(&name)
        )
    });
    format!("it names {}, and not {}{unit}", list(true), list(false))
}
