//! The catalogue of the server's own runs and diagnoses. A separate thread updates it: completely
//! at the start, and incrementally after the end of each run and analysis. Requests only read it.

use std::{
    fs,
    path::{Path, PathBuf},
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicBool, Ordering},
        mpsc::{Receiver, RecvTimeoutError, Sender, channel},
    },
    time::Duration,
};

use analysis::{
    catalog::{
        Catalog, CatalogError,
        scan::{Beside, ScanOptions, Scanned},
    },
    run_folder,
};

use instruments::clock;

use super::{
    jobs::{self, Ended},
    notebook::{About, Notebook},
};

/// The catalogue in the data folder.
const FILE: &str = "catalog.sqlite";
/// Folders there that are scanned: of runs, and of diagnoses among the analyses.
const RUNS: &str = "runs";
const ANALYSES: &str = "analyses";
/// Pause before a scan that has failed is tried again: a disk that is full, a file that is held.
const AGAIN: Duration = Duration::from_secs(60);

/// Keeps the catalogue of a data folder.
#[derive(Debug)]
pub struct CatalogKeeper {
    data: PathBuf,
    notebook: Arc<Notebook>,
    wake: Sender<PathBuf>,
    wakes: Mutex<Option<Receiver<PathBuf>>>,
    stop: AtomicBool,
    state: Mutex<ScanState>,
}

/// State of the scans of a catalogue.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct ScanState {
    /// One is under way.
    pub scanning: bool,
    /// When the last one succeeded, s since 1970; 0 before the first.
    pub scanned_unix_s: f64,
    /// How many failed since the start.
    pub failed: u64,
}

impl CatalogKeeper {
    /// Creates the catalogue keeper of a data folder. Does not scan yet.
    pub fn of(data: &Path, notebook: Arc<Notebook>) -> Self {
        let (wake, wakes) = channel();
        Self {
            data: data.to_path_buf(),
            notebook,
            wake,
            wakes: Mutex::new(Some(wakes)),
            stop: AtomicBool::new(false),
            state: Mutex::default(),
        }
    }

    /// Asks for a scan of the folder of a run, and does not wait for it.
    pub fn refresh_run(&self, run: &str) {
        self.refresh(self.data.join(RUNS).join(run));
    }

    /// Asks for a scan of the folder of an analysis.
    pub fn refresh_analysis(&self, id: &str) {
        self.refresh(self.data.join(ANALYSES).join(id));
    }

    fn refresh(&self, folder: PathBuf) {
        // If no scanning thread runs, the request has no receiver and is dropped.
        let _ = self.wake.send(folder);
    }

    /// Ends the scan at its next run, and the thread with it.
    pub fn end(&self) {
        self.stop.store(true, Ordering::Relaxed);
        self.refresh(PathBuf::new());
    }

    /// Opens the catalogue to be asked.
    ///
    /// # Errors
    /// [`CatalogError`]; before the first scan there is none.
    pub fn open(&self) -> Result<Catalog, CatalogError> {
        Catalog::open(&self.file())
    }

