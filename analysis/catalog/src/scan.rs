//! Builds a catalogue from run folders, and brings it up to date: what has not changed since the
//! last scan is not read again.

use std::{
    collections::HashSet,
    fs,
    os::unix::fs::MetadataExt,
    path::{Path, PathBuf},
    sync::{
        Mutex, PoisonError,
        atomic::{AtomicBool, Ordering},
        mpsc::{Receiver, SyncSender, sync_channel},
    },
};

use analysis_files::run_folder::DIAGNOSIS;
use rusqlite::{Connection, OptionalExtension};
use serde::{Deserialize, Serialize};

pub use crate::folder::Beside;
use crate::{
    Catalog, CatalogError,
    error::sql,
    folder,
    record::{CatalogDiagnosis, CatalogParameter, CatalogVerdict, Folder},
    store,
    walk::{Place, Walk},
};

/// Runs that are put in together.
const BATCH: usize = 500;
/// Runs that wait between two threads, at most: memory does not grow with their number.
const WAITING: usize = 64;
/// Threads that read, at most: beyond them the one that writes is the slowest.
const MOST_READERS: usize = 4;
/// Folder of runs beside that of analyses, in the data folder of a server.
const RUNS: &str = "runs";
/// Number of parent folders in which a diagnosis searches for its run: a diagnosis of one cell in a
/// server's analyses lies in `analyses/NAME/out/CELL`.
const ANCESTORS: usize = 5;

/// How a scan is done.
pub struct ScanOptions<'a> {
    /// Facts of a run beside its folder.
    pub beside: &'a (dyn Fn(&Path) -> Beside + Sync),
    /// If true, ends the scan at the next run; the records read so far stay.
    pub stop: &'a AtomicBool,
}

impl ScanOptions<'static> {
    /// Returns options for a scan of the folders alone that runs to its end.
    pub fn plain() -> Self {
        static NEVER: AtomicBool = AtomicBool::new(false);
        Self {
            beside: &|_| Beside::default(),
            stop: &NEVER,
        }
    }
}

/// Result of a scan.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct Scanned {
    /// Number of run folders that are there.
    pub runs: usize,
    /// Number of those that were read: new ones, and changed ones.
    pub read: usize,
    /// Number of those that were read and are damaged.
    pub damaged: usize,
    /// Number of runs whose folders have disappeared since the last scan.
    pub vanished: usize,
    /// Number of diagnoses that are there.
    pub diagnoses: usize,
    /// Folders that cannot be looked into, with the reason.
    pub unreadable: Vec<String>,
    /// It was stopped before its end.
    pub stopped: bool,
}

/// A run folder that is to be read.
struct Work {
    folder: PathBuf,
    stamp: String,
    beside: Beside,
    known: bool,
}

/// Message of a thread to the one that writes.
enum Message {
    Unchanged(String),
    Read {
        folder: Box<Folder>,
        known: bool,
    },
    Diagnosis {
        one: Box<CatalogDiagnosis>,
        stamp: String,
    },
    SameDiagnosis(String),
    Unreadable(String),
}

impl Catalog {
    /// Reads run folders below the given roots, or below the previously scanned roots if none is
    /// given.
    ///
    /// # Errors
    /// [`CatalogError`]: a root that does not exist, or a catalogue that cannot be written. A run
    /// folder that cannot be read is not an error: the catalogue lists it with the reason.
    pub fn scan(
        &self,
        roots: &[PathBuf],
        options: &ScanOptions<'_>,
    ) -> Result<Scanned, CatalogError> {
        let roots = self.resolved(roots)?;
        self.remember(&roots)?;
        self.scan_below(&roots, options)
    }

    /// Reads what has changed in some folders of a root, which the scans before have read whole.
    ///
    /// # Errors
    /// As [`Self::scan`].
    pub fn scan_again(
        &self,
        folders: &[PathBuf],
        options: &ScanOptions<'_>,
    ) -> Result<Scanned, CatalogError> {
        self.scan_below(&self.resolved(folders)?, options)
    }

