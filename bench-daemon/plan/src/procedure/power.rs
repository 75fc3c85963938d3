//! Power-up of the bipolar supply, which all stages of an experiment share.

use instruments::{
    supply4q::Holds,
    units::{Amps, Volts},
};

use crate::{
    config::Experiment,
    interlock::NO_CURRENT_A,
    plan::{Depth, IDLE_CURRENT_A, Step},
};

/// Power-up that all stages of an experiment share.
#[derive(Debug, Clone, Copy)]
pub(super) struct Power {
    /// Limit that the bipolar supply enforces itself.
    pub(super) held: Holds,
    /// Greatest current while its command is zero, A.
    pub(super) idle_a: Amps,
    /// Memory depth of the scope for the sweeps, if there are any.
    pub(super) depth: Option<Depth>,
}

impl Power {
    /// Returns the power-up of an experiment: the requirements of its sweeps apply to its other
    /// stages, too.
    pub(super) fn of(experiment: &Experiment) -> Self {
        let eis = experiment.eis.as_ref();
        let half_a = eis.map_or(Amps::INFINITY, |eis| 0.5 * eis.amplitude_a);
        Self {
            held: experiment
                .bench
                .bipolar()
                .map_or(Holds::Nothing, |can| can.holds),
            idle_a: IDLE_CURRENT_A.min(half_a).max(NO_CURRENT_A),
            depth: eis.map(|eis| Depth {
                memory_points: eis.memory_points,
                record_points: eis.record_points,
            }),
        }
    }

    /// Returns the step that powers up.
    pub(super) fn up(self, compliance_v: Volts, limit_a: Amps) -> Step {
        let Self {
            held,
            idle_a,
            depth,
        } = self;
        Step::PowerUp {
            compliance_v,
            limit_a,
            held,
            idle_a,
            depth,
        }
    }
}
