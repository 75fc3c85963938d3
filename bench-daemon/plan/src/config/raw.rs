//! Experiment and cell as they are typed: these structures mirror the TOML, and nothing else reads
//! them than `resolve` and `check`. The bench is in `raw_bench`.

use analysis_signal::series::Role;
use serde::Deserialize;

pub(super) use super::raw_pulses::{Pulses, Through};

use super::quantity::{
    Angle, Charge, Current, Duration, Frequency, Power, Quantity, Resistance, Share, Temperature,
    TemperatureDifference, Voltage, VoltageSlope,
};

/// An experiment: which measurements to make, with which cell, on which bench.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Experiment {
    /// Name of the experiment: letters, digits, `-` and `_`.
    pub(super) name: String,
    /// Path of the bench file, from the folder of this file.
    pub(super) bench: String,
    /// Path of the cell file, from the folder of this file.
    pub(super) cell: String,
    /// Seed of all random numbers: simulated errors, random orders, phases of a multisine.
    #[serde(default)]
    pub(super) seed: u64,
    /// Temperature to wait for. Left out: the run neither sets nor waits for a temperature.
    pub(super) temperature: Option<TemperatureSection>,
    /// Check of the controls before the cell is measured; it needs `[eis]`. Left out: no control is
    /// measured.
    pub(super) fixture_check: Option<FixtureCheck>,
    /// Reset of the state of charge before the measurements. Left out: the state of charge is not
    /// changed.
    pub(super) soc_reset: Option<SocReset>,
    /// Measurement of the open-circuit voltage over the state of charge. Left out: it is not
    /// measured.
    pub(super) ocv_soc: Option<super::raw_ocv_soc::Raw>,
    /// Sweeps, frequency by frequency. Left out: no sweep.
    pub(super) eis: Option<Eis>,
    /// Records of many frequencies at once. Left out: none.
    pub(super) multisine: Option<super::raw_multisine::Raw>,
    /// The individual cell that is measured; refused beside `[campaign]`. Left out: any cell of the
    /// kind of the cell file.
    pub(super) specimen: Option<super::identity::RawSpecimen>,
    /// Points of charge and temperature, at each of which the signals are measured; refused beside
    /// `[soc_reset]`, `[ocv_soc]`, `[campaign]`, `[[traces]]` and `[diagnosis]`. Left out: no map.
    pub(super) map: Option<super::raw_map::Raw>,
    /// Several cells, each measured several times; refused beside `[ocv_soc]` and `[multisine]`.
    /// Left out: one cell.
    pub(super) campaign: Option<Campaign>,
    /// Stepwise currents and their records; names must differ. Left out: none.
    #[serde(default)]
    pub(super) traces: Vec<Trace>,
    /// Fits of the extended Randles model.
    #[serde(default)]
    pub(super) fit: Fit,
    /// Diagnosis at the end of the run; it needs a sweep of the cell and `[ocv]` in the cell file.
    /// Left out: none.
    pub(super) diagnosis: Option<Diagnosis>,
    /// Rules for automatic continuation of an interrupted run. Left out: it continues only after
    /// faults of the wire, at most five times.
    pub(super) resume: Option<Resume>,
}

/// Rules for automatic continuation of an interrupted run. A trip of the interlock always ends the
/// run.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Resume {
    /// Pause before the run continues after a fault other than one of the wire, 5 s to 86 400 s.
    pub(super) after: Quantity<Duration>,
    /// Largest number of continuations after such faults, 0 to 20.
    pub(super) most: usize,
    /// Largest number of continuations after faults of the wire, 0 to 100. Left out: 5.
    pub(super) passing: Option<usize>,
}

/// Temperature of the cell; the bench needs a chiller and a logger.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TemperatureSection {
    /// Set-point, within the range of the chiller and the limits of the cell.
    pub(super) setpoint: Quantity<Temperature>,
    /// Largest accepted deviation of the cell, 0.01 K to 5 K.
    pub(super) within: Quantity<TemperatureDifference>,
    /// Longest wait for the temperature, 1 s to 86 400 s.
    pub(super) timeout: Quantity<Duration>,
}

