//! A named cell, and the runs of a campaign with several cells.

use std::{fmt, sync::Arc};

use instruments::units::{Celsius, Coulombs};

/// A named cell.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct Specimen {
    /// Its number in the jig, from 1.
    pub number: usize,
    /// Its name, which also appears in file names.
    pub name: String,
    /// Its serial number, if it has one.
    pub serial: Option<String>,
    /// Batch that it was made in, if known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub batch: Option<String>,
    /// Code that is printed on it, if known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub barcode: Option<String>,
}

impl Specimen {
    /// Checks whether a text can be the name of a cell: letters, digits and `-`.
    pub fn is_name(text: &str) -> bool {
        let is_part = |c: char| c.is_ascii_alphanumeric() || c == '-';
        !text.is_empty() && text.chars().all(is_part)
    }
}

/// One run of a campaign, or one point of a map.
#[derive(Debug, Clone, PartialEq)]
pub struct CampaignRun {
    /// Its number, from 1, in planned order.
    pub number: usize,
    /// The cell.
    pub cell: Arc<Specimen>,
    /// Number of the repeat of this cell, from 1.
    pub repeat: usize,
    /// The point of the map that it measures.
    pub point: Option<MapPoint>,
}

/// A point of a map.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MapPoint {
    /// State of charge.
    pub soc: f64,
    /// Temperature, °C.
    pub temperature_degc: Celsius,
    /// Charge below that of the full cell, C.
    pub below_full_coulomb: Coulombs,
    /// Distance from this charge within which the cell counts as being there, C.
    pub within_coulomb: Coulombs,
}

impl fmt::Display for MapPoint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} % and {}", percent(self.soc), self.temperature_degc)
    }
}

/// A share in percent, without the error of its rounding.
pub fn percent(share: f64) -> f64 {
    (1.0e6 * share).round() / 1.0e4
}

impl CampaignRun {
    /// Returns the name for its files.
    pub fn name(&self) -> String {
        match self.point {
            Some(_) => format!("point_{}", self.number),
            None => format!("{}_{}", self.cell.name, self.repeat),
        }
    }

    /// Returns what it is called in the title of a stage.
    pub fn title(&self) -> String {
        match self.point {
            Some(point) => format!("point {}, {point}", self.number),
            None => format!("run {}, cell {}", self.number, self.cell.name),
        }
    }

    /// Returns the prefix of a note about it.
    pub fn prefix(&self) -> String {
        match self.point {
            Some(point) => format!("point {} ({point}): ", self.number),
            None => format!(
                "run {} (cell {}, repeat {}): ",
                self.number, self.cell.name, self.repeat
            ),
        }
    }
}

impl fmt::Display for Specimen {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "cell {}", self.name)?;
        self.serial
            .as_ref()
            .map_or(Ok(()), |serial| write!(f, " (serial number {serial})"))
    }
}
