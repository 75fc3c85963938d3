//! Converts Zahner's measurements of the IM7, `.zmx`, to text with a table for each impedance.
//!
//! The XML file contains tables between `<csv type="data"><![CDATA[` and `]]>`, separated by semicolons: a
//! row of names, one of units, one of signals, and rows of numbers. Each column `|impedance|` with the
//! following `phase` is a spectrum; a measurement with parallel channels has several, named in the row of
//! signals.

use super::error::FormatError;
use super::ism::{self, Decoded};
use std::fmt::Write as _;
use std::path::Path;

/// Bytes that are searched for the root element.
const ROOT: usize = 1024;
/// Begin and end of a table.
const BEGIN: &str = "<csv type=\"data\"><![CDATA[";
const END: &str = "]]>";

/// An impedance of a table.
struct Impedance {
    /// Units of frequency, modulus and phase.
    units: [String; 3],
    signals: String,
    /// Frequency, modulus and phase of every point.
    points: Vec<[f64; 3]>,
}

/// Returns the text of a file; `None` if it is not such an XML file.
///
/// # Errors
/// [`FormatError::Decode`] if it contains no impedance or a field is not a number.
pub(super) fn text(path: &Path, bytes: &[u8]) -> Option<Result<Decoded, FormatError>> {
    let head = String::from_utf8_lossy(&bytes[..bytes.len().min(ROOT)]);
    if !head.contains("<zahner-measurement") {
        return None;
    }
    let text = String::from_utf8_lossy(bytes);
    Some(
        impedances(&text)
            .map(|all| decoded(path, &all))
            .map_err(|reason| FormatError::Decode {
                file: path.to_owned(),
                kind: "a Zahner .zmx",
                reason,
            }),
    )
}

fn impedances(text: &str) -> Result<Vec<Impedance>, String> {
    let mut all = Vec::new();
    let mut rest = text;
    while let Some((_, table)) = rest.split_once(BEGIN) {
        let (table, behind) = table
            .split_once(END)
            .ok_or("a table has no end; the file was cut off")?;
        rest = behind;
        let rows: Vec<Vec<&str>> = table
            .lines()
            .filter(|line| !line.trim().is_empty())
            .map(|line| line.split(';').map(str::trim).collect())
            .collect();
        let [names, units, signals, rows @ ..] = rows.as_slice() else {
            continue;
        };
        let Some(frequency) = names.iter().position(|name| *name == "frequency") else {
            continue;
        };
        for modulus in (0..names.len()).filter(|k| names[*k] == "|impedance|") {
            let columns = [frequency, modulus, modulus + 1];
            if names.get(columns[2]) != Some(&"phase") {
                return Err("a modulus is not followed by a phase".to_owned());
            }
            let field =
                |row: &Vec<&str>, k: usize| row.get(k).copied().unwrap_or_default().to_owned();
            let point = |(k, row): (usize, &Vec<&str>)| {
                let number = |column: usize| {
                    let field = field(row, column);
                    field.parse::<f64>().map_err(|_| {
                        format!(
                            "row {}, field {}: expected a number, met {field:?}",
                            k + 1,
                            column + 1
                        )
                    })
                };
                Ok([
                    number(columns[0])?,
                    number(columns[1])?,
                    number(columns[2])?,
                ])
            };
            let signals = name(&field(signals, modulus));
            if field(units, modulus).is_empty() {
                return Err(format!("the impedance {signals} has no unit"));
            }
            let points: Result<Vec<[f64; 3]>, String> =
                rows.iter().enumerate().map(point).collect();
            all.push(Impedance {
                units: columns.map(|column| field(units, column)),
                signals,
                points: points?,
            });
        }
    }
    if all.iter().all(|one| one.points.is_empty()) {
        return Err("no table of it holds an impedance and a phase".to_owned());
    }
    Ok(all)
}

/// Returns the signals of an impedance, `43045:CH4~43045:ADC4/2557874741:POT:I~…`, without their
/// converters.
fn name(signals: &str) -> String {
    let short = |signal: &str| signal.split('~').next().unwrap_or_default().to_owned();
    let parts: Vec<String> = signals.split('/').map(short).collect();
    parts.join(" per ")
}

/// Returns the tables of the impedances, each reduced to the sweep that is measured once.
fn decoded(path: &Path, all: &[Impedance]) -> Decoded {
    let (mut text, mut left_out) = (String::new(), 0);
    for Impedance {
        units,
        signals,
        points,
    } in all.iter().filter(|one| !one.points.is_empty())
    {
        let [hertz, ohm, angle] = units;
        let kept = ism::sweep(points);
        left_out += points.len() - kept.len();
        // Writing to a string cannot fail.
        let _ = writeln!(text, "{signals}\tTABLE");
        let _ = writeln!(text, "freq/{hertz}\t|Z|/{ohm}\tPhase/{angle}");
        for [freq_hz, modulus_ohm, phase_rad] in kept {
            let _ = writeln!(text, "{freq_hz:?}\t{modulus_ohm:?}\t{phase_rad:?}");
        }
    }
    Decoded {
        text,
        note: ism::note(path, left_out),
    }
}
