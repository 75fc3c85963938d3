//! Errors that the points of a spectrum share, as columns of the project's own CSV.

use analysis_signal::spectrum::{SharedError, Spectrum};

pub(crate) const RE: &str = "shared_re_ohm[";
pub(crate) const IM: &str = "shared_im_ohm[";

/// Header and rows of the columns of a spectrum's shared errors, each with a leading comma; empty
/// without such errors.
pub(crate) fn columns(spectrum: &Spectrum) -> (String, Vec<String>) {
    // The name is part of a comma-separated header.
    let name = |error: &SharedError| {
        error
            .name
            .replace([',', ';', '\t', '\n', '\r', '"', '[', ']'], " ")
    };
    let header = spectrum
        .shared
        .iter()
        .map(|error| format!(",{RE}{0}],{IM}{0}]", name(error)))
        .collect();
    let row = |k: usize| {
        let cell = |error: &SharedError| {
            error
                .at_ohm
                .get(k)
                .map_or_else(|| ",,".to_owned(), |d| format!(",{:?},{:?}", d.re, d.im))
        };
        spectrum.shared.iter().map(cell).collect()
    };
    (header, (0..spectrum.points.len()).map(row).collect())
}
