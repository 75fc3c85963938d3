//! The rows of `bath.csv`.

use super::readings::{format_value, number};

/// The columns of `bath.csv`.
pub const BATH_COLUMNS: &str = "time_s,bath_c,setpoint_c";

/// One row of `bath.csv`: a reading of the chiller, or a change of its setpoint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BathRow {
    /// Bench time, s.
    pub time_s: f64,
    /// Temperature of the bath from the chiller, °C; `None` if it was not read.
    pub bath_degc: Option<f64>,
    /// Setpoint of the bath, °C; `None` if none was set.
    pub setpoint_degc: Option<f64>,
}

impl BathRow {
    /// The row, without the end of its line.
    pub fn row(&self) -> String {
        let [bath, setpoint] =
            [self.bath_degc, self.setpoint_degc].map(|value| format_value(value, 4));
        format!("{:.3},{bath},{setpoint}", self.time_s)
    }

    /// Parses a row. A field without a finite number counts as not read; a row without a time is
    /// rejected.
    pub fn parse(row: &str) -> Option<Self> {
        let mut cells = row.split(',').map(number);
        Some(Self {
            time_s: cells.next()??,
            bath_degc: cells.next()?,
            setpoint_degc: cells.next()?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_comes_back_and_the_head_is_none() {
        let row = BathRow {
            time_s: 1.5,
            bath_degc: None,
            setpoint_degc: Some(25.0),
        };
        assert_eq!(row.row(), "1.500,,25.0000");
        assert_eq!(BathRow::parse(&row.row()), Some(row));
        assert_eq!(BathRow::parse(BATH_COLUMNS), None);
        assert_eq!(BathRow::parse("1.500,24.9"), None);
    }
}
