//! Runs of a data set from the loads of logs and from spectra: names, repeats, split.

use analysis::{
    diagnosis::Role,
    loads::{Kind, Load},
};
use serde::Serialize;

use super::thresholds::{
    FEWEST_STATES, REPEAT_SOC, REPEAT_TEMPERATURE_C, REPEAT_V, SAME_CURRENT_PART,
    SAME_DURATION_PART, STATE_SOC, STATE_TEMPERATURE_C, STATE_V,
};

/// A log and its loads.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FoundLog {
    /// Its path from the folder of the data set.
    pub file: String,
    /// Name for runs.
    pub name: String,
    /// Time between its first and its last row, s.
    pub lasting_s: f64,
    /// Temperature that is used in the place of its own.
    pub temperature: Option<TestTemperature>,
    /// Remarks on the content of the file and on contradictions to it.
    pub notes: Vec<String>,
    /// Its loads.
    pub loads: Vec<Load>,
}

/// A temperature of a whole log.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TestTemperature {
    /// Temperature, °C.
    pub celsius: f64,
    /// Where it stands, for a comment.
    pub source: String,
}

/// Circumstances of a run that other runs are compared with.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Place {
    /// State of charge.
    pub soc: Option<f64>,
    /// Rest voltage, V.
    pub ocv_v: Option<f64>,
    /// Temperature, °C.
    #[serde(rename = "temperature_c")]
    pub temperature_degc: Option<f64>,
}

impl Place {
    /// Returns whether both are equal within these tolerances. A value that one of them lacks
    /// counts as equal.
    fn is_near(&self, other: &Self, within: &Tolerance) -> bool {
        let near = |a: Option<f64>, b: Option<f64>, most: f64| match (a, b) {
            (Some(a), Some(b)) => (a - b).abs() < most,
            _ => true,
        };
        near(
            self.temperature_degc,
            other.temperature_degc,
            within.temperature_degc,
        ) && match (self.soc, other.soc) {
            (Some(_), Some(_)) => near(self.soc, other.soc, within.soc),
            _ => near(self.ocv_v, other.ocv_v, within.ocv_v),
        }
    }

    /// The temperature alone.
    fn without_state(self) -> Self {
        Self {
            temperature_degc: self.temperature_degc,
            ..Self::default()
        }
    }

    /// The state alone.
    fn without_temperature(self) -> Self {
        Self {
            temperature_degc: None,
            ..self
        }
    }

    /// Describes the state of charge or the rest voltage.
    pub(super) fn state(&self) -> String {
        match (self.soc, self.ocv_v) {
            (Some(soc), _) => format!("{:.1} % SOC", 100.0 * soc),
            (None, Some(ocv_v)) => format!("{ocv_v:.4} V"),
            (None, None) => "an unknown state".to_owned(),
        }
    }
}

/// Distances within which two places are one.
struct Tolerance {
    soc: f64,
    ocv_v: f64,
    temperature_degc: f64,
}

const REPEAT: Tolerance = Tolerance {
    soc: REPEAT_SOC,
    ocv_v: REPEAT_V,
    temperature_degc: REPEAT_TEMPERATURE_C,
};

const STATE: Tolerance = Tolerance {
    soc: STATE_SOC,
    ocv_v: STATE_V,
    temperature_degc: STATE_TEMPERATURE_C,
};

/// A run that is proposed.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ProposedRun {
    /// Unique name.
    pub name: String,
    /// Number of its log, from 0.
    pub log: usize,
    /// Number of its load in the log, from 0.
    pub load: usize,
    /// Circumstances at its start.
    pub place: Place,
    /// Group of repeats.
    pub repeat_group: String,
    /// Time of its start in the campaign, s.
    pub start_s: f64,
    /// Purpose.
    pub role: Role,
    /// Reason for the purpose, as text.
    pub reason: String,
}

/// A spectrum of a file.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FoundSpectrum {
    /// Name of the run.
    pub name: String,
    /// Path of its file from the folder of the data set.
    pub file: String,
    /// Name in the file, if the file contains several.
    pub among: Option<String>,
    /// Number of points.
    pub points: usize,
    /// Lowest used frequency, Hz; `None` if all are used.
    pub from_hz: Option<f64>,
    /// Highest used frequency, Hz; `None` if all are used.
    pub to_hz: Option<f64>,
    /// Whether `to_hz` leaves out inductive points.
    pub inductive: bool,
    /// Circumstances as stated.
    pub place: Place,
    /// Values of `place` that were not stated: they are copied from the runs in time.
    pub assumed: Vec<String>,
    /// Reason why it is not used.
    pub refusal: Option<String>,
}

