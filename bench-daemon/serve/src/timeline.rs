//! Readings and events of a run over time, thinned without loss of peaks.
//!
//! If there are too many rows, each interval of equal length is represented by its first and last
//! row and by the rows that hold its minimum and maximum voltage, current and temperature. No
//! peak is lost, and every row is one that was read. If there are fewer rows than requested, all
//! of them are returned. Rows of the bath are thinned in the same manner.
use std::{
    borrow::Cow,
    collections::VecDeque,
    io::{Read, Seek, SeekFrom},
    os::unix::fs::MetadataExt,
    path::{Path, PathBuf},
    sync::{Mutex, PoisonError},
};

use analysis::run_folder::{
    self, BATH, BathRow, ENDED_EARLY, ENVELOPE, EVENTS, EnvelopeRow, Event, EventRow, JOURNAL,
    READINGS, ReadingRow,
};
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use bench_core::journal::{Entry, Line, PointDone};
use bench_evaluate::support::present::significant;
use bench_plan::{plan::fixture_name, support::confined_path};

/// Maximum number of rows for an interval: first, last, and two extremes of three quantities.
const ROWS_OF_A_STRETCH: usize = 8;
/// Maximum number of marks, and of bounds, in a reply, the latest: a sweep has some dozens.
const MOST_MARKS: usize = 2000;
/// Runs whose readings are kept in memory: a million rows are 40 MB.
const KEPT_RUNS: usize = 4;
/// Digits of the frequency of a point.
const FREQ_DIGITS: i32 = 4;
/// Maximum time between the journal entry of a pause and its event, s: both describe one pause.
const SAME_S: f64 = 1.0;
/// Journal texts of the failures that latch a bench.
const TRIPS: [&str; 3] = [
    "interlock: ",
    "LOOK AT THE BENCH: ",
    "expected nothing with a voltage in the jig",
];
/// Kind of a mark of a point of a sweep.
const POINT: &str = "point";
/// Kind of a mark where a requested pause begins.
const PAUSE: &str = "pause";
/// Kind of a mark where the run continues.
const GO_ON: &str = "go_on";
/// Kind of a mark of a trip.
const TRIP: &str = "trip";
/// Kind of a mark of another end of the run.
const END: &str = "end";

/// A quantity of a row.
type Quantity<R> = fn(&R) -> f64;

/// Quantities of readings whose peaks are kept.
const OF_READINGS: [Quantity<Row>; 3] = [
    |row| row.voltage_v,
    |row| row.current_a,
    |row| row.temperature_degc,
];
/// Quantities of the bath whose peaks are kept.
const OF_BATH: [Quantity<BathRow>; 2] = [
    |row| row.bath_degc.unwrap_or(f64::NAN),
    |row| row.setpoint_degc.unwrap_or(f64::NAN),
];

/// A row of readings; a quantity that was not read is NaN.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Row {
    time_s: f64,
    voltage_v: f64,
    current_a: f64,
    temperature_degc: f64,
    /// Charge into the cell since the first row, C.
    charge_coulomb: f64,
}

/// Maximum distance of two current readings between which charge is integrated, s.
const CHARGE_GAP_S: f64 = 30.0;

impl From<ReadingRow<'_>> for Row {
    fn from(row: ReadingRow<'_>) -> Self {
        Self {
            time_s: row.time_s,
            voltage_v: row.voltage_v.unwrap_or(f64::NAN),
            current_a: row.current_a.unwrap_or(f64::NAN),
            temperature_degc: row.temperature_degc.unwrap_or(f64::NAN),
            charge_coulomb: 0.0,
        }
    }
}

/// How far a file of a run folder was read.
#[derive(Debug, Default)]
struct Place {
    inode: u64,
    /// Bytes of the file that are read: whole lines.
    bytes: u64,
}

/// Whole lines that a file has gained.
struct Gain {
    text: String,
    /// The file was replaced by another one: earlier content is no longer valid.
    anew: bool,
}

