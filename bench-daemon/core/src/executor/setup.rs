//! What a rig knows of bench and cell beside its steps.

use std::sync::Arc;

use crate::watch::WatchLink;
use bench_plan::{
    config::{self, Experiment, Jig, Wiring},
    interlock::{Limits, Settings},
    plan::Specimen,
};

/// Properties of bench and cell. They do not depend on the procedure and are the same for every
/// step, so they are not instructions: they define how a command reaches the cell, and what is
/// refused for any command.
pub(super) struct Setup {
    /// Name of the cell.
    pub(super) cell: String,
    /// The cell that is measured, if it has a name.
    pub(super) specimen: Option<Arc<Specimen>>,
    /// Limits of the cell.
    pub(super) limits: Limits,
    /// Settings of the interlock.
    pub(super) interlock: Settings,
    /// How the bench is wired.
    pub(super) wiring: Wiring,
    /// How a bath without its own control loop is controlled.
    pub(super) thermostat: config::Thermostat,
    /// Whether a person changes what is in the jig.
    pub(super) person_clamps: bool,
    /// The watch beside the procedure; `None` in virtual time, where the procedure makes its
    /// checks.
    pub(super) watch: Option<WatchLink>,
}

impl Setup {
    /// Takes the description of bench and cell from an experiment.
    pub(super) fn of(experiment: &Experiment, watch: Option<WatchLink>) -> Self {
        Self {
            cell: experiment.cell.name.clone(),
            specimen: experiment.specimen.clone(),
            limits: experiment.cell.limits,
            interlock: experiment.cell.interlock,
            wiring: experiment.bench.wiring.clone(),
            thermostat: experiment.bench.thermostat,
            person_clamps: matches!(experiment.bench.instruments.jig, Some(Jig::Person)),
            watch,
        }
    }
}
