//! Errors that the points of a spectrum share, as columns of the project's own CSV:
//! `shared_re_ohm[NAME]` and `shared_im_ohm[NAME]` hold the deviation of each point by one standard
//! deviation of the error NAME, Ω.

use num_complex::Complex64;

use super::error::FormatError;
use super::text::{self, Row, Text};
use crate::dataset::shared::{IM, RE};
use analysis_signal::spectrum::{SharedError, SourcedSpectrum};

/// Reads the columns, if the header names any, into the only spectrum of a file. `rows` are the rows
/// of its points.
///
/// # Errors
/// Returns an error for a column without its other part and for a field that is not a number.
pub(super) fn attach(
    text: &Text<'_>,
    rows: &[&Row<'_>],
    spectra: &mut [SourcedSpectrum],
) -> Result<(), FormatError> {
    let (Some(header), [only]) = (text.rows.first(), spectra) else {
        return Ok(());
    };
    let named = |prefix: &str| -> Vec<(usize, String)> {
        let name = |field: &str| Some(field.strip_prefix(prefix)?.strip_suffix(']')?.to_owned());
        header
            .fields
            .iter()
            .enumerate()
            .filter_map(|(index, field)| Some((index, name(field)?)))
            .collect()
    };
    let imaginary = named(IM);
    for (re, name) in named(RE) {
        let Some((im, _)) = imaginary.iter().find(|(_, other)| *other == name) else {
            let (expected, met) = (
                format!("a column {IM}{name}] beside {RE}{name}]"),
                "none".to_owned(),
            );
            return Err(FormatError::Header {
                file: text.file(),
                line: header.line,
                expected,
                met,
            });
        };
        let at_ohm = rows.iter().map(|row| {
            let part = |column: usize| {
                let field = row.fields.get(column).copied().unwrap_or_default();
                text::number(field, text.separator)
                    .filter(|v| v.is_finite())
                    .ok_or_else(|| FormatError::Field {
                        file: text.file(),
                        line: row.line,
                        column: column + 1,
                        name: "shared error",
                        expected: "a finite number in Ω",
                        met: field.to_owned(),
                    })
            };
            Ok(Complex64::new(part(re)?, part(*im)?))
        });
        only.spectrum.shared.push(SharedError {
            name,
            at_ohm: at_ohm.collect::<Result<_, FormatError>>()?,
        });
    }
    // Points are already sorted; the columns still have the order of the file.
    let freq_column = header
        .fields
        .iter()
        .position(|field| field.eq_ignore_ascii_case("freq_hz"));
    if let (Some(column), false) = (freq_column, only.spectrum.shared.is_empty()) {
        let mut order: Vec<(f64, usize)> = rows
            .iter()
            .map(|row| {
                text::number(
                    row.fields.get(column).copied().unwrap_or_default(),
                    text.separator,
                )
                .unwrap_or(0.0)
            })
            .zip(0..)
            .collect();
        order.sort_by(|a, b| a.0.total_cmp(&b.0));
        for error in &mut only.spectrum.shared {
            error.at_ohm = order
                .iter()
                .filter_map(|(_, k)| error.at_ohm.get(*k).copied())
                .collect();
        }
    }
    Ok(())
}
