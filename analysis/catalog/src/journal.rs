//! The lines of a journal that the catalogue stores, read without the rest: a journal contains
//! every point with its harmonics, most of which is irrelevant across runs.

use std::{
    fs::File,
    io::{BufRead, BufReader},
    path::Path,
};

use analysis_files::run_folder::JOURNAL;
use serde::Deserialize;

use crate::record::{CatalogEvent, CatalogEventKind};

/// How a run ends of which nothing is left to do.
pub(crate) const FINISHED: &str = "finished";
/// How the message of the interlock begins, in the message of the end.
const TRIPPED: &str = "interlock: ";
/// Text between the number and time of a line and its entry.
const ENTRY: &[u8] = b"\"entry\":";
/// Farthest place of an entry in its line, bytes: behind a number of 20 digits and a time of 24.
const ENTRY_WITHIN: usize = 96;
/// Entries that are read, as their lines spell them.
const KEPT: [&[u8]; 6] = [
    b"{\"started\"",
    b"{\"note\"",
    b"{\"resumed\"",
    b"{\"asked\"",
    b"{\"answered\"",
    b"{\"ended\"",
];

/// An entry that is kept.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Entry {
    Started {
        version: String,
        experiment: String,
        seed: u64,
        time: String,
    },
    Note {
        #[serde(default)]
        kind: Option<String>,
    },
    Resumed {
        text: String,
    },
    Asked {
        #[serde(default)]
        cell: Option<String>,
        #[serde(default)]
        serial: Option<String>,
    },
    Answered {
        by: String,
        #[serde(default)]
        serial: Option<String>,
    },
    Ended {
        how: String,
    },
}

#[derive(Debug, Deserialize)]
struct Line {
    number: u64,
    time_s: f64,
    entry: Entry,
}

/// A cell that an operator was asked to insert.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct AskedCell {
    /// Its name.
    pub(crate) name: String,
    /// Serial number of the cell, from the experiment.
    pub(crate) serial: Option<String>,
    /// Its serial number as the person read it.
    pub(crate) scanned: Option<String>,
}

/// Facts of a journal across runs.
#[derive(Debug, Default, PartialEq)]
pub(crate) struct Told {
    /// Version of the program.
    pub(crate) version: String,
    /// The experiment.
    pub(crate) experiment: String,
    /// Seed of simulation and searches.
    pub(crate) seed: u64,
    /// How bench time runs.
    pub(crate) time: String,
    /// Events, in their order.
    pub(crate) events: Vec<CatalogEvent>,
    /// Cells that operators were asked to insert.
    pub(crate) cells: Vec<AskedCell>,
    /// Serial number read from a cell without a name.
    pub(crate) scanned: Option<String>,
    /// Person who answered last.
    pub(crate) by: Option<String>,
    /// A state of charge was missed.
    pub(crate) soc_missed: bool,
    /// How often it was resumed.
    pub(crate) resumed: u32,
    /// Last end of the run; `None` if it continues or its process has died.
    pub(crate) how: Option<String>,
    /// The last requested cell without an answer.
    asked: Option<AskedCell>,
}

impl Told {
    /// Returns whether the run has no further work.
    pub(crate) fn is_finished(&self) -> bool {
        self.how.as_deref() == Some(FINISHED)
    }

    /// Message of the interlock that ended it.
    pub(crate) fn trip(&self) -> Option<&str> {
        let how = self.how.as_deref()?;
        how.find(TRIPPED).map(|at| &how[at + TRIPPED.len()..])
    }

    fn take(&mut self, line: Line) {
        let (number, time_s) = (line.number, line.time_s);
        let event = |kind, text: String, by| CatalogEvent {
            line: number,
            time_s,
            kind,
            text,
            by,
        };
        match line.entry {
            Entry::Started {
                version,
                experiment,
                seed,
                time,
            } => {
                (self.version, self.experiment) = (version, experiment);
                (self.seed, self.time) = (seed, time);
            }
            Entry::Note { kind } => self.soc_missed |= kind.as_deref() == Some("soc_missed"),
            Entry::Resumed { text } => {
                (self.how, self.resumed) = (None, self.resumed + 1);
                self.events
                    .push(event(CatalogEventKind::Resumed, text, None));
            }
            Entry::Asked { cell, serial } => {
                let scanned = None;
                self.asked = cell.map(|name| AskedCell {
                    name,
                    serial,
                    scanned,
                });
            }
            Entry::Answered { by, serial } => {
                let text = self
                    .asked
                    .as_ref()
                    .map_or_else(String::new, |cell| cell.name.clone());
                self.by = Some(by.clone());
                self.events
                    .push(event(CatalogEventKind::Answered, text, Some(by)));
                self.answer(serial);
            }
            Entry::Ended { how } => {
                self.how = Some(how.clone());
                let trip = self.trip().map(str::to_owned);
                let kind = trip
                    .as_ref()
                    .map_or(CatalogEventKind::Ended, |_| CatalogEventKind::Trip);
                self.events.push(event(kind, trip.unwrap_or(how), None));
            }
        }
    }

