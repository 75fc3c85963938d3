//! The rows of `readings.csv`.

/// The columns of `readings.csv`.
pub const READING_COLUMNS: &str = "time_s,phase,voltage_v,current_a,temperature_c";

/// One row of `readings.csv`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReadingRow<'a> {
    /// Bench time, s.
    pub time_s: f64,
    /// Phase of the run at that time.
    pub phase: &'a str,
    /// Voltage of the object in the jig, V; `None` if it was not read.
    pub voltage_v: Option<f64>,
    /// Current, charge positive, A; `None` if it was not read.
    pub current_a: Option<f64>,
    /// Temperature of the cell's surface, °C; `None` if it was not read.
    pub temperature_degc: Option<f64>,
}

impl<'a> ReadingRow<'a> {
    /// The row, without the end of its line.
    pub fn row(&self) -> String {
        format!(
            "{:.3},{},{},{},{}",
            self.time_s,
            self.phase,
            format_value(self.voltage_v, 6),
            format_value(self.current_a, 6),
            format_value(self.temperature_degc, 4)
        )
    }

    /// Parses a row. A field without a finite number counts as not read; a row without a time is
    /// rejected.
    pub fn parse(row: &'a str) -> Option<Self> {
        let mut cells = row.split(',');
        let time_s = cells.next().and_then(number)?;
        let phase = cells.next()?;
        let mut value = || cells.next().and_then(number);
        Some(Self {
            time_s,
            phase,
            voltage_v: value(),
            current_a: value(),
            temperature_degc: value(),
        })
    }

    /// Parses a row that has every column, each with a number or empty.
    pub fn parse_whole(row: &'a str) -> Option<Self> {
        let values = row.split(',').skip(2);
        let whole = values.clone().count() == 3
            && values
                .into_iter()
                .all(|cell| cell.is_empty() || cell.parse::<f64>().is_ok());
        Self::parse(row).filter(|_| whole)
    }
}

/// Formats a value with this number of decimals; returns an empty text for `None`.
pub(super) fn format_value(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(String::new, |value| format!("{value:.digits$}"))
}

/// A finite number.
pub(super) fn number(cell: &str) -> Option<f64> {
    cell.parse::<f64>().ok().filter(|value| value.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_comes_back() {
        let row = ReadingRow {
            time_s: 1.5,
            phase: "rest",
            voltage_v: Some(3.7),
            current_a: None,
            temperature_degc: Some(24.5),
        };
        assert_eq!(row.row(), "1.500,rest,3.700000,,24.5000");
        assert_eq!(ReadingRow::parse(&row.row()), Some(row));
        assert_eq!(ReadingRow::parse_whole(&row.row()), Some(row));
    }

    #[test]
    fn a_torn_row_tells_what_it_has_but_is_not_whole() {
        let torn = "1.500,rest,3.7,x";
        let read = ReadingRow::parse(torn).map(|row| (row.voltage_v, row.current_a));
        assert_eq!(read, Some((Some(3.7), None)));
        assert_eq!(ReadingRow::parse_whole(torn), None);
        assert_eq!(ReadingRow::parse("x,rest,3.7,0,25"), None);
    }
}
