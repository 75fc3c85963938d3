//! The row that names the columns of a table.

use super::names::{self, Named, Quantity, Unit};
use crate::formats::error::FormatError;
use crate::formats::sweeps;
use std::path::Path;

/// Number of lines below the names that are searched for a row of numbers, to count its fields.
const LOOKED_AT: usize = 10;

/// A column that is read.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Column {
    pub(super) index: usize,
    pub(super) title: String,
    pub(super) quantity: Quantity,
    pub(super) sign: f64,
    /// Factor that converts its numbers to Hz, Ω or rad; `None` if no unit is written.
    pub(super) unit: Option<f64>,
}

impl Column {
    /// Returns the factor that converts a number of the column to SI. A frequency and an impedance
    /// without unit are in Hz and Ω, except Digatron's impedances in mΩ.
    pub(super) fn factor(&self) -> f64 {
        let usual = if self.is_of_digatron() { 1.0e-3 } else { 1.0 };
        self.sign * self.unit.unwrap_or(usual)
    }

    /// Whether it is an impedance in an export of Digatron.
    pub(super) fn is_of_digatron(&self) -> bool {
        names::is_of_digatron(&self.title)
    }
}

/// An impedance in a row.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Curve {
    pub(super) drift_corrected: bool,
    /// Real and imaginary part, or modulus and phase.
    pub(super) columns: [Column; 2],
}

/// Modulus and phase beside the real and the imaginary part, for comparison.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Polar {
    pub(super) modulus: Option<Column>,
    pub(super) phase: Option<Column>,
}

/// The columns of a table.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Table {
    /// Line of its names, from 0.
    pub(super) line: usize,
    pub(super) separator: char,
    /// Fields in a row, without empty ones at the end.
    pub(super) width: usize,
    pub(super) freq: Column,
    pub(super) curves: Vec<Curve>,
    /// Columns that separate spectra: their kind and index.
    pub(super) labels: Vec<(&'static str, usize)>,
    /// Impedances of other electrodes, which are not read.
    pub(super) others: Vec<Other>,
    pub(super) polar: Polar,
}

/// A column that is not read.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Other {
    pub(super) index: usize,
    pub(super) title: String,
    /// Whether it contained a number other than zero.
    pub(super) used: bool,
}

/// A row of names with its place, for messages.
struct Header<'a> {
    path: &'a Path,
    line: usize,
    titles: Vec<&'a str>,
    named: Vec<Option<Named>>,
}

