//! Present state of a bench, as the API shows it.

use std::ops::RangeInclusive;

use super::queue::HeldBy;
use analysis::run_folder::{Between, EnvelopeRow};
use bench_core::{
    bench::{Output, outputs::OutputsState},
    safety::state::Latched,
};
use bench_plan::interlock::{CURRENT_MARGIN, Limits};
use serde::Serialize;
use utoipa::ToSchema;

/// Current state of a bench.
#[derive(Debug, Clone, Default, PartialEq, Serialize, ToSchema)]
pub struct Live {
    /// Its name.
    pub bench: String,
    /// State of the bench.
    pub state: BenchState,
    /// Reason why no run starts on it; null if it is not held.
    pub held: Option<String>,
    /// The run in progress, or the last one.
    pub run: Option<RunNow>,
    /// The last reading of that run.
    pub reading: Option<ReadingNow>,
    /// State of charge, if the cell's open-circuit voltage is known.
    pub soc: Option<Soc>,
    /// Limits for the reading, with the margin to those that end the run first: of the present
    /// step, of the cell, or of the control in its place.
    pub limits: Vec<Limit>,
    /// The instruments.
    pub instruments: Vec<InstrumentNow>,
    /// Why it is latched; null if it is not.
    pub trip: Option<TripNow>,
    /// Requested change of the fixture, for whose answer the run waits.
    pub question: Option<QuestionNow>,
    /// Report of the last stop.
    pub stop: Option<StopReport>,
    /// State of the outputs with the time of the read-back.
    pub outputs: OutputsState,
    /// True if nothing runs and current readings show every output off, or if the bench is
    /// simulated within a run's process and no run is in progress.
    pub verified: bool,
    /// True if a person must inspect the outputs: nothing runs, and the last run left them without
    /// a known reading, or an output was not read as off.
    pub needs_look: bool,
    /// The command that switches the bench off on the server's machine.
    pub safe_command: String,
    /// Interval at which the server reads the outputs of the idle bench, s; null if it does not.
    pub read_idle_s: Option<f64>,
}

impl Live {
    /// Returns whether the run pauses at the end of its step.
    pub fn is_pausing(&self) -> bool {
        self.run.as_ref().is_some_and(|run| run.pausing)
    }

    /// Returns the state with the judgement whether a person must inspect the outputs.
    #[must_use]
    pub fn judged(self) -> Self {
        let needs_look = match self.state {
            BenchState::Unknown => true,
            BenchState::Idle | BenchState::Latched => self.outputs.is_alarming(),
            BenchState::Running
            | BenchState::Paused
            | BenchState::Asking
            | BenchState::Stopping => false,
        };
        Self { needs_look, ..self }
    }
}

/// State of a bench.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum BenchState {
    /// The server has not read the bench yet, or a run ended whose outputs were not read back as
    /// off.
    #[default]
    Unknown,
    /// No run is in progress; `outputs` has the state of its outputs.
    Idle,
    /// A run is in progress.
    Running,
    /// A run is paused on request; all outputs are off.
    Paused,
    /// A run waits for a person to change the fixture; all outputs are off.
    Asking,
    /// The bench is being switched off.
    Stopping,
    /// A person must inspect and clear the bench.
    Latched,
}

impl BenchState {
    /// All states.
    pub const ALL: [Self; 7] = [
        Self::Unknown,
        Self::Idle,
        Self::Running,
        Self::Paused,
        Self::Asking,
        Self::Stopping,
        Self::Latched,
    ];

    /// Its name, as the API has it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Unknown => "unknown",
            Self::Idle => "idle",
            Self::Running => "running",
            Self::Paused => "paused",
            Self::Asking => "asking",
            Self::Stopping => "stopping",
            Self::Latched => "latched",
        }
    }
}

/// Progress of a run.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct RunNow {
    /// Its name; null if this server did not start it.
    pub run: Option<String>,
    /// Name of the experiment.
    pub experiment: String,
    /// True while it is in progress.
    pub going: bool,
    /// How it ended, if it ended by itself.
    pub ended: Option<String>,
    /// True if a person ended it.
    pub stopped: bool,
    /// True if it pauses at the end of the step, because a person requested it.
    pub pausing: bool,
    /// Expected wall time until the end of the step, s; null if it is unknown.
    pub step_left_s: Option<f64>,
    /// The current stage, as text.
    pub stage: String,
    /// Number of the current stage, from 1; 0 before the first.
    pub stage_number: usize,
    /// Number of stages.
    pub stages: usize,
    /// The current step, as text.
    pub step: String,
    /// Number of the current step, from 1.
    pub step_number: usize,
    /// Number of steps of the stage.
    pub steps: usize,
    /// The current point of the sweep.
    pub point: Option<PointNow>,
    /// Number of finished points of all sweeps.
    pub points_done: usize,
    /// Number of points of all sweeps.
    pub points: usize,
    /// Completed share of the expected bench time.
    pub done: f64,
    /// Remaining wall time, s; null if it is unknown.
    pub left_s: Option<f64>,
    /// Bench time of the last entry or reading, s.
    pub bench_time_s: f64,
    /// Course of bench time: `real`, `virtual` or `scaled:FACTOR`.
    pub time: String,
    /// True if all outputs were read back as off at the last entry of the journal.
    pub safe: bool,
}

