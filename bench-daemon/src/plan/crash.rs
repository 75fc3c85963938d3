//! Effect of a crash in a step on a resumed run: decided here, for every kind of step, and nowhere
//! else.

use super::Step;

/// Effect of a crash in a step on a resumed run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AfterCrash {
    /// Nothing that lasts was moved: it is played again.
    Repeat,
    /// It ends at a voltage, wherever it begins: the stage is played again from its beginning, and
    /// ends at once what has been reached.
    Absolute,
    /// It moved a charge that nobody knows: it is played again only after the cell was brought to a
    /// known state of charge.
    Unknown,
}

impl Step {
    /// Effect of a crash in this step.
    pub fn after_crash(&self) -> AfterCrash {
        match self {
            Self::Specimen(_)
            | Self::Mount(_)
            | Self::HoldTemperature { .. }
            | Self::Rest { .. }
            | Self::PowerUp { .. }
            | Self::Pause { .. }
            | Self::Zero(_)
            | Self::PowerDown => AfterCrash::Repeat,
            // A sinusoid takes back what it gives.
            Self::Sine { .. } | Self::Multisine(_) | Self::Recheck(_) => AfterCrash::Repeat,
            // What a cell has come to is judged only behind the rest that it came to it in; legs
            // begin with a full cell.
            Self::Discharge { .. } | Self::Charge { .. } | Self::Accept { .. } | Self::Leg(_) => {
                AfterCrash::Absolute
            }
            Self::Trace(_) => AfterCrash::Unknown,
        }
    }
}
