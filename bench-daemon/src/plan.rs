//! Plan of a run, as data: stages of steps, each with an upper bound in time. It is checked before
//! anything is energised.

mod check;
mod crash;
mod display;
mod drives;
mod extent;
mod leg;
mod multisine;
mod specimen;
mod sweep;
mod time;
mod trace;

use std::sync::Arc;

use instruments::{fixture::Fixture, supply4q::Holds};

pub use crash::AfterCrash;
pub use display::fixture_name;
use display::minutes;
pub use extent::Extent;
pub use leg::{Flow, Leg, Log};
pub use multisine::Band;
pub use specimen::{CampaignRun, Specimen};
#[cfg(test)]
pub(crate) use sweep::test_settings;
pub use sweep::{Depth, IDLE_CURRENT_A, SweepSettings};
pub use time::{LEEWAY_S, MAX_RANGING};
#[cfg(test)]
pub(crate) use trace::test_trace;
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

/// Purpose of a stage: decides what is done with its records.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Purpose {
    /// Bringing the cell to its temperature.
    Temperature,
    /// Bringing the cell to its state of charge.
    SocReset,
    /// Finding the open-circuit voltage over the state of charge.
    OcvSoc,
    /// A sweep over what is in the jig: 0 as a control, else the number of the repeat.
    Sweep(Fixture, usize),
    /// Many frequencies at once, with the number of the repeat.
    Multisine(usize),
    /// A current that steps through the cell.
    Trace,
}

/// One step: everything that the executor sends for it.
#[derive(Debug, Clone, PartialEq)]
pub enum Step {
    /// The cell of a run of a campaign is taken into use; every output is off.
    Specimen(CampaignRun),
    /// Something else is clamped into the jig; every output is off.
    Mount(Fixture),
    /// The chiller holds a temperature, and the cell is waited for.
    HoldTemperature {
        /// Set-point, °C.
        setpoint_c: f64,
        /// Accepted deviation, K.
        within_k: f64,
        /// Upper bound, s.
        max_s: f64,
    },
    /// Discharge at constant current down to a voltage.
    Discharge {
        /// Current, A, positive.
        current_a: f64,
        /// End, V under load.
        until_v: f64,
        /// Upper bound, s.
        max_s: f64,
    },
    /// Charge at constant current up to a voltage.
    Charge {
        /// Current, A.
        current_a: f64,
        /// Limit of the supply, V.
        limit_v: f64,
        /// End, V under load.
        until_v: f64,
        /// Upper bound, s.
        max_s: f64,
    },
    /// Nothing flows until the voltage is steady.
    Rest {
        /// Lower bound, s.
        min_s: f64,
        /// Upper bound, s.
        max_s: f64,
        /// Steady means slower than this, V/s.
        slope_v_per_s: f64,
    },
    /// The voltage at rest is compared with a band. Where it is within the band, the rest of the
    /// stage is left out.
    Accept {
        /// The band, V.
        band_v: (f64, f64),
        /// Treatment of a cell that misses it; `None` where the charge is tried again.
        missed: Option<Missed>,
    },
    /// Direct current through load or supply, or rest, every reading of which is kept.
    Leg(Leg),
    /// The bipolar supply is brought up with the generator at zero.
    PowerUp {
        /// Compliance voltage, V.
        compliance_v: f64,
        /// Current limit, A: the daemon judges its readings by it, and the supply holds it where it
        /// can.
        limit_a: f64,
        /// Limit that the supply holds by itself while the generator commands the current.
        held: Holds,
        /// Greatest current while its command is zero, A: more is a zero error that wants trimming.
        idle_a: f64,
        /// Depth that the scope is set to for the sweeps of the run; `None` where it has none.
        depth: Option<Depth>,
    },
    /// One sinusoid is driven and captured.
    Sine {
        /// Its number in the sweep, from 0.
        index: usize,
        /// Frequency, Hz.
        freq_hz: f64,
        /// Amplitude of the current, A.
        amplitude_a: f64,
        /// Shortest wait for the record, s.
        wait_s: f64,
        /// Settings that it shares with the other points.
        settings: Arc<SweepSettings>,
    },
    /// Many sinusoids are driven at once and captured.
    Multisine(Arc<Band>),
    /// The finished sweep is checked for consistency. Points that do not fit are measured again.
    Recheck(Quality),
    /// Nothing flows for a while.
    Pause {
        /// How long, s.
        span_s: f64,
    },
    /// Rest, then what scope and voltmeter show of the cell while nothing flows.
    Zero(Arc<TracePlan>),
    /// Steps of direct current are driven and recorded.
    Trace(Arc<TracePlan>),
    /// The bipolar supply is taken down.
    PowerDown,
}

/// Treatment of a run whose cell misses the band of its state of charge to the end.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Missed {
    /// It goes on, and says so.
    Flag,
    /// It ends.
    Refuse,
}

/// A plan that would leave the limits.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("stage {stage}, step {step} ({what}): {reason}")]
pub struct PlanError {
    /// Number of the stage, from 1.
    pub stage: usize,
    /// Number of the step in it, from 1.
    pub step: usize,
    /// The step in words.
    pub what: String,
    /// Why not.
    pub reason: String,
}

/// A plan that was checked; only such a plan can be executed.
#[derive(Debug, Clone, PartialEq)]
pub struct Checked(Plan);

impl Checked {
    /// The plan.
    pub fn plan(&self) -> &Plan {
        &self.0
    }
}

impl Stage {
    /// The cell that it is about, where there are several.
    pub fn specimen(&self) -> Option<&Arc<Specimen>> {
        self.of_campaign().map(|run| &run.cell)
    }

    /// Number of the campaign's run that it belongs to.
    pub fn run(&self) -> Option<usize> {
        self.of_campaign().map(|run| run.number)
    }

    /// Purpose of the stage; in a campaign also the run and the cell that it belongs to.
    pub fn title(&self) -> String {
        let of_run = self
            .of_campaign()
            .map(|run| format!("run {}, cell {}: ", run.number, run.cell.name));
        format!("{}{}", of_run.unwrap_or_default(), self.purpose)
    }

    fn of_campaign(&self) -> Option<&CampaignRun> {
        self.steps.iter().find_map(|step| {
            if let Step::Specimen(run) = step {
                Some(run)
            } else {
                None
            }
        })
    }
}