    fn scan_below(
        &self,
        roots: &[PathBuf],
        options: &ScanOptions<'_>,
    ) -> Result<Scanned, CatalogError> {
        let looker = Self::open(&self.path)?;
        let mut writer = Writer::of(self);
        std::thread::scope(|scope| {
            let (work, works) = sync_channel(WAITING);
            let (messages, received) = sync_channel(WAITING);
            let works = std::sync::Arc::new(Mutex::new(works));
            for _ in 0..readers() {
                let (works, messages) = (works.clone(), messages.clone());
                scope.spawn(move || read_all(&works, &messages));
            }
            // If all readers have ended, the walker ends as well, and the other way round.
            drop(works);
            scope.spawn(move || look(&looker, Walk::of(roots), options, &work, &messages));
            writer.write(&received, options.stop)
        })?;
        if !writer.scanned.stopped {
            writer.mark_missing(roots)?;
        }
        if writer.scanned.read > 0 {
            store::count_cells(&self.connection).map_err(sql(&self.path, "count the cells"))?;
        }
        self.run(
            "PRAGMA optimize; PRAGMA wal_checkpoint(TRUNCATE);",
            "tidy it up",
        )?;
        Ok(writer.scanned)
    }

    /// Removes the runs whose folders have disappeared and returns their number.
    ///
    /// # Errors
    /// [`CatalogError::Sql`].
    pub fn forget_missing(&self) -> Result<usize, CatalogError> {
        let failed = sql(&self.path, "forget missing runs");
        let mut asked = self
            .connection
            .prepare("SELECT run FROM run WHERE missing = 1")
            .map_err(&failed)?;
        let rows = asked.query_map([], |row| row.get::<_, String>(0));
        let runs: Vec<String> = rows.and_then(Iterator::collect).map_err(&failed)?;
        for run in &runs {
            store::remove(&self.connection, run).map_err(&failed)?;
        }
        store::count_cells(&self.connection).map_err(&failed)?;
        Ok(runs.len())
    }

    fn resolved(&self, roots: &[PathBuf]) -> Result<Vec<PathBuf>, CatalogError> {
        let roots = match roots {
            [] => self.roots()?,
            roots => roots.to_vec(),
        };
        if roots.is_empty() {
            return Err(CatalogError::NoRoot {
                path: self.path.clone(),
            });
        }
        let resolve = |path: PathBuf| {
            let found = fs::canonicalize(&path).and_then(|root| fs::read_dir(&root).map(|_| root));
            found.map_err(|source| CatalogError::Root { path, source })
        };
        roots.into_iter().map(resolve).collect()
    }
}

fn readers() -> usize {
    let cores = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    cores.clamp(1, MOST_READERS)
}

/// Searches for run folders, and passes on those that have changed.
fn look(
    known: &Catalog,
    walk: Walk,
    options: &ScanOptions<'_>,
    work: &SyncSender<Work>,
    messages: &SyncSender<Message>,
) {
    for place in walk {
        let sent = match place {
            _ if options.stop.load(Ordering::Relaxed) => return,
            Place::Unreadable(reason) => messages.send(Message::Unreadable(reason)).is_ok(),
            Place::Diagnosis(folder) => messages.send(diagnosis(known, &folder)).is_ok(),
            Place::Run(folder) => match compare(&known.connection, folder, options) {
                Ok(one) => work.send(one).is_ok(),
                Err(run) => messages.send(Message::Unchanged(run)).is_ok(),
            },
        };
        if !sent {
            return;
        }
    }
}

/// Returns a run folder that is to be read; the identity of one that has not changed.
fn compare(known: &Connection, folder: PathBuf, options: &ScanOptions<'_>) -> Result<Work, String> {
    let run = folder::identity(&folder);
    let beside = (options.beside)(&folder);
    let stamp = folder::stamp(&folder, &beside);
    let before = stored(known, "SELECT stamp, missing FROM run WHERE run = ?1", &run);
    match before {
        Some(before) if before.stamp == stamp && !before.missing => Err(run),
        before => Ok(Work {
            folder,
            stamp,
            beside,
            known: before.is_some(),
        }),
    }
}

struct Before {
    stamp: String,
    missing: bool,
}

fn stored(known: &Connection, text: &str, key: &str) -> Option<Before> {
    let mut asked = known.prepare_cached(text).ok()?;
    let found = asked.query_row([key], |row| {
        Ok(Before {
            stamp: row.get(0)?,
            missing: row.get(1)?,
        })
    });
    found.optional().ok()?
}

fn read_all(works: &Mutex<Receiver<Work>>, messages: &SyncSender<Message>) {
    loop {
        let next = works.lock().unwrap_or_else(PoisonError::into_inner).recv();
        let Ok(work) = next else { return };
        let folder = Box::new(folder::read(&work.folder, work.stamp, work.beside));
        let known = work.known;
        if messages.send(Message::Read { folder, known }).is_err() {
            return;
        }
    }
}