/// Runs of the usable loads, in the order of the logs.
pub fn propose(logs: &[FoundLog]) -> Vec<ProposedRun> {
    let mut runs: Vec<ProposedRun> = Vec::new();
    let mut free_s = 0.0;
    for (log, found) in logs.iter().enumerate() {
        let usable = || {
            found
                .loads
                .iter()
                .enumerate()
                .filter(|(_, load)| load.refusal.is_none())
        };
        let zero_s = usable().next().map_or(0.0, |(_, load)| load.from_s);
        let mut end_s = free_s;
        for (number, load) in usable() {
            let start_s = free_s + load.from_s - zero_s;
            end_s = start_s + load.to_s - load.from_s;
            let word = load.kind.word();
            let of_log = if logs.len() > 1 {
                format!("{}_", found.name)
            } else {
                String::new()
            };
            let name = format!("{of_log}{word}_{}_{}", number + 1, amperes(load));
            runs.push(ProposedRun {
                repeat_group: name.clone(),
                name,
                log,
                load: number,
                place: Place {
                    soc: load.soc.map(|soc| soc.value),
                    ocv_v: load.rest_v(),
                    temperature_degc: (found.temperature.as_ref())
                        .map(|temperature| temperature.celsius)
                        .or(load.temperature_degc),
                },
                start_s,
                role: Role::Train,
                reason: String::new(),
            });
        }
        free_s = end_s;
    }
    group(&mut runs, logs);
    split(&mut runs, logs);
    runs
}

/// A current as a part of a name.
fn amperes(load: &Load) -> String {
    let size = load.current_a.abs();
    let digits = if size < 0.1 { 3 } else { 2 };
    let direction = match load.kind {
        Kind::Pulse if load.current_a < 0.0 => "_charge",
        _ => "",
    };
    format!("{size:.digits$}A{direction}")
}

fn load_of<'a>(run: &ProposedRun, logs: &'a [FoundLog]) -> &'a Load {
    &logs[run.log].loads[run.load]
}

fn same_current(a: &Load, b: &Load) -> bool {
    (a.current_a - b.current_a).abs() <= SAME_CURRENT_PART * a.current_a.abs()
}

/// Gives pulses that repeat an earlier one its group.
fn group(runs: &mut [ProposedRun], logs: &[FoundLog]) {
    for later in 1..runs.len() {
        let (before, rest) = runs.split_at_mut(later);
        let Some(run) = rest.first_mut() else { return };
        let load = load_of(run, logs);
        let repeats = |first: &&ProposedRun| {
            let other = load_of(first, logs);
            let step_s = load.step_s.max(other.step_s);
            let apart_s = (load.duration_s - other.duration_s).abs();
            load.kind == Kind::Pulse
                && other.kind == Kind::Pulse
                && first.repeat_group == first.name
                && same_current(other, load)
                && apart_s <= (SAME_DURATION_PART * other.duration_s).max(step_s)
                && first.place.is_near(&run.place, &REPEAT)
        };
        if let Some(first) = before.iter().find(repeats) {
            run.repeat_group = first.repeat_group.clone();
        }
    }
}

/// Holds out, at each state and in each direction, the pulses of the largest and of a middle current where at least two
/// currents are left to train; of several drive cycles the last one.
fn split(runs: &mut [ProposedRun], logs: &[FoundLog]) {
    let mut waiting: Vec<usize> = (0..runs.len())
        .filter(|k| load_of(&runs[*k], logs).kind == Kind::Pulse)
        .collect();
    // The states of the discharges and of the charges.
    let mut states: [Vec<Vec<usize>>; 2] = [Vec::new(), Vec::new()];
    while let Some(first) = waiting.first().copied() {
        let place = runs[first].place;
        let charges = |k: &usize| load_of(&runs[*k], logs).current_a < 0.0;
        let charging = charges(&first);
        let (here, elsewhere) = waiting
            .into_iter()
            .partition(|k| runs[*k].place.is_near(&place, &STATE) && charges(k) == charging);
        waiting = elsewhere;
        split_state(runs, &here, logs);
        states[usize::from(charging)].push(here);
    }
    let any = runs.iter().any(|run| run.role == Role::HeldOut);
    for of_direction in states.iter().filter(|_| !any) {
        split_states(runs, of_direction);
    }
    let cycles: Vec<usize> = (0..runs.len())
        .filter(|k| load_of(&runs[*k], logs).kind == Kind::DriveCycle)
        .collect();
    for k in &cycles {
        let is_last = cycles.len() > 1 && cycles.last() == Some(k);
        runs[*k].role = role(is_last);
        runs[*k].reason = match (is_last, cycles.len()) {
            (true, _) => "the last of several drive cycles is held out",
            (false, 1) => "the only drive cycle trains",
            (false, _) => "a drive cycle before the last trains",
        }
        .to_owned();
    }
    for run in runs.iter_mut().filter(|run| run.reason.is_empty()) {
        run.reason = "long constant currents train".to_owned();
    }
}