    fn answer(&mut self, serial: Option<String>) {
        match self.asked.take() {
            Some(cell) => self.cells.push(AskedCell {
                scanned: serial,
                ..cell
            }),
            None => self.scanned = serial.or(self.scanned.take()),
        }
    }
}

/// Reads the journal of a run folder. A last line without its end is incomplete and left out.
///
/// # Errors
/// A text: a file that cannot be read, or an unexpected line.
pub(crate) fn read(folder: &Path) -> Result<Told, String> {
    let file = File::open(folder.join(JOURNAL)).map_err(|error| format!("{JOURNAL}: {error}"))?;
    let mut reader = BufReader::with_capacity(1 << 16, file);
    let (mut facts, mut text, mut number) = (Told::default(), Vec::new(), 0_u64);
    loop {
        text.clear();
        let read = reader.read_until(b'\n', &mut text);
        read.map_err(|error| format!("{JOURNAL}: {error}"))?;
        if text.last() != Some(&b'\n') {
            return Ok(facts);
        }
        number += 1;
        match is_kept(&text) {
            Some(true) => {
                let line = serde_json::from_slice(&text).map_err(|error| {
                    format!("{JOURNAL}:{number}: expected a line of a journal, found {error}")
                })?;
                facts.take(line);
            }
            Some(false) => (),
            None => {
                return Err(format!(
                    "{JOURNAL}:{number}: expected a line with the field entry, found none"
                ));
            }
        }
    }
}

/// Whether the entry of a line is one that is kept; none for a line without an entry.
fn is_kept(line: &[u8]) -> Option<bool> {
    let head = &line[..line.len().min(ENTRY_WITHIN)];
    let at = head
        .windows(ENTRY.len())
        .position(|window| window == ENTRY)?;
    let entry = &line[at + ENTRY.len()..];
    Some(KEPT.iter().any(|kept| entry.starts_with(kept)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read_text(text: &str) -> Result<Told, String> {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join(JOURNAL), text).unwrap();
        read(folder.path())
    }

    const STARTED: &str = r#"{"started":{"version":"0.1.0","experiment":"e","seed":3,"time":"real",
        "inherited":false,"files":[],"plan":[]}}"#;

    /// Returns a journal of entries, one to a line.
    fn journal(entries: &[&str]) -> String {
        let line = |(number, entry): (usize, &&str)| {
            let entry = entry.replace('\n', "");
            format!("{{\"number\":{number},\"time_s\":1.0,\"entry\":{entry},\"sha256\":\"0\"}}\n")
        };
        (1..).zip(entries).map(line).collect()
    }

    #[test]
    fn events_are_kept_and_points_are_passed_over() {
        let asked = r#"{"asked":{"text":"t","fixture":"cell","cell":"A","serial":"S1",
            "on_terminal":false}}"#;
        let text = journal(&[
            STARTED,
            asked,
            r#"{"answered":{"question":2,"by":"ann","serial":"S1"}}"#,
            r#"{"point":{"any":1}}"#,
            r#""safe""#,
            r#"{"ended":{"how":"ended early: interlock: voltage 4.3 V"}}"#,
        ]);
        let facts = read_text(&(text + "{\"number\":7,\"torn")).unwrap();
        assert_eq!((facts.seed, facts.by.as_deref()), (3, Some("ann")));
        assert_eq!(facts.cells[0].scanned.as_deref(), Some("S1"));
        let kinds: Vec<_> = facts.events.iter().map(|event| event.kind).collect();
        assert_eq!(kinds, [CatalogEventKind::Answered, CatalogEventKind::Trip]);
        assert_eq!(facts.trip(), Some("voltage 4.3 V"));
        assert!(!facts.is_finished());
    }

    #[test]
    fn a_resumed_run_has_no_end_before_its_last() {
        let resumed = r#"{"resumed":{"text":"x"}}"#;
        let ended = r#"{"ended":{"how":"finished"}}"#;
        let facts = read_text(&journal(&[STARTED, ended, resumed])).unwrap();
        assert_eq!((facts.how, facts.resumed), (None, 1));
        let facts = read_text(&journal(&[STARTED, resumed, ended])).unwrap();
        assert!(facts.is_finished());
    }

    #[test]
    fn a_line_that_is_none_is_reported_with_its_number() {
        let text = journal(&[STARTED]) + "{\"number\":2}\n";
        let error = read_text(&text).unwrap_err();
        assert!(error.ends_with(":2: expected a line with the field entry, found none"));
    }
}
