//! The rows of a table.

use super::names::Quantity;
use super::table::{self, Column, Curve, Table};
use crate::formats::{
    error::FormatError,
    sweeps::{Key, MeasuredRow, Rows, label_value},
    text::{self, shorten},
};
use analysis_numeric::Covariance2;
use analysis_signal::spectrum::{ImpedancePoint, Origin};
use num_complex::Complex64;
use std::path::Path;

/// Lines between names and numbers, at most.
const UNITS: usize = 3;
/// Mark of Gamry for a measurement that was aborted.
const ABORTED: &str = "EXPERIMENTABORTED";
/// Names of the curves of a row with two.
const CORRECTED: &str = "drift-corrected";
const UNCORRECTED: &str = "uncorrected";

/// The tables of a file as they are read.
pub(super) struct Reader<'a> {
    path: &'a Path,
    lines: &'a [&'a str],
    pub(super) rows: Rows,
    pub(super) notes: Vec<String>,
    /// True when some row named the columns of an impedance.
    pub(super) met_table: bool,
    tables: Vec<String>,
    mark: Option<char>,
}

/// One line of a table.
struct Line<'a> {
    path: &'a Path,
    at: usize,
    fields: Vec<&'a str>,
    separator: char,
}

/// Kind of a line below the names.
enum LineKind {
    /// A blank one, or a remark.
    Nothing,
    Units,
    /// One of numbers, with its frequency.
    Row(f64),
    /// The first behind the table.
    End,
}

