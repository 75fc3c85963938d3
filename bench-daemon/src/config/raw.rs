//! Experiment and cell as they are typed: these structures mirror the TOML, and nothing else reads
//! them than `resolve` and `check`. The bench is in `raw_bench`.

use analysis::series::Role;
use serde::Deserialize;

use super::quantity::{
    Angle, Charge, Current, Duration, Frequency, Power, Quantity, Resistance, Share, Temperature,
    TemperatureDifference, Voltage, VoltageSlope,
};

/// An experiment: what is to be done with which cell on which bench.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Experiment {
    pub(super) name: String,
    pub(super) bench: String,
    pub(super) cell: String,
    #[serde(default)]
    pub(super) seed: u64,
    pub(super) temperature: Option<TemperatureSection>,
    pub(super) fixture_check: Option<FixtureCheck>,
    pub(super) soc_reset: Option<SocReset>,
    pub(super) ocv_soc: Option<super::raw_ocv_soc::Raw>,
    pub(super) eis: Option<Eis>,
    pub(super) multisine: Option<super::raw_multisine::Raw>,
    pub(super) campaign: Option<Campaign>,
    #[serde(default)]
    pub(super) traces: Vec<Trace>,
    #[serde(default)]
    pub(super) fit: Fit,
    pub(super) diagnosis: Option<Diagnosis>,
    pub(super) resume: Option<Resume>,
}

/// When a run goes on by itself.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Resume {
    pub(super) after: Quantity<Duration>,
    pub(super) most: usize,
    pub(super) passing: Option<usize>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TemperatureSection {
    pub(super) setpoint: Quantity<Temperature>,
    pub(super) within: Quantity<TemperatureDifference>,
    pub(super) timeout: Quantity<Duration>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FixtureCheck {
    pub(super) shunt: ControlTolerance,
    pub(super) fake_cell: Option<ControlTolerance>,
    pub(super) short: Option<ShortTolerance>,
    pub(super) corrected_tolerance: Quantity<Share>,
    /// Where the controls are looked at beyond the sweep.
    #[serde(default)]
    pub(super) beyond: Vec<Quantity<Frequency>>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ControlTolerance {
    pub(super) magnitude: Quantity<Share>,
    pub(super) phase: Quantity<Angle>,
}

/// A short has no magnitude to be a share of, and no phase.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ShortTolerance {
    pub(super) error: Quantity<Resistance>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SocReset {
    pub(super) discharge_current: Quantity<Current>,
    pub(super) discharge_until: Quantity<Voltage>,
    pub(super) charge_current: Quantity<Current>,
    pub(super) charge_voltage: Quantity<Voltage>,
    pub(super) charge_until: Quantity<Voltage>,
    pub(super) rest_min: Quantity<Duration>,
    pub(super) rest_max: Quantity<Duration>,
    pub(super) rest_slope: Quantity<VoltageSlope>,
    pub(super) max_duration: Quantity<Duration>,
    /// Where the voltage must come to rest.
    pub(super) rest_band: Option<[Quantity<Voltage>; 2]>,
    #[serde(default = "three")]
    pub(super) attempts: usize,
    #[serde(default = "flag")]
    pub(super) missed: crate::plan::Missed,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Eis {
    pub(super) start: Option<Quantity<Frequency>>,
    pub(super) stop: Option<Quantity<Frequency>>,
    pub(super) points: Option<usize>,
    #[serde(default = "yes")]
    pub(super) include_stop: bool,
    pub(super) amplitude: Quantity<Current>,
    #[serde(default = "eleven")]
    pub(super) periods: f64,
    pub(super) extra_wait: Quantity<Duration>,
    #[serde(default = "five")]
    pub(super) periods_on_screen: f64,
    #[serde(default = "ten_thousand")]
    pub(super) record_points: u64,
    #[serde(default = "million")]
    pub(super) memory_points: u64,
    #[serde(default)]
    pub(super) mains: Option<Quantity<Frequency>>,
    /// In the place of start, stop and points.
    pub(super) frequencies: Option<Vec<Quantity<Frequency>>>,
    #[serde(default)]
    pub(super) fixture: SweptFixture,
    #[serde(default = "one")]
    pub(super) repeat: usize,
    /// Before each sweep of the cell.
    pub(super) rest_first: Option<Quantity<Duration>>,
    #[serde(default)]
    pub(super) order: super::Order,
    /// Sweeps of each round, in the place of one at `amplitude`, which is the largest.
    pub(super) amplitude_steps: Option<Vec<Quantity<Current>>>,
    /// Each sweep there and back, and every point at the time in between.
    #[serde(default)]
    pub(super) compensate_drift: bool,
    /// The next point settles while the record of this one is fetched and analysed.
    pub(super) overlap: Option<bool>,
    pub(super) quality: Option<super::raw_quality::Raw>,
}

/// Fixture that the sweeps of `[eis]` measure.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum SweptFixture {
    #[default]
    Cell,
    Shunt,
}

/// Several cells, each measured several times.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Campaign {
    pub(super) repeats: usize,
    #[serde(default)]
    pub(super) order: CampaignOrder,
    pub(super) cells: Vec<CampaignCell>,
}

/// Which cell comes next.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum CampaignOrder {
    #[default]
    CellByCell,
    RoundRobin,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CampaignCell {
    pub(super) name: String,
    pub(super) serial: Option<String>,
}

/// A current that steps, and how it is recorded.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Trace {
    pub(super) name: String,
    #[serde(default)]
    pub(super) role: Role,
    pub(super) repeat_group: Option<String>,
    #[serde(default = "one")]
    pub(super) repeat: usize,
    pub(super) rest_first: Quantity<Duration>,
    /// Open-circuit voltages at which it may begin.
    pub(super) start_voltage: [Quantity<Voltage>; 2],
    /// Highest resistance of the cell, leads to the voltmeter included.
    pub(super) resistance_max: Quantity<Resistance>,
    pub(super) segments: Option<Vec<Segment>>,
    pub(super) pulses: Option<Pulses>,
    pub(super) file: Option<String>,
    /// Factor on every row: a pack's profile on one of its cells, for instance.
    pub(super) scale: Option<f64>,
    #[serde(default)]
    pub(super) through: Through,
    /// Resistance between the cell and the load's voltmeter where load and supply drive.
    pub(super) lead_resistance: Option<Quantity<Resistance>>,
    /// Rows are averaged over steps of this length.
    pub(super) step: Option<Quantity<Duration>>,
    #[serde(default = "two_milliseconds")]
    pub(super) first_sample: Quantity<Duration>,
    #[serde(default = "twelve")]
    pub(super) samples_per_decade: f64,
    #[serde(default = "ten_seconds")]
    pub(super) longest_interval: Quantity<Duration>,
}