/// A change of the fixture that a person is asked to make.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct QuestionNow {
    /// Number of the question in the run; the answer names it.
    pub number: u64,
    /// Text of the question.
    pub text: String,
    /// Name of the cell, if the run has several.
    pub cell: Option<String>,
    /// Serial number of the cell, if it has one; an answer with another one is refused.
    pub serial: Option<String>,
    /// Barcode on the cell, if known; an answer may state it instead of the serial number.
    pub barcode: Option<String>,
    /// True if it is asked on the terminal of the run and can be answered only there.
    pub on_terminal: bool,
    /// Bench time at which it was asked, s.
    pub asked_s: f64,
}

/// A point in progress.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct PointNow {
    /// Number of the point in the sweep, from 1.
    pub number: usize,
    /// Number of points of the sweep.
    pub of: usize,
    /// Its frequency, Hz.
    pub freq_hz: f64,
}

/// A reading.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct ReadingNow {
    /// Bench time, s.
    pub time_s: f64,
    /// Step at that time.
    pub phase: String,
    /// Fixture in the jig: `cell` or a control.
    pub fixture: String,
    /// Voltage, V.
    pub voltage_v: Option<f64>,
    /// Current, A; positive for charge.
    pub current_a: Option<f64>,
    /// Last reading of the surface temperature of the cell, °C.
    #[serde(rename = "temperature_c")]
    pub temperature_degc: Option<f64>,
    /// True if the process that took the reading still runs; otherwise the reading is out of date.
    pub fresh: bool,
}

/// A state of charge.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, ToSchema)]
pub struct Soc {
    /// Share of the capacity.
    pub share: f64,
    /// Charge counted since the state of charge was determined from the voltage at rest, C;
    /// positive for charge.
    #[serde(rename = "counted_c")]
    pub counted_coulomb: f64,
}

/// A reading between its limits.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Limit {
    /// The quantity.
    pub quantity: &'static str,
    /// Its unit.
    pub unit: &'static str,
    /// Last reading.
    pub value: Option<f64>,
    /// Lower limit of the cell, or of the control in its place; null if there is none.
    pub least: Option<f64>,
    /// Upper limit of the cell, or of the control in its place.
    pub greatest: f64,
    /// The limits that end the run: the tighter ones of those of the present step and those of
    /// the cell or the control. Those of the current include the error of the meter.
    pub in_force: InForce,
    /// Source of the limit in force that is nearer to the reading.
    pub of: LimitOf,
    /// Distance to the nearer limit in force; negative beyond it, null without a fresh reading.
    pub margin: Option<f64>,
}

/// Limits that end the run.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, ToSchema)]
pub struct InForce {
    /// Lower limit; null if there is none.
    pub least: Option<f64>,
    /// Upper limit.
    pub greatest: f64,
}

/// Source of a limit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum LimitOf {
    /// The present step of the run.
    Step,
    /// The cell.
    Cell,
    /// The control in the jig instead of the cell.
    Control,
}

/// An instrument.
#[derive(Debug, Clone, Default, PartialEq, Serialize, ToSchema)]
pub struct InstrumentNow {
    /// Its role.
    pub role: String,
    /// Its model in the bench file.
    pub model: String,
    /// Its address.
    pub address: String,
    /// Identity in its last answer.
    pub identity: Option<String>,
    /// Whether that is the configured model.
    pub recognised: Option<bool>,
    /// Whether its output is on or carries a current; null for an instrument without an output,
    /// before it was asked, or if it was not reached.
    pub output: Option<bool>,
    /// Bench time of its last report in a run, s; null if it was read since.
    pub output_s: Option<f64>,
    /// Time of its reading outside a run, or at the end of a run, s since 1970.
    pub output_unix_s: Option<f64>,
    /// Source of that reading: `run`, `guardian`, `stop`, `safe`, `read` or `next run`.
    pub output_by: Option<String>,
    /// Bench time of its last answer, s.
    pub answered_s: Option<f64>,
    /// Known fault of the instrument.
    pub trouble: Option<String>,
}

/// Why a bench is latched.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct TripNow {
    /// The cause as text, with the step and the run.
    pub cause: String,
    /// Quantity that exceeded its limits, if it was a reading.
    pub quantity: Option<String>,
    /// Its value.
    pub value: Option<f64>,
    /// Its unit.
    pub unit: Option<String>,
    /// The step during which it tripped.
    pub step: Option<String>,
    /// Process that detected it.
    pub by: String,
    /// Time, s since 1970.
    pub unix_s: f64,
}

