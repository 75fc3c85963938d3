//! The rows of a table.

use super::line::Line;
use super::names::Quantity;
use super::polar::{self, Beside};
use super::table::{self, Column, Curve, Table};
use crate::formats::{
    error::FormatError,
    sweeps::{Key, MeasuredRow, Rows, label_value},
    text,
};
use analysis_numeric::Covariance2;
use analysis_signal::spectrum::{ImpedancePoint, Origin};
use num_complex::Complex64;
use std::path::Path;

/// Maximum number of lines between names and numbers.
const UNITS: usize = 3;
/// Gamry's mark of an aborted measurement.
const ABORTED: &str = "EXPERIMENTABORTED";
/// Names of the curves of a row with two.
const CORRECTED: &str = "drift-corrected";
const UNCORRECTED: &str = "uncorrected";

/// State of reading the tables of a file.
pub(super) struct Reader<'a> {
    path: &'a Path,
    lines: &'a [&'a str],
    pub(super) rows: Rows,
    pub(super) notes: Vec<String>,
    /// Whether a row named the columns of an impedance.
    pub(super) met_table: bool,
    tables: Vec<String>,
    mark: Option<char>,
    /// Modulus and phase beside the rows of the current table.
    beside: Vec<Beside>,
}

/// Kind of a line below the names.
enum LineKind {
    /// A blank one, or a remark.
    Nothing,
    Units,
    /// One of numbers, with its frequency.
    Row(f64),
    /// The first line after the table.
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
            beside: Vec::new(),
        }
    }

    /// Returns whether a line names the columns of an impedance, with or without errors.
    pub(super) fn takes(&self, at: usize) -> bool {
        table::table(self.path, self.lines, at).is_some()
    }

    /// Reads the table under a row of names; returns the line after it.
    pub(super) fn read_table(&mut self, header: usize) -> Result<usize, FormatError> {
        let Some(table) = table::table(self.path, self.lines, header) else {
            return Ok(header + 1);
        };
        let mut table = table?;
        self.met_table = true;
        let name = self.name_table(header);
        let before = self.rows.rows.len();
        self.beside.clear();
        let mut short = None;
        let (mut seen, mut end, mut settling) = (0, self.lines.len(), 0);
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
            match self.line_kind(&line, &table, seen)? {
                LineKind::Nothing => {}
                LineKind::Units => table.take_units(&line.fields, self.path, at + 1)?,
                LineKind::End => {
                    end = at;
                    break;
                }
                LineKind::Row(freq) => {
                    line.check_width(
                        &table,
                        *short.get_or_insert(line.fields.len()),
                        self.is_ec_lab(),
                    )?;
                    seen += 1;
                    // EC-Lab marks direct current in this way.
                    if freq != 0.0 {
                        settling += usize::from(self.drop_settling(&table, freq, before));
                        self.take_row(&line, &table, &name)?;
                        table.others.iter_mut().for_each(|other| {
                            other.used |=
                                line.number(other.index).is_some_and(|value| value != 0.0);
                        });
                    }
                }
            }
        }
        self.tell_of_digatron(&table, settling);
        self.tell(&table, before)?;
        Ok(end)
    }

    /// Removes the last row if an export of Digatron continues at its frequency: the program logs a
    /// point while it settles, and its last row counts. Returns whether a row was removed.
    fn drop_settling(&mut self, table: &Table, freq: f64, before: usize) -> bool {
        let freq_hz = freq * table.freq.factor();
        let again = self.rows.rows[before..]
            .last()
            .is_some_and(|row| row.point.freq_hz == freq_hz && table.is_of_digatron());
        if again {
            self.rows.rows.pop();
            self.beside.pop();
        }
        again
    }

    /// Returns remarks on how an export of Digatron is read.
    fn tell_of_digatron(&mut self, table: &Table, settling: usize) {
        let file = self.file();
        let open = table
            .read()
            .find(|column| column.is_of_digatron() && column.unit.is_none());
        self.notes.extend(open.map(|column| {
            let title = &column.title;
            format!(
                "{file}: column \"{title}\" has no unit and is taken in mΩ, as Digatron writes it"
            )
        }));
        if settling > 0 {
            self.notes.push(format!(
                "{file}: {settling} rows are left out: of the rows at one frequency the last counts"
            ));
        }
    }

    /// Returns the kind of a line below the names, after `seen` rows.
    ///
    /// # Errors
    /// Returns an error for a row with an invalid frequency or with too few or too many fields, and
    /// for text before further rows.
    fn line_kind(
        &self,
        line: &Line<'_>,
        table: &Table,
        seen: usize,
    ) -> Result<LineKind, FormatError> {
        if line.filled() == 0 || seen == 0 && self.counts_rows(line, table) {
            return Ok(LineKind::Nothing);
        }
        // A log with impedances in some of its rows.
        if table.read().all(|column| line.lacks(column)) && line.fields.len() > table.freq.index {
            return Ok(LineKind::Nothing);
        }
        if let Some(freq) = line.number(table.freq.index) {
            return Ok(LineKind::Row(freq));
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
            // RelaxIS writes the measurement conditions there.
            let is_condition = line.fields.iter().any(|field| field.contains(['=', ':']));
            let as_wide = [line.filled(), line.fields.len()].contains(&table.width);
            return Ok(if as_wide && !is_condition {
                LineKind::Units
            } else {
                LineKind::Nothing
            });
        }
        if !self.ends(line.at) && self.goes_on(line.at + 1, table) {
            return Err(line.wrong(
                &table.freq,
                "a frequency in Hz, or no further rows behind the end of the table",
            ));
        }
        Ok(LineKind::End)
    }

    /// Returns whether the file is EC-Lab's, whose rows may have fewer fields than names.
    fn is_ec_lab(&self) -> bool {
        self.lines
            .first()
            .is_some_and(|line| line.contains("-Lab ASCII FILE"))
    }

    /// Adds remarks on what was not read, determines the unit of phases without one, and compares parts
    /// with modulus and phase.
    fn tell(&mut self, table: &Table, before: usize) -> Result<(), FormatError> {
        let rows = &mut self.rows.rows[before..];
        if let Some(note) = polar::compare(self.path, table, rows, &self.beside)? {
            self.notes.push(format!("{}: {note}", self.file()));
        }
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

    /// Converts angles to degrees if they exceed a turn in rad; until then, points store them
    /// unconverted in the imaginary part.
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
            let value = |column: &Option<Column>| {
                let column = column.as_ref()?;
                Some(line.number(column.index)? * column.factor())
            };
            self.beside.push(Beside {
                modulus: value(&table.polar.modulus).unwrap_or(f64::NAN),
                phase: value(&table.polar.phase).unwrap_or(f64::NAN),
            });
            self.rows.rows.push(MeasuredRow {
                line: line.at + 1,
                origin: Origin::default(),
                key,
                point,
            });
        }
        Ok(())
    }

    /// Requires one decimal mark in all numbers that are read.
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

    /// Returns the name of a table: from the previous line, if it is Gamry's.
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

    /// Returns whether a line begins another table.
    fn ends(&self, at: usize) -> bool {
        is_title(self.lines[at]).is_some() || self.takes(at)
    }

    /// Returns whether rows of the table follow before a mark of an aborted measurement or another
    /// table.
    fn goes_on(&self, from: usize, table: &Table) -> bool {
        let ahead = (from..self.lines.len())
            .take_while(|at| !self.lines[*at].trim_start().starts_with(ABORTED) && !self.ends(*at));
        ahead.map(|at| self.line(at, table)).any(|line| {
            table
                .read()
                .all(|column| line.number(column.index).is_some())
        })
    }

    /// Returns whether a line under the names states the number of rows.
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

/// Returns the name of a table of Gamry's from its title line.
fn is_title(line: &str) -> Option<&str> {
    let mut fields = line.split('\t');
    let name = fields.next().filter(|name| !name.is_empty())?;
    (fields.next()?.trim() == "TABLE").then_some(name)
}