/// Check of the bench with controls; the bench needs a jig.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FixtureCheck {
    /// Tolerance of the current shunt as read.
    pub(super) shunt: ControlTolerance,
    /// Tolerance of the fake cell as read; the bench file must have `[controls.fake_cell]`. Left
    /// out: it is not measured.
    pub(super) fake_cell: Option<ControlTolerance>,
    /// Tolerance of the short as read; the bench file must have `[controls.short]`. Left out: it is
    /// not measured.
    pub(super) short: Option<ShortTolerance>,
    /// Largest deviation of a control after the correction, 0.01 % to 10 %.
    pub(super) corrected_tolerance: Quantity<Share>,
    /// Further frequencies at which controls are measured, above the last of the sweep. The bipolar
    /// supply must follow them, and nothing is judged by them. Left out: none.
    #[serde(default)]
    pub(super) beyond: Vec<Quantity<Frequency>>,
}

/// Largest deviation of a control from its known impedance.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ControlTolerance {
    /// Largest deviation of the magnitude, 0.01 % to 50 %.
    pub(super) magnitude: Quantity<Share>,
    /// Largest deviation of the phase, 0.01 ° to 45 °.
    pub(super) phase: Quantity<Angle>,
}

/// Largest deviation of a short, which has neither a magnitude for a relative tolerance nor a
/// phase.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ShortTolerance {
    /// Largest deviation in any direction, 0.1 µΩ to 100 mΩ.
    pub(super) error: Quantity<Resistance>,
}

/// Reset of the state of charge: discharge, charge, rest. The bench needs a load and a supply.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SocReset {
    /// Current of the discharge, positive, from 0.01 A to the limit of the cell and the load.
    pub(super) discharge_current: Quantity<Current>,
    /// Voltage under load at which the discharge ends: at least 50 mV above the lower limit of the
    /// cell, and below `charge_until`.
    pub(super) discharge_until: Quantity<Voltage>,
    /// Current of the charge, from 0.01 A to the limit of the cell and the supply.
    pub(super) charge_current: Quantity<Current>,
    /// Voltage limit of the supply while charging, within the limits of the cell.
    pub(super) charge_voltage: Quantity<Voltage>,
    /// Voltage at which the charge ends, at least 20 mV below `charge_voltage`.
    pub(super) charge_until: Quantity<Voltage>,
    /// Shortest rest, 1 s to 86 400 s.
    pub(super) rest_min: Quantity<Duration>,
    /// Longest rest, from `rest_min` to 86 400 s.
    pub(super) rest_max: Quantity<Duration>,
    /// Slope of the voltage below which the rest ends, 1 nV/s to 10 mV/s.
    pub(super) rest_slope: Quantity<VoltageSlope>,
    /// Longest discharge and longest charge, 1 s to 172 800 s.
    pub(super) max_duration: Quantity<Duration>,
    /// Lowest and highest accepted voltage after the rest, between `discharge_until` and
    /// `charge_until`. Left out: every voltage is accepted.
    pub(super) rest_band: Option<[Quantity<Voltage>; 2]>,
    /// Largest number of resets until the voltage lies in `rest_band`, 1 to 20.
    #[serde(default = "three")]
    pub(super) attempts: usize,
    /// Treatment of a cell that misses `rest_band` to the end.
    #[serde(default = "flag")]
    pub(super) missed: crate::plan::Missed,
}