impl Place {
    /// Reads the new part of a file, or returns `None` if it cannot be read.
    fn look(&mut self, folder: &Path, name: &str) -> Option<Gain> {
        let mut file = confined_path::open(folder, name)?;
        let meta = file.metadata().ok()?;
        let anew = self.inode != meta.ino() || self.bytes > meta.len();
        let from = if anew { 0 } else { self.bytes };
        let mut bytes = Vec::new();
        file.seek(SeekFrom::Start(from)).ok()?;
        file.read_to_end(&mut bytes).ok()?;
        // A line without its end is still being written.
        let whole = bytes
            .iter()
            .rposition(|byte| *byte == b'\n')
            .map_or(0, |at| at + 1);
        bytes.truncate(whole);
        *self = Self {
            inode: meta.ino(),
            bytes: from + whole as u64,
        };
        let text = String::from_utf8(bytes)
            .unwrap_or_else(|error| String::from_utf8_lossy(error.as_bytes()).into_owned());
        Some(Gain { text, anew })
    }
}

/// A run as far as its files were read.
#[derive(Debug, Default)]
struct Known {
    folder: PathBuf,
    readings: Place,
    bath: Place,
    journal: Place,
    rows: Vec<Row>,
    /// Time and current of the last reading of the current.
    current: Option<(f64, f64)>,
    bath_rows: Vec<BathRow>,
    noted: JournalMarks,
}

/// Marks and pauses from the journal.
#[derive(Debug, Default)]
struct JournalMarks {
    marks: Vec<Mark>,
    pauses: Vec<Pause>,
}

impl Known {
    /// Reads the new parts of the files, or returns `None` without a file of readings.
    fn look(&mut self) -> Option<()> {
        // The journal is read before the readings, and may be ahead of them.
        if let Some(gain) = self.journal.look(&self.folder, JOURNAL) {
            if gain.anew {
                self.noted = JournalMarks::default();
            }
            let lines = gain.text.lines().map(serde_json::from_str::<Line>);
            // A newer version may write entries that this one does not know.
            lines.flatten().for_each(|line| self.noted.take(&line));
        }
        if let Some(gain) = self.bath.look(&self.folder, BATH) {
            if gain.anew {
                self.bath_rows.clear();
            }
            let rows = gain.text.lines().filter_map(BathRow::parse);
            self.bath_rows.extend(rows);
        }
        let gain = self.readings.look(&self.folder, READINGS)?;
        if gain.anew {
            self.rows.clear();
            self.current = None;
        }
        // The header has no time and is skipped.
        let rows = gain.text.lines().filter_map(ReadingRow::parse);
        rows.map(Row::from).for_each(|row| self.push(row));
        Some(())
    }

    /// Adds a row, with the charge up to it.
    fn push(&mut self, mut row: Row) {
        row.charge_coulomb = self.rows.last().map_or(0.0, |last| last.charge_coulomb);
        if !row.current_a.is_nan() {
            if let Some((time_s, current_a)) = self.current
                && (0.0..=CHARGE_GAP_S).contains(&(row.time_s - time_s))
            {
                row.charge_coulomb += 0.5 * (current_a + row.current_a) * (row.time_s - time_s);
            }
            self.current = Some((row.time_s, row.current_a));
        }
        self.rows.push(row);
    }
}

impl JournalMarks {
    /// Takes the next line of the journal.
    fn take(&mut self, line: &Line) {
        let time_s = line.time_s;
        match &line.entry {
            Entry::Point(done) => self.marks.push(Mark::of_point(done)),
            Entry::Paused => {
                self.mark(time_s.0, PAUSE, "paused on request");
                self.pauses.push(Pause {
                    from_s: time_s.0,
                    to_s: f64::INFINITY,
                });
            }
            Entry::GoneOn => {
                self.end_pause(time_s.0);
                self.mark(time_s.0, GO_ON, "goes on on request");
            }
            Entry::Ended { how } => {
                self.end_pause(time_s.0);
                self.mark(
                    time_s.0,
                    kind_of_end(how),
                    how.strip_prefix(ENDED_EARLY).unwrap_or(how),
                );
            }
            // Its event is a mark already.
            Entry::Resumed { .. } => self.end_pause(time_s.0),
            _ => {}
        }
    }

    fn mark(&mut self, time_s: f64, kind: &'static str, text: &str) {
        self.marks.push(Mark::new(time_s, kind, text));
    }

    fn end_pause(&mut self, time_s: f64) {
        if let Some(pause) = self.pauses.last_mut().filter(|pause| pause.is_open()) {
            pause.to_s = time_s;
        }
    }

