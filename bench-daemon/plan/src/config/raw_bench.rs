//! The bench file as it is typed: these structures mirror the TOML, and nothing else reads them
//! than `resolve_bench` and `simulation`.

use std::collections::BTreeMap;

use analysis_signal::history::BenchHistory;
use serde::Deserialize;

use super::quantity::{
    Capacitance, Current, Duration, Frequency, Inductance, Quantity, Resistance,
    TemperatureDifference, Transconductance, Voltage,
};
use crate::mocks::{Fault, Value};

/// A bench: its instruments, its wiring, its controls, and optionally the simulation behind it.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Bench {
    /// Name of the bench. A server accepts only letters, digits, `-` and `_`.
    pub(super) name: String,
    /// Instruments by their roles.
    pub(super) instruments: Instruments,
    /// Wiring between generator, supply, shunt and scope.
    pub(super) wiring: Wiring,
    /// Known impedances that are measured as controls. Left out: only the shunt.
    #[serde(default)]
    pub(super) controls: Controls,
    /// Simulation behind the instruments. Left out: the instruments are real.
    pub(super) simulation: Option<Simulation>,
    /// Errors of the bench from its own past, for the diagnosis. Left out: they are assumed.
    pub(super) history: Option<BenchHistory>,
    /// Folder of the state of the bench (lock, latch, report of the doctor). Left out:
    /// `.eis-bench/NAME` beside this file.
    pub(super) state_folder: Option<String>,
    /// Time limits of the guardian.
    #[serde(default)]
    pub(super) guardian: Guardian,
    /// Control of a bath with relays.
    #[serde(default)]
    pub(super) thermostat: Thermostat,
    /// Requirement of a run on the last report of `eis-bench doctor`. Left out: none is required.
    #[serde(default)]
    pub(super) doctor: Doctor,
}

/// Control loop of a bath with relays. Only a chiller of model `relay-thermostat` uses it.
#[derive(Debug, Deserialize, Default)]
#[serde(deny_unknown_fields, default)]
pub(super) struct Thermostat {
    /// Distance from the set-point at which a relay is always on, 0.05 K to 20 K. Left out: 0.5 K.
    pub(super) proportional_band: Option<Quantity<TemperatureDifference>>,
    /// Integral time of the loop, 10 s to 100 000 s. Left out: 400 s.
    pub(super) integral_time: Option<Quantity<Duration>>,
    /// Length of the window in which a relay is switched once, 5 s to 45 s. Left out: 20 s.
    pub(super) window: Option<Quantity<Duration>>,
    /// Longest time without a plausible reading, from `window` to 600 s; then the run ends. Left
    /// out: 60 s.
    pub(super) stale: Option<Quantity<Duration>>,
    /// Excess of the reading of the sensor over the true temperature, −5 K to 5 K. Left out: 0 K.
    pub(super) sensor_offset: Option<Quantity<TemperatureDifference>>,
}

/// Requirement of a run on the last report of `eis-bench doctor`.
#[derive(Debug, Deserialize, Default)]
#[serde(deny_unknown_fields, default)]
pub(super) struct Doctor {
    /// Whether a run needs a report that passed; without one nothing is energised.
    pub(super) required: bool,
    /// Age up to which a report counts, above 0 s. Left out: 90 d.
    pub(super) valid_for: Option<Quantity<Duration>>,
}

/// Time limits of the guardian, which switches the bench off if the daemon cannot.
#[derive(Debug, Deserialize, Default)]
#[serde(deny_unknown_fields, default)]
pub(super) struct Guardian {
    /// Longest silence of the daemon, 1 s to 600 s; then the guardian ends the daemon and switches
    /// the bench off. Left out: 5 s.
    pub(super) lease: Option<Quantity<Duration>>,
    /// Longest computation of the daemon between two waits, 1 s to 600 s; after it the daemon
    /// counts as hung. Left out: 20 s.
    pub(super) stall: Option<Quantity<Duration>>,
}

