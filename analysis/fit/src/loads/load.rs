//! Loads of a log with the rests around them, and why one cannot be a run.

use analysis_signal::series::TimeSeries;
use serde::Serialize;

use super::{
    rest::{Rest, mean, rest_of, unfit},
    segment::{self, Course, Segment, inner, median, median_a},
    thresholds::{
        BASE_AFTER_S, BASE_BEFORE_S, COMPARED_BEFORE_S, FEWEST_OF_DISCHARGE, JITTER_PART, LEAD_S,
        LONGEST_PAUSE_S, LONGEST_PULSE_S, RESISTANCE_S, REST_VOLTAGE_S, SHORTEST_CYCLE_S,
    },
};

/// Conditions of a usable load.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LogSearch {
    /// Shortest rest before a load, s.
    pub rest_s: f64,
    /// Longest step between samples of a pulse or a drive cycle, s.
    pub slowest_s: f64,
}

/// Kind of a load.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// A short constant current.
    Pulse,
    /// A long constant current out of the cell.
    Discharge,
    /// A long constant current into the cell.
    Charge,
    /// A current that varies.
    DriveCycle,
}

impl Kind {
    /// Its name in names and tables.
    pub fn word(self) -> &'static str {
        match self {
            Self::Pulse => "pulse",
            Self::Discharge => "discharge",
            Self::Charge => "charge",
            Self::DriveCycle => "cycle",
        }
    }
}

/// A current that flows all the time, on which a pulse stands.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Base {
    /// The current, A, positive for discharge.
    pub current_a: f64,
    /// Voltage at its end, V.
    pub voltage_v: f64,
    /// Time of the log from which the run is compared, s: before it the cell settles under the base.
    pub compare_from_s: f64,
}

/// How a state of charge is known.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum SocFrom {
    /// Charge is counted from a known state on.
    Counted,
    /// A column of the log holds it.
    Column,
    /// The OCV curve has it at the rest voltage.
    RestVoltage,
}

/// A state of charge and how it is known.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct KnownSoc {
    /// State of charge, 0 to 1.
    pub value: f64,
    /// How it is known.
    pub from: SocFrom,
}

/// A load, and the run that it would be.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Load {
    /// Its kind.
    pub kind: Kind,
    /// Median current, A, positive for discharge; of a drive cycle the mean.
    pub current_a: f64,
    /// Start of the load in the log's time, s.
    pub start_s: f64,
    /// Duration of the load, s.
    pub duration_s: f64,
    /// Longest step between its samples, s.
    pub step_s: f64,
    /// Start of the run in the log's time, s.
    pub from_s: f64,
    /// End of the run in the log's time, s.
    pub to_s: f64,
    /// Rest before it; `None` if the load follows another one or begins the log.
    pub rest: Option<Rest>,
    /// Duration of the rest after it, s; 0 if there is none.
    pub rest_after_s: f64,
    /// The current that a pulse stands on; `None` if it follows a rest or another load.
    pub base: Option<Base>,
    /// Resistance of a pulse after 1 s, Ω: the change of the voltage over that of the current.
    pub resistance_1s_ohm: Option<f64>,
    /// Temperature of the cell at the start, °C, if logged.
    #[serde(rename = "temperature_c")]
    pub temperature_degc: Option<f64>,
    /// State of charge at the start, if known.
    pub soc: Option<KnownSoc>,
    /// Reason why the load cannot be a run.
    pub refusal: Option<String>,
    /// Samples of the load.
    #[serde(skip)]
    pub samples: std::ops::Range<usize>,
    /// Samples of the rest before the load, or of the current that a pulse stands on; empty if there
    /// is neither.
    #[serde(skip)]
    pub before: std::ops::Range<usize>,
    /// Course of its current.
    #[serde(skip)]
    pub course: Course,
    /// Sample at which its state of charge counts: the first, or the first of the run on a base.
    #[serde(skip)]
    pub(crate) begin: usize,
    /// Part of the log between two cuts.
    #[serde(skip)]
    pub part: usize,
}

impl Load {
    /// Rest voltage before the load, V.
    pub fn rest_v(&self) -> Option<f64> {
        self.rest.map(|rest| rest.voltage_v)
    }
}

