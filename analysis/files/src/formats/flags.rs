//! Reasons for which a quality gate has refused a point: the column `flags` of the project's own
//! CSV. Reasons are separated by `; `. The column is empty for accepted points.

use super::text::{self, Text};
use analysis_signal::spectrum::{FlaggedPoint, SourcedSpectrum};

/// Reads the column, if the header names it, into the spectra that contain the points.
pub(super) fn attach(text: &Text<'_>, spectra: &mut [SourcedSpectrum]) {
    let Some((header, rows)) = text.rows.split_first() else {
        return;
    };
    let place = |name: &str| {
        header
            .fields
            .iter()
            .position(|field| field.eq_ignore_ascii_case(name))
    };
    let (Some(freq), Some(re), Some(im), Some(flags)) = (
        place("freq_hz"),
        place("z_re_ohm"),
        place("z_im_ohm"),
        place("flags"),
    ) else {
        return;
    };
    for row in rows {
        let message = row.fields.get(flags).copied().unwrap_or_default();
        let number = |column: usize| {
            row.fields
                .get(column)
                .and_then(|field| text::number(field, text.separator))
        };
        let (Some(freq_hz), Some(re_ohm), Some(im_ohm), false) =
            (number(freq), number(re), number(im), message.is_empty())
        else {
            continue;
        };
        // A file may hold several sweeps: the point identifies its sweep.
        let holds = |one: &&mut SourcedSpectrum| {
            one.spectrum
                .points
                .iter()
                .any(|p| p.freq_hz == freq_hz && p.z_ohm.re == re_ohm && p.z_ohm.im == im_ohm)
        };
        let reasons = message.split("; ").map(str::to_owned).collect();
        if let Some(one) = spectra.iter_mut().find(holds) {
            one.flagged.push(FlaggedPoint { freq_hz, reasons });
        }
    }
}