    /// Returns whether the journal already contains the event of a request.
    fn has_request(&self, row: &EventRow<'_>) -> bool {
        row.kind == Some(Event::Request)
            && self.marks.iter().any(|mark| {
                [PAUSE, GO_ON].contains(&mark.kind) && (mark.time_s - row.time_s).abs() <= SAME_S
            })
    }
}

/// Kind of the mark of an end of a run.
fn kind_of_end(how: &str) -> &'static str {
    if TRIPS.iter().any(|words| how.contains(words)) {
        TRIP
    } else {
        END
    }
}

/// The runs that were requested last. For a growing file, only the new part is read.
#[derive(Debug, Default)]
pub struct Timelines {
    known: Mutex<VecDeque<Known>>,
}

/// Selects a part of a run.
#[derive(Debug, Clone, Copy, Default, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub struct Part {
    /// Maximum number of rows, 8 to 10 000.
    #[param(minimum = 8, maximum = 10_000)]
    pub most: Option<u16>,
    /// Start of the part, bench time, s.
    pub from_s: Option<f64>,
    /// End of the part, bench time, s.
    pub to_s: Option<f64>,
}

impl Part {
    /// Whether it is the whole run.
    fn is_all(&self) -> bool {
        self.from_s.is_none() && self.to_s.is_none()
    }

    /// Whether it has a bench time.
    fn has(&self, time_s: f64) -> bool {
        self.meets(time_s, time_s)
    }

    /// Returns whether an interval overlaps this part.
    fn meets(&self, from_s: f64, to_s: f64) -> bool {
        self.from_s.is_none_or(|least_s| to_s >= least_s)
            && self.to_s.is_none_or(|greatest_s| from_s <= greatest_s)
    }
}

/// Readings of a run, by column.
#[derive(Debug, Default, Serialize, ToSchema)]
pub struct Readings {
    /// Bench time, s.
    time_s: Vec<f64>,
    /// Voltage, V.
    voltage_v: Vec<Option<f64>>,
    /// Current, A; positive for charge.
    current_a: Vec<Option<f64>>,
    /// Surface temperature of the cell, °C.
    #[serde(rename = "temperature_c")]
    temperature_degc: Vec<Option<f64>>,
    /// Charge through the meter since the first reading, C, positive into the cell: the integral of
    /// readings that are at most 30 s apart, interpolated linearly.
    #[serde(rename = "charge_c")]
    charge_coulomb: Vec<f64>,
    /// Number of rows of this part in the file.
    rows: usize,
    /// True if all rows are returned.
    whole: bool,
    /// Last bench time of the run, s.
    end_s: f64,
    /// The chiller in this part.
    bath: Bath,
    /// Limits of the readings in this part, in order of time. The interlock adds 2 % to the limits
    /// of the current, for the error of the meter.
    envelopes: Vec<Envelope>,
    /// Periods of this part in which the run is paused on request.
    pauses: Vec<Pause>,
    /// Steps, stages, checks, requests, points and ends of this part, by time.
    marks: Vec<Mark>,
}

/// Readings of the chiller, by column.
#[derive(Debug, Default, Serialize, ToSchema)]
pub struct Bath {
    /// Bench time, s. The first may precede this part, because its setpoint is still in effect.
    time_s: Vec<f64>,
    /// Temperature of the bath as reported by the chiller, °C.
    #[serde(rename = "bath_c")]
    bath_degc: Vec<Option<f64>>,
    /// Setpoint, °C.
    #[serde(rename = "setpoint_c")]
    setpoint_degc: Vec<Option<f64>>,
    /// Number of rows of this part in the file.
    rows: usize,
    /// True if all rows are returned.
    whole: bool,
}

/// Limits of a quantity; null if there is none.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, ToSchema)]
pub struct Between {
    /// Lower limit.
    least: Option<f64>,
    /// Upper limit.
    greatest: Option<f64>,
}

/// Limits of each reading over a period, beyond which the present step trips.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, ToSchema)]
pub struct Envelope {
    /// Start, bench time, s.
    from_s: f64,
    /// End, bench time, s.
    to_s: f64,
    /// Voltage, V.
    voltage_v: Between,
    /// Current, A; positive for charge.
    current_a: Between,
    /// Surface temperature of the cell, °C.
    #[serde(rename = "temperature_c")]
    temperature_degc: Between,
}