/// Returns the columns that a line names, if it names those of an impedance.
///
/// # Errors
/// Returns an error for a column named twice and for a unit that is wrong for its quantity.
pub(super) fn table(path: &Path, lines: &[&str], at: usize) -> Option<Result<Table, FormatError>> {
    let mut ways = candidates(lines[at]);
    // Names in a comment do not determine the separator of the rows.
    if lines[at].trim_start().starts_with(['#', '%']) {
        let others = |(_, titles): &(char, Vec<_>)| {
            let of = |separator: &char| numbers_below(lines, at, *separator) == Some(titles.len());
            let separator = [';', '\t', ',', ' '].into_iter().find(of);
            separator.map(|separator| (separator, titles.clone()))
        };
        ways = ways
            .iter()
            .filter_map(others)
            .chain(ways.iter().cloned())
            .collect();
    }
    let mut found: Vec<(char, Header<'_>)> = ways
        .into_iter()
        .map(|(separator, titles)| (separator, Header::new(path, at, titles)))
        .filter(|(_, h)| h.is_whole())
        .collect();
    let fits = |(separator, header): &(char, Header<'_>)| {
        numbers_below(lines, at, *separator) == Some(header.titles.len())
    };
    let best = found.iter().position(fits).unwrap_or(0);
    (!found.is_empty()).then(|| {
        let (separator, header) = found.swap_remove(best);
        header.table(separator)
    })
}

/// Returns an error that names the missing column of a header of impedances; `None` if the line
/// names no such columns.
pub(super) fn near_miss(path: &Path, lines: &[&str], at: usize) -> Option<FormatError> {
    candidates(lines[at]).into_iter().find_map(|(_, titles)| {
        let header = Header::new(path, at, titles);
        let has = |quantity| header.has(quantity);
        use Quantity::{Frequency, Imaginary, Modulus, Phase, Real};
        let missing = match (
            has(Frequency),
            has(Real),
            has(Imaginary),
            has(Modulus),
            has(Phase),
        ) {
            (false, true, true, ..) => Frequency,
            (true, true, false, ..) => Imaginary,
            (true, false, true, ..) => Real,
            (true, false, false, true, false) => Phase,
            (true, false, false, false, true) => Modulus,
            _ => return None,
        };
        let met = crate::formats::text::shorten(&header.titles.join(", "));
        Some(FormatError::Header {
            file: path.to_owned(),
            line: at + 1,
            expected: format!("a column of {}", missing.name()),
            met,
        })
    })
}

/// Describes the quantities that a line names; returns `None` if it names none.
pub(super) fn quantities(line: &str) -> Option<Vec<&'static str>> {
    let of = |titles: Vec<&str>| -> Vec<&'static str> {
        let mut named: Vec<&str> = titles
            .into_iter()
            .filter_map(names::named)
            .map(|named| named.quantity.name())
            .collect();
        named.dedup();
        named
    };
    let ways = candidates(line).into_iter().map(|(_, titles)| of(titles));
    ways.max_by_key(Vec::len).filter(|named| !named.is_empty())
}

/// Splits a line by each possible separator of names; blanks give several results, because names
/// may contain them.
fn candidates(line: &str) -> Vec<(char, Vec<&str>)> {
    let line = line
        .trim_start_matches('\u{feff}')
        .trim_start_matches(['#', '%']);
    // VersaStudio: the list ends with a zero that is not a column.
    if let Some(definition) = line.strip_prefix("Definition=") {
        let mut titles = fields(definition, ',');
        titles.pop_if(|last| *last == "0");
        return vec![(',', titles)];
    }
    let trimmed = line.trim();
    // ZView's "Z60W" and "ZPlotW" write all names in one pair of quotes with blanks between them,
    // and numbers with commas.
    let quoted = trimmed
        .strip_prefix('"')
        .and_then(|rest| rest.strip_suffix('"'))
        .filter(|inner| !inner.contains(['"', ',', '\t', ';']));
    if let Some(inner) = quoted {
        return vec![
            (',', wide(inner)),
            (',', inner.split_whitespace().collect()),
        ];
    }
    match ['\t', ';', ',']
        .into_iter()
        .find(|separator| line.contains(*separator))
    {
        Some(separator) => vec![(separator, fields(line, separator))],
        None => vec![
            (' ', wide(trimmed)),
            (' ', with_units(trimmed)),
            (' ', trimmed.split_whitespace().collect()),
        ],
    }
    .into_iter()
    .map(|(separator, mut titles)| {
        while titles.last().is_some_and(|title| title.is_empty()) {
            titles.pop();
        }
        (separator, titles)
    })
    .collect()
}

/// Names with two blanks or more between them.
fn wide(text: &str) -> Vec<&str> {
    text.split("  ")
        .map(str::trim)
        .filter(|name| !name.is_empty())
        .collect()
}

/// Names with a blank between them and before units in brackets.
fn with_units(text: &str) -> Vec<&str> {
    let starts = text.char_indices().filter(|(at, c)| {
        let before = text[..*at].chars().next_back();
        !c.is_whitespace() && !matches!(c, '(' | '[') && before.is_none_or(char::is_whitespace)
    });
    let starts: Vec<usize> = starts.map(|(at, _)| at).collect();
    let ends = starts.iter().skip(1).copied().chain([text.len()]);
    starts
        .iter()
        .zip(ends)
        .map(|(start, end)| text[*start..end].trim())
        .collect()
}

