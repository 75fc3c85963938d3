//! State of a run from step to step, besides its instruments.

use std::sync::Arc;

use analysis::{calibration::Correction, multisine::Line};
use instruments::fixture::Fixture;

use super::{dc::Reset, leg::Legs, trace::Zero};
use crate::{
    interlock::Reading,
    operator::Operator,
    operator::progress::Progress,
    plan::{CampaignRun, Specimen},
};

/// The person at the bench.
pub struct Person<'a> {
    /// Who changes the fixture, where no device does.
    pub operator: &'a Operator,
    /// Progress that the person at the terminal sees.
    pub progress: &'a Progress,
}

/// Where in the run the stage in work is, and what is in the jig.
#[derive(Default)]
pub(super) struct Position {
    /// Fixture that was clamped into the jig last, and which of the cells it was, where there are
    /// several.
    pub(super) mounted: Option<(Fixture, Option<Arc<Specimen>>)>,
    /// The cell that is in use, where there are several.
    pub(super) specimen: Option<Arc<Specimen>>,
    /// The campaign's run that the stage in work belongs to.
    pub(super) run: Option<CampaignRun>,
    /// Number of the sweep, 0 for a control.
    pub(super) repeat: usize,
}

/// State that steps of direct current leave for the steps after them.
#[derive(Default)]
pub(super) struct Direct {
    /// Readings of the channels while nothing flows.
    pub(super) zero: Option<Zero>,
    /// Charge that traces have left in the cell, C.
    pub(super) charge_c: f64,
    /// The readings of the legs so far.
    pub(super) legs: Legs,
    /// Where the reset of the state of charge stands.
    pub(super) reset: Reset,
}

/// Knowledge of harness and cell beside the points.
pub(crate) struct Known {
    /// Correction of the harness for the channels.
    pub(crate) correction: Correction,
    /// Last reading of the cell before the bipolar supply went on.
    pub(crate) idle: Reading,
    /// Lines of multisines, with their noise and distortion, until somebody takes them.
    pub(crate) lines: Vec<Line>,
}
