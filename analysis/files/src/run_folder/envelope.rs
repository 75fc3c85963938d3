//! The rows of `envelope.csv`.

use super::readings::{format_value, number};

/// The columns of `envelope.csv`.
pub const ENVELOPE_COLUMNS: &str =
    "time_s,least_v,greatest_v,least_a,greatest_a,least_c,greatest_c";

/// Bounds of a quantity; `None` on a side without a bound.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Between {
    /// Least value.
    pub least: Option<f64>,
    /// Greatest value.
    pub greatest: Option<f64>,
}

impl Between {
    /// Creates bounds; an infinite bound becomes `None`.
    pub fn of(least: f64, greatest: f64) -> Self {
        let [least, greatest] =
            [least, greatest].map(|bound| Some(bound).filter(|bound| bound.is_finite()));
        Self { least, greatest }
    }
}

/// One row of `envelope.csv`: bounds of each reading from this time on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EnvelopeRow {
    /// Bench time from which on they hold, s.
    pub time_s: f64,
    /// Bounds of the voltage, V.
    pub voltage_v: Between,
    /// Bounds of the current, charge positive, A.
    pub current_a: Between,
    /// Bounds of the temperature of the cell's surface, °C.
    pub temperature_degc: Between,
}

impl EnvelopeRow {
    /// The row, without the end of its line.
    pub fn row(&self) -> String {
        let cells = [self.voltage_v, self.current_a, self.temperature_degc].map(|between| {
            format!(
                "{},{}",
                format_value(between.least, 6),
                format_value(between.greatest, 6)
            )
        });
        format!("{:.3},{}", self.time_s, cells.join(","))
    }

    /// Parses a row. A field without a finite number sets no bound; a row without a time is
    /// rejected.
    pub fn parse(row: &str) -> Option<Self> {
        let mut cells = row.split(',').map(number);
        let time_s = cells.next()??;
        let mut between = || {
            Some(Between {
                least: cells.next()?,
                greatest: cells.next()?,
            })
        };
        Some(Self {
            time_s,
            voltage_v: between()?,
            current_a: between()?,
            temperature_degc: between()?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_comes_back_without_what_is_infinite() {
        let row = EnvelopeRow {
            time_s: 2.0,
            voltage_v: Between::of(-1.0, 1.0),
            current_a: Between::of(-5.6, 0.1),
            temperature_degc: Between::of(f64::NEG_INFINITY, 60.0),
        };
        let text = "2.000,-1.000000,1.000000,-5.600000,0.100000,,60.000000";
        assert_eq!(row.row(), text);
        assert_eq!(EnvelopeRow::parse(text), Some(row));
        assert_eq!(EnvelopeRow::parse(ENVELOPE_COLUMNS), None);
        assert_eq!(EnvelopeRow::parse("2.000,-1,1,-5.6"), None);
    }
}
