//! The section `[campaign]`: several cells, each measured several times, by an experiment for one
//! cell.

use std::sync::Arc;

use fixtures::Scenario;
use instruments::fixture::Fixture;

use super::{ConfigError, Eis, Source, Trace, check::Check, raw};
use crate::plan::{CampaignRun, Specimen};

/// Several cells, each measured several times.
#[derive(Debug, Clone)]
pub struct Campaign {
    /// The cells.
    pub cells: Vec<Arc<Specimen>>,
    /// How often each is measured.
    pub repeats: usize,
    /// Order of the runs: if set, every cell once, then every cell again; otherwise all repeats
    /// of one cell, then the next.
    pub round_robin: bool,
}

impl Campaign {
    /// Its runs as they are planned.
    pub fn runs(&self) -> impl Iterator<Item = CampaignRun> + '_ {
        let count = self.cells.len();
        (0..count * self.repeats).map(move |index| {
            let (cell, repeat) = if self.round_robin {
                (index % count, index / count)
            } else {
                (index / self.repeats, index % self.repeats)
            };
            CampaignRun {
                number: index + 1,
                cell: self.cells[cell].clone(),
                repeat: repeat + 1,
                point: None,
            }
        })
    }

    /// A run by its number.
    pub fn run(&self, number: usize) -> Option<CampaignRun> {
        self.runs().nth(number.checked_sub(1)?)
    }
}

impl Check<'_> {
    pub(super) fn campaign(
        &self,
        raw: &raw::Campaign,
        eis: Option<&Eis>,
        traces: &[Trace],
    ) -> Result<Campaign, ConfigError> {
        if let Some(trace) = traces.iter().find(|trace| trace.repeat != 1) {
            let reason = format!(
                "expected a repeat of 1 beside [campaign], whose repeats say how often, found {}",
                trace.repeat
            );
            return Err(self.complain(&format!("traces.{}.repeat", trace.name), reason));
        }
        if eis.is_none_or(|eis| eis.fixture != Fixture::Cell || eis.repeat != 1) {
            let reason = "expected a section [eis] that sweeps the cell with a repeat of 1: \
            campaign.repeats says how often";
            return Err(self.complain("campaign", reason));
        }
        if eis.is_some_and(|eis| eis.steps_a.len() > 1) {
            return Err(self.complain(
                "eis.amplitude_steps",
                "expected one amplitude beside [campaign]: its runs are one sweep each",
            ));
        }
        if eis.is_some_and(|eis| eis.bias.is_some()) {
            return Err(self.complain(
                "eis.bias",
                "expected none beside [campaign]: its runs are one sweep at rest each",
            ));
        }
        self.within(
            "campaign.cells",
            raw.cells.len() as f64,
            1.0..=32.0,
            "cells",
        )?;
        self.within(
            "campaign.repeats",
            raw.repeats as f64,
            1.0..=1000.0,
            "repeats",
        )?;
        if raw.cells.len() > 1 {
            self.needs(self.bench.instruments.jig.as_ref(), "jig", "campaign")?;
        }
        let mut cells: Vec<Arc<Specimen>> = Vec::new();
        for (index, cell) in raw.cells.iter().enumerate() {
            let field = |part: &str| format!("campaign.cells.{}.{part}", index + 1);
            if !Specimen::is_name(&cell.name) {
                return Err(self.complain(
                    &field("name"),
                    format!(
                        "expected a name of letters, digits and `-`, found {:?}",
                        cell.name
                    ),
                ));
            }
            if let Some(known) = cells
                .iter()
                .find(|known| known.name.eq_ignore_ascii_case(&cell.name))
            {
                return Err(self.complain(&field("name"), same_name(&known.name, &cell.name)));
            }
            if let Some((known, serial)) = same_serial(&cells, cell.serial.as_deref()) {
                let reason = format!(
                    "expected serial numbers that differ, found {serial:?} for {} and {}",
                    known.name, cell.name
                );
                return Err(self.complain(&field("serial"), reason));
            }
            cells.push(Arc::new(Specimen {
                number: index + 1,
                name: cell.name.clone(),
                serial: cell.serial.clone(),
                batch: cell
                    .batch
                    .clone()
                    .or_else(|| self.cell.identity.batch.clone()),
                barcode: cell.barcode.clone(),
            }));
        }
        Ok(Campaign {
            cells,
            repeats: raw.repeats,
            round_robin: raw.order == raw::CampaignOrder::RoundRobin,
        })
    }

    /// Refuses a campaign with more cells than the simulated bench has.
    pub(super) fn specimens(
        &self,
        campaign: &Campaign,
        file: &Source,
        scenario: &Scenario,
    ) -> Result<(), ConfigError> {
        let there = scenario.specimens.count.max(1);
        let Some(first) = campaign.cells.get(there) else {
            return Ok(());
        };
        let (cells, file) = (
            if there == 1 { "cell" } else { "cells" },
            file.path().display(),
        );
        let reason = format!(
            "expected at most {there} {cells}, the number of the simulated bench (specimens.count \
            of {file}), found {}; {:?} is the first in excess",
            campaign.cells.len(),
            first.name
        );
        Err(self.complain("campaign.cells", reason))
    }
}

/// Returns the message for names that are equal on a case-insensitive file system.
fn same_name(known: &str, name: &str) -> String {
    if known == name {
        return format!("expected names that differ, found {name:?} twice");
    }
    format!(
        "expected names that differ in more than capital and small letters, found {known:?} and \
        {name:?}"
    )
}

/// The cell that has the serial number already.
fn same_serial<'a, 'b>(
    cells: &'a [Arc<Specimen>],
    serial: Option<&'b str>,
) -> Option<(&'a Specimen, &'b str)> {
    let serial = serial.map(str::trim).filter(|serial| !serial.is_empty())?;
    let known = cells.iter().find(|known| {
        known
            .serial
            .as_deref()
            .is_some_and(|known| known.trim() == serial)
    })?;
    Some((known.as_ref(), serial))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cell_by_cell_or_round_robin() {
        let cell = |(index, name): (usize, &str)| {
            Arc::new(Specimen {
                number: index + 1,
                name: name.to_owned(),
                serial: None,
                batch: None,
                barcode: None,
            })
        };
        let names = |round_robin| {
            let cells = ["A", "B"].into_iter().enumerate().map(cell).collect();
            let campaign = Campaign {
                cells,
                repeats: 3,
                round_robin,
            };
            assert_eq!(campaign.run(2), campaign.runs().nth(1));
            assert_eq!((campaign.run(0), campaign.run(7)), (None, None));
            campaign.runs().map(|run| run.name()).collect::<Vec<_>>()
        };
        assert_eq!(names(false), ["A_1", "A_2", "A_3", "B_1", "B_2", "B_3"]);
        assert_eq!(names(true), ["A_1", "B_1", "A_2", "B_2", "A_3", "B_3"]);
    }
}
