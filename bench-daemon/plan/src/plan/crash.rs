//! Effect of a crash in a step on a resumed run. This module alone determines it, for every kind
//! of step.

use super::{Flow, Leg, Step};

/// Effect of a crash in a step on a resumed run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AfterCrash {
    /// Nothing permanent was changed: the step is executed again.
    Repeat,
    /// The step ends at a voltage, from any starting point: the stage is executed again from its
    /// beginning, and steps whose target is reached end at once.
    Absolute,
    /// The step moves a charge that is counted and in the journal when it is done: a crash in it
    /// moved an unknown charge, and one after it did not.
    Counted,
    /// The step moved an unknown charge: it is executed again only after the cell was brought to a
    /// known state of charge.
    Unknown,
}

impl Step {
    /// Returns the effect of a crash in this step.
    pub fn after_crash(&self) -> AfterCrash {
        match self {
            Self::Specimen(_)
            | Self::Mount(_)
            | Self::HoldTemperature { .. }
            | Self::Rest { .. }
            | Self::PowerUp { .. }
            | Self::Pause { .. }
            | Self::Zero(_)
            | Self::BiasZero(_)
            | Self::PowerDown => AfterCrash::Repeat,
            // A sinusoid moves no net charge; one about a direct current lies between two steps
            // that do.
            Self::Sine { .. } | Self::Multisine(_) | Self::Recheck(_) => AfterCrash::Repeat,
            // The state of a cell is judged only after the rest in which it was reached; legs
            // begin with a full cell.
            Self::Leg(Leg {
                flow: Flow::DischargeTo { .. },
                ..
            }) => AfterCrash::Counted,
            Self::Discharge { .. } | Self::Charge { .. } | Self::Accept { .. } | Self::Leg(_) => {
                AfterCrash::Absolute
            }
            Self::Trace(_) | Self::Bias(_) | Self::Recharge(_) => AfterCrash::Unknown,
        }
    }
}
