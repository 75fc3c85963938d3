//! The state of the outputs of a bench: what was read back, and when. API, page, command line,
//! guardian and notices use the texts of this module, so that none of them claims more than was
//! read.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use bench_plan::support::calendar::local_time;

/// How long a reading counts as current, s. An older reading describes the past: another client or
/// a person at the panel may have switched an output on since.
pub const CURRENT_FOR_S: f64 = 900.0;

/// Roles of the instruments that can move charge.
pub const DRIVES: [&str; 4] = ["supply4q", "generator", "load", "supply"];

/// State of one output as read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum OutputState {
    /// The instrument reports the output off, and its meter, if any, shows no current.
    Off,
    /// On, or reported off although it was not.
    On,
    /// The instrument reports the output off, but its meter shows a current.
    Current,
    /// The generator is on at its zero command, because the supply behind it is not switched by
    /// the program.
    Zero,
    /// An analog supply, which the program can neither switch nor read.
    Unswitched,
    /// The instrument did not answer, or its answers do not match the questions.
    Unreachable,
}

impl OutputState {
    /// Returns its name in the API.
    pub fn name(self) -> &'static str {
        match self {
            Self::Off => "off",
            Self::On => "on",
            Self::Current => "current",
            Self::Zero => "on at its zero command",
            Self::Unswitched => "not switched by this program",
            Self::Unreachable => "unreachable",
        }
    }
}

/// Reading of one output.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct OutputReading {
    /// Role of the instrument.
    pub role: String,
    /// Its model in the bench file.
    pub model: String,
    /// State as read.
    pub state: OutputState,
    /// Voltage that it measured, V.
    pub volts: Option<f64>,
    /// Current that it measured, A.
    pub amps: Option<f64>,
    /// Time of the reading, s since 1970.
    pub unix_s: f64,
    /// Source of the reading: `run`, `guardian`, `safe`, `stop` (of the server), `read` (a
    /// requested reading), or `next run` (before it started).
    pub by: String,
}

impl OutputReading {
    /// Checks whether the output is off and carries no current.
    pub fn is_off(&self) -> bool {
        self.state == OutputState::Off
    }

    /// Checks whether the output is neither off nor in the state in which it is to stay.
    fn is_wrong(&self) -> bool {
        !matches!(
            self.state,
            OutputState::Off | OutputState::Zero | OutputState::Unswitched
        )
    }

    /// Returns the state and the readings of its meter, as text.
    pub fn in_words(&self) -> String {
        let meter = match (self.volts, self.amps) {
            (Some(volts), Some(amps)) => format!("; {volts:.4} V, {amps:.4} A"),
            _ => String::new(),
        };
        format!("{}{meter}", self.state.name())
    }
}

/// A reading with its age.
#[derive(Debug, Clone, PartialEq)]
pub struct KnownReading {
    /// The reading.
    pub reading: OutputReading,
    /// Age of the reading, s; null if the machine's clock has been set since.
    pub age_s: Option<f64>,
}

/// State of the outputs of a bench as a whole.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum OutputsKind {
    /// At least one output was never read, or not since the start of a run that left no reading.
    #[default]
    NotRead,
    /// All outputs were read as off, and all readings are current.
    Off,
    /// At least one output was read as on, or carries a current.
    On,
    /// All outputs that the program switches were read as off, or at their zero command, but an
    /// analog bipolar supply is not switched by the program.
    Unswitched,
    /// At least one output was not reached; the others were read as off.
    Unreachable,
    /// The reading is out of date, or the machine's clock has been set since.
    Stale,
    /// A run is in progress; its own readings give the state.
    InRun,
    /// The bench is simulated within the process of a run and has no outputs outside it.
    Simulated,
}

/// State of the outputs of a bench with the time of the readings.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct OutputsState {
    /// Kind of the state.
    pub state: OutputsKind,
    /// The same in words, with the time of the reading (the machine's local time).
    pub words: String,
    /// Time of the oldest reading, s since 1970.
    pub read_unix_s: Option<f64>,
    /// Age of the oldest reading, s, in whole minutes; null if nothing was read or the clock has
    /// been set since.
    pub age_s: Option<f64>,
    /// The readings, one for each output that was read.
    pub outputs: Vec<OutputReading>,
}

