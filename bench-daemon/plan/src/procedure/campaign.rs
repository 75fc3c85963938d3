//! Campaign (thesis 3.3: five cells, five sweeps each): every stage of a run begins with the
//! selection of its cell.

use crate::plan::{CampaignRun, Stage, Step};

/// Adds the run to a stage.
pub(super) fn of_run(mut stage: Stage, run: &CampaignRun) -> Stage {
    stage.steps.insert(0, Step::Specimen(run.clone()));
    stage
}
