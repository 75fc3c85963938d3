//! Values that hold for a whole run and stand in no step: made once from the experiment.

use crate::{
    config::{self, Experiment, Jig, Wiring},
    interlock::{Limits, Settings},
    measure::quality::Quality,
};

/// Values that hold for a whole run and stand in no step.
pub(super) struct Setup {
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
    /// Beginnings of the notes about the runs of a campaign, from run 1 on.
    prefixes: Vec<String>,
    /// Values that all sweeps share, where there are any.
    pub(super) sweeps: Option<Sweeps>,
    /// The quality gate of multisines.
    pub(super) multisine_quality: Option<Quality>,
}

/// Values that all sweeps of a run share.
#[derive(Clone, Copy)]
pub(super) struct Sweeps {
    /// Greatest amplitude of their currents, A.
    pub(super) amplitude_a: f64,
    /// Periods on the screen at least.
    pub(super) periods_on_screen: f64,
    /// Points downloaded per channel.
    pub(super) record_points: u64,
    /// Points in the scope's memory per channel.
    pub(super) memory_points: u64,
    /// Frequency of the mains that is fitted besides the sinusoid, Hz.
    pub(super) mains_hz: Option<f64>,
    /// Whether points overlap, where somebody has said so.
    pub(super) overlap: Option<bool>,
    /// The quality gate.
    pub(super) quality: Option<Quality>,
}

impl Setup {
    /// Takes what is needed out of an experiment.
    pub(super) fn of(experiment: &Experiment) -> Self {
        Self {
            limits: experiment.cell.limits,
            interlock: experiment.cell.interlock,
            wiring: experiment.bench.wiring.clone(),
            thermostat: experiment.bench.thermostat,
            person_clamps: matches!(experiment.bench.instruments.jig, Some(Jig::Person)),
            prefixes: experiment
                .campaign
                .iter()
                .flat_map(|campaign| campaign.runs().map(|run| run.prefix()))
                .collect(),
            sweeps: experiment.eis.as_ref().map(|eis| Sweeps {
                amplitude_a: eis.amplitude_a,
                periods_on_screen: eis.periods_on_screen,
                record_points: eis.record_points,
                memory_points: eis.memory_points,
                mains_hz: eis.mains_hz,
                overlap: eis.overlap,
                quality: eis.quality,
            }),
            multisine_quality: experiment
                .multisine
                .as_ref()
                .and_then(|multisine| multisine.quality),
        }
    }

    /// Beginning of a note about a run of the campaign.
    pub(super) fn prefix(&self, run: usize) -> Option<&str> {
        self.prefixes.get(run.checked_sub(1)?).map(String::as_str)
    }
}
