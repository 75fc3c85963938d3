//! The state in which each output was left, and the sentence that reports it. The sentence states
//! which current still flows, which meter shows it, what bounds it, and what to unplug. The
//! daemon, its guardian, `eis-bench safe` and the server share it.

use instruments::{
    clock,
    units::{Amps, Volts},
};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::outputs::{OutputReading, OutputState, OutputsState};
use bench_plan::interlock::NO_CURRENT_A;

/// State of one instrument after switching off.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Output {
    /// Its role.
    pub role: String,
    /// Its model in the bench file.
    pub model: String,
    /// True if the instrument reports its output off.
    pub off: bool,
    /// Measured voltage, V; null without a meter or an answer.
    #[schema(value_type = Option<f64>)]
    pub volts: Option<Volts>,
    /// Measured current, A; null without a meter or an answer.
    #[schema(value_type = Option<f64>)]
    pub amps: Option<Amps>,
    /// True if it reported off while a current flowed.
    #[serde(default)]
    pub lied: bool,
    /// True if its answers do not match the questions, so that its readings are unknown.
    #[serde(default)]
    pub out_of_step: bool,
    /// Setting that made its current zero while its output stayed on.
    pub by: Option<String>,
    /// Text of its current limit, if the output could not be verified to be off.
    pub bound: Option<String>,
    /// True if it was not reached or did not answer. Set only for a bath.
    #[serde(default)]
    pub silent: bool,
    /// Error message of the link, for the log.
    pub trouble: Option<String>,
}

/// Setting of a generator whose supply is not known to be off.
pub(super) const LEAST_SINE: &str = "its least sine";
/// Setting of a generator that commands an analog supply.
pub(super) const ZERO_COMMAND: &str = "its zero command";
/// What the program does with an analog supply.
pub(super) const UNSWITCHED: &str = "not switched by this program";
const SWITCH_IT_OFF: &str = "SWITCH IT OFF AT ITS PANEL";
/// The roles that measure their own current.
pub(super) const METERED: [&str; 3] = ["supply4q", "load", "supply"];

impl Output {
    /// Checks whether the output is reported as off and no current flows according to its meter,
    /// if any.
    pub fn verified(&self) -> bool {
        if self.commands_zero() || self.is_unswitched() {
            return self.trouble.is_none();
        }
        let metered = METERED.contains(&self.role.as_str());
        self.off
            && !self.lied
            && self.trouble.is_none()
            && (!metered || self.amps.is_some_and(|amps| amps.abs() <= NO_CURRENT_A))
    }

    /// Converts the state into a reading to be stored.
    fn reading(&self, unix_s: f64, by: &str) -> OutputReading {
        let is_metered = METERED.contains(&self.role.as_str());
        let state = if self.is_unswitched() {
            OutputState::Unswitched
        } else if self.commands_zero() {
            OutputState::Zero
        } else if self.verified() {
            OutputState::Off
        } else if self.lied || (!self.off && (self.amps.is_some() || self.holds())) {
            OutputState::On
        } else if self.off && is_metered && self.amps.is_some_and(Amps::is_finite) {
            OutputState::Current
        } else {
            OutputState::Unreachable
        };
        OutputReading {
            role: self.role.clone(),
            model: self.model.clone(),
            state,
            volts: self.volts.map(Volts::value),
            amps: self.amps.map(Amps::value),
            unix_s,
            by: by.to_owned(),
        }
    }

    /// Checks whether the output was left on intentionally, because its offset compensates the
    /// supply's zero error. Nothing tried to switch it off.
    fn holds(&self) -> bool {
        self.role == "generator" && self.by.is_some() && self.trouble.is_none()
    }

    /// Checks whether the output stays on at the command for no current, because no message
    /// switches the supply behind it.
    fn commands_zero(&self) -> bool {
        self.role == "generator" && self.by.as_deref() == Some(ZERO_COMMAND)
    }

    /// Checks whether this is an analog supply, of which only the command is known.
    fn is_unswitched(&self) -> bool {
        self.by.as_deref() == Some(UNSWITCHED)
    }