/// A period in which a run is paused on request.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, ToSchema)]
pub struct Pause {
    /// Start, bench time, s.
    from_s: f64,
    /// End, bench time, s; the end of the run if it is still paused.
    to_s: f64,
}

impl Pause {
    fn is_open(&self) -> bool {
        self.to_s.is_infinite()
    }
}

/// An event of a run.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Mark {
    /// Bench time, s.
    time_s: f64,
    /// Kind: `stage`, `step`, `check`, `again`, `request`, `resumed`, `note`; `point` in the middle
    /// of the record of a point; `pause` and `go_on` on request; `trip` if the run ended and
    /// latched the bench, `end` if it ended otherwise.
    kind: &'static str,
    /// Text of the event.
    text: String,
}

impl Mark {
    fn new(time_s: f64, kind: &'static str, text: &str) -> Self {
        Self {
            time_s,
            kind,
            text: text.split_whitespace().collect::<Vec<_>>().join(" "),
        }
    }

    fn of_point(done: &PointDone) -> Self {
        let point = &done.point;
        let fixture = fixture_name(point.fixture).replace('_', " ");
        let freq = significant(point.phasors.freq_hz, FREQ_DIGITS);
        let refused = if point.failing.is_empty() {
            ""
        } else {
            ", refused by the quality gate"
        };
        Self::new(
            point.time_s.0,
            POINT,
            &format!("{fixture}, {freq} Hz{refused}"),
        )
    }

    /// Converts an event. Returns `None` for events that the bench reports at every step.
    fn of_event(row: &EventRow<'_>) -> Option<Self> {
        let is_mark = |kind: &Event| !matches!(kind, Event::Bench | Event::OutputOn);
        let kind = row.kind.filter(is_mark)?.label();
        Some(Self::new(row.time_s, kind, row.text.trim_matches('"')))
    }
}

impl Timelines {
    /// Reads a part of a run folder, or returns `None` if it has no readings.
    pub fn read(&self, folder: &Path, part: &Part, most: usize) -> Option<Readings> {
        let events = text_of(folder, EVENTS);
        let envelopes = text_of(folder, ENVELOPE);
        let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        let known = fresh(&mut known, folder)?;
        let mut readings = Readings::of(&known.rows, part, most);
        let end_s = readings.end_s;
        readings.bath = Bath::of(&known.bath_rows, part, most);
        readings.envelopes = latest(bounds(&envelopes, end_s, part));
        readings.pauses = pauses(&known.noted.pauses, end_s, part);
        readings.marks = latest(marks(&known.noted, &events, part));
        Some(readings)
    }
}

impl Readings {
    fn of(all: &[Row], part: &Part, most: usize) -> Self {
        // The rows of a whole run, which may be long, are not copied.
        let rows: Cow<'_, [Row]> = if part.is_all() {
            Cow::Borrowed(all)
        } else {
            let inside = all.iter().filter(|row| part.has(row.time_s));
            inside.copied().collect()
        };
        let kept = thinned(&rows, |row| row.time_s, &OF_READINGS, most);
        let mut readings = Self {
            rows: rows.len(),
            whole: kept.len() == rows.len(),
            end_s: all.last().map_or(0.0, |row| row.time_s),
            ..Self::default()
        };
        let read = |value: f64| Some(value).filter(|value| !value.is_nan());
        for row in kept.into_iter().map(|index| &rows[index]) {
            readings.time_s.push(row.time_s);
            readings.voltage_v.push(read(row.voltage_v));
            readings.current_a.push(read(row.current_a));
            readings.temperature_degc.push(read(row.temperature_degc));
            readings.charge_coulomb.push(row.charge_coulomb);
        }
        readings
    }
}

impl Bath {
    fn of(all: &[BathRow], part: &Part, most: usize) -> Self {
        let inside = all.iter().filter(|row| part.has(row.time_s));
        let rows: Vec<BathRow> = inside.copied().collect();
        let kept = thinned(&rows, |row| row.time_s, &OF_BATH, most);
        let mut bath = Self {
            rows: rows.len(),
            whole: kept.len() == rows.len(),
            ..Self::default()
        };
        let before = |from_s: f64| all.iter().rev().find(|row| row.time_s < from_s);
        if let Some(row) = part.from_s.and_then(before) {
            bath.push(row);
        }
        kept.into_iter().for_each(|index| bath.push(&rows[index]));
        bath
    }

