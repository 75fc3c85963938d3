//! Present state of a bench, as the API shows it.

use serde::Serialize;
use utoipa::ToSchema;

use super::queue::HeldBy;
use crate::{
    bench::{Output, outputs::OutputsState},
    interlock::Limits,
    safety::state::Latched,
};

/// A bench as it is now.
#[derive(Debug, Clone, Default, PartialEq, Serialize, ToSchema)]
pub struct Live {
    /// Its name.
    pub bench: String,
    /// State of the bench.
    pub state: BenchState,
    /// Why nothing is begun on it; none where nothing holds it.
    pub held: Option<String>,
    /// The run in work, or the last one.
    pub run: Option<RunNow>,
    /// The last reading of that run.
    pub reading: Option<ReadingNow>,
    /// State of charge, where the cell's open-circuit voltage is known.
    pub soc: Option<Soc>,
    /// Limits of the cell for the reading, with the margin left. The step in work is judged by
    /// limits of its own within these, that of current above all: it may trip while there is a
    /// margin here.
    pub limits: Vec<Limit>,
    /// The instruments.
    pub instruments: Vec<InstrumentNow>,
    /// Why it is latched, if it is.
    pub trip: Option<TripNow>,
    /// Change of the fixture that a person is asked for; the run waits for the answer.
    pub question: Option<QuestionNow>,
    /// Report of the last stop.
    pub stop: Option<StopReport>,
    /// State of the outputs: what was read back, and when.
    pub outputs: OutputsState,
    /// Nothing runs, and every output was last read back as off by a reading that is current; or
    /// the bench is simulated within a run's process, and none runs.
    pub verified: bool,
    /// The command that switches the bench off on the server's machine.
    pub safe_command: String,
    /// Interval at which the server reads the outputs while nothing runs, s; none where it does
    /// not.
    pub read_idle_s: Option<f64>,
}

impl Live {
    /// Returns whether a person must inspect the outputs: nothing runs, and the last run left
    /// them without a known reading, or an output was not read as off.
    pub fn needs_look(&self) -> bool {
        match self.state {
            BenchState::Unknown => true,
            BenchState::Idle | BenchState::Latched => self.outputs.is_alarming(),
            BenchState::Running
            | BenchState::Paused
            | BenchState::Asking
            | BenchState::Stopping => false,
        }
    }
}

/// State of a bench.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum BenchState {
    /// The server has not looked yet, or a run has ended whose outputs were not read back as off.
    #[default]
    Unknown,
    /// Nothing runs; what its outputs do stands in `outputs`.
    Idle,
    /// A run is in work.
    Running,
    /// A run waits on request, every output off.
    Paused,
    /// A run waits for a person who is to change the fixture, every output off.
    Asking,
    /// It is being switched off.
    Stopping,
    /// A person has to look at it and to clear it.
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

/// A run as it is now.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct RunNow {
    /// Its name; none for one that was not begun by this server.
    pub run: Option<String>,
    /// Name of the experiment.
    pub experiment: String,
    /// It goes on.
    pub going: bool,
    /// How it ended, if it did by itself.
    pub ended: Option<String>,
    /// The stage in work, in words.
    pub stage: String,
    /// Its number, from 1; 0 before the first.
    pub stage_number: usize,
    /// How many there are.
    pub stages: usize,
    /// The step in work, in words.
    pub step: String,
    /// Its number, from 1.
    pub step_number: usize,
    /// How many steps the stage has.
    pub steps: usize,
    /// The sweep's point in work.
    pub point: Option<PointNow>,
    /// Points that are finished, of all sweeps.
    pub points_done: usize,
    /// How many there are.
    pub points: usize,
    /// Share that is done, by expected bench time.
    pub done: f64,
    /// Remaining wall time, s; null if it is unknown.
    pub left_s: Option<f64>,
    /// Bench time of the last entry or reading, s.
    pub bench_time_s: f64,
    /// How bench time runs: `real`, `virtual` or `scaled:FACTOR`.
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
    /// Surface temperature of the cell when it was read last, °C.
    pub temperature_c: Option<f64>,
    /// True if the process that took the reading still runs; otherwise the reading is out of date.
    pub fresh: bool,
}

/// A state of charge.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, ToSchema)]
pub struct Soc {
    /// Share of the capacity.
    pub share: f64,
    /// Charge counted since it was found from the voltage at rest, C; positive for charge.
    pub counted_c: f64,
}

