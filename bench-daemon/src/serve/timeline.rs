//! Readings and events of a run over time, thinned so that a picture of them is right.
//!
//! Of rows that are too many, stretches of equal time are each told by the rows that hold their
//! least and greatest voltage, current and temperature, and by their first and last: no peak is
//! lost, and every row is one that was read. Fewer rows than asked for are told as they are.

use std::{
    borrow::Cow,
    collections::VecDeque,
    io::{Read, Seek, SeekFrom},
    os::unix::fs::MetadataExt,
    path::{Path, PathBuf},
    sync::{Mutex, PoisonError},
};

use analysis::run_folder::{EVENTS, Event, EventRow, READINGS, ReadingRow};
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use crate::support::confined_path;

/// Rows that tell a stretch at most: first, last, and two extremes of three quantities.
const ROWS_OF_A_STRETCH: usize = 8;
/// Marks that are told at most, the latest: a sweep has some dozens.
const MOST_MARKS: usize = 2000;
/// Runs whose readings are kept in memory: a million rows are 32 MB.
const KEPT_RUNS: usize = 4;

/// A row of readings; what was not read is no number.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Row {
    time_s: f64,
    voltage_v: f64,
    current_a: f64,
    temperature_c: f64,
    /// Charge into the cell since the first row, C.
    charge_c: f64,
}

/// Between two readings of the current that lie further apart nothing is known to have flowed, s.
const CHARGE_GAP_S: f64 = 30.0;

impl From<ReadingRow<'_>> for Row {
    fn from(row: ReadingRow<'_>) -> Self {
        Self {
            time_s: row.time_s,
            voltage_v: row.voltage_v.unwrap_or(f64::NAN),
            current_a: row.current_a.unwrap_or(f64::NAN),
            temperature_c: row.temperature_c.unwrap_or(f64::NAN),
            charge_c: 0.0,
        }
    }
}

/// Readings of a run as far as they were read.
#[derive(Debug)]
struct Known {
    folder: PathBuf,
    inode: u64,
    /// Bytes of the file that are read: whole lines.
    bytes: u64,
    rows: Vec<Row>,
    /// Time and current of the last reading of the current.
    current: Option<(f64, f64)>,
}

impl Known {
    /// Adds a row, with the charge up to it.
    fn push(&mut self, mut row: Row) {
        row.charge_c = self.rows.last().map_or(0.0, |last| last.charge_c);
        if !row.current_a.is_nan() {
            if let Some((time_s, current_a)) = self.current
                && (0.0..=CHARGE_GAP_S).contains(&(row.time_s - time_s))
            {
                row.charge_c += 0.5 * (current_a + row.current_a) * (row.time_s - time_s);
            }
            self.current = Some((row.time_s, row.current_a));
        }
        self.rows.push(row);
    }
}

/// Readings of the runs that were asked for last, so that of a file that grows only what is new is
/// read.
#[derive(Debug, Default)]
pub struct Timelines {
    known: Mutex<VecDeque<Known>>,
}

/// Part of a run that is asked for.
#[derive(Debug, Clone, Copy, Default, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub struct Part {
    /// At most so many rows, 8 to 10 000.
    #[param(minimum = 8, maximum = 10_000)]
    pub most: Option<u16>,
    /// From this bench time on, s.
    pub from_s: Option<f64>,
    /// Up to this bench time, s.
    pub to_s: Option<f64>,
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
    temperature_c: Vec<Option<f64>>,
    /// Charge through the meter since the first reading, C, positive into the cell: its readings
    /// joined by lines, where they lie no more than 30 s apart.
    charge_c: Vec<f64>,
    /// Rows of this part in the file.
    rows: usize,
    /// Every one of them is told.
    whole: bool,
    /// Last bench time of the run, s.
    end_s: f64,
    /// Steps, stages, checks and requests of this part.
    marks: Vec<Mark>,
}

/// An event of a run.
#[derive(Debug, Serialize, ToSchema)]
pub struct Mark {
    /// Bench time, s.
    time_s: f64,
    /// Its kind: `stage`, `step`, `check`, `again`, `request`, `resumed`, `note`.
    kind: &'static str,
    /// In words.
    text: String,
}

