//! Converts current and voltage over time in MATLAB's `.mat` to cycler text: the vectors `Time`,
//! `Voltage` and `Current`, alone or as fields of a structure at any depth (`meas` in the data of
//! Kollmeyer, `cycle(k).data` in those of NASA's PCoE).
//!
//! Several such structures become steps of one record, ordered by the date vectors beside them or by
//! times that continue. Without either, the reader puts an hour between them and adds a remark.

mod level5;

use self::level5::{Contents, Group};
use super::error::FormatError;
use std::fmt::Write as _;
use std::path::Path;

/// First bytes of a file of Level 5; a file of version 7.3 begins with `MATLAB 7.3`.
const MAGIC: &[u8] = b"MATLAB 5.0 MAT-file";
/// Pause between two records without absolute times, s: it cuts the record, because no run spans it.
const APART_S: f64 = 3600.0;

/// Lower-case names of a quantity, and its column in the text.
const NAMED: [(&[&str], &str); 7] = [
    (&["time", "time_s", "t", "test_time"], "Time (s)"),
    (
        &["voltage", "voltage_v", "v", "voltage_measured"],
        "Voltage (V)",
    ),
    (
        &["current", "current_a", "i", "current_measured"],
        "Current (A)",
    ),
    (
        &[
            "battery_temp_degc",
            "temperature_c",
            "temperature",
            "temp",
            "temperature_measured",
        ],
        "Temperature (C)",
    ),
    (&["chamber_temp_degc"], "Chamber Temperature (C)"),
    (&["soc"], "SOC"),
    (&["step", "step_index"], "Step Index"),
];
/// Number of quantities at the start of the list that every record must have.
const NEEDED: usize = 3;
/// Index of the step among them.
const STEP: usize = 6;

/// The record of a file as text.
#[derive(Debug)]
pub(super) struct Decoded {
    pub(super) text: String,
    /// Remark on how several records were joined.
    pub(super) note: Option<String>,
}

/// Returns the record of a file; `None` if it is not a MATLAB file.
///
/// # Errors
/// [`FormatError::Decode`] if the file is truncated, contains no record, or contains the same
/// record twice.
pub(super) fn decode(path: &Path, bytes: &[u8]) -> Option<Result<Decoded, FormatError>> {
    bytes.starts_with(MAGIC).then(|| {
        decoded(bytes).map_err(|reason| FormatError::Decode {
            file: path.to_owned(),
            kind: "a MATLAB .mat with a record over time",
            reason,
        })
    })
}

fn decoded(bytes: &[u8]) -> Result<Decoded, String> {
    let Contents { groups, names } = level5::read(bytes)?;
    let records: Vec<Record<'_>> = groups.iter().filter_map(Record::of).collect();
    if records.is_empty() {
        return Err(format!(
            "expected vectors Time, Voltage and Current of one length, met none; its variables and \
             fields are {}",
            names.join(", ")
        ));
    }
    for (k, record) in records.iter().enumerate() {
        let same = |other: &&Record<'_>| other.columns[..NEEDED] == record.columns[..NEEDED];
        if let Some(first) = records[..k].iter().find(same) {
            return Err(format!(
                "expected each record once, met the same one in {} and {}",
                first.path, record.path
            ));
        }
    }
    let (starts_s, note) = starts_s(&records);
    Ok(Decoded {
        text: written(&records, &starts_s),
        note,
    })
}

/// Returns the time to add to each record, s, and a remark if there are several records.
fn starts_s(records: &[Record<'_>]) -> (Vec<f64>, Option<String>) {
    let (count, first) = (records.len(), records.first().map_or("", |one| one.path));
    let several = |how: &str| {
        (count > 1).then(|| format!("it holds {count} records, the first in {first}, joined {how}"))
    };
    let rises = |starts_s: &[f64]| {
        let mut pairs = records
            .iter()
            .zip(starts_s)
            .zip(records[1..].iter().zip(&starts_s[1..]));
        pairs.all(|((a, a_s), (b, b_s))| b.ends_s().0 + b_s > a.ends_s().1 + a_s)
    };
    let dated: Option<Vec<f64>> = records.iter().map(|record| record.begun_s).collect();
    if let Some(dates_s) = dated {
        let starts_s: Vec<f64> = dates_s.iter().map(|date_s| date_s - dates_s[0]).collect();
        if rises(&starts_s) {
            return (starts_s, several("by the dates beside them"));
        }
    }
    let as_they_are = vec![0.0; count];
    if rises(&as_they_are) {
        return (as_they_are, several("by their times, which go on"));
    }
    let mut free_s = 0.0;
    let apart = records.iter().map(|record| {
        let (begin_s, end_s) = record.ends_s();
        let start_s = free_s - begin_s;
        free_s = end_s + start_s + APART_S;
        start_s
    });
    let how = "with an hour between them: the file does not state their times";
    (apart.collect(), several(how))
}

/// Returns the rows of the records. With several records, the number of the record becomes the
/// step.
fn written(records: &[Record<'_>], starts_s: &[f64]) -> String {
    let several = records.len() > 1;
    let used: Vec<usize> = (0..NAMED.len())
        .filter(|k| {
            several && *k == STEP || records.iter().any(|record| record.columns[*k].is_some())
        })
        .collect();
    let names: Vec<&str> = used.iter().map(|k| NAMED[*k].1).collect();
    let mut text = names.join("\t") + "\n";
    for (nth, (record, start_s)) in records.iter().zip(starts_s).enumerate() {
        for row in 0..record.rows() {
            for (place, k) in used.iter().enumerate() {
                let value = record.columns[*k].and_then(|values| values.get(row).copied());
                let value = match *k {
                    0 => value.map(|time_s| time_s + start_s),
                    #[expect(clippy::cast_precision_loss, reason = "a number of records")]
                    STEP if several => Some((nth + 1) as f64),
                    _ => value,
                };
                // Writing to a string cannot fail. NaN becomes an empty field.
                let tab = if place > 0 { "\t" } else { "" };
                let _ = match value.filter(|value| value.is_finite()) {
                    Some(value) => write!(text, "{tab}{value}"),
                    None => write!(text, "{tab}"),
                };
            }
            text.push('\n');
        }
    }
    text
}

/// Returns the columns of a record in the order of [`NAMED`].
struct Record<'a> {
    path: &'a str,
    columns: [Option<&'a [f64]>; NAMED.len()],
    begun_s: Option<f64>,
}

impl<'a> Record<'a> {
    /// Returns the record of these vectors, if they form one.
    fn of(group: &'a Group) -> Option<Self> {
        let find = |(names, _): &(&[&str], &'static str)| {
            let met = |name: &&str| {
                let mut all = group.vectors.iter();
                all.find(|vector| vector.name.to_lowercase() == *name)
            };
            names
                .iter()
                .find_map(met)
                .map(|vector| vector.values.as_slice())
        };
        let mut columns = NAMED.each_ref().map(find);
        let rows = columns[0]?.len();
        for column in &mut columns {
            *column = column.filter(|values| values.len() == rows);
        }
        let whole = columns[..NEEDED].iter().all(Option::is_some);
        (whole && rows > 1).then_some(Self {
            path: &group.path,
            columns,
            begun_s: group.begun_s,
        })
    }

    fn rows(&self) -> usize {
        self.columns[0].map_or(0, <[f64]>::len)
    }

    /// Returns the first and the last time, s.
    fn ends_s(&self) -> (f64, f64) {
        let times_s = self.columns[0].unwrap_or_default();
        let end = |time_s: Option<&f64>| time_s.copied().unwrap_or(0.0);
        (end(times_s.first()), end(times_s.last()))
    }
}