impl<'a> Reader<'a> {
    pub(super) fn new(path: &'a Path, lines: &'a [&'a str]) -> Self {
        Self {
            path,
            lines,
            rows: Rows {
                rows: Vec::new(),
                keys: vec![Key::Table, Key::Curve],
            },
            notes: Vec::new(),
            met_table: false,
            tables: Vec::new(),
            mark: None,
        }
    }

    /// Whether a line names the columns of an impedance, rightly or not.
    pub(super) fn takes(&self, at: usize) -> bool {
        table::table(self.path, self.lines, at).is_some()
    }

    /// Reads the table under a row of names; gives the line behind it.
    pub(super) fn read_table(&mut self, header: usize) -> Result<usize, FormatError> {
        let Some(table) = table::table(self.path, self.lines, header) else {
            return Ok(header + 1);
        };
        let mut table = table?;
        self.met_table = true;
        let name = self.name_table(header);
        let before = self.rows.rows.len();
        let (mut seen, mut end) = (0, self.lines.len());
        for at in header + 1..self.lines.len() {
            if is_title(self.lines[at]).is_some() {
                end = at;
                break;
            }
            if self.lines[at].trim_start().starts_with(ABORTED) {
                self.notes.push(format!(
                    "{}: the measurement was aborted; what stands behind line {} is not read",
                    self.file(),
                    at + 1
                ));
                break;
            }
            let line = self.line(at, &table);
            match self.told(&line, &table, seen)? {
                LineKind::Nothing => {}
                LineKind::Units => table.take_units(&line.fields, self.path, at + 1)?,
                LineKind::End => {
                    end = at;
                    break;
                }
                LineKind::Row(freq) => {
                    seen += 1;
                    // So EC-Lab marks direct current.
                    if freq != 0.0 {
                        self.take_row(&line, &table, &name)?;
                        table.others.iter_mut().for_each(|other| {
                            other.used |=
                                line.number(other.index).is_some_and(|value| value != 0.0);
                        });
                    }
                }
            }
        }
        self.tell(&table, before)?;
        Ok(end)
    }

    /// Kind of a line below the names, after so many rows.
    ///
    /// # Errors
    /// A row with a frequency that is none, or with too few or too many fields; text before further
    /// rows.
    fn told(&self, line: &Line<'_>, table: &Table, seen: usize) -> Result<LineKind, FormatError> {
        if line.filled() == 0 || seen == 0 && self.counts_rows(line, table) {
            return Ok(LineKind::Nothing);
        }
        if let Some(freq) = line.number(table.freq.index) {
            return line.check_width(table.width).map(|()| LineKind::Row(freq));
        }
        let number = |column: &Column| line.number(column.index).is_some();
        if table
            .curves
            .iter()
            .all(|curve| curve.columns.iter().all(number))
        {
            return Err(line.wrong(&table.freq, "a positive finite frequency in Hz"));
        }
        if line
            .fields
            .iter()
            .all(|field| field.is_empty() || text::number(field, line.separator).is_some())
        {
            return Err(line.ragged(table.width));
        }
        let below = line.at - table.line;
        if seen == 0 && below <= UNITS && !self.ends(line.at) {
            return Ok(
                if [line.filled(), line.fields.len()].contains(&table.width) {
                    LineKind::Units
                } else {
                    LineKind::Nothing
                },
            );
        }
        if !self.ends(line.at) && self.goes_on(line.at + 1, table) {
            return Err(line.wrong(
                &table.freq,
                "a frequency in Hz, or no further rows behind the end of the table",
            ));
        }
        Ok(LineKind::End)
    }

    /// Tells what was not read, and settles phases without unit.
    fn tell(&mut self, table: &Table, before: usize) -> Result<(), FormatError> {
        let left: Vec<&str> = table
            .others
            .iter()
            .filter(|other| other.used)
            .map(|other| other.title.as_str())
            .collect();
        if !left.is_empty() {
            self.notes.push(format!(
                "{}: {} is read; {} are left out",
                self.file(),
                table.curves[0].columns[0].title,
                left.join(", ")
            ));
        }
        for Curve {
            columns: [_, phase],
            ..
        } in table
            .curves
            .iter()
            .filter(|curve| curve.columns[1].quantity == Quantity::Phase)
        {
            if phase.unit.is_none() {
                self.settle_phase(phase, before)?;
            }
        }
        Ok(())
    }

    /// Degrees, where angles go beyond a turn in rad; points hold them as if they were radians
    /// until then, in the imaginary part.
    fn settle_phase(&mut self, phase: &Column, before: usize) -> Result<(), FormatError> {
        let rows = &mut self.rows.rows[before..];
        let widest = rows
            .iter()
            .map(|row| row.point.z_ohm.im.abs())
            .fold(0.0, f64::max);
        if widest <= std::f64::consts::TAU {
            return Err(FormatError::Unit {
                file: self.path.to_owned(),
                line: rows.first().map_or(0, |row| row.line),
                column: phase.index + 1,
                name: phase.title.clone(),
                expected: phase.quantity.unit(),
                met: "no unit".to_owned(),
                reason: "its angles could be either",
            });
        }
        for row in rows {
            let Complex64 {
                re: modulus,
                im: angle,
            } = row.point.z_ohm;
            row.point.z_ohm = Complex64::from_polar(modulus, angle.to_radians());
        }
        self.notes.push(format!(
            "{}: column \"{}\" has no unit and is taken in degrees, for it goes beyond 2π",
            self.file(),
            phase.title
        ));
        Ok(())
    }

    fn take_row(&mut self, line: &Line<'_>, table: &Table, name: &str) -> Result<(), FormatError> {
        self.check_mark(line, table)?;
        let freq_hz = line.finite(&table.freq, "a positive finite frequency in Hz", |value| {
            value > 0.0
        })? * table.freq.factor();
        let labels: Vec<(Key, String)> = table
            .labels
            .iter()
            .map(|(kind, place)| {
                (
                    Key::Column(kind),
                    line.fields
                        .get(*place)
                        .map(|field| label_value(field))
                        .unwrap_or_default(),
                )
            })
            .collect();
        for curve in &table.curves {
            let point = ImpedancePoint {
                freq_hz,
                z_ohm: line.impedance(curve)?,
                covariance: Covariance2::UNKNOWN,
                amplitude_a: f64::NAN,
            };
            let which = match (table.curves.len(), curve.drift_corrected) {
                (1, _) => "",
                (_, true) => CORRECTED,
                (_, false) => UNCORRECTED,
            };
            let mut key = vec![name.to_owned(), which.to_owned()];
            for (place, (kind, value)) in labels.iter().enumerate() {
                if self.rows.keys.get(2 + place).is_none() {
                    self.rows.keys.push(*kind);
                }
                key.push(value.clone());
            }
            key.resize(key.len().max(self.rows.keys.len()), String::new());
            self.rows.rows.push(MeasuredRow {
                line: line.at + 1,
                origin: Origin::default(),
                key,
                point,
            });
        }
        Ok(())
    }

    /// One decimal mark in all numbers that are read.
    fn check_mark(&mut self, line: &Line<'_>, table: &Table) -> Result<(), FormatError> {
        for column in table.read() {
            let Some(found) = line
                .fields
                .get(column.index)
                .and_then(|field| text::mark(field, line.separator))
            else {
                continue;
            };
            if *self.mark.get_or_insert(found) != found {
                return Err(line.wrong_named(
                    column.index,
                    "number",
                    "one decimal mark in all numbers, a comma or a point",
                ));
            }
        }
        Ok(())
    }

    /// The name of a table: as the line before says, where it is Gamry's.
    fn name_table(&mut self, header: usize) -> String {
        let before = self.lines[..header]
            .last()
            .and_then(|line| is_title(line))
            .map(str::to_owned);
        let name = before
            .filter(|name| !self.tables.contains(name))
            .unwrap_or_else(|| format!("table{}", self.tables.len() + 1));
        self.tables.push(name.clone());
        name
    }

    fn line(&self, at: usize, table: &Table) -> Line<'a> {
        Line {
            path: self.path,
            at,
            fields: table::fields(self.lines[at], table.separator),
            separator: table.separator,
        }
    }

