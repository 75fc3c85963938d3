//! Columns of a table in long form, and rows as they come from a file.

use std::collections::BTreeMap;

/// Column that identifies the spectrum of a row.
pub(super) const ID: &str = "spectrum_id";
/// Columns that every table has.
pub(super) const NEEDED: [&str; 3] = ["freq_hz", "z_re_ohm", "z_im_ohm"];
/// Columns that a table may have.
pub(super) const OPTIONAL: [&str; 5] = [
    "sigma_ohm",
    "sigma_re_ohm",
    "sigma_im_ohm",
    "cov_re_im_ohm2",
    "amplitude_a",
];
/// Number of columns of numbers.
pub(super) const NUMBERS: usize = NEEDED.len() + OPTIONAL.len();

/// Names of the columns of numbers, in the order of [`Rows::numbers`].
pub(super) fn names() -> impl Iterator<Item = &'static str> {
    NEEDED.into_iter().chain(OPTIONAL)
}

/// Rows that follow each other in a file.
#[derive(Debug, Default)]
pub(super) struct Rows {
    /// Line or row of the first, from 1.
    pub(super) first: usize,
    /// Their spectra; empty if the table has no such column.
    pub(super) ids: Vec<String>,
    /// One list for each of [`names`]; empty if the table has no such column.
    pub(super) numbers: [Vec<f64>; NUMBERS],
    /// Indices of the rows that cannot be used, with the reasons.
    pub(super) refused: BTreeMap<usize, String>,
}

impl Rows {
    /// Number of rows.
    pub(super) fn len(&self) -> usize {
        self.numbers[0].len()
    }

    /// Returns the number of a column in a row; `None` if the table has no such column.
    pub(super) fn number(&self, column: usize, row: usize) -> Option<f64> {
        self.numbers[column].get(row).copied()
    }
}

/// Formats the place of a row for messages.
pub(super) fn place(kind: &str, number: usize) -> String {
    format!("{kind} {number}")
}
