//! One row of a table whose columns are known.

use super::columns::{Column, Impedance, Layout};
use crate::formats::error::FormatError;
use crate::formats::text::{self, Row, Text, shorten};
use analysis_numeric::Covariance2;
use analysis_signal::spectrum::{ImpedancePoint, Origin};
use num_complex::Complex64;

/// One row read by a layout.
pub(super) struct Cells<'a> {
    pub(super) text: &'a Text<'a>,
    pub(super) row: &'a Row<'a>,
    pub(super) layout: &'a Layout,
}

impl Cells<'_> {
    /// Returns the point of the row, with NaN for a part that was not measured; `None` for a row
    /// without a frequency and an impedance.
    pub(super) fn read(&self) -> Result<Option<(Origin, ImpedancePoint)>, FormatError> {
        self.check_width()?;
        let l = self.layout;
        let [a, b] = l.impedance.columns();
        if [l.freq, a, b]
            .into_iter()
            .all(|column| text::is_missing(self.field(column)))
        {
            return Ok(None);
        }
        let freq_hz = self.number(l.freq, "a positive finite frequency in Hz", |f| f > 0.0)?;
        let z_ohm = match l.impedance {
            Impedance::Cartesian { re, im } => {
                let part = |c| self.measured(c, "a finite number in Ω", |_| true);
                Complex64::new(part(re)?, part(im)?)
            }
            Impedance::Polar { abs, phase } => Complex64::from_polar(
                self.measured(abs, "a finite magnitude of zero or more in Ω", |m| {
                    m >= 0.0
                })?,
                self.measured(phase, "a finite angle in rad", |_| true)?,
            ),
        };
        let amplitude_a = self
            .optional(l.amplitude, "a positive amplitude in A, or nothing", |a| {
                a > 0.0
            })?
            .unwrap_or(f64::NAN);
        let point = ImpedancePoint {
            freq_hz,
            z_ohm,
            covariance: self.covariance()?,
            amplitude_a,
        };
        Ok(Some((self.origin()?, point)))
    }

    fn check_width(&self) -> Result<(), FormatError> {
        let (expected, met) = (self.layout.width, self.row.fields.len());
        let only_blanks_more =
            met > expected && self.row.fields[expected..].iter().all(|f| f.is_empty());
        if met == expected || only_blanks_more {
            return Ok(());
        }
        Err(FormatError::FieldCount {
            file: self.text.file(),
            line: self.row.line,
            column: met.min(expected) + 1,
            expected,
            met,
        })
    }

    fn origin(&self) -> Result<Origin, FormatError> {
        let bias_a = match self.layout.bias {
            // −0 and 0 are the same bias.
            Some(column) => Some(self.number(column, "a finite current in A", |_| true)? + 0.0),
            None => None,
        };
        let Some([fixture, cell, repeat]) = self.layout.labels else {
            return Ok(Origin {
                bias_a,
                ..Origin::default()
            });
        };
        if self.field(fixture).is_empty() {
            return Err(self.error(fixture, "the name of what was clamped in"));
        }
        let filled = |c| Some(self.field(c).to_owned()).filter(|t| !t.is_empty());
        Ok(Origin {
            fixture: filled(fixture),
            cell: filled(cell),
            repeat: filled(repeat),
            bias_a,
            curve: None,
        })
    }

    fn covariance(&self) -> Result<Covariance2, FormatError> {
        let Some((re, im)) = self.layout.sigma else {
            return Ok(Covariance2::UNKNOWN);
        };
        let sigma = |c| {
            self.optional(
                Some(c),
                "a standard uncertainty of zero or more in Ω, or nothing",
                |s| s >= 0.0,
            )
        };
        let (Some(sigma_re), Some(sigma_im)) = (sigma(re)?, sigma(im)?) else {
            return Ok(Covariance2::UNKNOWN);
        };
        // Rounding in the file can make the correlation slightly exceed one.
        let most = sigma_re * sigma_im * (1.0 + 1e-9);
        let expected = "a covariance in Ω² no larger than the product of the sigmas, or nothing";
        let re_im = self
            .optional(self.layout.cov, expected, |c| c.abs() <= most)?
            .unwrap_or(0.0);
        Ok(Covariance2 {
            re_re: sigma_re * sigma_re,
            re_im,
            im_im: sigma_im * sigma_im,
        })
    }

    fn number(
        &self,
        column: Column,
        expected: &'static str,
        good: impl Fn(f64) -> bool,
    ) -> Result<f64, FormatError> {
        match text::number(self.field(column), self.text.separator) {
            Some(v) if v.is_finite() && good(v) => Ok(v),
            _ => Err(self.error(column, expected)),
        }
    }

    /// Returns a part of an impedance; NaN if the field marks a missing measurement.
    fn measured(
        &self,
        column: Column,
        expected: &'static str,
        good: impl Fn(f64) -> bool,
    ) -> Result<f64, FormatError> {
        if text::is_missing(self.field(column)) {
            return Ok(f64::NAN);
        }
        let value = self.number(column, expected, good)?;
        Ok(if text::is_measured(value) {
            value
        } else {
            f64::NAN
        })
    }

    /// Returns `None` for a column that the file lacks, an empty field, or NaN, which means
    /// unknown.
    fn optional(
        &self,
        column: Option<Column>,
        expected: &'static str,
        good: impl Fn(f64) -> bool,
    ) -> Result<Option<f64>, FormatError> {
        match column {
            Some(c) if !self.field(c).is_empty() && !self.field(c).eq_ignore_ascii_case("nan") => {
                self.number(c, expected, good).map(Some)
            }
            _ => Ok(None),
        }
    }

    fn field(&self, column: Column) -> &str {
        self.row
            .fields
            .get(column.index)
            .copied()
            .unwrap_or_default()
    }

    fn error(&self, column: Column, expected: &'static str) -> FormatError {
        let quoted = shorten(self.field(column));
        let met = quoted.trim_matches('"').to_owned();
        FormatError::Field {
            file: self.text.file(),
            line: self.row.line,
            column: column.index + 1,
            name: column.name,
            expected,
            met,
        }
    }
}
