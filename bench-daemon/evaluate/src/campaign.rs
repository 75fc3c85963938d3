//! Campaigns over cells and benches: which cell is measured where and in which order, the
//! experiments that follow, and what came of them: how much cells, batches and benches differ.

mod design;
mod experiment;
mod file;
mod report;

pub use design::{Design, Visit};
pub use file::{CampaignFile, CellOfCampaign};
pub use report::{
    BenchOffset, CampaignReport, CorrectedCell, LeftOut, Quantity, ReportError, report,
};
