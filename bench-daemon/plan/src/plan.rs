//! Plan of a run, as data: stages of steps, each with an upper bound in time. The plan is checked
//! before anything is energised.

mod bias;
mod bias_course;
mod check;
mod crash;
mod display;
mod drives;
mod extent;
mod leg;
mod map_points;
mod multisine;
mod specimen;
mod sweep;
mod time;
mod trace;

use std::sync::Arc;

use instruments::{
    fixture::Fixture,
    supply4q::Holds,
    units::{Amps, Celsius, Hertz, Kelvins, Seconds, Volts},
};

pub use bias::{Bias, RAMP_STEP_S, Recharge, ramp_steps};
pub use crash::AfterCrash;
pub use display::fixture_name;
use display::minutes;
pub use extent::Extent;
pub use leg::{Flow, Leg, Log};
pub use map_points::PointRow;
pub use multisine::Band;
pub use specimen::{CampaignRun, MapPoint, Specimen, percent};
#[cfg(test)]
pub use sweep::test_settings;
pub use sweep::{Depth, IDLE_CURRENT_A, SweepSettings};
pub use time::{LEEWAY_S, MAX_RANGING};
pub use trace::{Averaged, Frame, LONGEST_FRAME_S, Level, Through, TracePlan};

use crate::measure::quality::Quality;

/// A plan.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    /// Its stages, in order.
    pub stages: Vec<Stage>,
}

/// Steps that belong together; the outputs are off before and after.
#[derive(Debug, Clone, PartialEq)]
pub struct Stage {
    /// Purpose of the stage.
    pub purpose: Purpose,
    /// Its steps, in order.
    pub steps: Vec<Step>,
}

/// Purpose of a stage: determines how its records are used.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Purpose {
    /// Brings the cell to its temperature.
    Temperature,
    /// Brings the cell to its state of charge.
    SocReset,
    /// Discharges a cell whose charge is counted to a point of a map.
    MapPoint,
    /// Determines the open-circuit voltage over the state of charge.
    OcvSoc,
    /// A sweep of the fixture in the jig: 0 for a control, otherwise the number of the repeat.
    Sweep(Fixture, usize),
    /// Many frequencies at once, with the number of the repeat.
    Multisine(usize),
    /// A stepwise current through the cell.
    Trace,
}

