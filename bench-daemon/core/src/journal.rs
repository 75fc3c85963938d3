//! Journal of a run: each step is on disk before it begins, and its result as soon as it is done.
//! A run whose process died is resumed from the journal.
//!
//! Each line contains one entry: a JSON object with its number, the bench time, the entry, and
//! last the first 16 hexadecimal digits of the SHA-256 of everything before. Lines are only ever
//! appended, and synced before the step that they name begins. A last line without a line end is
//! incomplete: it is cut off and kept in `journal.torn`. Any other defect of a line is an error.
//!
//! What follows from the entries for a resumed run is determined elsewhere
//! ([`crate::journal::replay`]).

pub mod replay;

use std::{
    fs::{File, OpenOptions, TryLockError},
    io::{self, Write},
    os::unix::fs::MetadataExt,
    path::{Path, PathBuf},
};

use analysis_files::run_folder::{JOURNAL, TORN_JOURNAL};
use instruments::{
    clock::{Clock, TimeMode},
    exchange::Identity,
    units::{Coulombs, Seconds},
};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::{
    bench::{Identified, state_readback::InstrumentReadback},
    clock::TypedClock,
    operator::question::{Answer, Question},
};
use bench_plan::{interlock::Reading, measure::SweepPoint, support::crash_point::Drill};

/// Beginning of a note in an older journal that means that the state of charge was missed.
const SOC_MISSED: &str = "SOC reset: expected ";
/// Text before the checksum of a line.
const CHECKSUM: &str = ",\"sha256\":\"";

/// Error while writing or validating a journal.
#[derive(Debug, thiserror::Error)]
pub enum JournalError {
    /// The file system reported an error.
    #[error("{path}: {what}: {source}; without a journal nothing may be begun", path = path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Operation that failed.
        what: &'static str,
        /// Error of the operating system.
        source: io::Error,
    },
    /// The folder contains no journal.
    #[error("{path}: cannot be read: {source}; expected the folder of a run", path = path.display())]
    Unread {
        /// The file.
        path: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
    /// A line differs from what was written.
    #[error("{path}:{line}: expected {expected}, found {found}", path = path.display())]
    Line {
        /// The file.
        path: PathBuf,
        /// Number of the line, from 1.
        line: usize,
        /// Expected content.
        expected: String,
        /// Content that was found.
        found: String,
    },
}

/// One entry.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Entry {
    /// The first entry: the identity of the run.
    Started(Box<Started>),
    /// A stage of the plan begins, or is restarted. Stages and steps count from 0.
    Stage {
        /// Its number.
        stage: usize,
    },
    /// A step is about to begin.
    Intent {
        /// The stage.
        stage: usize,
        /// The step.
        step: usize,
        /// The step, as text.
        text: String,
        /// Whether current may flow in it.
        live: bool,
    },
    /// A step was done.
    Done {
        /// The stage.
        stage: usize,
        /// The step.
        step: usize,
    },
    /// A point of a sweep was measured; its captures are on disk.
    Point(Box<PointDone>),
    /// A stage is done, and all its results are on disk.
    StageDone {
        /// Its number.
        stage: usize,
    },
    /// The charge of the cell that a map counts: since it was full, C, charge positive.
    Charge {
        /// The charge, C.
        #[serde(rename = "charge_c")]
        charge_coulomb: Coulombs,
    },
    /// A crash has left the charge of the cell unknown: a SOC reset and then a stage are executed
    /// again, and the charge is known when the reset is done.
    ChargeUnknown {
        /// The stage of the reset.
        reset: usize,
        /// The stage that was interrupted.
        open: usize,
    },
    /// A note for the report.
    Note(Note),
    /// The identities that the instruments reported: at the start of the run, and again if a
    /// person has accepted other ones.
    Instruments(Vec<InstrumentIdentity>),
    /// State of an instrument that a resumed run found before it changed anything.
    Found(InstrumentReadback),
    /// The run continues after its process had died or been stopped.
    Resumed {
        /// Where it continues, as text.
        text: String,
    },
    /// Every output is off and read back, and no current flows.
    Safe,
    /// The run is paused on request; no current flows.
    Paused,
    /// The run continues on request.
    GoneOn,
    /// A person is asked to change the fixture while every output is off; the number of this line
    /// is that of the question.
    Asked(Question),
    /// The change was confirmed.
    Answered(Answer),
    /// The run completed or was ended; `finished` if nothing remains to be done.
    Ended {
        /// How.
        how: String,
    },
}

