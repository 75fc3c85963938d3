//! The rows of a record, common to all layouts, and their text.

use super::super::calendar::days_since_1970;
use super::fields::{i32_at, u8_at, u16_at};
use std::fmt::Write as _;

/// Names of the columns. BDF's count charge positive, as Neware does.
const HEADER: &str = "Test Time / s\tVoltage / V\tCurrent / A\tUnix Time / s\tStep Count / 1\tStep Type\t\
                      Surface Temperature T1 / degC\n";
/// Largest range of a current, mA, whose unit the programs agree on.
const GREATEST_RANGE: u32 = 200_000;

/// Error of reading a file.
#[derive(Debug, thiserror::Error)]
pub(super) enum Fault {
    #[error("version {version} of {part} is not known; export the data as CSV or Excel from BTSDA")]
    Version { part: &'static str, version: u16 },
    #[error("{0}")]
    Cut(String),
    #[error(
        "a current range of {0} mA, whose unit is not known; export the data as CSV or Excel from BTSDA"
    )]
    Range(i32),
}

/// A record as text, and remarks on data that it omits.
#[derive(Debug, PartialEq)]
pub(in crate::formats) struct Decoded {
    pub(in crate::formats) text: String,
    pub(in crate::formats) notes: Vec<String>,
}

/// Time stamp of a row.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Moment {
    /// Time since its step began, s.
    OfStep(f64),
    /// Time since the test began, s.
    OfTest(f64),
}

/// One row.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Row {
    pub(super) index: u32,
    /// Identifies its step, to separate it from the previous one.
    pub(super) step: u32,
    pub(super) step_type: u8,
    pub(super) at: Moment,
    pub(super) voltage_v: f64,
    pub(super) current_a: f64,
    /// Seconds since 1970; NaN if absent.
    pub(super) unix_s: f64,
    /// °C; NaN if not measured.
    pub(super) temperature_degc: f64,
}

/// Returns the amperes of one count of a current, by the range.
pub(super) fn amperes_per_count(range: i32) -> Result<f64, Fault> {
    let size = range.unsigned_abs();
    if range == 0 || size > GREATEST_RANGE {
        return Err(Fault::Range(range));
    }
    let exponent = match size {
        ..10 => -7,
        10..100 => -6,
        100..1000 => -5,
        _ => -4,
    };
    // Negative ranges have a tenth of the step.
    let exponent = if range < 0 { exponent - 1 } else { exponent };
    Ok(10.0_f64.powi(exponent))
}

/// Converts a date (year (2 bytes), month, day, hour, minute, second) to seconds since 1970.
pub(super) fn date_s(bytes: &[u8], at: usize) -> f64 {
    let part = |k: usize| f64::from(u8_at(bytes, at + k));
    let (year, month) = (u16_at(bytes, at), u8_at(bytes, at + 2));
    let days = days_since_1970(i64::from(year), i64::from(month), 0);
    #[expect(clippy::cast_precision_loss, reason = "days of some thousand years")]
    let days = days as f64 + part(3);
    ((days * 24.0 + part(4)) * 60.0 + part(5)) * 60.0 + part(6)
}

/// Converts a count to a current or, with 0.1 mV, to a voltage.
pub(super) fn scaled(bytes: &[u8], at: usize, unit: f64) -> f64 {
    // Multiplying by 0.0001 adds rounding digits, dividing by 10000 does not.
    f64::from(i32_at(bytes, at)) / (1.0 / unit).round()
}

/// Returns the name of a step, which gives the direction of its current; empty if it gives none.
fn step_name(step_type: u8) -> &'static str {
    match step_type {
        1 => "CC_Chg",
        2 => "CC_DChg",
        3 => "CV_Chg",
        4 => "Rest",
        7 => "CCCV_Chg",
        8 => "CP_DChg",
        9 => "CP_Chg",
        10 => "CR_DChg",
        11 => "CR_Chg",
        13 => "Pause",
        18 => "PCCCV_Chg",
        19 => "CV_DChg",
        20 => "CCCV_DChg",
        22 => "OCV",
        26 => "CPCV_DChg",
        27 => "CPCV_Chg",
        28 => "CRCV_DChg",
        29 => "CRCV_Chg",
        _ => "",
    }
}

/// Returns the text of rows, sorted by index; the first row of each index counts.
///
/// # Errors
/// [`Fault::Cut`] if there is no row.
pub(super) fn text(mut rows: Vec<Row>, notes: Vec<String>) -> Result<Decoded, Fault> {
    rows.sort_by_key(|row| row.index);
    rows.dedup_by_key(|row| row.index);
    if rows.is_empty() {
        return Err(Fault::Cut("it holds no record".to_owned()));
    }
    let mut text = HEADER.to_owned();
    let (mut step, mut number, mut begun_s, mut longest_s) = (None, 0_u32, 0.0, 0.0_f64);
    for row in &rows {
        if step
            .replace(row.step)
            .is_none_or(|before| before != row.step)
        {
            number += 1;
            begun_s += longest_s;
            longest_s = 0.0;
        }
        let time_s = match row.at {
            Moment::OfTest(time_s) => time_s,
            Moment::OfStep(time_s) => {
                longest_s = longest_s.max(time_s);
                begun_s + time_s
            }
        };
        // Writing to a string cannot fail.
        let _ = writeln!(
            text,
            "{}\t{:?}\t{:?}\t{}\t{number}\t{}\t{}",
            plain(time_s),
            row.voltage_v,
            row.current_a,
            plain(row.unix_s),
            step_name(row.step_type),
            plain(row.temperature_degc)
        );
    }
    Ok(Decoded { text, notes })
}

/// Formats a number to the microsecond, because sums of times have rounding digits beyond.
fn plain(value: f64) -> String {
    if value.is_nan() {
        String::new()
    } else {
        format!("{}", (value * 1.0e6).round() / 1.0e6)
    }
}
