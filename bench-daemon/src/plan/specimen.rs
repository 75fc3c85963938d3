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

impl Stage {
    /// The cell that it is about, where there are several.
    pub fn specimen(&self) -> Option<&Arc<Specimen>> {
        self.of_campaign().map(|(specimen, _)| specimen)
    }

    /// Number of the campaign's run that it belongs to.
    pub fn run(&self) -> Option<usize> {
        self.of_campaign().map(|(_, run)| run)
    }

    /// Purpose of the stage; in a campaign also the run and the cell that it belongs to.
    pub fn title(&self) -> String {
        let of_run = self
            .of_campaign()
            .map(|(specimen, run)| format!("run {run}, cell {}: ", specimen.name));
        format!("{}{}", of_run.unwrap_or_default(), self.purpose)
    }

    fn of_campaign(&self) -> Option<(&Arc<Specimen>, usize)> {
        self.steps.iter().find_map(|step| {
            if let Step::Specimen(specimen, run) = step {
                Some((specimen, *run))
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