/// Returns the fields of a line, without blanks and quotes around them.
pub(super) fn fields(line: &str, separator: char) -> Vec<&str> {
    if separator == ' ' {
        return line.split_whitespace().collect();
    }
    line.split(separator)
        .map(crate::formats::text::unquote)
        .collect()
}

/// Returns the number of fields of the first row of numbers under a line.
fn numbers_below(lines: &[&str], at: usize, separator: char) -> Option<usize> {
    let rows = lines
        .iter()
        .skip(at + 1)
        .take(LOOKED_AT)
        .map(|line| fields(line, separator));
    rows.filter(|row| row.len() > 2)
        .find(|row| {
            row.iter()
                .all(|field| crate::formats::text::number(field, separator).is_some())
        })
        .map(|row| row.len())
}

impl<'a> Header<'a> {
    fn new(path: &'a Path, at: usize, titles: Vec<&'a str>) -> Self {
        // Maccor: the amplitudes of the voltage and of the current.
        let amplitudes = titles
            .iter()
            .any(|title| title.eq_ignore_ascii_case("VMag"));
        let is_current = |title: &str| amplitudes && title.eq_ignore_ascii_case("IMag");
        let named = |title: &&str| names::named(title).filter(|_| !is_current(title));
        let named = titles.iter().map(named).collect();
        Self {
            path,
            line: at + 1,
            titles,
            named,
        }
    }

    fn has(&self, quantity: Quantity) -> bool {
        self.named
            .iter()
            .flatten()
            .any(|n| n.quantity == quantity && !n.drift_corrected)
    }

    /// Returns whether it names all columns of an impedance.
    fn is_whole(&self) -> bool {
        let cartesian = self.has(Quantity::Real) && self.has(Quantity::Imaginary);
        self.has(Quantity::Frequency)
            && (cartesian || self.has(Quantity::Modulus) && self.has(Quantity::Phase))
    }

    fn table(&self, separator: char) -> Result<Table, FormatError> {
        let cartesian = self.has(Quantity::Real) && self.has(Quantity::Imaginary);
        let pair = if cartesian {
            [Quantity::Real, Quantity::Imaginary]
        } else {
            [Quantity::Modulus, Quantity::Phase]
        };
        let mut curves = Vec::new();
        let corrected = |quantity| {
            self.named
                .iter()
                .flatten()
                .any(|n| n.quantity == quantity && n.drift_corrected)
        };
        for drift_corrected in [true, false] {
            if drift_corrected && !pair.into_iter().all(corrected) {
                continue;
            }
            let [a, b] = pair;
            curves.push(Curve {
                drift_corrected,
                columns: [
                    self.column(a, drift_corrected)?,
                    self.column(b, drift_corrected)?,
                ],
            });
        }
        let freq = self.column(Quantity::Frequency, false)?;
        let labels = self
            .titles
            .iter()
            .enumerate()
            .filter_map(|(index, title)| Some((sweeps::label(title)?, index)))
            .collect();
        let others = self
            .titles
            .iter()
            .enumerate()
            .filter(|(index, title)| self.named[*index].is_none() && of_another(title));
        let others = others
            .map(|(index, title)| Other {
                index,
                title: (*title).to_owned(),
                used: false,
            })
            .collect();
        let beside = |quantity| {
            // Digatron's modulus is beside it without a unit.
            let digatron = self.titles.iter().any(|title| names::is_of_digatron(title));
            let there = cartesian && !digatron && self.has(quantity);
            there.then(|| self.column(quantity, false).ok()).flatten()
        };
        let polar = Polar {
            modulus: beside(Quantity::Modulus),
            phase: beside(Quantity::Phase),
        };
        Ok(Table {
            polar,
            line: self.line - 1,
            separator,
            width: self.titles.len(),
            freq,
            curves,
            labels,
            others,
        })
    }