    fn push(&mut self, row: &BathRow) {
        self.time_s.push(row.time_s);
        self.bath_degc.push(row.bath_degc);
        self.setpoint_degc.push(row.setpoint_degc);
    }
}

impl From<run_folder::Between> for Between {
    fn from(between: run_folder::Between) -> Self {
        Self {
            least: between.least,
            greatest: between.greatest,
        }
    }
}

/// The text of a file, as far as it can be read.
fn text_of(folder: &Path, name: &str) -> String {
    let mut text = String::new();
    if let Some(mut file) = confined_path::open(folder, name) {
        // A file that cannot be read to its end is used as far as it could be read.
        let _ = file.read_to_string(&mut text);
    }
    text
}

/// Bounds in a part of a run: each holds up to the next, the last up to the end.
fn bounds(text: &str, end_s: f64, part: &Part) -> Vec<Envelope> {
    let rows: Vec<EnvelopeRow> = text.lines().filter_map(EnvelopeRow::parse).collect();
    let ends_s = rows.iter().skip(1).map(|row| row.time_s);
    let ends_s = ends_s.chain(std::iter::once(end_s));
    rows.iter()
        .zip(ends_s)
        .map(|(row, to_s)| Envelope {
            from_s: row.time_s,
            to_s: to_s.max(row.time_s),
            voltage_v: row.voltage_v.into(),
            current_a: row.current_a.into(),
            temperature_degc: row.temperature_degc.into(),
        })
        .filter(|envelope| part.meets(envelope.from_s, envelope.to_s))
        .collect()
}

/// Returns the pauses in a part of a run; an open pause ends with the last reading.
fn pauses(all: &[Pause], end_s: f64, part: &Part) -> Vec<Pause> {
    all.iter()
        .map(|pause| Pause {
            from_s: pause.from_s,
            to_s: if pause.is_open() {
                end_s.max(pause.from_s)
            } else {
                pause.to_s
            },
        })
        .filter(|pause| part.meets(pause.from_s, pause.to_s))
        .collect()
}

/// Marks of journal and events in a part of a run, by time.
fn marks(noted: &JournalMarks, events: &str, part: &Part) -> Vec<Mark> {
    let rows = events.lines().skip(1).filter_map(EventRow::parse);
    let mut marks: Vec<Mark> = rows
        .filter(|row| part.has(row.time_s) && !noted.has_request(row))
        .filter_map(|row| Mark::of_event(&row))
        .collect();
    let of_journal = noted.marks.iter().filter(|mark| part.has(mark.time_s));
    marks.extend(of_journal.cloned());
    marks.sort_by(|one, other| one.time_s.total_cmp(&other.time_s));
    marks
}

/// Returns the latest entries if there are too many.
fn latest<T>(mut all: Vec<T>) -> Vec<T> {
    all.drain(..all.len().saturating_sub(MOST_MARKS));
    all
}

/// A run with what its files have gained; the run that was asked for longest ago gives its place
/// away.
fn fresh<'a>(known: &'a mut VecDeque<Known>, folder: &Path) -> Option<&'a Known> {
    let place = known.iter().position(|one| one.folder == folder);
    let one = place.and_then(|place| known.remove(place));
    let mut one = one.unwrap_or_else(|| Known {
        folder: folder.to_owned(),
        ..Known::default()
    });
    one.look()?;
    known.push_front(one);
    known.truncate(KEPT_RUNS);
    known.front()
}

/// Returns the indices of at most `most` rows that represent all rows, in rising order.
fn thinned<R>(
    rows: &[R],
    time_s: Quantity<R>,
    quantities: &[Quantity<R>],
    most: usize,
) -> Vec<usize> {
    if rows.len() <= most {
        return (0..rows.len()).collect();
    }
    let stretches = (most / ROWS_OF_A_STRETCH).max(1);
    let (start_s, end_s) = (time_s(&rows[0]), time_s(&rows[rows.len() - 1]));
    let width_s = (end_s - start_s) / stretches as f64;
    let stretch_of = |row: &R| (((time_s(row) - start_s) / width_s) as usize).min(stretches - 1);
    let mut kept = Vec::new();
    let mut from = 0;
    while from < rows.len() {
        let stretch = stretch_of(&rows[from]);
        let count = rows[from..]
            .iter()
            .take_while(|row| stretch_of(row) == stretch)
            .count()
            .max(1);
        let part = from..from + count;
        let mut places = vec![part.start, part.end - 1];
        for quantity in quantities {
            let read = || part.clone().filter(|at| !quantity(&rows[*at]).is_nan());
            let order = |a: &usize, b: &usize| quantity(&rows[*a]).total_cmp(&quantity(&rows[*b]));
            places.extend(read().min_by(order));
            places.extend(read().max_by(order));
        }
        places.sort_unstable();
        places.dedup();
        kept.extend(places);
        from = part.end;
    }
    kept
}