/// Holds out every other state of a direction where none has enough currents and there are at least
/// three.
fn split_states(runs: &mut [ProposedRun], states: &[Vec<usize>]) {
    if states.len() < FEWEST_STATES {
        return;
    }
    for k in states.iter().skip(1).step_by(2).flatten() {
        runs[*k].role = role(true);
        runs[*k].reason = "every other state is held out, for each has too few currents".to_owned();
    }
}

fn role(held_out: bool) -> Role {
    if held_out { Role::HeldOut } else { Role::Train }
}

/// Splits the pulses of one state and direction.
fn split_state(runs: &mut [ProposedRun], here: &[usize], logs: &[FoundLog]) {
    // One load for each current, by rising magnitude.
    let mut levels: Vec<&Load> = Vec::new();
    for k in here {
        let load = load_of(&runs[*k], logs);
        if !levels.iter().any(|level| same_current(level, load)) {
            levels.push(load);
        }
    }
    levels.sort_by(|a, b| a.current_a.abs().total_cmp(&b.current_a.abs()));
    let count = levels.len();
    let largest = (count >= 3).then(|| count - 1);
    let middle = (count >= 4).then(|| (count - 1) / 2);
    for k in here {
        let load = load_of(&runs[*k], logs);
        let level = levels.iter().position(|level| same_current(level, load));
        let (held_out, reason) = match level {
            _ if count < 3 => (
                false,
                "too few currents at this state and in this direction: all train",
            ),
            level if level == largest => (
                true,
                "the largest current at this state and direction is held out",
            ),
            level if level == middle => (
                true,
                "a middle current at this state and direction is held out",
            ),
            _ => (
                false,
                "the other currents at this state and direction train",
            ),
        };
        runs[*k].role = role(held_out);
        reason.clone_into(&mut runs[*k].reason);
    }
}

/// Completes the conditions of spectra with those of the runs, and refuses spectra that were
/// measured under other conditions.
pub fn check_spectra(spectra: &mut [FoundSpectrum], runs: &[ProposedRun]) {
    let first = runs.first().map(|run| run.place);
    for spectrum in spectra.iter_mut().filter(|one| one.refusal.is_none()) {
        let place = &mut spectrum.place;
        // Its missing keys are written as comments then.
        let Some(first) = first else { continue };
        let lacks_state = place.soc.or(place.ocv_v).is_none();
        let several = [
            (
                place.temperature_degc.is_none(),
                Place::without_state as fn(Place) -> Place,
                "temperature",
            ),
            (lacks_state, Place::without_temperature, "state"),
        ];
        let open = several.into_iter().find(|(lacks, part, _)| {
            let alike = |run: &ProposedRun| part(run.place).is_near(&part(first), &STATE);
            *lacks && !runs.iter().all(alike)
        });
        if let Some((_, _, what)) = open {
            let option = if what == "state" {
                "soc=SOC"
            } else {
                "temperature_c=C"
            };
            spectrum.refusal = Some(format!(
                "its {what} is not stated, and the runs have several: --at {}:{option} states it",
                spectrum.name
            ));
            continue;
        }
        if place.temperature_degc.is_none() && first.temperature_degc.is_some() {
            place.temperature_degc = first.temperature_degc;
            spectrum.assumed.push("temperature_c".to_owned());
        }
        if lacks_state {
            place.ocv_v = first.ocv_v;
            place.soc = first.soc.filter(|_| first.ocv_v.is_none());
            let key = if first.ocv_v.is_some() {
                "ocv_v"
            } else {
                "soc"
            };
            spectrum.assumed.push(key.to_owned());
        }
        if !runs.iter().any(|run| run.place.is_near(place, &STATE)) {
            let at = |place: &Place| match place.temperature_degc {
                Some(celsius) => format!("{} and {celsius:.1} °C", place.state()),
                None => place.state(),
            };
            spectrum.refusal = Some(format!(
                "it was taken at {}, the first run at {}",
                at(place),
                at(&first)
            ));
        }
    }
}
