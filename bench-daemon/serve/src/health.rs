//! Notes of a server about its benches and its disk, for metrics: trips, ends of runs, controls,
//! free space. What takes a disk is looked at by a thread of its own.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
};

use analysis::run_folder::archive_status::ArchiveStatus;
use instruments::clock::Clock;
use nix::sys::statvfs::statvfs;

use super::{
    controls::{self, ControlNow},
    jobs::{Ended, Job, Jobs},
};

/// Interval between two checks of the disk, s.
const LOOK_S: f64 = 5.0;

/// Folder of the runs in the data folder.
const RUNS: &str = "runs";

/// Notes of a server.
#[derive(Debug)]
pub struct Health {
    data: PathBuf,
    jobs: Arc<Jobs>,
    noted: Mutex<Noted>,
    stop: AtomicBool,
}

/// Notes so far.
#[derive(Debug, Clone, Default)]
pub struct Noted {
    /// The disk of the data folder, once it has been checked.
    pub disk: Option<Disk>,
    /// State of the archive, if `eis-archive` has written one.
    pub archive: Option<ArchiveStatus>,
    /// Each bench.
    pub benches: BTreeMap<String, BenchHealth>,
}

/// A disk.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Disk {
    /// Bytes that this program may still write.
    pub free_bytes: f64,
    /// All of them.
    pub size_bytes: f64,
}

/// Notes on a bench.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct BenchHealth {
    /// Trips since the server was started.
    pub trips: u64,
    /// Runs since then that came to their end.
    pub finished: u64,
    /// Runs since then that a person stopped.
    pub stopped: u64,
    /// Runs since then that ended early for another reason.
    pub failed: u64,
    /// When the last run ended, however, s since 1970.
    pub ended_unix_s: Option<f64>,
    /// When the last run came to its end, s since 1970.
    pub finished_unix_s: Option<f64>,
    /// Controls of the last run that has measured some.
    pub controls: Vec<ControlNow>,
    /// A run whose controls have not been read yet.
    unread: Option<String>,
}

impl Health {
    /// Creates the health data of these benches, without any check yet.
    pub fn of<'a>(data: &Path, jobs: &Arc<Jobs>, benches: impl Iterator<Item = &'a str>) -> Self {
        let benches = benches.map(|bench| (bench.to_owned(), BenchHealth::default()));
        let noted = Noted {
            benches: benches.collect(),
            ..Noted::default()
        };
        Self {
            data: data.to_owned(),
            jobs: jobs.clone(),
            noted: Mutex::new(noted),
            stop: AtomicBool::new(false),
        }
    }

    /// Returns all health data.
    pub fn noted(&self) -> Noted {
        self.lock().clone()
    }

    /// A bench has tripped.
    pub fn tripped(&self, bench: &str) {
        self.note(bench, |health| health.trips += 1);
    }

    /// A run has ended.
    pub fn ended(&self, bench: &str, run: &str, ended: &Ended) {
        self.note(bench, |health| {
            health.seen(ended);
            health.unread = Some(run.to_owned());
            if ended.finished {
                health.finished += 1;
            } else if ended.stopped {
                health.stopped += 1;
            } else {
                health.failed += 1;
            }
        });
    }

    /// Checks what earlier runs have left, and then checks the disk and the controls until the
    /// end.
    pub async fn work(&self, clock: &Clock) {
        self.earlier();
        while !self.stop.load(Ordering::Relaxed) {
            let (disk, archive) = (disk_of(&self.data), self.read_archive());
            {
                let mut noted = self.lock();
                noted.disk = disk;
                noted.archive = archive;
            }
            self.read_controls();
            clock.sleep_s(LOOK_S).await;
        }
    }

    /// Ends the checks.
    pub fn end(&self) {
        self.stop.store(true, Ordering::Relaxed);
    }

    fn lock(&self) -> MutexGuard<'_, Noted> {
        self.noted.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn note(&self, bench: &str, note: impl FnOnce(&mut BenchHealth)) {
        if let Some(health) = self.lock().benches.get_mut(bench) {
            note(health);
        }
    }

    /// The latest end, and the latest controls, of each bench before this server was started.
    fn earlier(&self) {
        let jobs: Vec<Job> = self.jobs.latest().collect();
        for bench in self.noted().benches.keys() {
            let runs = jobs.iter().filter(|job| job.item.bench == *bench);
            let found = runs
                .clone()
                .map(|job| self.controls_of(&job.item.run))
                .find(|controls| !controls.is_empty());
            self.note(bench, |health| {
                runs.filter_map(|job| job.ended.as_ref())
                    .for_each(|ended| health.seen(ended));
                // A run that ended in the meantime is newer.
                if health.controls.is_empty() {
                    health.controls = found.unwrap_or_default();
                }
            });
        }
    }

    fn read_archive(&self) -> Option<ArchiveStatus> {
        ArchiveStatus::read(&self.data).unwrap_or_else(|reason| {
            tracing::warn!("the archive is not in the metrics: {reason}");
            None
        })
    }

    fn controls_of(&self, run: &str) -> Vec<ControlNow> {
        controls::read(&self.data.join(RUNS).join(run))
    }

    fn read_controls(&self) {
        let unread: Vec<(String, String)> = {
            let mut noted = self.lock();
            let benches = noted.benches.iter_mut();
            benches
                .filter_map(|(bench, health)| Some((bench.clone(), health.unread.take()?)))
                .collect()
        };
        for (bench, run) in unread {
            let found = self.controls_of(&run);
            if !found.is_empty() {
                self.note(&bench, |health| health.controls = found);
            }
        }
    }
}

impl BenchHealth {
    fn seen(&mut self, ended: &Ended) {
        self.ended_unix_s = later_of(self.ended_unix_s, ended.unix_s);
        if ended.finished {
            self.finished_unix_s = later_of(self.finished_unix_s, ended.unix_s);
        }
    }
}

fn later_of(known: Option<f64>, unix_s: f64) -> Option<f64> {
    Some(known.map_or(unix_s, |known| known.max(unix_s)))
}

fn disk_of(data: &Path) -> Option<Disk> {
    let found = statvfs(data).ok()?;
    let bytes = |blocks: u64| blocks as f64 * found.fragment_size() as f64;
    Some(Disk {
        free_bytes: bytes(found.blocks_available()),
        size_bytes: bytes(found.blocks()),
    })
}
