//! Compares real and imaginary part with modulus and phase, if a table has both.

use super::table::{Column, Table};
use crate::formats::error::FormatError;
use crate::formats::sweeps::MeasuredRow;
use std::path::Path;

/// Ratios of units that are commonly confused.
const FACTORS: [f64; 4] = [1.0e3, 1.0e-3, 1.0e6, 1.0e-6];
/// Tolerance of such a ratio; programs write at least three digits.
const NEAR: f64 = 0.03;
/// Smallest angle whose sign is compared, rad: one degree.
const SMALL_RAD: f64 = 0.0175;
/// Fraction of the rows that must agree. Single points are rounded or overloaded.
const MOST: f64 = 0.9;
/// Minimum number of rows for the comparison.
const FEWEST: usize = 3;

/// Modulus and phase of a row in Ω and rad, as in the file; NaN if missing.
#[derive(Debug, Clone, Copy)]
pub(super) struct Beside {
    pub(super) modulus: f64,
    pub(super) phase: f64,
}

/// Compares the rows of a table with modulus and phase beside them; returns a remark if it inverted
/// a sign.
///
/// # Errors
/// Returns an error if a modulus or a phase contradicts the parts by a factor or by a sign.
pub(super) fn compare(
    path: &Path,
    table: &Table,
    rows: &mut [MeasuredRow],
    beside: &[Beside],
) -> Result<Option<String>, FormatError> {
    let [curve] = table.curves.as_slice() else {
        return Ok(None);
    };
    let [_, imaginary] = &curve.columns;
    let refused = |line: usize, met: String| FormatError::Header {
        file: path.to_owned(),
        line,
        expected: "columns of one impedance that agree".to_owned(),
        met,
    };
    if let Some(modulus) = &table.polar.modulus {
        let ratio =
            |(row, beside): (&MeasuredRow, &Beside)| beside.modulus / row.point.z_ohm.norm();
        let ratios: Vec<f64> = rows
            .iter()
            .zip(beside)
            .map(ratio)
            .filter(|r| r.is_finite())
            .collect();
        let is = |factor: &f64| mostly(&ratios, |ratio| (ratio / factor - 1.0).abs() < NEAR);
        if let Some(factor) = FACTORS.into_iter().find(is) {
            let line = rows.first().map_or(0, |row| row.line);
            let met = format!(
                "\"{}\" {factor} times that of \"{}\" and \"{}\": one of their units is wrong; correct \
                 the name",
                modulus.title, curve.columns[0].title, imaginary.title
            );
            return Err(refused(line, met));
        }
    }
    let Some(phase) = &table.polar.phase else {
        return Ok(None);
    };
    let Some(row) = opposite(rows, beside, phase) else {
        return Ok(None);
    };
    let (titles, line) = ((&imaginary.title, &phase.title), rows[row].line);
    let opposed = format!("\"{}\" and \"{}\" of opposite sign", titles.0, titles.1);
    match (imaginary.sign < 0.0, phase.sign < 0.0) {
        // The written sign takes precedence.
        (false, true) => {
            for row in rows {
                row.point.z_ohm = row.point.z_ohm.conj();
            }
            Ok(Some(format!(
                "{opposed}: the imaginary part is taken as −Im Z, for the name of the phase says its sign"
            )))
        }
        (true, false) => Ok(Some(format!(
            "{opposed}: the phase is passed over, for the name of the imaginary part says its sign"
        ))),
        _ => {
            let point = rows[row].point;
            let (im, f) = (point.z_ohm.im, point.freq_hz);
            Err(refused(
                line,
                format!(
                    "{opposed}: at {f} Hz Im Z is {im} Ω and the phase {} rad; write a minus before the \
                     name that holds the negative (-Z'' or -Phase)",
                    beside[row].phase
                ),
            ))
        }
    }
}

/// Returns a row whose phase is that of the conjugate, if most rows are so.
fn opposite(rows: &[MeasuredRow], beside: &[Beside], phase: &Column) -> Option<usize> {
    // Without a unit, the magnitude distinguishes degrees from radians.
    let factors: &[f64] = if phase.unit.is_some() {
        &[1.0]
    } else {
        &[1.0, std::f64::consts::PI / 180.0]
    };
    factors.iter().find_map(|factor| {
        let pairs = rows.iter().zip(beside).enumerate();
        let known: Vec<(usize, f64, f64)> = pairs
            .map(|(k, (row, beside))| (k, row.point.z_ohm.arg(), factor * beside.phase))
            .filter(|(_, of_parts, stated)| stated.is_finite() && of_parts.abs() > SMALL_RAD)
            .collect();
        let close = |a: f64, b: f64| (a - b).abs() < NEAR * a.abs().max(0.1);
        let opposite = mostly(&known, |(_, of_parts, stated)| close(*of_parts, -stated));
        opposite.then(|| known.first().map(|(k, ..)| *k)).flatten()
    })
}

/// Returns whether most of a sufficient number of values meet a condition.
fn mostly<T>(all: &[T], is: impl Fn(&T) -> bool) -> bool {
    let count = all.iter().filter(|one| is(one)).count();
    #[expect(clippy::cast_precision_loss, reason = "numbers of rows")]
    let most = count as f64 >= MOST * all.len() as f64;
    all.len() >= FEWEST && most
}