/// One step: everything that the executor sends for it.
#[derive(Debug, Clone, PartialEq)]
pub enum Step {
    /// Selects the cell of a run of a campaign; every output is off.
    Specimen(CampaignRun),
    /// Clamps another fixture into the jig; every output is off.
    Mount(Fixture),
    /// Holds a temperature with the chiller, and waits for the cell.
    HoldTemperature {
        /// Set-point, °C.
        setpoint_degc: Celsius,
        /// Accepted deviation, K.
        within_k: Kelvins,
        /// Upper bound, s.
        max_s: Seconds,
    },
    /// Discharges at constant current down to a voltage.
    Discharge {
        /// Current, A, positive.
        current_a: Amps,
        /// End, V under load.
        until_v: Volts,
        /// Upper bound, s.
        max_s: Seconds,
    },
    /// Charges at constant current up to a voltage.
    Charge {
        /// Current, A.
        current_a: Amps,
        /// Limit of the supply, V.
        limit_v: Volts,
        /// End, V under load.
        until_v: Volts,
        /// Upper bound, s.
        max_s: Seconds,
    },
    /// Waits without a current until the voltage is steady.
    Rest {
        /// Lower bound, s.
        min_s: Seconds,
        /// Upper bound, s.
        max_s: Seconds,
        /// Slope below which the voltage is steady, V/s.
        slope_v_per_s: f64,
    },
    /// Compares the voltage at rest with a band. If it is within the band, the rest of the stage
    /// is skipped.
    Accept {
        /// The band, V.
        band_v: (Volts, Volts),
        /// Treatment of a cell that misses it; `None` if the charge is tried again.
        missed: Option<Missed>,
    },
    /// A direct current through load or supply, or a rest, with every reading stored.
    Leg(Leg),
    /// Switches the bipolar supply on with the generator at zero.
    PowerUp {
        /// Compliance voltage, V.
        compliance_v: Volts,
        /// Current limit, A: the daemon judges its readings by it, and the supply enforces it if
        /// it can.
        limit_a: Amps,
        /// Limit that the supply enforces itself while the generator commands the current.
        held: Holds,
        /// Greatest current while its command is zero, A: a larger one is a zero error that must
        /// be trimmed.
        idle_a: Amps,
        /// Memory depth of the scope for the sweeps of the run; `None` if there are none.
        depth: Option<Depth>,
    },
    /// Drives and captures one sinusoid.
    Sine {
        /// Its number in the sweep, from 0.
        index: usize,
        /// Frequency, Hz.
        freq_hz: Hertz,
        /// Amplitude of the current, A.
        amplitude_a: Amps,
        /// Shortest wait for the record, s.
        wait_s: Seconds,
        /// Settings that it shares with the other points.
        settings: Arc<SweepSettings>,
    },
    /// Records the channels with every output off, before a direct current is driven.
    BiasZero(Bias),
    /// Changes the direct current under the sinusoids.
    Bias(Bias),
    /// Brings back the charge that a direct current has moved.
    Recharge(Recharge),
    /// Drives and captures many sinusoids at once.
    Multisine(Arc<Band>),
    /// Checks the finished sweep for consistency. Points that do not fit are measured again.
    Recheck(Quality),
    /// Waits without a current.
    Pause {
        /// Duration, s.
        span_s: Seconds,
    },
    /// Rests, then records scope and voltmeter of the cell without a current.
    Zero(Arc<TracePlan>),
    /// Drives and records steps of direct current.
    Trace(Arc<TracePlan>),
    /// Switches the bipolar supply off.
    PowerDown,
}

/// Treatment of a run whose cell does not reach the band of its state of charge.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Missed {
    /// The run continues and reports it.
    Flag,
    /// The run ends.
    Refuse,
}

/// A plan that would exceed the limits.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("stage {stage}, step {step} ({what}): {reason}")]
pub struct PlanError {
    /// Number of the stage, from 1.
    pub stage: usize,
    /// Number of the step in it, from 1.
    pub step: usize,
    /// The step, as text.
    pub what: String,
    /// Reason.
    pub reason: String,
}

/// A plan that was checked; only such a plan can be executed.
#[derive(Debug, Clone, PartialEq)]
pub struct Checked(Plan);

impl Checked {
    /// Returns the plan.
    pub fn plan(&self) -> &Plan {
        &self.0
    }
}

impl Stage {
    /// Returns the cell of the stage, if there are several.
    pub fn specimen(&self) -> Option<&Arc<Specimen>> {
        self.campaign_run().map(|run| &run.cell)
    }

    /// Returns the number of the campaign's run that it belongs to.
    pub fn run(&self) -> Option<usize> {
        self.campaign_run().map(|run| run.number)
    }

    /// Returns the purpose of the stage; in a campaign also the run and the cell that it belongs
    /// to.
    pub fn title(&self) -> String {
        let of_run = self.campaign_run().map(|run| format!("{}: ", run.title()));
        format!("{}{}", of_run.unwrap_or_default(), self.purpose)
    }

    /// Returns the point of the map that it belongs to.
    pub fn point(&self) -> Option<MapPoint> {
        self.campaign_run().and_then(|run| run.point)
    }

    /// Returns the run of the campaign, or the point of the map, that it belongs to.
    pub fn campaign_run(&self) -> Option<&CampaignRun> {
        self.steps.iter().find_map(|step| {
            if let Step::Specimen(run) = step {
                Some(run)
            } else {
                None
            }
        })
    }
}