impl From<Latched> for TripNow {
    fn from(latched: Latched) -> Self {
        // The run's folder is not disclosed beyond this machine.
        let Latched {
            cause,
            quantity,
            value,
            unit,
            step,
            by,
            unix_s,
            ..
        } = latched;
        Self {
            cause,
            quantity,
            value,
            unit,
            step,
            by,
            unix_s,
        }
    }
}

/// Report of a stop.
#[derive(Debug, Clone, Default, PartialEq, Serialize, ToSchema)]
pub struct StopReport {
    /// The bench.
    pub bench: String,
    /// Name of the caller.
    pub by: String,
    /// The side that holds the bench behind it.
    #[serde(skip)]
    pub held_by: HeldBy,
    /// Time, s since 1970.
    pub unix_s: f64,
    /// True after the stop has completed.
    pub over: bool,
    /// True if every output that can move charge was read back as off.
    pub verified: bool,
    /// The bench was simulated within the run's process, which has ended. It has no outputs, and
    /// none was read back.
    pub simulated: bool,
    /// Steps of the stop, as text, in order.
    pub steps: Vec<String>,
    /// State of the bench after the read-back, in one sentence.
    pub message: String,
    /// State of the outputs in words, with the time of the reading.
    pub read: String,
    /// Time of the read-back, s since 1970.
    pub read_unix_s: Option<f64>,
    /// States that were read back, one for each instrument.
    pub outputs: Vec<OutputRead>,
}

impl StopReport {
    /// Returns whether the stop is over and its outputs are verified off, or simulated.
    pub fn proven(&self) -> bool {
        self.over && (self.verified || self.simulated)
    }

    /// Returns why the bench is held after the stop.
    pub fn held(&self) -> String {
        format!("stopped by {}", self.by)
    }
}

/// State of an instrument that was read back: as `eis-bench safe --json` and the guardian's report
/// have it, with the conclusion.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct OutputRead {
    /// State of the output.
    #[serde(flatten)]
    pub output: Output,
    /// True if the instrument reports the output off and its meter, if any, shows no current.
    pub verified: bool,
    /// The complete line for people.
    pub text: String,
}

impl From<&Output> for OutputRead {
    fn from(output: &Output) -> Self {
        let text = output
            .line()
            .split_whitespace()
            .collect::<Vec<_>>()
            .join(" ");
        Self {
            output: output.clone(),
            verified: output.verified(),
            text,
        }
    }
}

impl Limit {
    /// Creates the limit of a cell or of a control, without a margin.
    fn new(
        quantity: &'static str,
        unit: &'static str,
        value: Option<f64>,
        range: RangeInclusive<f64>,
    ) -> Self {
        let least = Some(*range.start()).filter(|least| least.is_finite());
        let greatest = *range.end();
        Self {
            quantity,
            unit,
            value,
            least,
            greatest,
            in_force: InForce { least, greatest },
            of: LimitOf::Cell,
            margin: None,
        }
    }

    /// Determines the limits in force and the margin: the interlock judges against the bounds of
    /// the present step and of `of`, both times `share`.
    fn judged(self, of: LimitOf, step: Between, share: f64) -> Self {
        let least = self.least.map(|least| share * least);
        let greatest = share * self.greatest;
        let step_least = (step.least.map(|bound| share * bound))
            .filter(|bound| least.is_none_or(|least| *bound > least));
        let step_greatest =
            (step.greatest.map(|bound| share * bound)).filter(|bound| *bound < greatest);
        let in_force = InForce {
            least: step_least.or(least),
            greatest: step_greatest.unwrap_or(greatest),
        };
        let below = |value: f64| in_force.least.map_or(f64::INFINITY, |least| value - least);
        let above = |value: f64| in_force.greatest - value;
        let is_lower_nearer = self.value.is_some_and(|value| below(value) < above(value));
        let is_of_step = if is_lower_nearer {
            step_least.is_some()
        } else {
            step_greatest.is_some()
        };
        Self {
            in_force,
            of: if is_of_step { LimitOf::Step } else { of },
            margin: self.value.map(|value| below(value).min(above(value))),
            ..self
        }
    }
}