#[derive(Debug, Deserialize)]
struct DiagnosisFile {
    data_set: String,
    model: String,
    verdict: String,
    summary: String,
    #[serde(default)]
    effects: Vec<Effect>,
}

#[derive(Debug, Deserialize)]
struct Effect {
    name: String,
    #[serde(default)]
    parameters: Vec<Parameter>,
}

#[derive(Debug, Deserialize)]
struct Parameter {
    name: String,
    value: f64,
    sigma: Option<f64>,
    unit: String,
}

fn diagnosis(known: &Catalog, folder: &Path) -> Message {
    let file = folder.join(DIAGNOSIS);
    let stamp = fs::metadata(&file).map_or_else(
        |_| "-".to_owned(),
        |meta| format!("{}:{}.{}", meta.len(), meta.mtime(), meta.mtime_nsec()),
    );
    let name = folder.to_string_lossy().into_owned();
    let before = stored(
        &known.connection,
        // Its run may have come behind it.
        "SELECT stamp, 0 FROM diagnosis WHERE folder = ?1 AND run IS NOT NULL",
        &name,
    );
    if before.is_some_and(|before| before.stamp == stamp) {
        return Message::SameDiagnosis(name);
    }
    let one = Box::new(read_diagnosis(folder, &name));
    Message::Diagnosis { one, stamp }
}

pub(crate) fn read_diagnosis(folder: &Path, name: &str) -> CatalogDiagnosis {
    let read = fs::read(folder.join(DIAGNOSIS)).map_err(|error| error.to_string());
    let read = read.and_then(|text| {
        serde_json::from_slice::<DiagnosisFile>(&text).map_err(|error| error.to_string())
    });
    let damaged = |reason: String| CatalogDiagnosis {
        folder: name.to_owned(),
        run: None,
        cell: None,
        data_set: String::new(),
        model: String::new(),
        verdict: String::new(),
        summary: String::new(),
        parameters: Vec::new(),
        damage: Some(format!("{DIAGNOSIS}: {reason}")),
    };
    let file = match read {
        Ok(file) => file,
        Err(reason) => return damaged(reason),
    };
    CatalogDiagnosis {
        folder: name.to_owned(),
        run: run_of(folder, &file.data_set),
        cell: None,
        data_set: file.data_set,
        model: file.model,
        verdict: file.verdict,
        summary: file.summary,
        parameters: file.effects.into_iter().flat_map(parameters).collect(),
        damage: None,
    }
}

fn parameters(effect: Effect) -> impl Iterator<Item = CatalogParameter> {
    let name = effect.name;
    let one = move |parameter: Parameter| CatalogParameter {
        effect: name.clone(),
        name: parameter.name,
        value: parameter.value,
        sigma: parameter.sigma,
        unit: parameter.unit,
    };
    effect.parameters.into_iter().map(one)
}

/// Returns the run that a diagnosis is of: the folder that it lies in, or the one of the name of
/// its data set beside it.
fn run_of(folder: &Path, data_set: &str) -> Option<String> {
    run_folder_of(folder, data_set).map(|run| folder::identity(&run))
}

/// Returns the folder of the run that a diagnosis is of, by its own folder.
pub(crate) fn run_folder_of_diagnosis(folder: &Path) -> Option<PathBuf> {
    let text = fs::read(folder.join(DIAGNOSIS)).ok()?;
    let file: DiagnosisFile = serde_json::from_slice(&text).ok()?;
    run_folder_of(folder, &file.data_set)
}

fn run_folder_of(folder: &Path, data_set: &str) -> Option<PathBuf> {
    let above = || folder.ancestors().take(ANCESTORS);
    let within = above()
        .find(|one| folder::is_run(one))
        .map(Path::to_path_buf);
    let plain = !data_set.is_empty() && !data_set.contains(['/', '\0']) && data_set != "..";
    let beside = || {
        above()
            .skip(1)
            .flat_map(|one| [one.join(data_set), one.join(RUNS).join(data_set)])
            .find(|one| plain && folder::is_run(one))
    };
    within.or_else(beside)
}

/// The thread that writes.
struct Writer<'a> {
    catalog: &'a Catalog,
    scanned: Scanned,
    /// Identities of the runs that are there: 8 bytes each.
    seen: HashSet<u64>,
    diagnoses: HashSet<String>,
    pending: usize,
}