    /// State of the scans.
    pub fn state(&self) -> ScanState {
        *self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn note(&self, note: impl FnOnce(&mut ScanState)) {
        note(&mut self.state.lock().unwrap_or_else(PoisonError::into_inner));
    }

    /// Runs a scan, logs its failure and records the outcome. Returns whether the scan succeeded.
    fn run_scan(&self, scan: impl FnOnce() -> Result<(), CatalogError>) -> bool {
        self.note(|state| state.scanning = true);
        let scanned = scan();
        self.note(|state| {
            state.scanning = false;
            match &scanned {
                Ok(()) => state.scanned_unix_s = clock::unix_time_s(),
                Err(_) => state.failed += 1,
            }
        });
        if let Err(error) = &scanned {
            tracing::warn!("the catalogue stays as it is: {error}");
        }
        scanned.is_ok()
    }

    /// The data folder.
    pub fn data(&self) -> &Path {
        &self.data
    }

    /// Scans everything now, and single folders on request, until the end. Calls `changed` after
    /// each scan that succeeded.
    pub fn work(&self, changed: impl Fn()) {
        let taken = self
            .wakes
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take();
        let Some(wakes) = taken else { return };
        let mut done = self.run_scan(|| self.scan());
        loop {
            if done {
                changed();
            }
            let woken = match done {
                true => wakes.recv().map_err(|_| RecvTimeoutError::Disconnected),
                false => wakes.recv_timeout(AGAIN),
            };
            if self.stop.load(Ordering::Relaxed) {
                return;
            }
            match woken {
                Err(RecvTimeoutError::Disconnected) => return,
                // A failed scan may have missed any folder, so everything is scanned again.
                _ if !done => done = self.run_scan(|| self.scan()),
                // What did not begin has no folder.
                Ok(folder) if folder.is_dir() => done = self.run_scan(|| self.scan_again(folder)),
                _ => (),
            }
        }
    }

    fn file(&self) -> PathBuf {
        self.data.join(FILE)
    }

    /// Scans everything. The catalogue belongs to the server and is never the only copy: a
    /// damaged one is rebuilt.
    fn scan(&self) -> Result<(), CatalogError> {
        let roots = [RUNS, ANALYSES].map(|name| self.data.join(name));
        let roots: Vec<PathBuf> = roots.into_iter().filter(|root| root.is_dir()).collect();
        let scan = || self.scan_with(|catalog, options| catalog.scan(&roots, options));
        match scan() {
            Err(error) if error.is_damaged() => {
                tracing::warn!("the catalogue is built again: {error}");
                // Also removes SQLite's side files: pages of the damaged database do not belong
                // to the new one.
                for end in ["", "-wal", "-shm"] {
                    let _ = fs::remove_file(self.data.join(format!("{FILE}{end}")));
                }
                scan()
            }
            scanned => scanned,
        }
    }

    fn scan_again(&self, folder: PathBuf) -> Result<(), CatalogError> {
        let scanned = self.scan_with(|catalog, options| catalog.scan_again(&[folder], options));
        match scanned {
            Err(error) if error.is_damaged() => self.scan(),
            scanned => scanned,
        }
    }

    fn scan_with(
        &self,
        scan: impl FnOnce(&Catalog, &ScanOptions<'_>) -> Result<Scanned, CatalogError>,
    ) -> Result<(), CatalogError> {
        let catalog = Catalog::make(&self.file())?;
        let beside = |folder: &Path| self.beside(folder);
        let options = ScanOptions {
            beside: &beside,
            stop: &self.stop,
        };
        let scanned = scan(&catalog, &options)?;
        tracing::debug!("catalogue: {} runs, {} read", scanned.runs, scanned.read);
        Ok(())
    }

    /// Returns the facts of the record and of the notebook about a run.
    fn beside(&self, folder: &Path) -> Beside {
        let Some(run) = folder.file_name().and_then(|name| name.to_str()) else {
            return Beside::default();
        };
        let job = jobs::read(&self.data, run);
        let entries = self.notebook.read(About::Run(run));
        Beside {
            how: job
                .as_ref()
                .and_then(|job| job.ended.as_ref())
                .map(end_in_words),
            operator: job.map(|job| job.item.by),
            tags: entries.tags,
            notes: entries.notes.into_iter().map(|note| note.text).collect(),
        }
    }
}

/// Describes the end of a run as its journal would; the process of a stopped run may have died
/// without an entry.
fn end_in_words(ended: &Ended) -> String {
    match ended.stopped && !run_folder::is_stopped(&ended.how) {
        true => format!("stopped on request: {}", ended.how),
        false => ended.how.clone(),
    }
}

#[cfg(test)]
mod tests {
    use analysis::catalog::query::Filter;

    use super::*;

    fn keeper() -> (tempfile::TempDir, CatalogKeeper) {
        let data = tempfile::tempdir().unwrap();
        fs::create_dir(data.path().join(RUNS)).unwrap();
        let notebook = Arc::new(Notebook::of(data.path()));
        let keeper = CatalogKeeper::of(data.path(), notebook);
        (data, keeper)
    }

    #[test]
    fn a_damaged_catalogue_is_built_again() {
        let (_data, keeper) = keeper();
        keeper.scan().unwrap();
        let file = keeper.file();
        let whole = fs::read(&file).unwrap();
        // A file that is not a database, and a database whose pages after the header are missing.
        for text in [&b"a text that is not a database at all"[..], &whole[..100]] {
            let mut text = text.to_vec();
            text.resize(whole.len(), 0x5a);
            fs::write(&file, text).unwrap();
            keeper.scan().unwrap();
            assert!(keeper.open().unwrap().roots().unwrap().len() == 1);
        }
    }

    #[test]
    fn a_run_whose_process_died_ended_as_its_record_states_and_has_its_notes() {
        let (data, keeper) = keeper();
        let folder = data.path().join(RUNS).join("demo-1");
        fs::create_dir(&folder).unwrap();
        let started = r#"{"started":{"version":"0","experiment":"demo","seed":1,"time":"real"}}"#;
        let line = format!("{{\"number\":1,\"time_s\":0.0,\"entry\":{started}}}\n");
        fs::write(folder.join(run_folder::JOURNAL), line).unwrap();
        let verdict = |stopped: bool| {
            let how = "its process was killed or died";
            let item = r#"{"id":1,"run":"demo-1","kind":"run","experiment":"demo","bench":"demo",
                "seed":null,"expected_s":1.0,"by":"ann","submitted_unix_s":1.0,"process":null}"#;
            let ended = format!(
                r#"{{"code":null,"finished":false,"stopped":{stopped},"how":"{how}","unix_s":1.0}}"#
            );
            fs::create_dir_all(data.path().join("jobs")).unwrap();
            let job = format!("{{\"item\":{item},\"ended\":{ended}}}");
            fs::write(data.path().join("jobs/demo-1.json"), job).unwrap();
            keeper.scan().unwrap();
            let run = keeper.open().unwrap().show("demo-1").unwrap().run;
            (run.verdict.label(), run.tags, run.notes)
        };
        assert_eq!(verdict(false), ("failed", vec![], 0));
        assert_eq!(verdict(true), ("stopped", vec![], 0));
        let about = About::Run("demo-1");
        keeper.notebook.note(about, "ann", "Swollen").unwrap();
        let tags = ["aged".to_owned()];
        keeper.notebook.tag(about, "ann", &tags).unwrap();
        assert_eq!(verdict(true), ("stopped", tags.to_vec(), 1));
        let catalog = keeper.open().unwrap();
        let found = |tag: Option<&str>, text: Option<&str>| {
            let [tag, text] = [tag, text].map(|text| text.map(str::to_owned));
            let filter = Filter {
                tag,
                text,
                ..Filter::default()
            };
            catalog.runs(&filter).unwrap().runs.len()
        };
        assert_eq!(
            (found(Some("aged"), None), found(Some("age"), None)),
            (1, 0)
        );
        assert_eq!(
            (found(None, Some("swollen AGED")), found(None, Some("bent"))),
            (1, 0)
        );
        assert_eq!(catalog.choices().unwrap().tags, tags);
    }
}
