//! Analyses that users request over the API: fits, tests and diagnoses of runs. Each analysis has
//! a folder with its record, its output and its results; [`super::analyst`] runs them.

mod arguments;
mod error;
mod joined;
mod record;
mod story;

use std::{
    path::{Path, PathBuf},
    sync::{
        Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
};

use analysis::dataset::write_atomically;
use instruments::clock;
use nix::{
    sys::signal::{Signal, kill},
    unistd::Pid,
};
use serde::Serialize;
use tokio::sync::Notify;
use utoipa::ToSchema;

use super::{hub::Hub, investigations::Investigations, settings::Settings};
use arguments::arguments;
pub use arguments::{AnalysisKind, Options, Request};
use bench_core::operator::progress::PROGRESS_LINE;
use bench_plan::support::confined_path;
pub use error::AnalysisError;
pub use record::{Analysis, Progress, State};
pub use story::{Conclusion, Recommended, Story};

/// Analyses that may wait.
const MOST_WAITING: usize = 100;
/// Maximum number of analyses in the list.
const MOST_LISTED: usize = 200;
/// File of what its process wrote.
pub(super) const OUTPUT: &str = "output.txt";
/// File of the arguments of its process.
const ARGUMENTS: &str = "arguments.json";

/// An analysis with its results.
#[derive(Debug, Serialize, ToSchema)]
pub struct WithResults {
    /// The analysis.
    #[serde(flatten)]
    pub analysis: Analysis,
    /// Files of results.
    pub files: Vec<ResultFile>,
    /// Story of a diagnosis, for each cell.
    pub stories: Vec<Story>,
}

/// A file of results.
#[derive(Debug, Serialize, ToSchema)]
pub struct ResultFile {
    /// Its path among the results.
    pub path: String,
    /// Its length, bytes.
    pub bytes: u64,
}

/// All analyses of a server.
#[derive(Debug)]
pub struct Analyses {
    pub(super) folder: PathBuf,
    /// Diagnoses and experiments in turn.
    pub investigations: Investigations,
    all: Mutex<Vec<Analysis>>,
    /// Lets one be taken after the other.
    turn: Mutex<()>,
    /// The server ends, and the process at work with it.
    ending: AtomicBool,
    /// Something waits.
    pub(super) more: Notify,
    /// The one in work is to end.
    pub(super) cancel: Notify,
}

impl Analyses {
    /// Opens the analyses of a data folder. An analysis that was running has ended with its
    /// server.
    pub fn open(data: &Path) -> Self {
        let folder = data.join("analyses");
        let entries = std::fs::read_dir(&folder).into_iter().flatten().flatten();
        let read = |entry: std::fs::DirEntry| -> Option<Analysis> {
            let text = std::fs::read_to_string(entry.path().join("analysis.json")).ok()?;
            serde_json::from_str(&text).ok()
        };
        let mut all: Vec<Analysis> = entries.filter_map(read).collect();
        all.sort_by(|a, b| a.submitted_unix_s.total_cmp(&b.submitted_unix_s));
        let now_s = clock::unix_time_s();
        let left: Vec<String> = all
            .iter_mut()
            .filter(|one| one.state == State::InWork)
            .map(|one| {
                one.state = State::Failed;
                one.message = Some("its server ended before it".to_owned());
                one.left_s = None;
                one.ended_unix_s = Some(now_s);
                one.id.clone()
            })
            .collect();
        let opened = Self {
            folder,
            investigations: Investigations::open(data),
            all: Mutex::new(all),
            turn: Mutex::default(),
            ending: AtomicBool::new(false),
            more: Notify::new(),
            cancel: Notify::new(),
        };
        for one in opened.lock().iter().filter(|one| left.contains(&one.id)) {
            if let Err(error) = opened.keep(one) {
                tracing::error!("{error}");
            }
            end_left(one.pid, &opened.results(&one.id));
        }
        opened
    }

    /// Locks and returns all analyses, the latest last.
    pub(super) fn lock(&self) -> MutexGuard<'_, Vec<Analysis>> {
        self.all.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The latest first.
    pub fn list(&self) -> Vec<Analysis> {
        self.lock()
            .iter()
            .rev()
            .take(MOST_LISTED)
            .cloned()
            .collect()
    }

    /// One by its name, with its results.
    pub fn read(&self, settings: &Settings, id: &str) -> Option<WithResults> {
        let analysis = self.find(id)?;
        let results = self.results(id);
        let found = confined_path::list(&results).unwrap_or_default();
        let files = found
            .into_iter()
            .map(|(path, bytes)| ResultFile { path, bytes });
        let stories = if analysis.kind == AnalysisKind::Diagnose {
            story::all(settings, &analysis, &results)
        } else {
            Vec::new()
        };
        Some(WithResults {
            files: files.collect(),
            stories,
            analysis,
        })
    }

    /// Folder of the results of an analysis.
    pub fn results(&self, id: &str) -> PathBuf {
        self.folder.join(id).join("out")
    }

    /// Last lines of its process.
    pub fn log(&self, id: &str) -> Vec<String> {
        let text = confined_path::tail(&self.folder.join(id), OUTPUT);
        let lines = text.lines().filter(|line| !line.starts_with(PROGRESS_LINE));
        lines.map(str::to_owned).collect()
    }

    /// Takes an analysis.
    ///
    /// # Errors
    /// [`AnalysisError`].
    pub fn submit(
        &self,
        settings: &Settings,
        hub: &Hub,
        request: Request,
        by: &str,
    ) -> Result<Analysis, AnalysisError> {
        // Serialises submissions, so that each number is assigned once. Readers of the list take
        // another lock and do not wait for the files that are read here.
        let _turn = self.turn.lock().unwrap_or_else(PoisonError::into_inner);
        let id = self.next_id(request.kind)?;
        let arguments = arguments(settings, &request, &self.results(&id))?;
        let analysis = Analysis {
            id,
            kind: request.kind,
            runs: request.runs,
            spectra: request.spectra,
            options: request.options,
            by: by.to_owned(),
            submitted_unix_s: clock::unix_time_s(),
            began_unix_s: None,
            ended_unix_s: None,
            state: State::Waiting,
            progress: Progress::default(),
            left_s: None,
            message: None,
            command: arguments::in_words(&arguments),
            pid: None,
        };
        self.write(&analysis.id, ARGUMENTS, &arguments)?;
        self.keep(&analysis)?;
        self.lock().push(analysis.clone());
        self.more.notify_one();
        hub.tell("analysis", &analysis);
        Ok(analysis)
    }

    /// The name of the next one.
    fn next_id(&self, kind: AnalysisKind) -> Result<String, AnalysisError> {
        let all = self.lock();
        if all.iter().filter(|one| one.state == State::Waiting).count() >= MOST_WAITING {
            let text = format!("expected at most {MOST_WAITING} analyses that wait, found as many");
            return Err(AnalysisError::Conflict(text));
        }
        let latest = all
            .iter()
            .filter_map(|one| one.id.rsplit('-').next()?.parse().ok())
            .max();
        Ok(format!("{}-{}", kind.name(), latest.unwrap_or(0_u64) + 1))
    }

    fn keep(&self, analysis: &Analysis) -> Result<(), AnalysisError> {
        self.write(&analysis.id, "analysis.json", analysis)
    }

    /// Writes a file of an analysis, whole or not at all.
    fn write(&self, id: &str, name: &str, content: &impl Serialize) -> Result<(), AnalysisError> {
        let failed = |error: &dyn std::fmt::Display| AnalysisError::Io(error.to_string());
        let folder = self.folder.join(id);
        std::fs::create_dir_all(&folder).map_err(|error| failed(&error))?;
        let text = serde_json::to_string_pretty(content).map_err(|error| failed(&error))?;
        write_atomically(&folder.join(name), text.as_bytes()).map_err(|error| failed(&error))
    }

    /// Returns the arguments of the process of an analysis, as stored on submission.
    ///
    /// # Errors
    /// In words: a file that cannot be read.
    pub(super) fn arguments(&self, id: &str) -> Result<Vec<String>, String> {
        let path = self.folder.join(id).join(ARGUMENTS);
        let fail = |error: &dyn std::fmt::Display| {
            let path = path.display();
            format!("{path}: expected the arguments of the analysis: {error}; begin it again")
        };
        let text = std::fs::read_to_string(&path).map_err(|error| fail(&error))?;
        serde_json::from_str(&text).map_err(|error| fail(&error))
    }

    /// One by its name.
    pub fn find(&self, id: &str) -> Option<Analysis> {
        self.lock().iter().find(|one| one.id == id).cloned()
    }

    /// Returns the conclusion of a diagnosis of one cell, or `None` if it has no results.
    pub fn conclusion(&self, settings: &Settings, analysis: &Analysis) -> Option<Conclusion> {
        story::conclusion(settings, analysis, &self.results(&analysis.id))
    }

    /// Ends an analysis that waits or is in work.
    ///
    /// # Errors
    /// [`AnalysisError`].
    pub fn cancel(&self, hub: &Hub, id: &str) -> Result<Analysis, AnalysisError> {
        let mut all = self.lock();
        let found = all.iter_mut().find(|one| one.id == id);
        let one = found.ok_or_else(|| AnalysisError::Unknown(id.to_owned()))?;
        if !matches!(one.state, State::Waiting | State::InWork) {
            let text = "expected an analysis that waits or is in work, found one that has ended";
            return Err(AnalysisError::Conflict(text.to_owned()));
        }
        one.state = State::Cancelled;
        one.ended_unix_s = Some(clock::unix_time_s());
        one.left_s = None;
        let changed = one.clone();
        self.keep(&changed)?;
        drop(all);
        // The worker checks whether the cancelled analysis is the one it runs.
        self.cancel.notify_one();
        hub.tell("analysis", &changed);
        Ok(changed)
    }

    /// Whether an analysis is still to be done.
    pub fn is_in_work(&self, id: &str) -> bool {
        let all = self.lock();
        all.iter()
            .any(|one| one.id == id && one.state == State::InWork)
    }

    /// Returns whether an analysis of this name exists.
    pub fn exists(&self, id: &str) -> bool {
        self.lock().iter().any(|one| one.id == id)
    }

    /// Whether the server ends: an analysis that fails now was ended with it.
    pub fn is_ending(&self) -> bool {
        self.ending.load(Ordering::SeqCst)
    }

    /// Ends the process at work, with the server.
    pub fn end(&self) {
        self.ending.store(true, Ordering::SeqCst);
        let all = self.lock();
        let in_work = all.iter().find(|one| one.state == State::InWork);
        if let Some(pid) = in_work.and_then(|one| one.pid) {
            let _ = kill(Pid::from_raw(-pid), Signal::SIGTERM);
        }
    }

    /// Changes the first analysis that matches, saves it and publishes it.
    fn change_where(
        &self,
        hub: &Hub,
        fits: impl Fn(&Analysis) -> bool,
        change: impl FnOnce(&mut Analysis),
    ) -> Option<Analysis> {
        let mut all = self.lock();
        let one = all.iter_mut().find(|one| fits(one))?;
        change(one);
        let changed = one.clone();
        // Saved before the next change, so that the file always contains the latest state.
        if let Err(error) = self.keep(&changed) {
            tracing::error!("{error}");
        }
        drop(all);
        hub.tell("analysis", &changed);
        Some(changed)
    }

    /// Changes the analysis of this name, saves it and publishes it.
    pub(super) fn change(&self, hub: &Hub, id: &str, change: impl FnOnce(&mut Analysis)) {
        self.change_where(hub, |one| one.id == id, change);
    }

    /// Begins the one that has waited longest.
    pub(super) fn next(&self, hub: &Hub) -> Option<Analysis> {
        let waits = |one: &Analysis| one.state == State::Waiting;
        self.change_where(hub, waits, |one| {
            one.state = State::InWork;
            one.began_unix_s = Some(clock::unix_time_s());
        })
    }
}

/// Ends a process that an earlier server has left: the one with this process number, if its
/// command line contains the folder of the results.
fn end_left(pid: Option<i32>, results: &Path) {
    let Some(pid) = pid.filter(|pid| *pid > 1) else {
        return;
    };
    let line = std::fs::read(format!("/proc/{pid}/cmdline")).unwrap_or_default();
    if String::from_utf8_lossy(&line).contains(&*results.to_string_lossy()) {
        let _ = kill(Pid::from_raw(-pid), Signal::SIGTERM);
    }
}