#[cfg(test)]
mod tests {
    use instruments::units::{Hertz, Seconds, Volts};
    use std::{fs, io::Write as _};

    use analysis::{
        run_folder::{BATH_COLUMNS, ENVELOPE_COLUMNS, EVENT_COLUMNS, READING_COLUMNS},
        spectrum::{ChannelPhasors, PhasorVariance},
    };
    use instruments::fixture::Fixture;
    use tempfile::TempDir;

    use super::*;
    use bench_core::{executor::ExecuteError, safety::failure::Failure};
    use bench_plan::{
        interlock::{Reading, Trip},
        measure::{HarmonicsAndDrift, Spent, SweepPoint, quality::Measures},
    };

    fn row(k: usize) -> Row {
        Row {
            time_s: k as f64,
            voltage_v: if k == 777 { 9.0 } else { 3.7 },
            current_a: if k == 1234 { -5.0 } else { 0.0 },
            temperature_degc: if k.is_multiple_of(100) {
                25.0
            } else {
                f64::NAN
            },
            charge_coulomb: 0.0,
        }
    }

    fn of_rows(rows: &[Row], most: usize) -> Vec<usize> {
        thinned(rows, |row| row.time_s, &OF_READINGS, most)
    }

    /// A run folder with readings every second from 0 s to 100 s.
    fn run() -> TempDir {
        let folder = tempfile::tempdir().unwrap();
        let rows: Vec<String> = (0..=100)
            .map(|k| format!("{k}.000,rest,3.7,0.0,25.0"))
            .collect();
        write(&folder, READINGS, READING_COLUMNS, &rows.join("\n"));
        folder
    }

    fn write(folder: &TempDir, name: &str, columns: &str, rows: &str) {
        fs::write(folder.path().join(name), format!("{columns}\n{rows}\n")).unwrap();
    }

    fn journal(folder: &TempDir, entries: Vec<(f64, Entry)>) {
        let lines = (1..).zip(entries).map(|(number, (time_s, entry))| {
            let line = Line {
                number,
                time_s: Seconds(time_s),
                entry,
            };
            serde_json::to_string(&line).unwrap() + "\n"
        });
        fs::write(folder.path().join(JOURNAL), lines.collect::<String>()).unwrap();
    }

    fn read(folder: &TempDir, from_s: f64, to_s: f64) -> Readings {
        let part = Part {
            from_s: Some(from_s),
            to_s: Some(to_s),
            ..Part::default()
        };
        Timelines::default()
            .read(folder.path(), &part, 1000)
            .unwrap()
    }

    fn marks_of(readings: &Readings) -> Vec<(f64, &str, &str)> {
        let marks = readings.marks.iter();
        marks
            .map(|mark| (mark.time_s, mark.kind, mark.text.as_str()))
            .collect()
    }

    fn point(time_s: f64) -> Entry {
        let phasors = ChannelPhasors {
            freq_hz: 0.1,
            volts: [num_complex::Complex64::ONE; 4],
            variance: [PhasorVariance::circular(1.0e-12); 4],
        };
        Entry::Point(Box::new(PointDone {
            stage: 0,
            step: 2,
            files: Vec::new(),
            idle: Reading::default(),
            point: SweepPoint {
                fixture: Fixture::FakeCell,
                index: 0,
                phasors,
                volts_per_div: [1.0; 4],
                free_freq_hz: Hertz(0.1),
                residual_lag1: 0.0,
                harmonics_and_drift: HarmonicsAndDrift::default(),
                warnings: Vec::new(),
                time_s: Seconds(time_s),
                captures: 1,
                rechecked: 0,
                spent: Spent::default(),
                measures: Measures::default(),
                failing: Vec::new(),
                conditions: None,
            },
        }))
    }

    fn ended(how: &str) -> Entry {
        Entry::Ended {
            how: how.to_owned(),
        }
    }