/// An instrument as it identified itself.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct InstrumentIdentity {
    /// Its role.
    pub role: String,
    /// The complete answer.
    pub identity: String,
    /// Its serial number, if it reports one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub serial: Option<String>,
}

impl InstrumentIdentity {
    /// Creates the identity from the role and the answer of an instrument.
    pub fn of(identified: &Identified) -> Self {
        let identity = &identified.identity;
        Self {
            role: identified.role.to_owned(),
            identity: identity.raw.clone(),
            serial: identity.has_serial().then(|| identity.serial.clone()),
        }
    }

    /// Returns the identity, split into its parts.
    pub fn parsed(&self) -> Identity {
        Identity::parse(&self.identity)
    }
}

/// A note for the report.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Note {
    /// In words.
    pub text: String,
    /// Its kind, if results depend on it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub kind: Option<NoteKind>,
}

/// Kind of a note that results depend on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum NoteKind {
    /// The state of charge differs from the requested one.
    SocMissed,
}

impl Note {
    /// Creates a note on which no result depends.
    pub fn of(text: &str) -> Self {
        Self {
            text: text.to_owned(),
            kind: None,
        }
    }

    /// Checks whether the note means that the state of charge was missed. Older journals contain
    /// only text.
    pub fn is_soc_missed(&self) -> bool {
        self.kind == Some(NoteKind::SocMissed) || self.text.contains(SOC_MISSED)
    }
}

/// Identity of a run, sufficient to check whether a resumed run is the same.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Started {
    /// Version of the program.
    pub version: String,
    /// Name of the experiment.
    pub experiment: String,
    /// Seed of simulation and searches.
    pub seed: u64,
    /// Time mode of the bench.
    pub time: String,
    /// Whether it began on a simulated bench that had been used before, or with the correction of
    /// another run.
    pub inherited: bool,
    /// The files that it was read from, the experiment first, then the bench.
    pub files: Vec<ConfigCopy>,
    /// The stages of the plan: the first 16 digits of the SHA-256 of each.
    pub plan: Vec<String>,
}

/// A configuration file and its copy in the run folder.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ConfigCopy {
    /// Original path.
    pub path: PathBuf,
    /// The copy, relative to the run folder.
    pub copy: String,
    /// SHA-256 of its text.
    pub sha256: String,
}

/// A point that was measured.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PointDone {
    /// The stage.
    pub stage: usize,
    /// The step.
    pub step: usize,
    /// Its captures, relative to the run folder, with their SHA-256; the last one is used.
    pub files: Vec<(String, String)>,
    /// Last reading of the cell before its current was switched on.
    pub idle: Reading,
    /// The point itself.
    pub point: SweepPoint,
}

/// A line of the journal.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Line {
    /// Its number, from 1.
    pub number: u64,
    /// Bench time, s.
    pub time_s: Seconds,
    /// Entry that the line holds.
    pub entry: Entry,
}

/// A destination for bytes that survive a power cut.
pub trait Durable: Write + Send {
    /// Returns when the written data would survive a power cut.
    ///
    /// # Errors
    /// Errors of the system.
    fn sync(&mut self) -> io::Result<()>;
}

impl Durable for File {
    fn sync(&mut self) -> io::Result<()> {
        self.sync_data()?;
        // Data that are written into a deleted file are lost when it is closed.
        if self.metadata()?.nlink() == 0 {
            return Err(io::Error::new(
                io::ErrorKind::NotFound,
                "the run folder was deleted while the run was going on",
            ));
        }
        Ok(())
    }
}

/// A world in virtual time dies with its process, and its run can be repeated: waiting for the
/// disk has no benefit.
struct Unsynced(File);

impl Write for Unsynced {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.0.flush()
    }
}

