//! The instruments through which the current of a step flows.

use super::{Flow, Step};
use crate::interlock::Drives;

impl Step {
    /// Returns the drives that the step uses.
    pub fn drives(&self) -> Drives {
        match *self {
            Self::Discharge { .. } => Drives::LOAD,
            Self::Charge { .. } => Drives::SUPPLY,
            Self::Leg(leg) => match leg.flow {
                Flow::Discharge { .. } | Flow::DischargeTo { .. } => Drives::LOAD,
                Flow::Charge { .. } => Drives::SUPPLY,
                Flow::Rest => Drives::default(),
            },
            Self::PowerUp { .. }
            | Self::Sine { .. }
            | Self::Bias(_)
            | Self::Recharge(_)
            | Self::Multisine(_)
            | Self::Recheck(_)
            | Self::PowerDown => Drives::SUPPLY4Q,
            Self::Trace(ref trace) if trace.bipolar() => Drives::SUPPLY4Q,
            Self::Trace(_) => Drives::LOAD_AND_SUPPLY,
            Self::Specimen(_)
            | Self::Mount(_)
            | Self::HoldTemperature { .. }
            | Self::Rest { .. }
            | Self::Accept { .. }
            | Self::Pause { .. }
            | Self::BiasZero(_)
            | Self::Zero(_) => Drives::default(),
        }
    }
}