    #[test]
    fn the_bath_is_thinned_alike_and_its_setpoint_holds_in_a_later_part() {
        let folder = run();
        assert_eq!(read(&folder, 0.0, 100.0).bath.rows, 0);
        let rows: Vec<String> = (0..50)
            .map(|k| {
                let bath_degc = if k == 33 { 31.0 } else { 25.0 };
                format!("{k}.500,{bath_degc},20.0")
            })
            .collect();
        write(&folder, BATH, BATH_COLUMNS, &rows.join("\n"));
        let timelines = Timelines::default();
        let whole = timelines.read(folder.path(), &Part::default(), 16).unwrap();
        let bath = &whole.bath;
        assert!(bath.rows == 50 && !bath.whole && bath.time_s.len() <= 16);
        assert!(bath.time_s.contains(&33.5) && bath.bath_degc.contains(&Some(31.0)));
        // Exact in a part, with the row before it.
        let bath = read(&folder, 40.0, 42.0).bath;
        assert_eq!(bath.time_s, [39.5, 40.5, 41.5]);
        assert!(bath.whole && bath.rows == 2);
        let bath = read(&folder, 90.0, 91.0).bath;
        assert_eq!((bath.time_s, bath.rows), (vec![49.5], 0));
        assert_eq!(bath.setpoint_degc, [Some(20.0)]);
    }

    #[test]
    fn bounds_hold_up_to_the_next_ones_and_the_last_up_to_the_end() {
        let folder = run();
        let rows = "10.000,2.5,4.2,-0.1,0.1,0.0,60.0\n20.000,-1.0,1.0,-5.6,5.6,,60.0";
        write(&folder, ENVELOPE, ENVELOPE_COLUMNS, rows);
        let spans = |from_s, to_s| -> Vec<(f64, f64)> {
            let envelopes = read(&folder, from_s, to_s).envelopes;
            envelopes
                .iter()
                .map(|envelope| (envelope.from_s, envelope.to_s))
                .collect()
        };
        assert_eq!(spans(0.0, 100.0), [(10.0, 20.0), (20.0, 100.0)]);
        assert_eq!(spans(12.0, 13.0), [(10.0, 20.0)]);
        assert!(spans(0.0, 9.0).is_empty());
        let last = read(&folder, 50.0, 60.0).envelopes[0];
        let between = |least, greatest| Between { least, greatest };
        assert_eq!(last.current_a, between(Some(-5.6), Some(5.6)));
        assert_eq!(last.temperature_degc, between(None, Some(60.0)));
    }

    #[test]
    fn a_pause_is_a_stretch_and_its_request_is_reported_once() {
        let folder = run();
        let pause = |entries: Vec<(f64, Entry)>| {
            journal(&folder, entries);
            let pauses = read(&folder, 0.0, 100.0).pauses;
            pauses
                .iter()
                .map(|pause| (pause.from_s, pause.to_s))
                .collect::<Vec<_>>()
        };
        let began = (30.0, Entry::Paused);
        let text = "from the journal".to_owned();
        let resumed = Entry::Resumed { text };
        // The pause is still open, or ends by one of three causes.
        assert_eq!(pause(vec![began.clone()]), [(30.0, 100.0)]);
        for end in [
            resumed,
            ended("ended early: ended on request"),
            Entry::GoneOn,
        ] {
            let entries = vec![began.clone(), (40.0, end)];
            assert_eq!(pause(entries), [(30.0, 40.0)]);
        }
        let events = "5.000,request,\"another\"\n30.010,request,\"paused on request: off\"\n\
            40.010,request,\"goes on\"";
        write(&folder, EVENTS, EVENT_COLUMNS, events);
        let whole = read(&folder, 0.0, 100.0);
        let expected = [
            (5.0, "request", "another"),
            (30.0, PAUSE, "paused on request"),
            (40.0, GO_ON, "goes on on request"),
        ];
        assert_eq!(marks_of(&whole), expected);
        // A part in the middle of the run contains no marks.
        let part = read(&folder, 34.0, 36.0);
        assert!(part.marks.is_empty() && part.pauses.len() == 1);
    }