/// Sweeps; the bench needs a bipolar supply, a generator and a scope.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Eis {
    /// Lowest frequency, from what the generator can set, 1 mHz at least. Left out: `frequencies`
    /// must be given.
    pub(super) start: Option<Quantity<Frequency>>,
    /// Highest frequency, up to what the supply follows, 10 kHz at most. Left out: `frequencies`
    /// must be given.
    pub(super) stop: Option<Quantity<Frequency>>,
    /// Number of frequencies on a logarithmic grid, 2 to 1000. Left out: `frequencies` must be
    /// given.
    pub(super) points: Option<usize>,
    /// Whether `stop` is the last point of the grid; otherwise the grid ends one step before it.
    #[serde(default = "yes")]
    pub(super) include_stop: bool,
    /// Amplitude of the current, from 0.01 A to the smallest limit of supply and cell. Half a
    /// period may move 2 % of the capacity at most.
    pub(super) amplitude: Quantity<Current>,
    /// Smallest number of periods waited after each change of frequency, 2 to 10 000.
    #[serde(default = "eleven")]
    pub(super) periods: f64,
    /// Wait on top of these periods, 0 s to 3600 s.
    pub(super) extra_wait: Quantity<Duration>,
    /// Smallest number of periods in a record, 2 to 1000.
    #[serde(default = "five")]
    pub(super) periods_on_screen: f64,
    /// Points of a record downloaded per channel, up to `memory_points`. The least is 20 times
    /// `periods_on_screen`.
    #[serde(default = "ten_thousand")]
    pub(super) record_points: u64,
    /// Points in the memory of the scope per channel, 1000 to 10 000 000.
    #[serde(default = "million")]
    pub(super) memory_points: u64,
    /// Frequency of the mains, 10 Hz to 1000 Hz, whose pick-up is fitted beside the sinusoid. Left
    /// out: none is fitted.
    #[serde(default)]
    pub(super) mains: Option<Quantity<Frequency>>,
    /// List of 2 to 1000 frequencies instead of `start`, `stop` and `points`. Left out: these must
    /// be given.
    pub(super) frequencies: Option<Vec<Quantity<Frequency>>>,
    /// Fixture that is swept; `shunt` needs a jig.
    #[serde(default)]
    pub(super) fixture: SweptFixture,
    /// Number of sweeps, 0 to 1000; with 0 only the controls are measured.
    #[serde(default = "one")]
    pub(super) repeat: usize,
    /// Rest of the cell before each sweep, 0 s to 86 400 s. Left out: no rest.
    pub(super) rest_first: Option<Quantity<Duration>>,
    /// Order in which the frequencies are measured.
    #[serde(default)]
    pub(super) order: super::Order,
    /// Amplitudes of the sweeps of each round, all different, from 0.01 A to `amplitude`. Left out:
    /// one sweep at `amplitude`.
    pub(super) amplitude_steps: Option<Vec<Quantity<Current>>>,
    /// Whether each sweep runs in both directions, so that every point counts at the mean time.
    #[serde(default)]
    pub(super) compensate_drift: bool,
    /// Whether the next point settles while the record of this one is fetched and analysed. Left
    /// out: in real time only.
    pub(super) overlap: Option<bool>,
    /// Quality gate that every point must pass. Left out: no point is judged.
    pub(super) quality: Option<super::raw_quality::Raw>,
    /// Direct currents under the sinusoids, all different, positive for a charge: 0 A, or from 0.1 A
    /// to the limits of cell, supply and generator minus `amplitude`. Each round has a sweep at each,
    /// that at 0 A first, and every second round is reversed. Left out: no direct current.
    pub(super) bias: Option<Vec<Quantity<Current>>>,
    /// Largest charge that a direct current may move, as a share of the capacity, 0.1 % to 20 %; then
    /// it is brought back. Left out: 5 %.
    pub(super) bias_charge: Option<Quantity<Share>>,
    /// Highest resistance of the cell, leads to the voltmeter included, 0.1 mΩ to 1 Ω. It bounds
    /// voltage and heat under a direct current. Left out: `bias` may only be 0 A.
    pub(super) resistance_max: Option<Quantity<Resistance>>,
    /// Wait at a direct current before the first point, 5 s to 3600 s. Left out: 30 s.
    pub(super) bias_settle: Option<Quantity<Duration>>,
}

/// Fixture that the sweeps of `[eis]` measure.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum SweptFixture {
    /// The cell.
    #[default]
    Cell,
    /// The current shunt.
    Shunt,
}

