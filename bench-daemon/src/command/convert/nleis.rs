//! `eis-bench convert --to nleis`: first and second harmonic of a sweep as the columns that nleis.py
//! takes.

use std::{collections::BTreeMap, fmt::Write as _, path::Path};

use analysis::{
    run_folder::{HARMONIC_COLUMNS, HARMONICS},
    table::{Hash, Table},
};

use bench_core::safety::failure::Failure;

/// Columns of the file: frequency of the fundamental, Z₁, Z₂ and their standard uncertainties.
const COLUMNS: &str = "freq_hz,z1_re_ohm,z1_im_ohm,z2_re_ohm_per_a,z2_im_ohm_per_a,sigma_z1_re,\
    sigma_z1_im,sigma_z2_re,sigma_z2_im";

/// One row of the table of a run: order, real and imaginary part and their standard uncertainties.
#[derive(Clone, Copy)]
struct Harmonic {
    parts: [f64; 2],
    sigmas: [f64; 2],
}

/// Order 1 and 2 of one frequency.
#[derive(Default, Clone, Copy)]
struct Pair {
    first: Option<Harmonic>,
    second: Option<Harmonic>,
}

/// Returns the text of each sweep in a table of harmonics, by its number.
///
/// # Errors
/// A file that is not such a table; a field that is not a number; a file without a second harmonic.
pub(super) fn texts(path: &Path) -> Result<Vec<(String, String)>, Failure> {
    let fail = |reason: String| Failure::Usage(format!("{}: {reason}", path.display()));
    let table = Table::read(path, Hash::Row).map_err(|error| Failure::Usage(error.to_string()))?;
    let columns: Vec<&str> = HARMONIC_COLUMNS.split(',').collect();
    if table.columns != columns {
        return Err(fail(format!(
            "expected the file {HARMONICS} of a run folder, with the columns {HARMONIC_COLUMNS}, found {}",
            table.columns.join(",")
        )));
    }
    let mut sweeps: BTreeMap<String, Vec<(f64, Pair)>> = BTreeMap::new();
    for row in &table.rows {
        let number = |column: usize| {
            row.number(column).ok_or_else(|| {
                fail(format!(
                    "line {}, column {}: expected a number, found {:?}",
                    row.line,
                    columns[column],
                    row.field(column)
                ))
            })
        };
        let harmonic = Harmonic {
            parts: [number(5)?, number(6)?],
            sigmas: [number(7)?, number(8)?],
        };
        let (freq_hz, order) = (number(3)?, number(4)?);
        let rows = sweeps.entry(number(0)?.to_string()).or_default();
        if rows.last().is_none_or(|(last_hz, _)| *last_hz != freq_hz) {
            rows.push((freq_hz, Pair::default()));
        }
        if let Some((_, pair)) = rows.last_mut() {
            match order {
                1.0 => pair.first = Some(harmonic),
                2.0 => pair.second = Some(harmonic),
                _ => {}
            }
        }
    }
    let texts: Vec<(String, String)> = sweeps
        .into_iter()
        .map(|(sweep, rows)| (sweep, text(&rows)))
        .filter(|(_, text)| text.lines().count() > 1)
        .collect();
    if texts.is_empty() {
        return Err(fail(
            "expected frequencies with orders 1 and 2, found none".to_owned(),
        ));
    }
    Ok(texts)
}

/// Returns the frequencies that have both orders.
fn text(rows: &[(f64, Pair)]) -> String {
    let mut text = format!("{COLUMNS}\n");
    for (freq_hz, pair) in rows {
        let (Some(first), Some(second)) = (pair.first, pair.second) else {
            continue;
        };
        let numbers = [first.parts, second.parts, first.sigmas, second.sigmas].concat();
        let fields: Vec<String> = numbers.iter().map(|v| format!("{v:e}")).collect();
        let _ = writeln!(text, "{freq_hz},{}", fields.join(","));
    }
    text
}
