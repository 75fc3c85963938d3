//! What a rig knows of bench and cell besides its steps.

use std::sync::Arc;

use crate::{
    config::{self, Experiment, Jig, Wiring},
    interlock::{Limits, Settings},
    plan::Specimen,
    watch::WatchLink,
};

/// What a rig knows of bench and cell. No procedure decides it and it is the same for every step,
/// so that it is no instruction: it says how a command reaches the cell, and what is refused
/// whatever was commanded.
pub(super) struct Setup {
    /// Name of the cell.
    pub(super) cell: String,
    /// The one cell that is measured, where it is named.
    pub(super) specimen: Option<Arc<Specimen>>,
    /// Limits of the cell.
    pub(super) limits: Limits,
    /// Settings of the interlock.
    pub(super) interlock: Settings,
    /// How the bench is wired.
    pub(super) wiring: Wiring,
    /// How a bath without a loop of its own is held.
    pub(super) thermostat: config::Thermostat,
    /// A person changes what is in the jig.
    pub(super) person_clamps: bool,
    /// The watch beside the procedure; `None` in virtual time, where the procedure makes its checks.
    pub(super) watch: Option<WatchLink>,
}

impl Setup {
    /// Takes what describes bench and cell out of an experiment.
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