    /// Returns why the output is not verified, and what to do: one clause of the sentence.
    fn clause(&self, drive_off: bool) -> String {
        let (name, unplug) = (self.name(), self.unplug());
        let bound = self
            .bound
            .as_ref()
            .map_or_else(String::new, |bound| format!(", {bound}"));
        match (self.role.as_str(), self.amps) {
            ("chiller", _) => {
                let since = match &self.by {
                    _ if self.silent => " and it was not reached".to_owned(),
                    Some(by) => format!(" since it was given {by}"),
                    None => String::new(),
                };
                format!(
                    "the relays of {name} are not known to be open{since}; a pulse ends by itself \
                    within a minute: {unplug}"
                )
            }
            ("generator", _) if drive_off => {
                format!(
                    "{name} is not known to be off; the bipolar supply that it commands is off, so \
                    that it drives nothing: {unplug}"
                )
            }
            ("generator", _) => format!(
                "{name} is not known to be off, and it commands the bipolar supply: {unplug}"
            ),
            (_, Some(amps)) if amps.abs() > NO_CURRENT_A && self.off => {
                format!(
                    "{:.2} A may still flow through {name}: its own meter shows them, though it \
                    says that it is off{bound}: {unplug}",
                    amps.abs().0
                )
            }
            (_, Some(amps)) if amps.abs() > NO_CURRENT_A => {
                format!(
                    "{:.2} A still flow through {name} by its own meter{bound}: {unplug}",
                    amps.abs().0
                )
            }
            (_, Some(amps)) if self.lied => {
                let by = self
                    .by
                    .as_ref()
                    .map_or_else(String::new, |by| format!(" until it was given {by}"));
                format!(
                    "{name} says that it is off, but a current flowed{by}; its own meter now shows \
                    {:.2} A: {unplug}",
                    amps.abs().0
                )
            }
            (_, Some(amps)) => {
                let by = self
                    .by
                    .as_ref()
                    .map_or_else(String::new, |by| format!(" since it was given {by}"));
                format!(
                    "{name} does not say that it is off; its own meter shows {:.2} A{by}{bound}: \
                    {unplug}",
                    amps.abs().0
                )
            }
            (_, None) => {
                let text = match (self.out_of_step, self.off) {
                    (true, _) => "its answers do not belong to the questions",
                    (false, true) => "it says that it is off, and its meter does not answer",
                    (false, false) => "it does not answer",
                };
                format!(
                    "whether a current flows through {name} is not known: {text}{bound}: {unplug}"
                )
            }
        }
    }

    fn name(&self) -> String {
        let role = match self.role.as_str() {
            "supply4q" => "the bipolar supply",
            "supply" => "the charger",
            "chiller" => "the bath",
            other => return format!("the {other} ({})", self.model),
        };
        format!("{role} ({})", self.model)
    }

    fn unplug(&self) -> &'static str {
        match self.role.as_str() {
            "supply4q" => "UNPLUG THE BIPOLAR SUPPLY FROM THE CELL",
            "load" => "UNPLUG THE LOAD FROM THE CELL",
            "supply" => "UNPLUG THE CHARGER FROM THE CELL",
            "generator" => SWITCH_IT_OFF,
            _ => "PULL THE PLUGS OF HEATER AND COOLER",
        }
    }

    /// Returns one line for people.
    pub fn line(&self) -> String {
        let meter = match (self.volts, self.amps) {
            (Some(volts), Some(amps)) => format!("; {volts:.4}, {amps:.4}"),
            _ => String::new(),
        };
        let state = match &self.by {
            _ if self.is_unswitched() => format!("{UNSWITCHED}: {SWITCH_IT_OFF}"),
            _ if self.commands_zero() => format!("on at {ZERO_COMMAND}, read back"),
            _ if self.verified() => "off, read back".to_owned(),
            Some(by) if self.holds() => {
                format!("left on at {by}: the supply that it commands is not known to be off")
            }
            _ => "NOT VERIFIED".to_owned(),
        };
        let trouble = self
            .trouble
            .as_ref()
            .map_or_else(String::new, |trouble| format!("; {trouble}"));
        format!(
            "{:<10} {:<20} {state}{meter}{trouble}",
            self.role, self.model
        )
    }
}