/// Instruments of a bench by their roles. Each section of the experiment states the roles it needs.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Instruments {
    /// Bipolar supply, which drives sweeps, multisines, pulses and waves. Left out: the bench has
    /// none.
    pub(super) supply4q: Option<Supply4q>,
    /// Function generator, which commands the bipolar supply. Left out: the bench has none.
    pub(super) generator: Option<Instrument>,
    /// Scope with four channels, on shunt and cell. Left out: the bench has none.
    pub(super) scope: Option<Instrument>,
    /// DC load, which discharges the cell and measures its voltage. Left out: the bench has none.
    pub(super) load: Option<Load>,
    /// DC supply, which charges the cell. Left out: the bench has none.
    pub(super) supply: Option<Instrument>,
    /// Chiller, which holds the temperature. Left out: the bench has none.
    pub(super) chiller: Option<Instrument>,
    /// Logger of temperatures. Left out: the bench has none.
    pub(super) logger: Option<Logger>,
    /// Jig, in which the fixture is changed. Left out: the bench has none.
    pub(super) jig: Option<Jig>,
}

/// Bipolar supply with a link, or an analog one, which the generator alone commands.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Supply4q {
    /// Model as `eis-bench identify` names it, or `analog`: a supply without a link, which the
    /// program cannot switch, limit or read.
    pub(super) model: String,
    /// Address, such as `tcp://192.0.2.20:5025`; no two instruments share one. Left out: the model
    /// is `analog`.
    pub(super) address: Option<String>,
    /// Text in the identity of another model that is accepted as this one. Left out: the identity
    /// must be that of the model.
    pub(super) accept: Option<String>,
    /// Longest usual time to the answer to a question, 0.05 s to 5 s, on which the watch relies.
    /// Left out: 0.3 s.
    pub(super) answer: Option<Quantity<Duration>>,
    /// Volts, amperes and option of a Kepco BOP, such as `36-12M` or `20-50MG`. Left out: 20 A.
    pub(super) rating: Option<String>,
    /// Current per volt at the input of an `analog` supply, such as `-2 A/V`, 0.01 A/V to 100 A/V;
    /// negative if a positive voltage discharges the cell. Left out: the model is not `analog`.
    pub(super) gain: Option<Quantity<Transconductance>>,
    /// Rated current of an `analog` supply, above 0 A, at most 400 A. Left out: the model is not
    /// `analog`.
    pub(super) full_scale: Option<Quantity<Current>>,
    /// Frequency up to which an `analog` supply follows its input within a few per cent, 1 Hz to
    /// 100 kHz. Left out: 300 Hz.
    pub(super) max_frequency: Option<Quantity<Frequency>>,
}

/// Model and address of an instrument.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Instrument {
    /// Model as `eis-bench identify` names it.
    pub(super) model: String,
    /// Address, such as `tcp://192.0.2.20:5025`; no two instruments share one.
    pub(super) address: String,
    /// Text in the identity of another model that is accepted as this one. Left out: the identity
    /// must be that of the model.
    pub(super) accept: Option<String>,
    /// Longest usual time to the answer to a question, 0.05 s to 5 s, on which the watch relies.
    /// Left out: 0.3 s.
    pub(super) answer: Option<Quantity<Duration>>,
}

/// DC load, and where it measures the voltage.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Load {
    /// Model as `eis-bench identify` names it.
    pub(super) model: String,
    /// Address, such as `tcp://192.0.2.20:5025`; no two instruments share one.
    pub(super) address: String,
    /// Text in the identity of another model that is accepted as this one. Left out: the identity
    /// must be that of the model.
    pub(super) accept: Option<String>,
    /// Longest usual time to the answer to a question, 0.05 s to 5 s, on which the watch relies.
    /// Left out: 0.3 s.
    pub(super) answer: Option<Quantity<Duration>>,
    /// Whether it measures the voltage at its sense terminals, which must then be connected to the
    /// cell, or at its input, with the drop of its leads. Left out: it stays as it is.
    pub(super) remote_sense: Option<bool>,
}

/// Logger of temperatures and its channels.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Logger {
    /// Model as `eis-bench identify` names it.
    pub(super) model: String,
    /// Address, such as `tcp://192.0.2.20:5025`; no two instruments share one.
    pub(super) address: String,
    /// Text in the identity of another model that is accepted as this one. Left out: the identity
    /// must be that of the model.
    pub(super) accept: Option<String>,
    /// Channel of the thermometer on the cell; one input is channel 1.
    pub(super) cell_channel: u16,
    /// Channel of the thermometer in the air, not that of the cell. Left out: none.
    pub(super) ambient_channel: Option<u16>,
}

