//! Parts of a record: the direction that a file counts positive, the numbers of its head, and rows that
//! were left out.

use std::str::FromStr;

/// Direction of the current that is positive in a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CurrentSign {
    /// Discharging is positive.
    Discharge,
    /// Charging is positive.
    Charge,
}

impl FromStr for CurrentSign {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "discharge" => Ok(Self::Discharge),
            "charge" => Ok(Self::Charge),
            met => Err(format!(
                "expected which direction is positive, `discharge` or `charge`, met {met:?}"
            )),
        }
    }
}

/// A number of the head.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fact {
    /// Its value, in the unit of its name.
    pub value: f64,
    /// Its line, from 1.
    pub line: usize,
}

/// Numbers of the head, if it contains them.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Head {
    /// Capacity of the cell, Ah.
    pub capacity_ah: Option<Fact>,
    /// Temperature of the test, °C.
    pub temperature_degc: Option<Fact>,
}

/// A row that was left out because it has no voltage or no current, or because another row at the
/// same time follows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LeftOut {
    /// Its line, from 1; in Parquet the row.
    pub line: usize,
    /// Its time, s.
    pub time_s: f64,
    /// Whether it was measured, and another row at the same time was kept instead.
    pub replaced: bool,
}