/// State of a bath after switching off.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct BathLeft {
    /// Description of the state.
    pub words: String,
    /// True if the bath may drift to a temperature that harms the cell and did not obey the stop
    /// command. A person must check it.
    pub astray: bool,
}

impl BathLeft {
    pub(super) fn harmless(words: String) -> Self {
        Self {
            words,
            astray: false,
        }
    }

    pub(super) fn astray(words: &str) -> Self {
        Self {
            words: format!("LOOK AT THE BATH: {words}"),
            astray: true,
        }
    }
}

impl std::fmt::Display for BathLeft {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.words)
    }
}

/// State of a bench after switching off.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SafeReport {
    /// Its name.
    pub bench: String,
    /// True if every output was read back as off and no meter shows a current.
    pub verified: bool,
    /// State of the bench, in one sentence.
    pub message: String,
    /// All instruments that were switched off.
    pub outputs: Vec<Output>,
    /// State of a bath with its own control loop, if it was checked.
    #[serde(default)]
    pub bath: Option<BathLeft>,
    /// Time of the read-back, s since 1970; null if nothing was read.
    #[serde(default)]
    pub read_unix_s: Option<f64>,
    /// State of the outputs in words, with the time of the reading.
    #[serde(default)]
    pub read: String,
}

impl SafeReport {
    /// Checks whether all outputs that are not verified do not answer.
    pub(super) fn is_silent(&self) -> bool {
        let wrong = |output: &&Output| !output.verified() && !output.holds();
        let mut outputs = self.outputs.iter().filter(wrong).peekable();
        outputs.peek().is_some()
            && outputs.all(|output| !output.off && output.amps.is_none() && !output.out_of_step)
    }

    /// Builds the report from the outputs.
    pub(super) fn of(bench: &str, outputs: Vec<Output>) -> Self {
        let unswitched = outputs.iter().find(|output| output.is_unswitched());
        let drive_off = outputs
            .iter()
            .filter(|output| output.role == "supply4q")
            .all(|output| output.verified() && !output.is_unswitched());
        let verified = outputs.iter().all(Output::verified);
        // A generator that holds the supply's command at zero is not a danger of its own.
        let mut wrong: Vec<&Output> = outputs
            .iter()
            .filter(|output| !output.verified() && !output.holds())
            .collect();
        // The greatest current comes first, then unknown currents.
        wrong.sort_by(|one, other| weight(other).total_cmp(&weight(one)));
        let silent = |output: &&Output| output.amps.is_none() && !output.off && !output.out_of_step;
        let message = if outputs.is_empty() {
            "the bench has nothing that could drive a current".to_owned()
        } else if wrong.is_empty() && unswitched.is_some() {
            let zero = outputs.iter().any(Output::commands_zero);
            let others = if zero {
                "the generator commands zero and every other output"
            } else {
                "every output that the program switches"
            };
            format!("{others} is off, read back")
        } else if wrong.is_empty() {
            "every output is off and was read back, and no current flows".to_owned()
        } else if wrong
            .iter()
            .filter(|output| METERED.contains(&output.role.as_str()))
            .count()
            > 1
            && wrong.iter().all(silent)
        {
            let names = wrong
                .iter()
                .map(|output| output.name())
                .collect::<Vec<_>>()
                .join(", ");
            format!(
                "whether a current flows is not known: {names} do not answer, and nothing but \
                their ratings is known to bound it: UNPLUG THE CELL"
            )
        } else {
            wrong
                .iter()
                .map(|output| output.clause(drive_off))
                .collect::<Vec<_>>()
                .join("; ")
        };
        let message = match unswitched {
            Some(supply) => format!(
                "{message}; {} is {UNSWITCHED}, and no meter shows its current: {SWITCH_IT_OFF}",
                supply.name()
            ),
            None => message,
        };
        let mut report = Self {
            bench: bench.to_owned(),
            verified,
            message,
            outputs,
            bath: None,
            read_unix_s: Some(clock::unix_time_s()),
            read: String::new(),
        };
        report.read = OutputsState::just_read(&report.readings("")).words;
        report
    }

