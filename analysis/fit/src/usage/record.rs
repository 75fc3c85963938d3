//! A record, and why one is refused.

/// The voltage of one cell.
#[derive(Debug, Clone, PartialEq)]
pub struct CellVoltage {
    /// Its name.
    pub name: String,
    /// Voltage at each time, V.
    pub voltage_v: Vec<f64>,
}

/// A record of ordinary use.
#[derive(Debug, Clone, PartialEq)]
pub struct UsageRecord {
    /// Time, s, rising; the stamps may jitter, and a gap divides the record.
    pub time_s: Vec<f64>,
    /// Current, A, positive for discharge.
    pub current_a: Vec<f64>,
    /// The cells that carry it.
    pub cells: Vec<CellVoltage>,
}

/// Reason why a record is refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum UsageError {
    /// Lists of different lengths, or too few rows.
    #[error(
        "expected at least {expected} rows with a time, a current and a voltage of each cell, found {found}"
    )]
    Rows {
        /// Number needed.
        expected: usize,
        /// Number found.
        found: usize,
    },
    /// A time that does not rise, or a value that is not a number.
    #[error("row {row} (counted from 1): expected {expected}, found {found}")]
    Row {
        /// Number of the row, from 1.
        row: usize,
        /// Expected value.
        expected: &'static str,
        /// Value found.
        found: f64,
    },
    /// The current has power nowhere.
    #[error(
        "expected a current that changes enough for an impedance known to {expected_percent} % at one \
        frequency at least, found none from {from_hz} Hz to {to_hz} Hz"
    )]
    NoPower {
        /// Greatest uncertainty, %.
        expected_percent: f64,
        /// Lowest frequency that was tried, Hz.
        from_hz: f64,
        /// Highest frequency that was tried, Hz.
        to_hz: f64,
    },
}

/// Fewest rows of a record.
const FEWEST: usize = 256;

impl UsageRecord {
    /// Refuses a record without enough valid rows.
    pub(super) fn check(&self) -> Result<(), UsageError> {
        let lists = self.cells.iter().map(|cell| cell.voltage_v.len());
        let found = lists
            .chain([self.time_s.len(), self.current_a.len()])
            .min()
            .unwrap_or(0);
        let equal = self
            .cells
            .iter()
            .all(|cell| cell.voltage_v.len() == self.time_s.len());
        if found < FEWEST
            || !equal
            || self.current_a.len() != self.time_s.len()
            || self.cells.is_empty()
        {
            return Err(UsageError::Rows {
                expected: FEWEST,
                found,
            });
        }
        for (index, pair) in self.time_s.windows(2).enumerate() {
            if !(pair[1] > pair[0] && pair[1].is_finite()) {
                return Err(UsageError::Row {
                    row: index + 2,
                    expected: "a time after the one before",
                    found: pair[1],
                });
            }
        }
        let lists = self
            .cells
            .iter()
            .map(|cell| &cell.voltage_v)
            .chain([&self.current_a]);
        for list in lists {
            if let Some(index) = list.iter().position(|value| !value.is_finite()) {
                return Err(UsageError::Row {
                    row: index + 1,
                    expected: "a number",
                    found: list[index],
                });
            }
        }
        Ok(())
    }

    /// Returns the record with the current of a later time, s, in each row.
    pub(super) fn with_current_earlier(&self, lag_s: f64) -> Self {
        let at = |time_s: &f64| {
            let (times, values) = (&self.time_s, &self.current_a);
            let time_s = (time_s + lag_s).clamp(times[0], times[times.len() - 1]);
            let after = times
                .partition_point(|t| *t < time_s)
                .clamp(1, times.len() - 1);
            let share = (time_s - times[after - 1]) / (times[after] - times[after - 1]);
            values[after - 1] + share * (values[after] - values[after - 1])
        };
        Self {
            current_a: self.time_s.iter().map(at).collect(),
            ..self.clone()
        }
    }

    /// Returns the rows from `from` to before `to`.
    pub(super) fn part(&self, from: usize, to: usize) -> Self {
        let cell = |cell: &CellVoltage| CellVoltage {
            name: cell.name.clone(),
            voltage_v: cell.voltage_v[from..to].to_vec(),
        };
        Self {
            time_s: self.time_s[from..to].to_vec(),
            current_a: self.current_a[from..to].to_vec(),
            cells: self.cells.iter().map(cell).collect(),
        }
    }
}