/// One limit of the cell.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Limit {
    /// The quantity.
    pub quantity: &'static str,
    /// Its unit.
    pub unit: &'static str,
    /// Value that was read last.
    pub value: Option<f64>,
    /// Lower limit; none where there is none.
    pub least: Option<f64>,
    /// Upper limit.
    pub greatest: f64,
    /// Distance to the nearer of them; negative beyond it, none where nothing was read or the
    /// reading is not fresh. The step in work is judged tighter.
    pub margin: Option<f64>,
}

/// An instrument.
#[derive(Debug, Clone, Default, PartialEq, Serialize, ToSchema)]
pub struct InstrumentNow {
    /// Its role.
    pub role: String,
    /// Its model in the bench file.
    pub model: String,
    /// Where it is reached.
    pub address: String,
    /// Identity by its own last answer.
    pub identity: Option<String>,
    /// Whether that is the configured model.
    pub recognised: Option<bool>,
    /// Whether its output is on, or carries a current; none for an instrument without one, before
    /// it was asked, or if it was not reached.
    pub output: Option<bool>,
    /// Bench time of its own word in a run, s; none if it was read since.
    pub output_s: Option<f64>,
    /// When it was read outside a run, or at its end, s since 1970.
    pub output_unix_s: Option<f64>,
    /// Who read it then: `run`, `guardian`, `stop`, `safe`, `read` or `next run`.
    pub output_by: Option<String>,
    /// Bench time of its last answer, s.
    pub answered_s: Option<f64>,
    /// Fault of it, as far as is known.
    pub trouble: Option<String>,
}

/// Why a bench is latched.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct TripNow {
    /// In words, with the step and the run.
    pub cause: String,
    /// Quantity that left its limits, where it was a reading.
    pub quantity: Option<String>,
    /// Its value.
    pub value: Option<f64>,
    /// Its unit.
    pub unit: Option<String>,
    /// The step in work.
    pub step: Option<String>,
    /// Which process found it.
    pub by: String,
    /// When, s since 1970.
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
    /// Who stopped it.
    pub by: String,
    /// The side that holds the bench behind it.
    #[serde(skip)]
    pub held_by: HeldBy,
    /// When, s since 1970.
    pub unix_s: f64,
    /// It is over.
    pub over: bool,
    /// Every output that can move charge was read back as off.
    pub verified: bool,
    /// The bench was simulated within the run's process, which has ended. It has no outputs, and
    /// none was read back.
    pub simulated: bool,
    /// Steps of the stop, in words, in order.
    pub steps: Vec<String>,
    /// State in which the bench was left, in one sentence, once it was read back.
    pub message: String,
    /// State of the outputs in words, with the time of the reading.
    pub read: String,
    /// When they were read back, s since 1970.
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
    /// It is off by its own word, and no current flows by its meter, where it has one.
    pub verified: bool,
    /// The line in full.
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

/// The limits of a cell, or of a control in its place, with the margin that a reading leaves.
pub fn limits(limits: &Limits, cell: bool, reading: &ReadingNow) -> Vec<Limit> {
    let limits = if cell { *limits } else { limits.of_control() };
    // An old reading gives no margin, because the present state is unknown.
    let margin = |value: Option<f64>, least: Option<f64>, greatest: f64| {
        let value = value.filter(|_| reading.fresh)?;
        Some(least.map_or(greatest - value, |least| {
            (value - least).min(greatest - value)
        }))
    };
    let row = |quantity, unit, value: Option<f64>, least: f64, greatest: f64| {
        let least = Some(least).filter(|least| least.is_finite());
        Limit {
            quantity,
            unit,
            value,
            least,
            greatest,
            margin: margin(value, least, greatest),
        }
    };
    let voltage = if cell {
        "cell voltage"
    } else {
        "voltage across the control"
    };
    vec![
        row(voltage, "V", reading.voltage_v, limits.min_v, limits.max_v),
        row(
            "current",
            "A",
            reading.current_a,
            -limits.discharge_a,
            limits.charge_a,
        ),
        row(
            "cell temperature",
            "°C",
            reading.temperature_c,
            limits.min_c,
            limits.max_c,
        ),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::SafeReport;

    #[test]
    fn the_report_of_a_stop_is_that_of_safe_and_more() {
        let load = Output {
            role: "load".to_owned(),
            model: "rigol-dl3000".to_owned(),
            volts: Some(3.6),
            amps: Some(3.0),
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