impl<'a> Writer<'a> {
    fn of(catalog: &'a Catalog) -> Self {
        Self {
            catalog,
            scanned: Scanned::default(),
            seen: HashSet::new(),
            diagnoses: HashSet::new(),
            pending: 0,
        }
    }

    fn write(
        &mut self,
        received: &Receiver<Message>,
        stop: &AtomicBool,
    ) -> Result<(), CatalogError> {
        while let Ok(message) = received.recv() {
            self.take(message)?;
        }
        self.commit()?;
        self.scanned.stopped = stop.load(Ordering::Relaxed);
        Ok(())
    }

    fn see(&mut self, run: &str) {
        self.scanned.runs += 1;
        self.seen.insert(number(run));
    }

    fn take(&mut self, message: Message) -> Result<(), CatalogError> {
        match message {
            Message::Unchanged(run) => self.see(&run),
            Message::Unreadable(reason) => self.scanned.unreadable.push(reason),
            Message::SameDiagnosis(folder) => _ = self.diagnoses.insert(folder),
            Message::Diagnosis { one, stamp } => {
                self.begin()?;
                let put = store::put_diagnosis(&self.catalog.connection, &one, &stamp);
                put.map_err(sql(&self.catalog.path, "put a diagnosis in"))?;
                self.diagnoses.insert(one.folder);
            }
            Message::Read { folder, known } => {
                self.begin()?;
                let put = store::put(&self.catalog.connection, &folder, known);
                put.map_err(sql(&self.catalog.path, "put a run in"))?;
                self.scanned.read += 1;
                let damaged = folder.run.verdict == CatalogVerdict::Damaged;
                self.scanned.damaged += usize::from(damaged);
                self.see(&folder.run.run);
            }
        }
        Ok(())
    }

    /// Begins a batch, or ends one that is full and begins the next.
    fn begin(&mut self) -> Result<(), CatalogError> {
        if self.pending >= BATCH {
            self.commit()?;
        }
        if self.pending == 0 {
            self.catalog.run("BEGIN IMMEDIATE", "begin a batch")?;
        }
        self.pending += 1;
        Ok(())
    }

    fn commit(&mut self) -> Result<(), CatalogError> {
        if std::mem::take(&mut self.pending) > 0 {
            self.catalog.run("COMMIT", "end a batch")?;
        }
        Ok(())
    }

    /// Marks the runs below roots that no longer exist, and removes such diagnoses.
    fn mark_missing(&mut self, roots: &[PathBuf]) -> Result<(), CatalogError> {
        self.scanned.diagnoses = self.diagnoses.len();
        let runs = self.gone("SELECT run, folder FROM run WHERE missing = 0", roots)?;
        let diagnoses = self.gone("SELECT folder, folder FROM diagnosis", roots)?;
        let failed = sql(&self.catalog.path, "mark missing runs");
        let connection = &self.catalog.connection;
        for row in &runs {
            connection
                .execute("UPDATE run SET missing = 1 WHERE run = ?1", [&row.key])
                .map_err(&failed)?;
        }
        for row in &diagnoses {
            connection
                .execute("DELETE FROM diagnosis WHERE folder = ?1", [&row.key])
                .map_err(&failed)?;
        }
        self.scanned.vanished = runs.len();
        Ok(())
    }

    /// Returns the rows whose folder lies below one of the roots and no longer exists.
    fn gone(&self, text: &str, roots: &[PathBuf]) -> Result<Vec<Row>, CatalogError> {
        let failed = sql(&self.catalog.path, "look for missing runs");
        let mut asked = self.catalog.connection.prepare(text).map_err(&failed)?;
        let rows = asked.query_map([], |row| {
            Ok(Row {
                key: row.get(0)?,
                folder: row.get(1)?,
            })
        });
        let below = |row: &Row| {
            roots
                .iter()
                .any(|root| Path::new(&row.folder).starts_with(root))
        };
        let is_seen =
            |row: &Row| self.seen.contains(&number(&row.key)) || self.diagnoses.contains(&row.key);
        let wanted = |row: &rusqlite::Result<Row>| {
            row.as_ref().map_or(true, |row| below(row) && !is_seen(row))
        };
        rows.and_then(|rows| rows.filter(wanted).collect())
            .map_err(&failed)
    }
}

struct Row {
    key: String,
    folder: String,
}

/// Returns the number that an identity of a run spells.
fn number(run: &str) -> u64 {
    u64::from_str_radix(run, 16).unwrap_or_default()
}
