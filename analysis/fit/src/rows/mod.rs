//! Results of many spectra as one table: a row for each spectrum, whether it could be worked on or
//! not.
//!
//! Every kind of table begins with `spectrum_id` and ends with `warning_codes`, `warnings` (each
//! with semicolons between) and `error`. Names hold units. What is not known is missing.

mod circuit;
mod erm;
mod validity;

pub use circuit::CircuitRows;
pub use erm::ErmRows;
pub use validity::ValidityRows;

use crate::fit::Warnings;
use analysis_signal::spectrum::{ImpedancePoint, SourcedSpectrum, Spectrum};
use num_complex::Complex64;

/// Kind of the values of a column.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ColumnKind {
    /// Floating-point numbers.
    Number,
    /// Whole numbers.
    Count,
    /// Texts.
    Text,
}

/// A column of a table of results.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ResultColumn {
    /// Name with the unit.
    pub name: String,
    /// Kind of its values.
    pub kind: ColumnKind,
}

impl ResultColumn {
    /// Column of floating-point numbers.
    pub fn number(name: impl Into<String>) -> Self {
        Self {
            name: name.into(),
            kind: ColumnKind::Number,
        }
    }

    /// Column of whole numbers.
    pub fn count(name: impl Into<String>) -> Self {
        Self {
            name: name.into(),
            kind: ColumnKind::Count,
        }
    }

    /// Column of texts.
    pub fn text(name: impl Into<String>) -> Self {
        Self {
            name: name.into(),
            kind: ColumnKind::Text,
        }
    }

    /// A value that is not known.
    pub fn missing(&self) -> Cell {
        match self.kind {
            ColumnKind::Number => Cell::Number(None),
            ColumnKind::Count => Cell::Count(None),
            ColumnKind::Text => Cell::Text(None),
        }
    }
}

/// A value of a table of results.
#[derive(Debug, Clone, PartialEq)]
pub enum Cell {
    /// Of a column of numbers.
    Number(Option<f64>),
    /// Of a column of whole numbers.
    Count(Option<u64>),
    /// Of a column of texts.
    Text(Option<String>),
}

impl Cell {
    /// Returns the value if it is finite.
    pub fn finite(value: f64) -> Self {
        Self::Number(Some(value).filter(|value| value.is_finite()))
    }

    /// A whole number.
    pub fn whole(value: usize) -> Self {
        Self::Count(Some(value as u64))
    }

    /// A text.
    pub fn text(value: impl Into<String>) -> Self {
        Self::Text(Some(value.into()))
    }
}

/// Results of one spectrum, in the order of the columns, and whether they need attention.
#[derive(Debug, Clone, PartialEq)]
pub struct ResultRow {
    /// One value for each column.
    pub cells: Vec<Cell>,
    /// Reason why the result is missing; the last cell contains it too.
    pub error: Option<String>,
    /// The result carries warnings.
    pub has_warnings: bool,
    /// Impedances that the result gives at the points that it comes from.
    pub fitted: Option<Spectrum>,
}

/// Work on one spectrum that gives a row.
pub trait ResultRows: Sync {
    /// Columns between `spectrum_id` and `warning_codes`.
    fn own_columns(&self) -> Vec<ResultColumn>;

    /// Returns the values of these columns, and warnings.
    ///
    /// # Errors
    /// The reason why there are no values.
    fn values(&self, sourced: &SourcedSpectrum) -> Result<RowValues, String>;

    /// All columns.
    fn columns(&self) -> Vec<ResultColumn> {
        let mut columns = vec![ResultColumn::text("spectrum_id")];
        columns.extend(self.own_columns());
        columns.extend(["warning_codes", "warnings", "error"].map(ResultColumn::text));
        columns
    }

    /// Returns the row of a spectrum, or of the reason why it is missing.
    fn row(&self, spectrum_id: &str, spectrum: &Result<SourcedSpectrum, String>) -> ResultRow {
        let values = spectrum
            .as_ref()
            .map_err(Clone::clone)
            .and_then(|sourced| self.values(sourced));
        let (values, error) = match values {
            Ok(values) => (values, None),
            Err(reason) => (self.missing(), Some(reason)),
        };
        let has_warnings = !values.warning_codes.is_empty();
        let mut cells = vec![Cell::Text(Some(spectrum_id.to_owned()))];
        cells.extend(values.cells);
        cells.push(Cell::Text(Some(values.warning_codes.join(";"))));
        cells.push(Cell::Text(Some(values.warnings.join("; "))));
        cells.push(Cell::Text(error.clone()));
        ResultRow {
            cells,
            error,
            has_warnings,
            fitted: values.fitted,
        }
    }

    /// Values of a spectrum without a result.
    fn missing(&self) -> RowValues {
        let columns = self.own_columns();
        RowValues {
            cells: columns.iter().map(ResultColumn::missing).collect(),
            ..RowValues::default()
        }
    }
}

/// Values of one row between the columns that all tables have.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct RowValues {
    /// One value for each of [`ResultRows::own_columns`].
    pub cells: Vec<Cell>,
    /// Kinds of the warnings, each once.
    pub warning_codes: Vec<String>,
    /// The warnings in sentences.
    pub warnings: Vec<String>,
    /// Impedances that the result gives at the points that it comes from.
    pub fitted: Option<Spectrum>,
}

impl RowValues {
    fn of(cells: Vec<Cell>, warnings: &Warnings, fitted: Spectrum) -> Self {
        let codes = warnings.codes();
        Self {
            cells,
            warning_codes: codes.iter().map(|code| code.name().to_owned()).collect(),
            warnings: warnings.words(),
            fitted: Some(fitted),
        }
    }
}

/// A model at the points of a spectrum.
fn at_points(spectrum: &Spectrum, name: &str, z_ohm: impl Fn(f64) -> Complex64) -> Spectrum {
    let point = |p: &ImpedancePoint| ImpedancePoint {
        z_ohm: z_ohm(p.freq_hz),
        ..*p
    };
    Spectrum {
        name: name.to_owned(),
        points: spectrum.points.iter().map(point).collect(),
        ..Spectrum::default()
    }
}
