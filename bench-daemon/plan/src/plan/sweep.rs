//! Settings of a sweep as data: those that its points share.

use instruments::units::{Amps, Hertz};

use crate::measure::quality::Quality;

/// Greatest current of the bipolar supply with its command at zero, A: a larger one is a zero
/// error that must be trimmed.
pub const IDLE_CURRENT_A: Amps = Amps(0.2);

/// Settings that all points of the sweeps of a run share.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SweepSettings {
    /// Greatest amplitude of the currents of the run's sweeps, A: it determines the scope's first
    /// ranges.
    pub amplitude_a: Amps,
    /// Least number of periods on the screen.
    pub periods_on_screen: f64,
    /// Points per channel that are downloaded.
    pub record_points: u64,
    /// Frequency of the mains that is fitted beside the sinusoid, Hz.
    pub mains_hz: Option<Hertz>,
    /// Whether points overlap, if configured.
    pub overlap: Option<bool>,
    /// The quality gate.
    pub quality: Option<Quality>,
}

/// Points per channel of a scope's record.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Depth {
    /// Points in the scope's memory.
    pub memory_points: u64,
    /// Points that are downloaded.
    pub record_points: u64,
}

#[cfg(test)]
/// Settings of a sweep for tests.
pub fn test_settings() -> std::sync::Arc<SweepSettings> {
    std::sync::Arc::new(SweepSettings {
        amplitude_a: Amps(1.0),
        periods_on_screen: 5.0,
        record_points: 10_000,
        mains_hz: None,
        overlap: None,
        quality: None,
    })
}