impl OutputsState {
    /// Combines the readings of the outputs into the state of the bench. `roles` lists the outputs
    /// that must have been read; `begun_unix_s` is the start of a run that has left no reading, s
    /// since 1970.
    pub fn of(
        roles: &[&str],
        known: &[KnownReading],
        begun_unix_s: Option<f64>,
        now_unix_s: f64,
    ) -> Self {
        let missing: Vec<&str> = roles
            .iter()
            .filter(|role| known.iter().all(|one| one.reading.role != **role))
            .copied()
            .collect();
        let read_unix_s = known.iter().map(|one| one.reading.unix_s).reduce(f64::min);
        let Some(read_unix_s) = read_unix_s else {
            return Self::not_read(begun_unix_s, now_unix_s);
        };
        let ages: Option<Vec<f64>> = known.iter().map(|one| one.age_s).collect();
        let age_s = ages.map(|ages| ages.into_iter().fold(0.0, f64::max));
        let readings: Vec<OutputReading> = known.iter().map(|one| one.reading.clone()).collect();
        let time = local_time(read_unix_s, now_unix_s);
        let aged = aged(age_s);
        let state = if aged.is_some() {
            OutputsKind::Stale
        } else {
            kind(&readings, &missing)
        };
        Self {
            state,
            words: format!(
                "{}{}",
                what(&readings, &missing, &time),
                aged.unwrap_or_default()
            ),
            read_unix_s: Some(read_unix_s),
            age_s: age_s.map(|age_s| (age_s / 60.0).floor() * 60.0),
            outputs: readings,
        }
    }

    /// Returns the state right after a reading.
    pub fn just_read(readings: &[OutputReading]) -> Self {
        let read_unix_s = readings.first().map_or(0.0, |reading| reading.unix_s);
        Self::read_earlier(readings, read_unix_s)
    }

    /// Returns the state at the time of an earlier reading. The text contains the date unless it
    /// is today.
    pub fn read_earlier(readings: &[OutputReading], now_unix_s: f64) -> Self {
        let known: Vec<KnownReading> = readings
            .iter()
            .map(|reading| KnownReading {
                reading: reading.clone(),
                age_s: Some(0.0),
            })
            .collect();
        Self::of(&[], &known, None, now_unix_s)
    }

    fn not_read(begun_unix_s: Option<f64>, now_unix_s: f64) -> Self {
        let since = begun_unix_s.map_or_else(String::new, |begun_s| {
            format!(" since a run began at {}", local_time(begun_s, now_unix_s))
        });
        Self {
            words: format!("outputs not read{since}"),
            ..Self::default()
        }
    }

    /// Returns the state during a run.
    pub fn in_run() -> Self {
        Self {
            state: OutputsKind::InRun,
            words: "a run is in work: its readings show the outputs".to_owned(),
            ..Self::default()
        }
    }

    /// Returns the state of a bench that is simulated within the process of a run.
    pub fn simulated() -> Self {
        Self {
            state: OutputsKind::Simulated,
            words: "simulated within a run's process: no outputs to read".to_owned(),
            ..Self::default()
        }
    }

    /// Checks whether every output was read as off by current readings, or whether the bench is
    /// simulated.
    pub fn is_off(&self) -> bool {
        matches!(self.state, OutputsKind::Off | OutputsKind::Simulated)
    }

    /// Checks whether a person must inspect what was read.
    pub fn is_alarming(&self) -> bool {
        matches!(self.state, OutputsKind::On | OutputsKind::Unreachable)
            || self.state == OutputsKind::Stale && self.outputs.iter().any(OutputReading::is_wrong)
    }

    /// Returns the reading of a role.
    pub fn of_role(&self, role: &str) -> Option<&OutputReading> {
        self.outputs.iter().find(|reading| reading.role == role)
    }
}

/// Returns why a reading is old, as text, or `None` if it is current.
fn aged(age_s: Option<f64>) -> Option<String> {
    match age_s {
        None => Some(", and the machine's clock was set since: no longer current".to_owned()),
        Some(age_s) if age_s > CURRENT_FOR_S => {
            Some(format!(", {} ago: no longer current", duration(age_s)))
        }
        Some(_) => None,
    }
}

fn kind(readings: &[OutputReading], missing: &[&str]) -> OutputsKind {
    let any = |state| readings.iter().any(|reading| reading.state == state);
    if any(OutputState::On) || any(OutputState::Current) {
        OutputsKind::On
    } else if any(OutputState::Unreachable) {
        OutputsKind::Unreachable
    } else if missing.is_empty() && (any(OutputState::Zero) || any(OutputState::Unswitched)) {
        OutputsKind::Unswitched
    } else if missing.is_empty() {
        OutputsKind::Off
    } else {
        OutputsKind::NotRead
    }
}

/// Describes what was read. Outputs that are not off come first.
fn what(readings: &[OutputReading], missing: &[&str], time: &str) -> String {
    let all = |state| readings.iter().all(|reading| reading.state == state);
    if missing.is_empty() && all(OutputState::Off) {
        return format!("outputs read off at {time}");
    }
    if missing.is_empty() && all(OutputState::Unreachable) {
        return format!("outputs not reached at {time}");
    }
    let odd: Vec<String> = readings
        .iter()
        .filter(|reading| !reading.is_off())
        .map(clause)
        .chain(
            missing
                .iter()
                .map(|role| format!("{} not read", name(role))),
        )
        .collect();
    format!("{} (read {time})", odd.join(", "))
}