/// Pulses of either sign, each with a relaxation behind it: first out of the cell, then into it,
/// amplitude by amplitude.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Pulses {
    pub(super) amplitudes: Vec<Quantity<Current>>,
    #[serde(default = "five_seconds")]
    pub(super) duration: Quantity<Duration>,
    pub(super) relaxation: Quantity<Duration>,
}

/// Instruments that play a trace.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Through {
    #[default]
    Bipolar,
    Wave,
    LoadAndSupply,
    /// The first of these that can.
    Auto,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Segment {
    /// Charge positive.
    pub(super) current: Option<Quantity<Current>>,
    /// In the place of a current.
    pub(super) power: Option<Quantity<Power>>,
    pub(super) duration: Quantity<Duration>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(super) struct Fit {
    pub(super) rc: Vec<usize>,
    pub(super) objective: String,
    /// Points that the quality gate has refused, too.
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
    pub(super) rc: Option<usize>,
}

fn five_seconds() -> Quantity<Duration> {
    Quantity::of(5.0)
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

/// A cell and what may be done to it.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Cell {
    pub(super) name: String,
    pub(super) capacity: Quantity<Charge>,
    pub(super) voltage_min: Quantity<Voltage>,
    pub(super) voltage_max: Quantity<Voltage>,
    pub(super) charge_current_max: Quantity<Current>,
    pub(super) discharge_current_max: Quantity<Current>,
    pub(super) temperature_min: Quantity<Temperature>,
    pub(super) temperature_max: Quantity<Temperature>,
    #[serde(default)]
    pub(super) interlock: super::interlock::Section,
    #[serde(default)]
    pub(super) absolute: super::limits::Section,
    pub(super) pack: Pack,
    pub(super) ocv: Option<Ocv>,
}

/// Knots of the open-circuit voltage over the state of charge.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Ocv {
    pub(super) soc: Vec<f64>,
    pub(super) voltage_v: Vec<f64>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Pack {
    pub(super) series: u32,
    pub(super) parallel: u32,
}