/// Several cells, each measured several times.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Campaign {
    /// Number of runs of each cell, 1 to 1000.
    pub(super) repeats: usize,
    /// Order of the runs.
    #[serde(default)]
    pub(super) order: CampaignOrder,
    /// The cells, 1 to 32; more than one needs a jig. A simulated bench has as many as its scenario
    /// says.
    pub(super) cells: Vec<CampaignCell>,
}

/// Order of the runs of a campaign.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum CampaignOrder {
    /// Each cell `repeats` times in a row, then the next one.
    #[default]
    CellByCell,
    /// Every cell once, then every cell again.
    RoundRobin,
}

/// A cell of a campaign.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CampaignCell {
    /// Name of the cell: letters, digits and `-`. Names must differ in more than upper and lower
    /// case.
    pub(super) name: String,
    /// Serial number; those of a campaign must differ. Left out: not known.
    pub(super) serial: Option<String>,
    /// Batch or lot that it was made in. Left out: that of the cell file.
    pub(super) batch: Option<String>,
    /// Barcode on the cell, as a scanner reads it. Left out: none is known.
    pub(super) barcode: Option<String>,
}

/// A stepwise current and its record. Exactly one of `segments`, `pulses` and `file` is given.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Trace {
    /// Name of the trace: letters, digits, `-` and `_`. Its files have this name.
    pub(super) name: String,
    /// Purpose of the record in fits and in the diagnosis.
    #[serde(default)]
    pub(super) role: Role,
    /// Name of the group of traces that are repeats of each other. Left out: `name`.
    pub(super) repeat_group: Option<String>,
    /// Number of executions of the trace, 1 to 1000; beside `[campaign]` it must be 1.
    #[serde(default = "one")]
    pub(super) repeat: usize,
    /// Rest before the trace with nothing connected, 0 s to 86 400 s.
    pub(super) rest_first: Quantity<Duration>,
    /// Lowest and highest open-circuit voltage at which the trace may start, within the limits of
    /// the cell.
    pub(super) start_voltage: [Quantity<Voltage>; 2],
    /// Highest resistance of the cell, leads to the voltmeter included, 0.1 mΩ to 1 Ω.
    pub(super) resistance_max: Quantity<Resistance>,
    /// Steps of current or power, typed one by one. Left out: `pulses` or `file` must be given.
    pub(super) segments: Option<Vec<Segment>>,
    /// Pulses of either sign instead of typed steps. Left out: `segments` or `file` must be given.
    pub(super) pulses: Option<Pulses>,
    /// Path of a file of steps or of a profile over time, from the folder of this file. Left out:
    /// `segments` or `pulses` must be given.
    pub(super) file: Option<String>,
    /// Factor on every row, −1000 to 1000 and not 0, for example to scale a pack's profile to one
    /// cell. Left out: 1.
    pub(super) scale: Option<f64>,
    /// Direct current that is added to every row, positive for a charge; the rows must be currents. Left
    /// out: 0 A.
    pub(super) bias: Option<Quantity<Current>>,
    /// Instruments that drive the trace.
    #[serde(default)]
    pub(super) through: Through,
    /// Resistance between the cell and the voltmeter of the load if load and supply drive the
    /// trace, 0 Ω to 0.1 Ω. Left out: 0 Ω.
    pub(super) lead_resistance: Option<Quantity<Resistance>>,
    /// Length of the steps over which rows are averaged, 1 ms to 3600 s, at most that of the trace.
    /// Left out: rows stay as they are.
    pub(super) step: Option<Quantity<Duration>>,
    /// Delay and length of the first mean after a step, 0.2 ms to 1 s.
    #[serde(default = "two_milliseconds")]
    pub(super) first_sample: Quantity<Duration>,
    /// Number of means per decade of the time since a step, 2 to 100.
    #[serde(default = "twelve")]
    pub(super) samples_per_decade: f64,
    /// Longest time between two rows of the record, 1 s to 3600 s.
    #[serde(default = "ten_seconds")]
    pub(super) longest_interval: Quantity<Duration>,
}