impl Timelines {
    /// Reads a part of a run folder; nothing where it has no readings.
    pub fn read(&self, folder: &Path, part: &Part, most: usize) -> Option<Readings> {
        let inside = |time_s: f64| {
            part.from_s.is_none_or(|from_s| time_s >= from_s)
                && part.to_s.is_none_or(|to_s| time_s <= to_s)
        };
        let mut readings = Readings::default();
        {
            let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
            let all = &fresh(&mut known, folder)?.rows;
            readings.end_s = all.last().map_or(0.0, |row| row.time_s);
            // Of the whole run, which may be long, nothing is copied.
            let rows: Cow<'_, [Row]> = if part.from_s.is_none() && part.to_s.is_none() {
                Cow::Borrowed(all)
            } else {
                all.iter()
                    .filter(|row| inside(row.time_s))
                    .copied()
                    .collect()
            };
            let kept = thinned(&rows, most);
            readings.rows = rows.len();
            readings.whole = kept.len() == rows.len();
            let read = |value: f64| Some(value).filter(|value| !value.is_nan());
            for row in kept.into_iter().map(|index| &rows[index]) {
                readings.time_s.push(row.time_s);
                readings.voltage_v.push(read(row.voltage_v));
                readings.current_a.push(read(row.current_a));
                readings.temperature_c.push(read(row.temperature_c));
                readings.charge_c.push(row.charge_c);
            }
        }
        let mut events = String::new();
        if let Some(mut file) = confined_path::open(folder, EVENTS) {
            // What cannot be read is told as far as it could.
            let _ = file.read_to_string(&mut events);
        }
        let marks: Vec<Mark> = events
            .lines()
            .skip(1)
            .filter_map(EventRow::parse)
            .filter(|row| inside(row.time_s))
            .filter_map(|row| {
                let told = |kind: &Event| !matches!(kind, Event::Bench | Event::OutputOn);
                let words = row.text.trim_matches('"').split_whitespace();
                Some(Mark {
                    time_s: row.time_s,
                    kind: row.kind.filter(told)?.label(),
                    text: words.collect::<Vec<_>>().join(" "),
                })
            })
            .collect();
        let first = marks.len().saturating_sub(MOST_MARKS);
        readings.marks = marks.into_iter().skip(first).collect();
        Some(readings)
    }
}

/// The readings of a run with what its file has gained; the run that was asked for longest ago gives
/// its place away.
fn fresh<'a>(known: &'a mut VecDeque<Known>, folder: &Path) -> Option<&'a Known> {
    let mut file = confined_path::open(folder, READINGS)?;
    let meta = file.metadata().ok()?;
    let place = known.iter().position(|one| one.folder == folder);
    let mut one = place.and_then(|place| known.remove(place));
    // Another file in its place is read anew.
    one = one.filter(|one| one.inode == meta.ino() && one.bytes <= meta.len());
    let mut one = one.unwrap_or_else(|| Known {
        folder: folder.to_owned(),
        inode: meta.ino(),
        bytes: 0,
        rows: Vec::new(),
        current: None,
    });
    let mut bytes = Vec::new();
    file.seek(SeekFrom::Start(one.bytes)).ok()?;
    file.read_to_end(&mut bytes).ok()?;
    // A line without its end is still being written.
    let whole = bytes
        .iter()
        .rposition(|byte| *byte == b'\n')
        .map_or(0, |at| at + 1);
    let text = String::from_utf8_lossy(&bytes[..whole]);
    // The head is no row: it has no time.
    let rows = text.lines().filter_map(ReadingRow::parse).map(Row::from);
    rows.for_each(|row| one.push(row));
    one.bytes += whole as u64;
    known.push_front(one);
    known.truncate(KEPT_RUNS);
    known.front()
}

/// Places of at most so many rows that tell the rest, rising.
fn thinned(rows: &[Row], most: usize) -> Vec<usize> {
    if rows.len() <= most {
        return (0..rows.len()).collect();
    }
    let stretches = (most / ROWS_OF_A_STRETCH).max(1);
    let (start_s, end_s) = (rows[0].time_s, rows[rows.len() - 1].time_s);
    let width_s = (end_s - start_s) / stretches as f64;
    let stretch_of = |row: &Row| (((row.time_s - start_s) / width_s) as usize).min(stretches - 1);
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
        for quantity in [
            (|row: &Row| row.voltage_v) as fn(&Row) -> f64,
            |row| row.current_a,
            |row| row.temperature_c,
        ] {
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
    use std::{fs, io::Write as _};

    use super::*;

    fn row(k: usize) -> Row {
        Row {
            time_s: k as f64,
            voltage_v: if k == 777 { 9.0 } else { 3.7 },
            current_a: if k == 1234 { -5.0 } else { 0.0 },
            temperature_c: if k.is_multiple_of(100) {
                25.0
            } else {
                f64::NAN
            },
            charge_c: 0.0,
        }
    }

    #[test]
    fn no_peak_is_lost_and_no_more_rows_are_told_than_asked_for() {
        let rows: Vec<Row> = (0..10_000).map(row).collect();
        for most in [8, 100, 999, 10_000, 20_000] {
            let kept = thinned(&rows, most);
            assert!(kept.len() <= most, "{most}: {}", kept.len());
            assert!(kept.contains(&777) && kept.contains(&1234), "{most}");
            assert!(kept.first() == Some(&0) && kept.last() == Some(&9_999));
            assert!(kept.is_sorted_by(|a, b| a < b));
        }
        assert_eq!(thinned(&rows, 10_000).len(), 10_000);
        assert!(thinned(&[], 8).is_empty());
        // All at one time, as a clock that stands writes them.
        let still: Vec<Row> = (0..50).map(|_| row(0)).collect();
        assert!(thinned(&still, 8).len() <= 8);
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
        assert_eq!(read.charge_c, [0.0, 0.0, 1.0]);
        assert!(read.whole && read.rows == 3 && read.end_s == 3.0);
        let part = Part {
            from_s: Some(1.5),
            to_s: Some(2.5),
            ..Part::default()
        };
        assert_eq!(times(&part), [2.0]);
        // A new file in the place of the old one.
        fs::write(folder.path().join("new"), "time_s\n9.0,rest,3.7,,\n").unwrap();
        fs::rename(folder.path().join("new"), &path).unwrap();
        assert_eq!(times(&whole), [9.0]);
    }
}