    /// Returns the only column of a quantity; if there are two, with and without a minus, the one
    /// without.
    fn column(&self, quantity: Quantity, drift_corrected: bool) -> Result<Column, FormatError> {
        let all = self
            .named
            .iter()
            .enumerate()
            .filter_map(|(index, named)| Some((index, named.as_ref()?)));
        let of_it: Vec<(usize, &Named)> = all
            .filter(|(_, n)| n.quantity == quantity && n.drift_corrected == drift_corrected)
            .collect();
        let positive: Vec<_> = of_it
            .iter()
            .filter(|(_, n)| n.sign > 0.0)
            .copied()
            .collect();
        let chosen = if positive.is_empty() { of_it } else { positive };
        let [(index, named)] = chosen.as_slice() else {
            let met = chosen
                .iter()
                .map(|(index, _)| format!("\"{}\"", self.titles[*index]))
                .collect::<Vec<_>>()
                .join(" and ");
            let expected = format!("one column of {}", quantity.name());
            return Err(FormatError::Header {
                file: self.path.to_owned(),
                line: self.line,
                expected,
                met,
            });
        };
        let mut column = Column {
            index: *index,
            title: self.titles[*index].to_owned(),
            quantity,
            sign: named.sign,
            unit: None,
        };
        column.take_unit(named.unit.clone(), self.path, self.line)?;
        Ok(column)
    }
}

/// Returns whether a column is the impedance of another electrode or of another channel.
fn of_another(title: &str) -> bool {
    let plain: String = title
        .chars()
        .filter(|c| !c.is_whitespace())
        .flat_map(char::to_lowercase)
        .collect();
    ["re(z", "-im(z", "im(z", "z2real", "z2imag"]
        .iter()
        .any(|start| plain.starts_with(start))
}

impl Column {
    /// Sets a unit.
    fn take_unit(&mut self, unit: Unit, path: &Path, line: usize) -> Result<(), FormatError> {
        let refused = |met: String, reason: &'static str| FormatError::Unit {
            file: path.to_owned(),
            line,
            column: self.index + 1,
            name: self.title.clone(),
            expected: self.quantity.unit(),
            met,
            reason,
        };
        match (unit, self.unit) {
            (Unit::Unstated, _) => {}
            (Unit::Refused(met, reason), _) => return Err(refused(format!("\"{met}\""), reason)),
            (Unit::Factor(factor), Some(known)) if factor != known => {
                return Err(refused(
                    "another unit under the name than in it".to_owned(),
                    "one of them is wrong",
                ));
            }
            (Unit::Factor(factor), _) => self.unit = Some(factor),
        }
        Ok(())
    }
}

impl Table {
    /// Returns whether it is an export of Digatron.
    pub(super) fn is_of_digatron(&self) -> bool {
        self.read().any(Column::is_of_digatron)
    }

    /// Returns the columns that are read.
    pub(super) fn read(&self) -> impl Iterator<Item = &Column> {
        std::iter::once(&self.freq).chain(self.curves.iter().flat_map(|curve| &curve.columns))
    }

    /// Sets the units from a row under the names.
    pub(super) fn take_units(
        &mut self,
        row: &[&str],
        path: &Path,
        line: usize,
    ) -> Result<(), FormatError> {
        let columns = std::iter::once(&mut self.freq)
            .chain(self.curves.iter_mut().flat_map(|curve| &mut curve.columns));
        for column in columns {
            if let Some(unit) = row
                .get(column.index)
                .and_then(|field| names::unit_under(column.quantity, field))
            {
                column.take_unit(unit, path, line)?;
            }
        }
        // A column that only serves a comparison is skipped if its unit is unknown.
        for place in [&mut self.polar.modulus, &mut self.polar.phase] {
            let unit = |column: &Column| names::unit_under(column.quantity, row.get(column.index)?);
            if let Some(unit) = place.as_ref().and_then(unit)
                && place
                    .as_mut()
                    .is_some_and(|column| column.take_unit(unit, path, line).is_err())
            {
                *place = None;
            }
        }
        Ok(())
    }
}
