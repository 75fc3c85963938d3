//! How long a plan takes: as a rule of thumb, and at most.

use super::{Leg, Plan, Step};

/// How often a point is measured again because a channel clipped or was too small.
pub const MAX_RANGING: usize = 4;
/// Seconds that setting up and downloading one point takes, as a rule of thumb.
const OVERHEAD_S: f64 = 2.0;

impl Plan {
    /// Expected duration, bench s: the fixed waits whole, the others by a rule of thumb.
    pub fn expected_s(&self) -> f64 {
        self.stages.iter().flat_map(|stage| &stage.steps).map(Step::expected_s).sum()
    }

    /// Longest possible duration, bench s.
    pub fn longest_s(&self) -> f64 {
        self.stages.iter().flat_map(|stage| &stage.steps).map(Step::longest_s).sum()
    }
}

impl Step {
    /// Expected duration, bench s.
    pub fn expected_s(&self) -> f64 {
        match *self {
            Self::Specimen(..) | Self::Mount(_) | Self::PowerUp { .. } | Self::PowerDown => OVERHEAD_S,
            Self::HoldTemperature { max_s, .. } => 0.2 * max_s,
            Self::Discharge { max_s, .. } | Self::Charge { max_s, .. } => 0.2 * max_s,
            Self::Rest { min_s, max_s, .. } => 0.5 * (min_s + max_s),
            Self::Accept { .. } => 0.0,
            Self::Leg(ref leg) => leg.expected_s(),
            Self::Sine { wait_s, .. } => wait_s + OVERHEAD_S,
            Self::Multisine(ref band) => band.expected_s() + 2.0 * OVERHEAD_S,
            Self::Recheck { .. } => OVERHEAD_S,
            Self::Pause { span_s } => span_s,
            Self::Zero(ref trace) => trace.rest_s + 2.0 * OVERHEAD_S,
            Self::Trace(ref trace) => trace.length_s() + OVERHEAD_S,
        }
    }

    /// Longest possible duration, bench s.
    pub fn longest_s(&self) -> f64 {
        match *self {
            Self::Specimen(..) | Self::Mount(_) | Self::PowerUp { .. } | Self::PowerDown => 60.0,
            Self::HoldTemperature { max_s, .. } | Self::Discharge { max_s, .. } | Self::Charge { max_s, .. } | Self::Rest { max_s, .. } => {
                max_s
            }
            Self::Accept { .. } => 0.0,
            Self::Leg(Leg { max_s, .. }) | Self::Recheck { max_s, .. } => max_s,
            Self::Multisine(ref band) => (band.expected_s() + 60.0) * (MAX_RANGING + 1) as f64,
            Self::Sine { wait_s, .. } => (wait_s + 60.0) * (MAX_RANGING + 1) as f64,
            Self::Pause { span_s } => span_s + 60.0,
            Self::Zero(ref trace) => trace.rest_s + 60.0,
            Self::Trace(ref trace) => trace.length_s() + 60.0,
        }
    }
}
