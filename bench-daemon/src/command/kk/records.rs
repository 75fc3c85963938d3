//! A table of what the records show besides the sine.

use std::path::Path;

use analysis::validity::{Drift, DriftShape, Harmonic, Record};

use crate::command::Failure;

/// Highest harmonic that is looked for.
const MOST: u32 = 20;

/// Reads `freq_hz` and any of `periods,drift_over_amplitude`, `hN,sigma_hN`.
///
/// # Errors
/// A file that cannot be read, a column that is missing, a field that is no number.
pub(super) fn read(path: &Path) -> Result<Vec<Record>, Failure> {
    let text = std::fs::read_to_string(path).map_err(|error| Failure::Usage(format!("{}: {error}", path.display())))?;
    let mut lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty() && !line.starts_with('#'));
    let header: Vec<&str> = lines.next().map(|(_, line)| line.split(',').map(str::trim).collect()).unwrap_or_default();
    let column = |name: &str| header.iter().position(|column| *column == name);
    let freq = column("freq_hz")
        .ok_or_else(|| Failure::Usage(format!("{}: expected a header with freq_hz, found \"{}\"", path.display(), header.join(","))))?;
    let harmonics: Vec<(u32, usize, usize)> =
        (2..=MOST).filter_map(|order| Some((order, column(&format!("h{order}"))?, column(&format!("sigma_h{order}"))?))).collect();
    let drift = column("drift_over_amplitude").zip(column("periods"));
    let mut records = Vec::new();
    for (index, line) in lines {
        let fields: Vec<&str> = line.split(',').map(str::trim).collect();
        let number = |column: usize, least: f64| {
            let field = fields.get(column).copied().unwrap_or_default();
            let good = |value: &f64| value.is_finite() && *value >= least;
            field.parse::<f64>().ok().filter(good).ok_or_else(|| {
                let name = header.get(column).copied().unwrap_or_default();
                Failure::Usage(format!("{}, line {}, {name}: expected a number, found \"{field}\"", path.display(), index + 1))
            })
        };
        let harmonic = |&(order, ratio, sigma): &(u32, usize, usize)| {
            Ok(Harmonic { order, ratio: number(ratio, 0.0)?, sigma: number(sigma, f64::MIN_POSITIVE)? })
        };
        records.push(Record {
            freq_hz: number(freq, f64::MIN_POSITIVE)?,
            harmonics: harmonics.iter().map(harmonic).collect::<Result<_, Failure>>()?,
            drift: match drift {
                Some((over, periods)) => {
                    Some(Drift { over_amplitude: number(over, f64::NEG_INFINITY)?, periods: number(periods, f64::MIN_POSITIVE)? })
                }
                None => None,
            },
        });
    }
    Ok(records)
}