/// The loads of a log, in its order. `steps` holds the number of the cycler's step in each row, if the
/// log has it.
pub fn loads(series: &TimeSeries, steps: Option<&[f64]>, search: &LogSearch) -> Vec<Load> {
    let segments = segment::segments(series, steps);
    let of = |k: usize| -> Option<Load> {
        let load = segments
            .get(k)
            .filter(|segment| !segment.rest && !segment.base)?;
        let beside = |at: Option<usize>| {
            at.and_then(|at| segments.get(at))
                .filter(|rest| rest.rest && rest.part == load.part)
        };
        let before = Before {
            rest: beside(k.checked_sub(1)),
            base: k
                .checked_sub(1)
                .and_then(|at| segments.get(at))
                .filter(|base| base.base && base.part == load.part),
            // The rest then belongs to the load before too.
            shared: k >= 2 && segments[k - 2].part == load.part,
        };
        let after = After {
            rest: beside(Some(k + 1)),
            shared: segments
                .get(k + 2)
                .is_some_and(|next| next.part == load.part),
            load: segments
                .get(k + 1)
                .filter(|next| !next.rest && next.part == load.part),
        };
        Some(one(series, search, load, before, after))
    };
    let mut all: Vec<Load> = (0..segments.len()).filter_map(of).collect();
    for k in 1..all.len() {
        // A load that is left out takes no rest from the one before it.
        if all[k].refusal.is_some() && all[k - 1].rest_after_s > 0.0 {
            let before = &mut all[k - 1];
            before.to_s = before.start_s + before.duration_s + before.rest_after_s;
        }
    }
    all
}

/// Rest before a load.
#[derive(Clone, Copy)]
struct Before<'a> {
    rest: Option<&'a Segment>,
    /// The current that the load stands on.
    base: Option<&'a Segment>,
    shared: bool,
}

/// Rest after a load.
#[derive(Clone, Copy)]
struct After<'a> {
    rest: Option<&'a Segment>,
    shared: bool,
    /// The load that follows without a rest.
    load: Option<&'a Segment>,
}

/// Part of a rest that goes to the load after it, s.
fn lead_s(rest_s: f64, shared: bool) -> f64 {
    LEAD_S.min(if shared { 0.5 * rest_s } else { rest_s })
}

fn one(
    series: &TimeSeries,
    search: &LogSearch,
    load: &Segment,
    before: Before<'_>,
    after: After<'_>,
) -> Load {
    let time_s = &series.time_s;
    let first = load.samples.start;
    let start_s = time_s[first];
    // The load lasts until the first sample without current.
    let off = after
        .rest
        .map_or(load.samples.end - 1, |rest| rest.samples.start);
    let duration_s = match after.load {
        // The next current begins after one more step of the log, or at its own first sample.
        Some(next) => {
            let step_s = longest_step_s(time_s, first..off);
            time_s[next.samples.start].min(time_s[off] + step_s) - start_s
        }
        None => time_s[off] - start_s,
    };
    let course = segment::course(series, load);
    let middle_a = median_a(series, inner(load));
    let kind = match course {
        Course::Constant if duration_s <= LONGEST_PULSE_S => Kind::Pulse,
        Course::Constant if middle_a > 0.0 => Kind::Discharge,
        Course::Constant => Kind::Charge,
        Course::AtLimit | Course::Varying => Kind::DriveCycle,
    };
    let current_a = match course {
        Course::Constant => middle_a,
        Course::AtLimit | Course::Varying => mean(&series.current_a[load.samples.clone()]),
    };
    let rest = before.rest.map(|rest| rest_of(series, rest, start_s));
    let from_s = rest.map_or(start_s, |rest| {
        start_s - lead_s(rest.duration_s, before.shared)
    });
    let end_s = after
        .rest
        .map_or(time_s[off], |rest| time_s[rest.samples.end - 1]);
    let rest_after_s = end_s - time_s[off];
    let to_s = if after.shared {
        end_s - lead_s(rest_after_s, true)
    } else {
        end_s
    };
    let from = before.rest.map_or(first, |rest| {
        time_s[rest.samples.clone()].partition_point(|t| *t < from_s) + rest.samples.start
    });
    let temperature_degc = series
        .temperature_degc
        .as_ref()
        .and_then(|all| all[from..=off].iter().copied().find(|t| t.is_finite()));
    let step_s = longest_step_s(
        time_s,
        first.saturating_sub(usize::from(rest.is_some()))..off,
    );
    let on_base = before.base.filter(|base| {
        let goes_on = after.load.is_some_and(|next| next.base);
        let long = base.lasting_s(series) >= LONGEST_PAUSE_S;
        goes_on && long && kind == Kind::Pulse
    });
    let mut found = Load {
        kind,
        current_a,
        start_s,
        duration_s,
        step_s,
        from_s,
        to_s,
        rest,
        rest_after_s,
        base: None,
        resistance_1s_ohm: rest.filter(|_| kind == Kind::Pulse).and_then(|rest| {
            let before = Point {
                voltage_v: rest.voltage_v,
                current_a: 0.0,
            };
            resistance_ohm(series, load, before)
        }),
        temperature_degc,
        soc: None,
        refusal: None,
        samples: load.samples.clone(),
        before: before
            .rest
            .or(on_base)
            .map_or(first..first, |before| before.samples.clone()),
        course,
        begin: first,
        part: load.part,
    };
    if let Some((base, next)) = on_base.zip(after.load) {
        place_on_base(series, &mut found, load, base, next);
    }
    let rows = before.rest.map_or(first, |rest| rest.samples.start)
        ..after.rest.map_or(load.samples.end, |rest| rest.samples.end);
    let ends = after.rest.is_some() || after.load.is_some();
    found.refusal = damaged(series, rows)
        .or_else(|| refusal(&found, course, search))
        .or_else(|| {
            let open = found.kind == Kind::Pulse && !ends;
            open.then(|| "no rest after it".to_owned())
        });
    found
}

