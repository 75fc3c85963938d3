//! The bench file as it is typed: these structures mirror the TOML, and nothing else reads them
//! than `resolve_bench` and `simulation`.

use std::collections::BTreeMap;

use analysis::diagnosis::BenchHistory;
use serde::Deserialize;

use super::quantity::{
    Capacitance, Duration, Inductance, Quantity, Resistance, TemperatureDifference, Voltage,
};
use crate::mocks::{Fault, Value};

/// A bench: its instruments, its wiring, its controls, and the simulation behind it, if there is
/// one.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Bench {
    pub(super) name: String,
    pub(super) instruments: Instruments,
    pub(super) wiring: Wiring,
    #[serde(default)]
    pub(super) controls: Controls,
    pub(super) simulation: Option<Simulation>,
    pub(super) history: Option<BenchHistory>,
    /// Where the state of the bench is kept.
    pub(super) state_folder: Option<String>,
    #[serde(default)]
    pub(super) guardian: Guardian,
    #[serde(default)]
    pub(super) thermostat: Thermostat,
    #[serde(default)]
    pub(super) doctor: Doctor,
}

/// How the daemon holds a bath whose loop it closes.
#[derive(Debug, Deserialize, Default)]
#[serde(deny_unknown_fields, default)]
pub(super) struct Thermostat {
    pub(super) proportional_band: Option<Quantity<TemperatureDifference>>,
    pub(super) integral_time: Option<Quantity<Duration>>,
    pub(super) window: Option<Quantity<Duration>>,
    pub(super) stale: Option<Quantity<Duration>>,
    pub(super) sensor_offset: Option<Quantity<TemperatureDifference>>,
}

/// Requirement of a run on the last report of `eis-bench doctor`.
#[derive(Debug, Deserialize, Default)]
#[serde(deny_unknown_fields, default)]
pub(super) struct Doctor {
    pub(super) required: bool,
    pub(super) valid_for: Option<Quantity<Duration>>,
}

#[derive(Debug, Deserialize, Default)]
#[serde(deny_unknown_fields, default)]
pub(super) struct Guardian {
    pub(super) lease: Option<Quantity<Duration>>,
    pub(super) stall: Option<Quantity<Duration>>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Instruments {
    pub(super) supply4q: Option<Instrument>,
    pub(super) generator: Option<Instrument>,
    pub(super) scope: Option<Instrument>,
    pub(super) load: Option<Instrument>,
    pub(super) supply: Option<Instrument>,
    pub(super) chiller: Option<Instrument>,
    pub(super) logger: Option<Logger>,
    pub(super) jig: Option<Jig>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Instrument {
    pub(super) model: String,
    pub(super) address: String,
    /// Text in the identity of another model that is accepted as this one.
    pub(super) accept: Option<String>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Logger {
    pub(super) model: String,
    pub(super) address: String,
    pub(super) accept: Option<String>,
    pub(super) cell_channel: u16,
    pub(super) ambient_channel: Option<u16>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Jig {
    pub(super) model: String,
    pub(super) address: Option<String>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Wiring {
    pub(super) generator_channel: u8,
    pub(super) command_trim: f64,
    pub(super) command_offset: Quantity<Voltage>,
    pub(super) bursts: Option<bool>,
    pub(super) shunt: Known,
    /// Vertical scale of channels 1…4 for one ampere of amplitude.
    pub(super) scale_per_ampere: [Quantity<Voltage>; 4],
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Known {
    pub(super) resistance: Quantity<Resistance>,
    pub(super) resistance_sigma: Quantity<Resistance>,
    pub(super) inductance: Quantity<Inductance>,
    pub(super) inductance_sigma: Quantity<Inductance>,
}

#[derive(Debug, Deserialize, Default)]
#[serde(deny_unknown_fields, default)]
pub(super) struct Controls {
    pub(super) fake_cell: Option<Known>,
    pub(super) short: Option<Known>,
    pub(super) open: Option<Open>,
}

/// Bounds of a meter's reading of the empty jig.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Open {
    pub(super) resistance_min: Quantity<Resistance>,
    pub(super) capacitance_max: Quantity<Capacitance>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Simulation {
    pub(super) scenario: String,
    pub(super) time: Option<String>,
    pub(super) faults: Option<Faults>,
    /// Quirks of the mocks, by role.
    #[serde(default)]
    pub(super) quirks: BTreeMap<String, BTreeMap<String, Value>>,
}

/// Faults between the simulated instruments and their client.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Faults {
    pub(super) seed: u64,
    pub(super) per_message: f64,
    pub(super) most: usize,
    pub(super) kinds: Option<Vec<Fault>>,
    pub(super) role: Option<String>,
    pub(super) from: Option<Quantity<Duration>>,
    /// Which of the things that another client does to a model, from 0.
    pub(super) variant: Option<usize>,
}