/// Returns the limits for a reading, with the margin that is left. `step` has the bounds of the
/// present step.
pub fn limits(limits: &Limits, reading: &ReadingNow, step: Option<&EnvelopeRow>) -> Vec<Limit> {
    let (limits, of, voltage) = if reading.fixture == "cell" {
        (*limits, LimitOf::Cell, "cell voltage")
    } else {
        (
            limits.of_control(),
            LimitOf::Control,
            "voltage across the control",
        )
    };
    let volts = Limit::new(
        voltage,
        "V",
        reading.voltage_v,
        limits.min_v.value()..=limits.max_v.value(),
    );
    let range = (-limits.discharge_a).value()..=limits.charge_a.value();
    let amps = Limit::new("current", "A", reading.current_a, range);
    let range = limits.min_degc.value()..=limits.max_degc.value();
    let degrees = Limit::new("cell temperature", "°C", reading.temperature_degc, range);
    let bounds = |of: fn(&EnvelopeRow) -> Between| step.map_or(Between::of(f64::NAN, f64::NAN), of);
    let mut all = vec![
        volts.judged(of, bounds(|row| row.voltage_v), 1.0),
        amps.judged(of, bounds(|row| row.current_a), CURRENT_MARGIN),
        degrees.judged(of, bounds(|row| row.temperature_degc), 1.0),
    ];
    for limit in &mut all {
        // An old reading gives no margin, because the present state is unknown.
        limit.margin = limit.margin.filter(|_| reading.fresh);
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use bench_core::bench::SafeReport;
    use instruments::units::{Amps, Celsius, Volts};

    fn reading(fixture: &str, amps: f64) -> ReadingNow {
        ReadingNow {
            time_s: 10.0,
            phase: "sine".to_owned(),
            fixture: fixture.to_owned(),
            voltage_v: Some(3.7),
            current_a: Some(amps),
            temperature_degc: Some(25.0),
            fresh: true,
        }
    }

    fn cell() -> Limits {
        Limits {
            min_v: Volts(2.5),
            max_v: Volts(4.2),
            charge_a: Amps(13.5),
            discharge_a: Amps(45.0),
            min_degc: Celsius(0.0),
            max_degc: Celsius(60.0),
        }
    }

    #[test]
    fn the_limit_that_ends_the_run_is_the_one_that_is_shown() {
        let step = EnvelopeRow {
            time_s: 9.0,
            voltage_v: Between::of(2.5, 4.2),
            current_a: Between::of(-1.2, 1.2),
            temperature_degc: Between::of(f64::NEG_INFINITY, 60.0),
        };
        let near = |met: f64, expected: f64| (met - expected).abs() < 1e-9;
        let of = |limits: &[Limit]| limits.iter().map(|limit| limit.of).collect::<Vec<_>>();
        let all = limits(&cell(), &reading("cell", 1.0), Some(&step));
        assert_eq!(of(&all), [LimitOf::Cell, LimitOf::Step, LimitOf::Cell]);
        let current = &all[1];
        assert_eq!((current.least, current.greatest), (Some(-45.0), 13.5));
        assert!(near(current.in_force.greatest, 1.224), "{current:?}");
        assert!(near(current.margin.unwrap(), 0.224), "{current:?}");
        assert!(near(all[0].margin.unwrap(), 0.5), "{all:?}");
        // Without a step, those of the cell, within the error of the meter.
        let all = limits(&cell(), &reading("cell", 13.6), None);
        assert_eq!(of(&all), [LimitOf::Cell; 3]);
        assert!(near(all[1].margin.unwrap(), 0.17), "{all:?}");
        let all = limits(&cell(), &reading("shunt", 1.0), Some(&step));
        assert_eq!((all[0].of, all[1].of), (LimitOf::Control, LimitOf::Step));
        assert_eq!(all[0].quantity, "voltage across the control");
        let old = ReadingNow {
            fresh: false,
            ..reading("cell", 1.0)
        };
        let all = limits(&cell(), &old, Some(&step));
        assert!(all.iter().all(|limit| limit.margin.is_none()), "{all:?}");
        assert_eq!(all[1].of, LimitOf::Step);
    }

    #[test]
    fn the_report_of_a_stop_is_that_of_safe_and_more() {
        let load = Output {
            role: "load".to_owned(),
            model: "rigol-dl3000".to_owned(),
            volts: Some(Volts(3.6)),
            amps: Some(Amps(3.0)),
            by: Some("a set-point of 0".to_owned()),
            bound: Some("it stops below 2.5 V".to_owned()),
            trouble: Some("no answer".to_owned()),
            ..Output::default()
        };
        let message = "3.00 A still flow through the load".to_owned();
        let safe = SafeReport {
            bench: "demo".to_owned(),
            verified: false,
            message,
            outputs: vec![load],
            ..SafeReport::default()
        };
        let stop = StopReport {
            bench: "demo".to_owned(),
            by: "ann".to_owned(),
            message: safe.message.clone(),
            read: safe.read.clone(),
            outputs: safe.outputs.iter().map(OutputRead::from).collect(),
            ..StopReport::default()
        };
        let json = serde_json::to_value(&stop).unwrap();
        assert_eq!(json["outputs"][0]["verified"], false);
        assert_eq!(serde_json::from_value::<SafeReport>(json).unwrap(), safe);
    }
}
