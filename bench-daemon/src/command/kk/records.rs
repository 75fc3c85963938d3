//! Reads a table of drift and harmonics of the records, for `eis-bench kk`.

use std::path::Path;

use analysis::{
    spectrum::Spectrum,
    table::{Hash, Row, Table},
    validity::{Drift, DriftShape, Harmonic, Record},
};

use bench_core::safety::failure::Failure;

/// Highest harmonic that is looked for.
const MOST: u32 = 20;

/// Positions of the columns.
struct Columns {
    freq: usize,
    /// Order, ratio, its standard deviation.
    harmonics: Vec<(u32, usize, usize)>,
    /// Drift over amplitude, periods.
    drift: Option<(usize, usize)>,
}

/// A row of the table, with its location for error messages.
struct Line<'a> {
    path: &'a Path,
    header: &'a [String],
    row: &'a Row,
}

/// Reads `freq_hz` and any of `periods,drift_over_amplitude`, `hN,sigma_hN`. Returns each record
/// with its line number.
///
/// # Errors
/// A file that cannot be read, a column that is unknown or lacks its partner, a column that is
/// missing, a field that is not a number.
pub(super) fn read(path: &Path) -> Result<Vec<(usize, Record)>, Failure> {
    let table =
        Table::read(path, Hash::Comment).map_err(|error| Failure::Usage(error.to_string()))?;
    let columns = Columns::of(&table).ok_or_else(|| {
        Failure::Usage(format!(
            "{}: expected a header with freq_hz, found \"{}\"",
            path.display(),
            table.columns.join(",")
        ))
    })?;
    check(path, &table.columns)?;
    let record = |row: &Row| {
        let line = Line {
            path,
            header: &table.columns,
            row,
        };
        Ok((row.line, line.record(&columns)?))
    };
    table.rows.iter().map(record).collect()
}

/// No column is passed over in silence.
fn check(path: &Path, header: &[String]) -> Result<(), Failure> {
    let order = |name: &str| {
        name.parse::<u32>()
            .ok()
            .filter(|order| (2..=MOST).contains(order))
    };
    for name in header.iter().filter(|name| *name != "freq_hz") {
        let partner = match name.as_str() {
            "periods" => Some("drift_over_amplitude".to_owned()),
            "drift_over_amplitude" => Some("periods".to_owned()),
            _ => match (
                name.strip_prefix("sigma_h").and_then(order),
                name.strip_prefix('h').and_then(order),
            ) {
                (Some(order), _) => Some(format!("h{order}")),
                (None, Some(order)) => Some(format!("sigma_h{order}")),
                (None, None) => None,
            },
        };
        let expected = match partner {
            None => format!(
                "freq_hz, periods, drift_over_amplitude, or hN and sigma_hN with N from 2 to {MOST}"
            ),
            Some(partner) if !header.contains(&partner) => {
                format!("a column {partner} with it")
            }
            Some(_) => continue,
        };
        return Err(Failure::Usage(format!(
            "{}, column {name}: expected {expected}",
            path.display()
        )));
    }
    Ok(())
}

/// Every record belongs to a point of a spectrum.
///
/// # Errors
/// A record at a frequency that no spectrum has.
pub(super) fn belong(
    path: &Path,
    records: &[(usize, Record)],
    spectra: &[&Spectrum],
) -> Result<(), Failure> {
    let known = |record: &Record| {
        spectra
            .iter()
            .flat_map(|s| &s.points)
            .any(|p| (record.freq_hz / p.freq_hz - 1.0).abs() < 1e-3)
    };
    let Some((line, record)) = records.iter().find(|(_, record)| !known(record)) else {
        return Ok(());
    };
    Err(Failure::Usage(format!(
        "{}, line {line}, freq_hz: expected a frequency of the spectra to 0.1 %, found {} Hz",
        path.display(),
        record.freq_hz
    )))
}

impl Columns {
    fn of(table: &Table) -> Option<Self> {
        let column = |name: &str| table.column(name);
        let harmonic = |order: u32| {
            Some((
                order,
                column(&format!("h{order}"))?,
                column(&format!("sigma_h{order}"))?,
            ))
        };
        Some(Self {
            freq: column("freq_hz")?,
            harmonics: (2..=MOST).filter_map(harmonic).collect(),
            drift: column("drift_over_amplitude").zip(column("periods")),
        })
    }
}

impl Line<'_> {
    fn record(&self, columns: &Columns) -> Result<Record, Failure> {
        let harmonic = |&(order, ratio, sigma): &(u32, usize, usize)| {
            Ok(Harmonic {
                order,
                ratio: self.number(ratio, 0.0)?,
                sigma: self.number(sigma, f64::MIN_POSITIVE)?,
            })
        };
        let drift = |(over, periods): (usize, usize)| {
            let over_amplitude = self.number(over, f64::NEG_INFINITY)?;
            Ok::<_, Failure>(Drift {
                over_amplitude,
                periods: self.number(periods, f64::MIN_POSITIVE)?,
                shape: DriftShape::Ramp,
            })
        };
        Ok(Record {
            freq_hz: self.number(columns.freq, f64::MIN_POSITIVE)?,
            harmonics: columns
                .harmonics
                .iter()
                .map(harmonic)
                .collect::<Result<_, Failure>>()?,
            drift: columns.drift.map(drift).transpose()?,
        })
    }

    /// The number in a column, at least `least`.
    fn number(&self, column: usize, least: f64) -> Result<f64, Failure> {
        let field = self.row.field(column);
        let good = |value: &f64| value.is_finite() && *value >= least;
        field.parse::<f64>().ok().filter(good).ok_or_else(|| {
            let name = self.header.get(column).map_or("", String::as_str);
            Failure::Usage(format!(
                "{}, line {}, {name}: expected a number, found \"{field}\"",
                self.path.display(),
                self.row.line
            ))
        })
    }
}