    #[test]
    fn points_and_ends_are_marks_between_the_events() {
        let folder = run();
        let events = "1.000,stage,\"EIS sweep\"\n2.000,bench,\"load: off\"\n50.000,note,\"odd\"";
        write(&folder, EVENTS, EVENT_COLUMNS, events);
        let how = "ended early: interlock: cell voltage 4.3 V left its limits";
        journal(&folder, vec![(60.0, point(20.0)), (70.0, ended(how))]);
        let expected = [
            (1.0, "stage", "EIS sweep"),
            (20.0, POINT, "fake cell, 0.1000 Hz"),
            (50.0, "note", "odd"),
            (70.0, TRIP, "interlock: cell voltage 4.3 V left its limits"),
        ];
        assert_eq!(marks_of(&read(&folder, 0.0, 100.0)), expected);
        journal(&folder, vec![(70.0, ended("finished"))]);
        assert_eq!(
            marks_of(&read(&folder, 60.0, 100.0)),
            [(70.0, END, "finished")]
        );
    }

    #[test]
    fn what_latches_a_bench_is_a_trip_and_a_request_is_none() {
        let trip = Trip::Chiller {
            message: "STOP".to_owned(),
            time_s: Seconds(1.0),
        };
        let left_in = ExecuteError::CellLeftIn {
            what: "mount".to_owned(),
            volts: Volts(3.7),
        };
        let unproven = Failure::Unsafe {
            failures: "load".to_owned(),
            cause: String::new(),
        };
        for (failure, kind) in [
            (ExecuteError::from(trip).into(), TRIP),
            (left_in.into(), TRIP),
            (unproven, TRIP),
            (ExecuteError::Aborted.into(), END),
            (Failure::Interrupted("runs/a".to_owned()), END),
        ] {
            let how = format!("{ENDED_EARLY}{failure}");
            assert_eq!(kind_of_end(&how), kind, "{how}");
        }
    }

    #[test]
    fn no_peak_is_lost_and_no_more_rows_are_sent_than_asked_for() {
        let rows: Vec<Row> = (0..10_000).map(row).collect();
        for most in [8, 100, 999, 10_000, 20_000] {
            let kept = of_rows(&rows, most);
            assert!(kept.len() <= most, "{most}: {}", kept.len());
            assert!(kept.contains(&777) && kept.contains(&1234), "{most}");
            assert!(kept.first() == Some(&0) && kept.last() == Some(&9_999));
            assert!(kept.is_sorted_by(|a, b| a < b));
        }
        assert_eq!(of_rows(&rows, 10_000).len(), 10_000);
        assert!(of_rows(&[], 8).is_empty());
        // All rows have one time, as a stopped clock writes them.
        let still: Vec<Row> = (0..50).map(|_| row(0)).collect();
        assert!(of_rows(&still, 8).len() <= 8);
    }

    #[test]
    fn of_a_file_that_grows_only_what_is_new_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(READINGS);
        let timelines = Timelines::default();
        let whole = Part::default();
        assert!(timelines.read(folder.path(), &whole, 8).is_none());
        fs::write(
            &path,
            "time_s,phase,voltage_v,current_a,temperature_c\n1.0,rest,3.7,0.0,25.0\n2.0,re",
        )
        .unwrap();
        let times = |part: &Part| timelines.read(folder.path(), part, 100).unwrap().time_s;
        assert_eq!(times(&whole), [1.0]);
        let mut file = fs::File::options().append(true).open(&path).unwrap();
        write!(file, "st,3.6,,\n3.0,rest,3.5,1.0,\n").unwrap();
        assert_eq!(times(&whole), [1.0, 2.0, 3.0]);
        let read = timelines.read(folder.path(), &whole, 100).unwrap();
        assert_eq!(read.current_a, [Some(0.0), None, Some(1.0)]);
        // A line from 0 A at 1 s to 1 A at 3 s; a reading without a current is passed over.
        assert_eq!(read.charge_coulomb, [0.0, 0.0, 1.0]);
        assert!(read.whole && read.rows == 3 && read.end_s == 3.0);
        let part = Part {
            from_s: Some(1.5),
            to_s: Some(2.5),
            ..Part::default()
        };
        assert_eq!(times(&part), [2.0]);
        // A new file replaces the old one.
        fs::write(folder.path().join("new"), "time_s\n9.0,rest,3.7,,\n").unwrap();
        fs::rename(folder.path().join("new"), &path).unwrap();
        assert_eq!(times(&whole), [9.0]);
    }
}