impl Durable for Unsynced {
    fn sync(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Returns the question that has not been answered yet, with its number.
pub fn pending_question(lines: &[Line]) -> Option<(u64, &Question)> {
    let last = lines.iter().rev().find(|line| {
        matches!(
            line.entry,
            Entry::Asked(_) | Entry::Answered(_) | Entry::Ended { .. } | Entry::Resumed { .. }
        )
    })?;
    match &last.entry {
        Entry::Asked(question) => Some((last.number, question)),
        _ => None,
    }
}

/// A journal that is open for writing.
pub struct Journal {
    path: PathBuf,
    file: Box<dyn Durable>,
    clock: Clock,
    next: u64,
    drill: Drill,
    /// Whether a write has failed and may have left a part of a line: nothing may follow it.
    broken: bool,
}

impl Journal {
    /// Creates the journal of a run folder.
    ///
    /// # Errors
    /// Fails if the file already exists or cannot be created.
    pub fn create(folder: &Path, clock: &Clock) -> Result<Self, JournalError> {
        let path = folder.join(JOURNAL);
        let made = OpenOptions::new().write(true).create_new(true).open(&path);
        let file = made.map_err(|source| JournalError::Io {
            path: path.clone(),
            what: "cannot be made",
            source,
        })?;
        file.try_lock().map_err(|error| JournalError::Io {
            path: path.clone(),
            what: "is in use by another process",
            source: error.into(),
        })?;
        let named = File::open(folder).and_then(|folder| folder.sync_all());
        named.map_err(|source| JournalError::Io {
            path: folder.to_owned(),
            what: "cannot be synced",
            source,
        })?;
        Ok(Self::on(path, durable(file, clock), clock, 1))
    }

    /// Reopens the journal of a run folder whose lines were read with [`read`]. First moves an
    /// incomplete last line to another file.
    ///
    /// # Errors
    /// Fails if files cannot be written.
    pub fn reopen(folder: &Path, clock: &Clock, read: &Read) -> Result<Self, JournalError> {
        let path = folder.join(JOURNAL);
        let io = |what| {
            let path = path.clone();
            move |source| JournalError::Io {
                path: path.clone(),
                what,
                source,
            }
        };
        // Lock before anything is written: if two processes resume one run, one of them must fail.
        let file = OpenOptions::new()
            .append(true)
            .open(&path)
            .map_err(io("cannot be opened"))?;
        file.try_lock()
            .map_err(|error| io("is in use by another process")(error.into()))?;
        if !read.torn.is_empty() {
            let mut aside = OpenOptions::new()
                .append(true)
                .create(true)
                .open(folder.join(TORN_JOURNAL))
                .map_err(io("cannot put a torn line aside"))?;
            aside
                .write_all(&read.torn)
                .and_then(|()| aside.sync_all())
                .map_err(io("cannot put a torn line aside"))?;
        }
        file.set_len(read.whole_bytes)
            .and_then(|()| file.sync_all())
            .map_err(io("cannot be cut after its last whole line"))?;
        let next = read.lines.last().map_or(1, |line| line.number + 1);
        Ok(Self::on(path.clone(), durable(file, clock), clock, next))
    }

    fn on(path: PathBuf, file: Box<dyn Durable>, clock: &Clock, next: u64) -> Self {
        Self {
            path,
            file,
            clock: clock.clone(),
            next,
            drill: Drill::none(),
            broken: false,
        }
    }

    /// Makes its writes points of a crash drill from now on.
    pub fn drill(&mut self, drill: Drill) {
        self.drill = drill;
    }

    /// Appends an entry, which is on disk when this returns. Returns the number of its line.
    ///
    /// # Errors
    /// Fails if a file cannot be written.
    pub fn write(&mut self, entry: Entry) -> Result<u64, JournalError> {
        self.drill.journal();
        if self.broken {
            return Err(self.error("cannot be written")(io::Error::other(
                "a write before this one has failed",
            )));
        }
        self.broken = true;
        self.drill
            .room(JOURNAL)
            .map_err(self.error("cannot be written"))?;
        let line = Line {
            number: self.next,
            time_s: Seconds((self.clock.now() * 1.0e3).0.round() / 1.0e3),
            entry,
        };
        let text = text_of(&line)
            .map_err(|error| self.error("cannot be put into JSON")(io::Error::other(error)))?;
        self.file
            .write_all(text.as_bytes())
            .and_then(|()| self.file.flush())
            .map_err(self.error("cannot be written"))?;
        self.file.sync().map_err(self.error("cannot be synced"))?;
        (self.next, self.broken) = (self.next + 1, false);
        self.drill.journal();
        Ok(line.number)
    }

    fn error(&self, what: &'static str) -> impl Fn(io::Error) -> JournalError + use<> {
        let path = self.path.clone();
        move |source| JournalError::Io {
            path: path.clone(),
            what,
            source,
        }
    }
}

/// Checks whether a process is writing into the journal of a run folder. The system releases the
/// lock of that process when it ends for any reason.
pub fn is_written(folder: &Path) -> bool {
    let blocked = |file: File| matches!(file.try_lock_shared(), Err(TryLockError::WouldBlock));
    File::open(folder.join(JOURNAL)).is_ok_and(blocked)
}

/// Locks a run folder, so that no other process can resume its run while the returned value lives.
///
/// # Errors
/// Fails if a process is writing into the journal.
pub fn hold(folder: &Path) -> Result<File, JournalError> {
    let path = folder.join(JOURNAL);
    let error = |what| {
        let path = path.clone();
        move |source| JournalError::Io {
            path: path.clone(),
            what,
            source,
        }
    };
    let file = File::open(&path).map_err(error("cannot be opened"))?;
    file.try_lock()
        .map_err(|blocked| error("is in use by another process")(blocked.into()))?;
    Ok(file)
}

fn durable(file: File, clock: &Clock) -> Box<dyn Durable> {
    if clock.mode() == TimeMode::Virtual {
        Box::new(Unsynced(file))
    } else {
        Box::new(file)
    }
}

fn text_of(line: &Line) -> Result<String, serde_json::Error> {
    let mut text = serde_json::to_string(line)?;
    text.pop();
    let sum = checksum(&text);
    Ok(format!("{text}{CHECKSUM}{sum}\"}}\n"))
}

/// Returns the first 16 hexadecimal digits of a text's SHA-256.
pub fn checksum(text: &str) -> String {
    Sha256::digest(text)
        .iter()
        .take(8)
        .map(|byte| format!("{byte:02x}"))
        .collect()
}

/// A journal as it was found.
#[derive(Debug, Clone, PartialEq)]
pub struct Read {
    /// Its complete lines.
    pub lines: Vec<Line>,
    /// Length of these lines, bytes.
    pub whole_bytes: u64,
    /// Bytes that follow them.
    pub torn: Vec<u8>,
}

/// Reads the journal of a run folder without changing anything.
///
/// # Errors
/// Fails if a file cannot be read or a complete line differs from what was written.
pub fn read(folder: &Path) -> Result<Read, JournalError> {
    let path = folder.join(JOURNAL);
    let bytes = std::fs::read(&path).map_err(|source| JournalError::Unread {
        path: path.clone(),
        source,
    })?;
    let whole = bytes
        .iter()
        .rposition(|byte| *byte == b'\n')
        .map_or(0, |at| at + 1);
    let mut lines = Vec::new();
    for (index, text) in String::from_utf8_lossy(&bytes[..whole]).lines().enumerate() {
        let (line, number) = (index + 1, index as u64 + 1);
        let fail = |expected: String, found: String| JournalError::Line {
            path: path.clone(),
            line,
            expected,
            found,
        };
        let Some((body, sum)) = text.rsplit_once(CHECKSUM) else {
            return Err(fail(
                "a line that ends in its checksum".to_owned(),
                excerpt(text),
            ));
        };
        let (wanted, sum) = (checksum(body), sum.trim_end_matches("\"}"));
        if wanted != sum {
            return Err(fail(
                format!("a line with the checksum {sum}"),
                format!("one with {wanted}: it was altered after it was written"),
            ));
        }
        let parsed: Line = serde_json::from_str(text).map_err(|error| {
            fail(
                format!("an entry that version {} knows", env!("CARGO_PKG_VERSION")),
                error.to_string(),
            )
        })?;
        if parsed.number != number {
            return Err(fail(
                format!("line number {number}"),
                format!("{}: lines are missing or doubled", parsed.number),
            ));
        }
        lines.push(parsed);
    }
    Ok(Read {
        lines,
        whole_bytes: whole as u64,
        torn: bytes[whole..].to_vec(),
    })
}

fn excerpt(text: &str) -> String {
    let short: String = text.chars().take(60).collect();
    format!("{short:?}")
}

#[cfg(test)]
mod tests;
