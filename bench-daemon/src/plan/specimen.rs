//! The cells of a campaign.

use std::{fmt, sync::Arc};

use super::{Stage, Step};

/// One of several cells.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct Specimen {
    /// Its number in the jig, from 1.
    pub number: usize,
    /// Its name: files are called after it.
    pub name: String,
    /// Its serial number, where it has one.
    pub serial: Option<String>,
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

impl Stage {
    /// The cell that it is about, where there are several.
    pub fn specimen(&self) -> Option<&Arc<Specimen>> {
        self.of_campaign().map(|run| &run.cell)
    }

    /// Number of the campaign's run that it belongs to.
    pub fn run(&self) -> Option<usize> {
        self.of_campaign().map(|run| run.number)
    }

    /// Purpose of the stage; in a campaign also the run and the cell that it belongs to.
    pub fn title(&self) -> String {
        let of_run = self
            .of_campaign()
            .map(|run| format!("run {}, cell {}: ", run.number, run.cell.name));
        format!("{}{}", of_run.unwrap_or_default(), self.purpose)
    }

    fn of_campaign(&self) -> Option<&CampaignRun> {
        self.steps.iter().find_map(|step| {
            if let Step::Specimen(run) = step {
                Some(run)
            } else {
                None
            }
        })
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
