//! One line of a table and the numbers in it.

use super::names::Quantity;
use super::table::{Column, Curve, Table};
use crate::formats::error::FormatError;
use crate::formats::text::{self, shorten};
use num_complex::Complex64;
use std::path::Path;

/// One line of a table.
pub(super) struct Line<'a> {
    pub(super) path: &'a Path,
    pub(super) at: usize,
    pub(super) fields: Vec<&'a str>,
    pub(super) separator: char,
}

impl Line<'_> {
    /// Returns the number of a column by its index.
    pub(super) fn number(&self, column: usize) -> Option<f64> {
        self.fields
            .get(column)
            .and_then(|field| text::number(field, self.separator))
    }

    /// Returns the fields up to the last one that is not empty.
    pub(super) fn filled(&self) -> usize {
        self.fields
            .iter()
            .rposition(|field| !field.is_empty())
            .map_or(0, |last| last + 1)
    }

    /// Refuses a row with more or fewer fields than names. EC-Lab's rows may all lack the same last
    /// fields, if none of these is read.
    pub(super) fn check_width(
        &self,
        table: &Table,
        first: usize,
        ec_lab: bool,
    ) -> Result<(), FormatError> {
        let width = table.width;
        let short =
            ec_lab && self.fields.len() == first && table.read().all(|column| column.index < first);
        if self.filled() > width || self.fields.len() < width && !short {
            Err(self.ragged(width))
        } else {
            Ok(())
        }
    }

    /// Returns whether a column has no value in the row.
    pub(super) fn lacks(&self, column: &Column) -> bool {
        self.fields
            .get(column.index)
            .is_none_or(|field| text::is_missing(field))
    }

    /// Returns the error for a row with too few or too many fields.
    pub(super) fn ragged(&self, expected: usize) -> FormatError {
        let met = if self.filled() > expected {
            self.filled()
        } else {
            self.fields.len()
        };
        FormatError::FieldCount {
            file: self.path.to_owned(),
            line: self.at + 1,
            column: met.min(expected) + 1,
            expected,
            met,
        }
    }

    /// Returns an impedance; if its phase has no unit, modulus and phase without conversion.
    pub(super) fn impedance(&self, curve: &Curve) -> Result<Complex64, FormatError> {
        let [a, b] = &curve.columns;
        if b.quantity == Quantity::Imaginary {
            let part = |column: &Column| self.measured(column, "a finite number in Ω", |_| true);
            return Ok(Complex64::new(part(a)?, part(b)?));
        }
        let modulus = self.measured(a, "a finite magnitude of zero or more in Ω", |value| {
            value >= 0.0
        })?;
        let angle = self.measured(b, "a finite angle", |_| true)?;
        Ok(if b.unit.is_some() {
            Complex64::from_polar(modulus, angle)
        } else {
            Complex64::new(modulus, angle)
        })
    }

    /// Returns the number of a column in its unit; NaN if it was not measured.
    pub(super) fn measured(
        &self,
        column: &Column,
        expected: &'static str,
        good: impl Fn(f64) -> bool,
    ) -> Result<f64, FormatError> {
        if self.lacks(column) {
            return Ok(f64::NAN);
        }
        let value = self.finite(column, expected, good)?;
        Ok(if text::is_measured(value) {
            value * column.factor()
        } else {
            f64::NAN
        })
    }

    /// Returns the number of a column if it is in range.
    pub(super) fn finite(
        &self,
        column: &Column,
        expected: &'static str,
        good: impl Fn(f64) -> bool,
    ) -> Result<f64, FormatError> {
        self.number(column.index)
            .filter(|value| value.is_finite() && good(*value))
            .ok_or_else(|| self.wrong(column, expected))
    }

    /// Returns the error for a field of a column.
    pub(super) fn wrong(&self, column: &Column, expected: &'static str) -> FormatError {
        let name = match column.quantity {
            Quantity::Frequency => "frequency",
            Quantity::Real => "Re Z",
            Quantity::Imaginary => "Im Z",
            Quantity::Modulus => "|Z|",
            Quantity::Phase => "phase",
        };
        self.wrong_named(column.index, name, expected)
    }

    /// Returns the error for a field by the name of its column.
    pub(super) fn wrong_named(
        &self,
        index: usize,
        name: &'static str,
        expected: &'static str,
    ) -> FormatError {
        let field = self.fields.get(index);
        let met = field.map_or_else(
            || "the end of the line".to_owned(),
            |field| shorten(field).trim_matches('"').to_owned(),
        );
        FormatError::Field {
            file: self.path.to_owned(),
            line: self.at + 1,
            column: index + 1,
            name,
            expected,
            met,
        }
    }
}