fn clause(reading: &OutputReading) -> String {
    let name = name(&reading.role);
    let flows = reading
        .amps
        .filter(|amps| amps.abs() >= 0.005)
        .map(|amps| format!("{:.2} A", amps.abs()));
    match (reading.state, flows) {
        (OutputState::Off, _) => format!("{name} off"),
        (OutputState::On, Some(flows)) => format!("{name} on, {flows}"),
        (OutputState::On, None) => format!("{name} on"),
        (OutputState::Current, flows) => {
            format!("{name} off but {} flow", flows.unwrap_or_default())
        }
        (OutputState::Zero | OutputState::Unswitched, _) => {
            format!("{name} {}", reading.state.name())
        }
        (OutputState::Unreachable, _) => format!("{name} not reached"),
    }
}

fn name(role: &str) -> &str {
    match role {
        "supply4q" => "bipolar supply",
        "supply" => "charger",
        "chiller" => "relays of the bath",
        other => other,
    }
}

fn duration(seconds: f64) -> String {
    let minutes = seconds / 60.0;
    if minutes < 120.0 {
        format!("{} min", minutes.floor())
    } else if minutes < 48.0 * 60.0 {
        format!("{} h", (minutes / 60.0).floor())
    } else {
        format!("{} d", (minutes / 1440.0).floor())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOW_S: f64 = 1.8e9;
    const ROLES: [&str; 2] = ["load", "supply"];

    fn known(role: &str, state: OutputState, age_s: Option<f64>) -> KnownReading {
        KnownReading {
            reading: OutputReading {
                role: role.to_owned(),
                model: "m".to_owned(),
                state,
                volts: None,
                amps: None,
                unix_s: NOW_S - age_s.unwrap_or(0.0),
                by: "safe".to_owned(),
            },
            age_s,
        }
    }

    #[test]
    fn the_words_say_what_was_read_and_when_and_nothing_else() {
        use OutputState::{Current, Off, On, Unreachable};
        let time = local_time(NOW_S, NOW_S);
        let draws = |mut one: KnownReading| {
            one.reading.amps = Some(-20.0);
            one
        };
        let both = |load, supply| {
            vec![
                known("load", load, Some(0.0)),
                known("supply", supply, Some(0.0)),
            ]
        };
        for (known, kind, words) in [
            (vec![], OutputsKind::NotRead, "outputs not read".to_owned()),
            (
                both(Off, Off),
                OutputsKind::Off,
                format!("outputs read off at {time}"),
            ),
            (
                both(On, Off),
                OutputsKind::On,
                format!("load on (read {time})"),
            ),
            (
                vec![
                    draws(known("load", On, Some(0.0))),
                    known("supply", Off, Some(0.0)),
                ],
                OutputsKind::On,
                format!("load on, 20.00 A (read {time})"),
            ),
            (
                vec![
                    draws(known("load", Current, Some(0.0))),
                    known("supply", Off, Some(0.0)),
                ],
                OutputsKind::On,
                format!("load off but 20.00 A flow (read {time})"),
            ),
            (
                both(On, Unreachable),
                OutputsKind::On,
                format!("load on, charger not reached (read {time})"),
            ),
            (
                both(Off, Unreachable),
                OutputsKind::Unreachable,
                format!("charger not reached (read {time})"),
            ),
            (
                both(Unreachable, Unreachable),
                OutputsKind::Unreachable,
                format!("outputs not reached at {time}"),
            ),
            (
                vec![known("load", Off, Some(0.0))],
                OutputsKind::NotRead,
                format!("charger not read (read {time})"),
            ),
            (
                vec![known("load", Off, None), known("supply", Off, None)],
                OutputsKind::Stale,
                format!(
                    "outputs read off at {time}, and the machine's clock was set since: no longer \
                    current"
                ),
            ),
        ] {
            let state = OutputsState::of(&ROLES, &known, None, NOW_S);
            assert_eq!((state.state, state.words), (kind, words));
        }
    }

    #[test]
    fn a_reading_is_current_for_a_bounded_time() {
        let at = |age_s: f64| {
            let one = known("load", OutputState::Off, Some(age_s));
            let state = OutputsState::of(&["load"], &[one], None, NOW_S);
            let end = state.words.split_once(", ").map(|(_, end)| end.to_owned());
            (state.state, state.is_off(), end)
        };
        assert_eq!(at(CURRENT_FOR_S), (OutputsKind::Off, true, None));
        for (age_s, words) in [
            (CURRENT_FOR_S + 1.0, "15 min ago: no longer current"),
            (3.0 * 3600.0, "3 h ago: no longer current"),
            (3.0 * 86_400.0, "3 d ago: no longer current"),
        ] {
            assert_eq!(
                at(age_s),
                (OutputsKind::Stale, false, Some(words.to_owned()))
            );
        }
    }

    #[test]
    fn a_run_that_has_left_no_reading_is_named_by_its_time() {
        let state = OutputsState::of(&ROLES, &[], Some(NOW_S), NOW_S);
        let words = format!(
            "outputs not read since a run began at {}",
            local_time(NOW_S, NOW_S)
        );
        assert_eq!((state.state, state.words), (OutputsKind::NotRead, words));
    }
}