    /// Returns the reading of each output, or nothing if nothing was read.
    pub fn readings(&self, by: &str) -> Vec<OutputReading> {
        let Some(unix_s) = self.read_unix_s else {
            return Vec::new();
        };
        self.outputs
            .iter()
            .map(|output| output.reading(unix_s, by))
            .collect()
    }

    /// Checks whether everything that moves charge is off; a bath may still be on.
    pub fn drives_verified(&self) -> bool {
        self.outputs
            .iter()
            .filter(|output| output.role != "chiller")
            .all(Output::verified)
    }

    /// Checks whether the bath did not answer.
    pub fn bath_is_silent(&self) -> bool {
        self.outputs.iter().any(|output| output.silent)
    }

    /// Adds the state of a bath that closes its own loop. If the bath may harm the cell and could
    /// not be stopped, the report is not verified.
    #[must_use]
    pub fn with_bath(mut self, bath: Option<BathLeft>) -> Self {
        if let Some(bath) = bath.as_ref().filter(|bath| bath.astray) {
            self.message = if self.verified {
                bath.words.clone()
            } else {
                format!("{}; {}", self.message, bath.words)
            };
            self.verified = false;
        }
        Self { bath, ..self }
    }

    /// Returns the report, or an error with its message if anything is not verified.
    ///
    /// # Errors
    /// [`Unsafe`].
    pub fn proven(self) -> Result<Self, Unsafe> {
        if self.verified {
            Ok(self)
        } else {
            Err(Unsafe(Box::new(self)))
        }
    }

    /// Returns the errors of the links, for a log.
    pub fn troubles(&self) -> String {
        let troubles = self
            .outputs
            .iter()
            .filter_map(|output| Some(format!("{}: {}", output.role, output.trouble.as_ref()?)));
        troubles.collect::<Vec<_>>().join("; ")
    }
}

fn weight(output: &Output) -> Amps {
    output.amps.map_or(0.5 * NO_CURRENT_A, Amps::abs)
}

/// A bench whose outputs are not known to be off.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{}", .0.message)]
pub struct Unsafe(pub Box<SafeReport>);

#[cfg(test)]
mod tests {
    use super::*;

    fn output(role: &str, off: bool, amps: Option<Amps>) -> Output {
        Output {
            role: role.to_owned(),
            model: "m".to_owned(),
            off,
            volts: amps.map(|_| Volts(3.7)),
            amps,
            ..Output::default()
        }
    }

    #[test]
    fn one_sentence_says_what_flows_by_whose_reading_what_bounds_it_and_what_to_unplug() {
        let load = Output {
            bound: Some("it stops below 2.5 V".to_owned()),
            ..output("load", false, Some(Amps(3.0)))
        };
        let report = SafeReport::of(
            "demo",
            vec![
                output("supply4q", true, Some(Amps(0.001))),
                output("generator", true, None),
                load,
            ],
        );
        assert!(!report.verified);
        assert_eq!(
            report.message,
            "3.00 A still flow through the load (m) by its own meter, it stops below 2.5 V: UNPLUG \
            THE LOAD FROM THE CELL"
        );
        let report = SafeReport::of("demo", vec![output("supply4q", true, None)]);
        let unknown = "whether a current flows through the bipolar supply (m) is not known: it \
        says that it is off, and its meter does not answer: \
                       UNPLUG THE BIPOLAR SUPPLY FROM THE CELL";
        assert_eq!((report.verified, report.message.as_str()), (false, unknown));
        let zeroed = Output {
            by: Some("its current at 0".to_owned()),
            ..output("supply", false, Some(Amps(0.0)))
        };
        let words = "the charger (m) does not say that it is off; its own meter shows 0.00 A since \
        it was given its current at 0: UNPLUG THE CHARGER FROM \
                     THE CELL";
        assert_eq!(SafeReport::of("demo", vec![zeroed]).message, words);
    }

    #[test]
    fn a_generator_that_was_left_at_its_least_sine_is_reported_as_that() {
        let held = Output {
            by: Some(LEAST_SINE.to_owned()),
            ..output("generator", false, None)
        };
        let report = SafeReport::of(
            "demo",
            vec![output("supply4q", false, Some(Amps(2.0))), held.clone()],
        );
        let words = "2.00 A still flow through the bipolar supply (m) by its own meter: UNPLUG THE \
        BIPOLAR SUPPLY FROM THE CELL";
        assert_eq!((report.verified, report.message.as_str()), (false, words));
        assert_eq!(
            held.line().trim_end(),
            "generator  m                    left on at its least sine: the supply that it \
            commands is not known to be off"
        );
    }