/// Longest step between these samples and those after them, s.
fn longest_step_s(time_s: &[f64], samples: std::ops::Range<usize>) -> f64 {
    samples
        .map(|k| time_s[k + 1] - time_s[k])
        .fold(0.0, f64::max)
}

/// Gives a pulse on a base the run from the base before it to that after it.
fn place_on_base(
    series: &TimeSeries,
    found: &mut Load,
    load: &Segment,
    base: &Segment,
    next: &Segment,
) {
    let time_s = &series.time_s;
    // Half of a short base is left to the pulse on its other side.
    let tail_s = |base: &Segment| BASE_AFTER_S.min(0.5 * base.lasting_s(series));
    let earliest_s = time_s[base.samples.start] + tail_s(base);
    found.from_s = earliest_s.max(found.start_s - BASE_BEFORE_S);
    found.begin = time_s.partition_point(|t| *t < found.from_s);
    found.to_s = found.start_s + found.duration_s + tail_s(next);
    let late = time_s[base.samples.clone()]
        .partition_point(|t| *t < found.start_s - REST_VOLTAGE_S)
        .min(base.samples.len() - 1);
    let before = Point {
        voltage_v: median(series.voltage_v[base.samples.start + late..base.samples.end].to_vec()),
        current_a: median_a(series, inner(base)),
    };
    found.base = Some(Base {
        current_a: before.current_a,
        voltage_v: before.voltage_v,
        compare_from_s: found.from_s.max(found.start_s - COMPARED_BEFORE_S),
    });
    found.resistance_1s_ohm = resistance_ohm(series, load, before);
}

/// Voltage and current before a pulse.
#[derive(Clone, Copy)]
struct Point {
    voltage_v: f64,
    current_a: f64,
}

/// The resistance of a pulse 1 s after its last sample before it, Ω; none if no sample is within half a
/// second of it.
fn resistance_ohm(series: &TimeSeries, load: &Segment, before: Point) -> Option<f64> {
    let begun_s = series.time_s[load.samples.start.checked_sub(1)?];
    let away_s = |k: &usize| (series.time_s[*k] - begun_s - RESISTANCE_S).abs();
    let nearest = load
        .samples
        .clone()
        .min_by(|a, b| away_s(a).total_cmp(&away_s(b)))
        .filter(|k| away_s(k) <= 0.5 * RESISTANCE_S)?;
    let ohm = (before.voltage_v - series.voltage_v[nearest])
        / (series.current_a[nearest] - before.current_a);
    Some(ohm).filter(|ohm| ohm.is_finite())
}

/// Rows of which no run can be made.
fn damaged(series: &TimeSeries, mut rows: std::ops::Range<usize>) -> Option<String> {
    let lacking = rows
        .clone()
        .find(|k| !(series.current_a[*k].is_finite() && series.voltage_v[*k].is_finite()));
    if let Some(k) = lacking {
        let at_s = series.time_s[k];
        return Some(format!(
            "the row at {at_s:.3} s has no current or no voltage"
        ));
    }
    let start = rows.start;
    rows.find(|k| *k > start && series.time_s[*k] <= series.time_s[k - 1])
        .map(|k| format!("the stamp {:.3} s repeats or goes back", series.time_s[k]))
}

/// Why a load cannot be a run.
fn refusal(load: &Load, course: Course, search: &LogSearch) -> Option<String> {
    match load.rest {
        Some(rest) => unfit(&rest, search.rest_s),
        None if load.base.is_some() => None,
        None => Some("no rest before it".to_owned()),
    }
    .or_else(|| refusal_of_load(load, course, search))
}

/// Why the current of a load is none of a run.
fn refusal_of_load(load: &Load, course: Course, search: &LogSearch) -> Option<String> {
    if course == Course::AtLimit {
        return Some("a voltage limit was hit: its current falls at one voltage".to_owned());
    }
    if course == Course::Varying && load.duration_s < SHORTEST_CYCLE_S {
        return Some("its current is not constant".to_owned());
    }
    let slowest_s = match load.kind {
        Kind::Pulse | Kind::DriveCycle => search.slowest_s * (1.0 + JITTER_PART),
        Kind::Discharge | Kind::Charge => load.duration_s / FEWEST_OF_DISCHARGE,
    };
    (load.step_s > slowest_s).then(|| {
        format!(
            "rows are {:.2} s apart, more than {slowest_s:.2} s: logged too slowly, or rows lack",
            load.step_s
        )
    })
}