    /// Whether a line begins another table.
    fn ends(&self, at: usize) -> bool {
        is_title(self.lines[at]).is_some() || self.takes(at)
    }

    /// Whether rows of the table follow, up to a mark of an aborted measurement or another table.
    fn goes_on(&self, from: usize, table: &Table) -> bool {
        let ahead = (from..self.lines.len())
            .take_while(|at| !self.lines[*at].trim_start().starts_with(ABORTED) && !self.ends(*at));
        ahead.map(|at| self.line(at, table)).any(|line| {
            table
                .read()
                .all(|column| line.number(column.index).is_some())
        })
    }

    /// Whether a line under the names states the number of rows.
    fn counts_rows(&self, line: &Line<'_>, table: &Table) -> bool {
        let alone = line.filled() == 1 && table.width > 1;
        let rows = || {
            (line.at + 1..self.lines.len())
                .take_while(|at| self.line(*at, table).number(table.freq.index).is_some())
                .count()
        };
        alone
            && line
                .fields
                .first()
                .and_then(|field| field.parse().ok())
                .is_some_and(|count: usize| count == rows())
    }

    fn file(&self) -> String {
        self.path
            .file_name()
            .map_or_else(String::new, |name| name.to_string_lossy().into_owned())
    }
}

/// The name of a table of Gamry's, whose title this line is.
fn is_title(line: &str) -> Option<&str> {
    let mut fields = line.split('\t');
    let name = fields.next().filter(|name| !name.is_empty())?;
    (fields.next()?.trim() == "TABLE").then_some(name)
}

impl Line<'_> {
    fn number(&self, column: usize) -> Option<f64> {
        self.fields
            .get(column)
            .and_then(|field| text::number(field, self.separator))
    }

    /// Fields up to the last that is not empty.
    fn filled(&self) -> usize {
        self.fields
            .iter()
            .rposition(|field| !field.is_empty())
            .map_or(0, |last| last + 1)
    }

    fn check_width(&self, width: usize) -> Result<(), FormatError> {
        if self.filled() > width || self.fields.len() < width {
            Err(self.ragged(width))
        } else {
            Ok(())
        }
    }

    fn ragged(&self, expected: usize) -> FormatError {
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

    /// An impedance; of one whose phase has no unit, modulus and phase as they stand.
    fn impedance(&self, curve: &Curve) -> Result<Complex64, FormatError> {
        let [a, b] = &curve.columns;
        if b.quantity == Quantity::Imaginary {
            let part = |column: &Column| {
                Ok(self.finite(column, "a finite number in Ω", |_| true)? * column.factor())
            };
            return Ok(Complex64::new(part(a)?, part(b)?));
        }
        let modulus = self.finite(a, "a finite magnitude of zero or more in Ω", |value| {
            value >= 0.0
        })? * a.factor();
        let angle = self.finite(b, "a finite angle", |_| true)? * b.factor();
        Ok(if b.unit.is_some() {
            Complex64::from_polar(modulus, angle)
        } else {
            Complex64::new(modulus, angle)
        })
    }

    fn finite(
        &self,
        column: &Column,
        expected: &'static str,
        good: impl Fn(f64) -> bool,
    ) -> Result<f64, FormatError> {
        self.number(column.index)
            .filter(|value| value.is_finite() && good(*value))
            .ok_or_else(|| self.wrong(column, expected))
    }

    fn wrong(&self, column: &Column, expected: &'static str) -> FormatError {
        let name = match column.quantity {
            Quantity::Frequency => "frequency",
            Quantity::Real => "Re Z",
            Quantity::Imaginary => "Im Z",
            Quantity::Modulus => "|Z|",
            Quantity::Phase => "phase",
        };
        self.wrong_named(column.index, name, expected)
    }

    fn wrong_named(&self, index: usize, name: &'static str, expected: &'static str) -> FormatError {
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