    #[test]
    fn an_analog_supply_is_never_switched_off() {
        let analog = Output {
            model: "analog".to_owned(),
            by: Some(UNSWITCHED.to_owned()),
            ..output("supply4q", false, None)
        };
        let zero = Output {
            by: Some(ZERO_COMMAND.to_owned()),
            ..output("generator", false, None)
        };
        let report = SafeReport::of("thesis", vec![analog.clone(), zero.clone()]);
        let tail = "the bipolar supply (analog) is not switched by this program, and no meter \
        shows its current: SWITCH IT OFF AT ITS PANEL";
        let words = "the generator commands zero and every other output is off, read back";
        assert_eq!(
            (report.verified, report.message.as_str()),
            (true, format!("{words}; {tail}").as_str())
        );
        let states: Vec<OutputState> = report.readings("run").iter().map(|one| one.state).collect();
        assert_eq!(states, [OutputState::Unswitched, OutputState::Zero]);
        assert!(!OutputsState::just_read(&report.readings("run")).is_off());
        // A generator that does not answer may command anything, and the supply follows it.
        let lost = Output {
            trouble: Some("timeout".to_owned()),
            ..output("generator", false, None)
        };
        let report = SafeReport::of("thesis", vec![analog.clone(), lost]);
        let words = "the generator (m) is not known to be off, and it commands the bipolar supply: \
        SWITCH IT OFF AT ITS PANEL";
        assert_eq!(
            (report.verified, report.message.as_str()),
            (false, format!("{words}; {tail}").as_str())
        );
        let refused = Output {
            trouble: Some("clamped".to_owned()),
            ..zero
        };
        assert!(!SafeReport::of("thesis", vec![analog, refused]).verified);
    }

    #[test]
    fn whose_word_was_wrong_is_not_verified_and_whose_answers_are_shifted_has_no_current() {
        let lied = Output {
            lied: true,
            by: Some("its set-points at 0".to_owned()),
            ..output("load", true, Some(Amps(0.0)))
        };
        let report = SafeReport::of("demo", vec![lied]);
        let words = "the load (m) says that it is off, but a current flowed until it was given its \
        set-points at 0; its own meter now shows 0.00 A: UNPLUG THE \
                     LOAD FROM THE CELL";
        assert_eq!((report.verified, report.message.as_str()), (false, words));
        let shifted = Output {
            out_of_step: true,
            ..output("load", true, None)
        };
        let words = "whether a current flows through the load (m) is not known: its answers do not \
        belong to the questions: UNPLUG THE LOAD FROM THE CELL";
        assert_eq!(SafeReport::of("demo", vec![shifted]).message, words);
        let words = "3.00 A may still flow through the load (m): its own meter shows them, though \
        it says that it is off: UNPLUG THE LOAD FROM THE CELL";
        assert_eq!(
            SafeReport::of("demo", vec![output("load", true, Some(Amps(3.0)))]).message,
            words
        );
    }

    #[test]
    fn only_what_is_off_and_carries_nothing_is_verified() {
        for (made, verified) in [
            (output("load", true, Some(Amps(0.05))), true),
            (output("load", true, Some(Amps(0.2))), false),
            (output("load", true, Some(Amps::NAN)), false),
            (output("load", true, None), false),
            (output("load", false, Some(Amps(0.0))), false),
            (output("generator", true, None), true),
            (output("generator", false, None), false),
        ] {
            assert_eq!(
                SafeReport::of("demo", vec![made.clone()]).verified,
                verified,
                "{made:?}"
            );
        }
    }

    #[test]
    fn the_greatest_current_is_reported_first() {
        let report = SafeReport::of(
            "demo",
            vec![
                output("supply4q", false, None),
                output("load", false, Some(Amps(3.0))),
            ],
        );
        assert!(
            report
                .message
                .starts_with("3.00 A still flow through the load"),
            "{}",
            report.message
        );
    }
}
