//! The catalogue of the server's own runs and diagnoses. It is brought up to date by a thread of its
//! own, at the start and after the end of each run and analysis; requests only read it.

use std::{
    fs,
    path::{Path, PathBuf},
    sync::{
        Mutex, PoisonError,
        atomic::{AtomicBool, Ordering},
        mpsc::{Receiver, SyncSender, sync_channel},
    },
};

use analysis::catalog::{
    Catalog, CatalogError,
    scan::{Beside, ScanOptions},
};

use super::jobs;

/// The catalogue in the data folder.
const FILE: &str = "catalog.sqlite";
/// Folders there that are scanned.
const SCANNED: [&str; 2] = ["runs", "analyses"];

/// Keeps the catalogue of a data folder.
#[derive(Debug)]
pub struct CatalogKeeper {
    data: PathBuf,
    wake: SyncSender<()>,
    wakes: Mutex<Option<Receiver<()>>>,
    stop: AtomicBool,
}

impl CatalogKeeper {
    /// The keeper of a data folder; nothing is scanned yet.
    pub fn of(data: &Path) -> Self {
        // One that waits is enough: a scan that begins later sees all that has come before.
        let (wake, wakes) = sync_channel(1);
        Self {
            data: data.to_path_buf(),
            wake,
            wakes: Mutex::new(Some(wakes)),
            stop: AtomicBool::new(false),
        }
    }

    /// Asks for a scan; it does not wait for it.
    pub fn refresh(&self) {
        let _ = self.wake.try_send(());
    }

    /// Ends the scan at its next run, and the thread with it.
    pub fn end(&self) {
        self.stop.store(true, Ordering::Relaxed);
        self.refresh();
    }

    /// Opens the catalogue to be asked.
    ///
    /// # Errors
    /// [`CatalogError`]; before the first scan there is none.
    pub fn open(&self) -> Result<Catalog, CatalogError> {
        Catalog::open(&self.file())
    }

    /// The data folder.
    pub fn data(&self) -> &Path {
        &self.data
    }

    /// Scans now and whenever that is asked for, until the end.
    pub fn work(&self) {
        let taken = self
            .wakes
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take();
        let Some(wakes) = taken else { return };
        loop {
            if let Err(error) = self.scan() {
                tracing::warn!("the catalogue stays as it is: {error}");
            }
            let ended = wakes.recv().is_err();
            if ended || self.stop.load(Ordering::Relaxed) {
                return;
            }
        }
    }

    fn file(&self) -> PathBuf {
        self.data.join(FILE)
    }

    fn scan(&self) -> Result<(), CatalogError> {
        let catalog = match Catalog::make(&self.file()) {
            // It is the server's own and never the only copy: a damaged one is built again.
            Err(CatalogError::Sql { source, .. }) => {
                tracing::warn!("the catalogue is built again: {source}");
                let _ = fs::remove_file(self.file());
                Catalog::make(&self.file())?
            }
            made => made?,
        };
        let roots: Vec<PathBuf> = SCANNED
            .iter()
            .map(|name| self.data.join(name))
            .filter(|root| root.is_dir())
            .collect();
        let beside = |folder: &Path| self.beside(folder);
        let options = ScanOptions {
            beside: &beside,
            stop: &self.stop,
        };
        let scanned = catalog.scan(&roots, &options)?;
        tracing::debug!("catalogue: {} runs, {} read", scanned.runs, scanned.read);
        Ok(())
    }

    /// Who asked for a run, as its record tells.
    fn beside(&self, folder: &Path) -> Beside {
        let run = folder.file_name().and_then(|name| name.to_str());
        let job = run.and_then(|run| jobs::read(&self.data, run));
        Beside {
            operator: job.map(|job| job.item.by),
        }
    }
}