/// A current or a power for a duration: one of the two is given.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Segment {
    /// Current, positive for a charge. Left out: `power` must be given.
    pub(super) current: Option<Quantity<Current>>,
    /// Power instead of a current, positive for a charge. Left out: `current` must be given.
    pub(super) power: Option<Quantity<Power>>,
    /// Duration, above 0 s.
    pub(super) duration: Quantity<Duration>,
}

/// The fits of a run.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(super) struct Fit {
    /// Numbers of RC branches of the models, 1 to 8 and all different. Each model has 2·rc + 1
    /// parameters; the sweep must have at least as many points.
    pub(super) rc: Vec<usize>,
    /// Objective that is minimised: `complex`, `modulus` or `sum-abs`.
    pub(super) objective: String,
    /// Whether points that the quality gate has refused are also fitted.
    pub(super) refused_points: bool,
}

impl Default for Fit {
    fn default() -> Self {
        Self {
            rc: vec![1, 2, 3, 4],
            objective: "complex".to_owned(),
            refused_points: false,
        }
    }
}

/// The diagnosis at the end of a run.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Diagnosis {
    /// Number of RC branches of the model to diagnose, one of `fit.rc`. Left out: the highest of
    /// them.
    pub(super) rc: Option<usize>,
}

fn three() -> usize {
    3
}
fn flag() -> crate::plan::Missed {
    crate::plan::Missed::Flag
}
fn yes() -> bool {
    true
}
fn one() -> usize {
    1
}
fn two_milliseconds() -> Quantity<Duration> {
    Quantity::of(2.0e-3)
}
fn twelve() -> f64 {
    12.0
}
fn ten_seconds() -> Quantity<Duration> {
    Quantity::of(10.0)
}
fn eleven() -> f64 {
    11.0
}
fn five() -> f64 {
    5.0
}
fn ten_thousand() -> u64 {
    10_000
}
fn million() -> u64 {
    1_000_000
}

/// A cell and its limits.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Cell {
    /// Name of the cell.
    pub(super) name: String,
    /// Capacity, above 0 Ah.
    pub(super) capacity: Quantity<Charge>,
    /// Lowest voltage, above 0 V. The interlock trips below it.
    pub(super) voltage_min: Quantity<Voltage>,
    /// Highest voltage, above `voltage_min` and 5 V at most. The interlock trips above it.
    pub(super) voltage_max: Quantity<Voltage>,
    /// Highest charging current, above 0 A. The interlock trips above it.
    pub(super) charge_current_max: Quantity<Current>,
    /// Highest discharging current, positive. The interlock trips above it.
    pub(super) discharge_current_max: Quantity<Current>,
    /// Lowest temperature of the surface. The interlock trips below it.
    pub(super) temperature_min: Quantity<Temperature>,
    /// Highest temperature of the surface, above `temperature_min`. The interlock trips above it.
    pub(super) temperature_max: Quantity<Temperature>,
    /// Identity of the cell, or of its kind.
    #[serde(default)]
    pub(super) identity: super::identity::Identity,
    /// Limits of the interlock in addition to those of the cell.
    #[serde(default)]
    pub(super) interlock: super::interlock::Section,
    /// Limits of the maker, which no limit of this file may exceed. Left out: none is checked.
    #[serde(default)]
    pub(super) absolute: super::limits::Section,
    /// Pack to which the model of the cell is mapped.
    pub(super) pack: Pack,
    /// Known open-circuit voltage over the state of charge. Left out: a diagnosis inside a run is
    /// refused.
    pub(super) ocv: Option<Ocv>,
}

/// Knots of the open-circuit voltage over the state of charge.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Ocv {
    /// States of charge, two or more, rising, 0 to 1.
    pub(super) soc: Vec<f64>,
    /// Open-circuit voltage at each state of charge, V; it must not fall.
    pub(super) voltage_v: Vec<f64>,
}

/// Cells of a pack.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Pack {
    /// Number of cells in series, 1 or more.
    pub(super) series: u32,
    /// Number of cells in parallel, 1 or more.
    pub(super) parallel: u32,
}
