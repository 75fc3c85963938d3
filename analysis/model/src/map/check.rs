//! Checks of the numbers of a map.

use std::ops::RangeInclusive;

/// Reason why numbers are not a map.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum MapError {
    /// A list of the wrong length.
    #[error("map: {field}: expected {expected} values, met {met}")]
    Length {
        /// Name of the list.
        field: String,
        /// Number of values that belong there.
        expected: usize,
        /// Number found.
        met: usize,
    },
    /// A value that cannot be.
    #[error("map: {field}: expected {expected}, met {met}")]
    Value {
        /// Name of the field, with its place.
        field: String,
        /// Allowed values.
        expected: &'static str,
        /// Value found.
        met: f64,
    },
}

pub(super) fn length(field: &str, expected: usize, met: usize) -> Result<(), MapError> {
    if expected == met {
        return Ok(());
    }
    let field = field.to_owned();
    Err(MapError::Length {
        field,
        expected,
        met,
    })
}

pub(super) fn finite(field: &str, list: &[f64]) -> Result<(), MapError> {
    match list.iter().find(|value| !value.is_finite()) {
        None => Ok(()),
        Some(met) => Err(MapError::Value {
            field: field.to_owned(),
            expected: "finite numbers",
            met: *met,
        }),
    }
}

pub(super) fn zero_or_more(field: &str, list: &[f64]) -> Result<(), MapError> {
    match list
        .iter()
        .find(|value| !(value.is_finite() && **value >= 0.0))
    {
        None => Ok(()),
        Some(met) => Err(MapError::Value {
            field: field.to_owned(),
            expected: "zero or more",
            met: *met,
        }),
    }
}

pub(super) fn positive(field: &str, met: f64) -> Result<(), MapError> {
    if met.is_finite() && met > 0.0 {
        return Ok(());
    }
    Err(MapError::Value {
        field: field.to_owned(),
        expected: "a number above zero",
        met,
    })
}

pub(super) fn rising(
    field: &str,
    list: &[f64],
    least: usize,
    range: RangeInclusive<f64>,
    expected: &'static str,
) -> Result<(), MapError> {
    if list.len() < least {
        return length(field, least, list.len());
    }
    let mut before = f64::NEG_INFINITY;
    for (k, met) in list.iter().enumerate() {
        if !range.contains(met) || *met <= before {
            return Err(MapError::Value {
                field: format!("{field}[{k}]"),
                expected,
                met: *met,
            });
        }
        before = *met;
    }
    Ok(())
}
