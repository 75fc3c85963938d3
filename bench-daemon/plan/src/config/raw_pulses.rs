//! Pulses as they are typed, and the instruments that drive them.

use serde::Deserialize;

use super::quantity::{Current, Duration, Quantity};

/// Pulses of either sign, each followed by a relaxation: first discharge, then charge, amplitude by
/// amplitude.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Pulses {
    /// Amplitudes of the pulses, 1 mA to 1000 A, in order.
    pub(super) amplitudes: Vec<Quantity<Current>>,
    /// Duration of each pulse, above 0 s.
    #[serde(default = "five_seconds")]
    pub(super) duration: Quantity<Duration>,
    /// Rest after each pulse, above 0 s.
    pub(super) relaxation: Quantity<Duration>,
}

/// Instruments that drive a trace.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Through {
    /// The bipolar supply, one message for each step of 0.5 s or longer.
    #[default]
    Bipolar,
    /// The bipolar supply, which follows a wave in the memory of the generator.
    Wave,
    /// The DC load and the DC supply, for steps of 1 s or longer.
    LoadAndSupply,
    /// The first of these that can drive the trace.
    Auto,
}

fn five_seconds() -> Quantity<Duration> {
    Quantity::of(5.0)
}