/// Jig: a person, or a device.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Jig {
    /// `person`, who changes the fixture and confirms it, or `mock-jig`.
    pub(super) model: String,
    /// Address of a jig that is a device. Left out: the jig is a person.
    pub(super) address: Option<String>,
}

/// Wiring of a bench.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Wiring {
    /// Channel of the generator that commands the bipolar supply, 1 or 2.
    pub(super) generator_channel: u8,
    /// Factor on the commanded amplitude that corrects the gain of the supply, 0.1 to 10.
    pub(super) command_trim: f64,
    /// Voltage at the input of the supply that cancels its zero error, −0.5 V to 0.5 V.
    pub(super) command_offset: Quantity<Voltage>,
    /// Whether the generator can play bursts that end by themselves. Left out: true.
    pub(super) bursts: Option<bool>,
    /// Impedance of the current shunt, which is also the first control.
    pub(super) shunt: Known,
    /// Vertical scale of channels 1 to 4 for one ampere of amplitude, each above 0 V.
    pub(super) scale_per_ampere: [Quantity<Voltage>; 4],
}

/// Impedance that was measured separately, with its standard uncertainty.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Known {
    /// Resistance, above 0 Ω and below 1 Ω.
    pub(super) resistance: Quantity<Resistance>,
    /// Standard uncertainty of the resistance, above 0 Ω and below the resistance.
    pub(super) resistance_sigma: Quantity<Resistance>,
    /// Inductance, 0 H or more.
    pub(super) inductance: Quantity<Inductance>,
    /// Standard uncertainty of the inductance, 0 H or more.
    pub(super) inductance_sigma: Quantity<Inductance>,
}

/// Known impedances in the jig.
#[derive(Debug, Deserialize, Default)]
#[serde(deny_unknown_fields, default)]
pub(super) struct Controls {
    /// Impedance of the fake cell. Left out: it cannot be a control.
    pub(super) fake_cell: Option<Known>,
    /// Impedance of the short. Left out: it cannot be a control.
    pub(super) short: Option<Known>,
    /// Bounds of the empty jig. Left out: the stray admittance is ignored.
    pub(super) open: Option<Open>,
}

/// Bounds of a meter's reading of the empty jig.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Open {
    /// Lowest resistance of the empty jig, above 0 Ω.
    pub(super) resistance_min: Quantity<Resistance>,
    /// Highest capacitance of the empty jig, 0 F or more.
    pub(super) capacitance_max: Quantity<Capacitance>,
}

/// Simulation of a bench.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Simulation {
    /// Path of the scenario file, from the folder of this file.
    pub(super) scenario: String,
    /// `real`, `virtual`, or `scaled:FACTOR` with a factor from 0.01 to 1000. Left out: `virtual`
    /// where all addresses are `memory:`, else `real`.
    pub(super) time: Option<String>,
    /// Faults between the instruments and their client. Left out: none.
    pub(super) faults: Option<Faults>,
    /// Quirks of the mocks, by role and name. Left out: none.
    #[serde(default)]
    pub(super) quirks: BTreeMap<String, BTreeMap<String, Value>>,
}

/// Faults between the simulated instruments and their client.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Faults {
    /// Seed of the faults.
    pub(super) seed: u64,
    /// Chance of a fault with each message, 0 to 1.
    pub(super) per_message: f64,
    /// Largest number of faults on one instrument.
    pub(super) most: usize,
    /// Possible faults. Left out: those of the wire and of the day, `lose_message` to `output_off`.
    pub(super) kinds: Option<Vec<Fault>>,
    /// Role of the only instrument that has faults. Left out: all instruments.
    pub(super) role: Option<String>,
    /// Bench time before which no fault happens. Left out: 0 s.
    pub(super) from: Option<Quantity<Duration>>,
    /// Number, from 0, of the change that `second_client` makes to an instrument. Left out: a
    /// random one.
    pub(super) variant: Option<usize>,
}
