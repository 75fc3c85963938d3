//! The scope's settings: those that are wanted, and those that it was told last.

use instruments::{
    scope::{Trigger, Vertical},
    units::{Seconds, Volts},
};

/// The scope's settings: those that are wanted, and those that it was told last.
pub(super) struct Screen {
    /// What the channels are to be set to.
    pub(super) verticals: [Option<Vertical>; 4],
    /// What they were last set to.
    pub(super) applied: [Option<Vertical>; 4],
    /// Level of the trigger; follows the signal.
    pub(super) trigger_v: Volts,
    /// Points that the memory was last set to.
    pub(super) memory_points: Option<u64>,
    /// When the scope was stopped last, s.
    pub(super) stopped_s: f64,
    /// Time per division and trigger that the scope was armed with last.
    pub(super) armed: Option<(Seconds, Trigger)>,
}

impl Default for Screen {
    fn default() -> Self {
        Self {
            verticals: [None; 4],
            applied: [None; 4],
            trigger_v: Volts(0.0),
            memory_points: None,
            stopped_s: 0.0,
            armed: None,
        }
    }
}
