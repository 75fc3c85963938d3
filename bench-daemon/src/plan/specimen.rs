//! A certain cell, and the runs of a campaign of several.

use std::{fmt, sync::Arc};

/// A certain cell.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct Specimen {
    /// Its number in the jig, from 1.
    pub number: usize,
    /// Its name: files are called after it.
    pub name: String,
    /// Its serial number, where it has one.
    pub serial: Option<String>,
    /// Batch that it was made in, where that is known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub batch: Option<String>,
    /// Code that is printed on it, where that is known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub barcode: Option<String>,
}

impl Specimen {
    /// Whether a text can be the name of a cell: letters, digits and `-`.
    pub fn is_name(text: &str) -> bool {
        let is_part = |c: char| c.is_ascii_alphanumeric() || c == '-';
        !text.is_empty() && text.chars().all(is_part)
    }
}

/// One run of a campaign.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CampaignRun {
    /// Its number, from 1, in the order in which the runs are planned.
    pub number: usize,
    /// The cell.
    pub cell: Arc<Specimen>,
    /// Number of the repeat of this cell, from 1.
    pub repeat: usize,
}

impl CampaignRun {
    /// Name of its files.
    pub fn name(&self) -> String {
        format!("{}_{}", self.cell.name, self.repeat)
    }

    /// Prefix of a note about it.
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
