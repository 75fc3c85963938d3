//! Campaign (thesis 3.3: five cells, five sweeps each): every stage of a run begins with the cell
//! that it is about.

use crate::plan::{CampaignRun, Stage, Step};

/// A stage as one of a run's.
pub(super) fn of_run(mut stage: Stage, run: &CampaignRun) -> Stage {
    stage.steps.insert(0, Step::Specimen(run.clone()));
    stage
}
