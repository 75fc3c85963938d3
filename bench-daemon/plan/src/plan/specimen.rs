//! A named cell, and the runs of a campaign with several cells.

use std::{fmt, sync::Arc};

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

/// One run of a campaign.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CampaignRun {
    /// Its number, from 1, in planned order.
    pub number: usize,
    /// The cell.
    pub cell: Arc<Specimen>,
    /// Number of the repeat of this cell, from 1.
    pub repeat: usize,
}

impl CampaignRun {
    /// Returns the name for its files.
    pub fn name(&self) -> String {
        format!("{}_{}", self.cell.name, self.repeat)
    }

    /// Returns the prefix of a note about it.
    pub fn prefix(&self) -> String {
        format!(
            "run {} (cell {}, repeat {}): ",
            self.number, self.cell.name, self.repeat
        )
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
