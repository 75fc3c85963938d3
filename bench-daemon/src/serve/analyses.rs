//! Analyses that people ask for over the API: fits, tests and diagnoses of runs. Each is a command
//! of this program, run by a process of its own, one after the other, so that neither the server
//! nor a run waits for it. Its record, its log and its results lie in a folder of its own.

mod arguments;
mod story;

use std::{
    fs::File,
    os::unix::fs::OpenOptionsExt,
    path::{Path, PathBuf},
    process::Stdio,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

use analysis::dataset::write_atomically;
use instruments::clock;
use nix::{
    sys::signal::{Signal, kill},
    unistd::Pid,
};
use serde::{Deserialize, Serialize};
use tokio::{process::Command, sync::Notify};
use utoipa::ToSchema;

use super::Server;
use crate::{
    operator::progress::{PROGRESS_LINE, PROGRESS_VARIABLE},
    support::confined_path,
};
pub use arguments::{Kind, Options, Request};
pub use story::Story;

/// Exit code of a diagnosis of data that cannot be diagnosed: it is a result.
const INVALID: i32 = 12;
/// Analyses that may wait.
const MOST_WAITING: usize = 100;
/// Analyses that are told.
const MOST_TOLD: usize = 200;
/// Time between two looks at the log of a process, s.
const LOOK_S: f64 = 0.5;
/// Time that a process has to end when it is cancelled, s.
const PATIENCE_S: f64 = 3.0;
/// End of a log that is read, bytes.
const TAIL: usize = 64 * 1024;

/// State of an analysis.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum State {
    /// Others come first.
    Waiting,
    /// Its process runs.
    #[serde(rename = "in work")]
    InWork,
    /// It has results.
    Done,
    /// It has none.
    Failed,
    /// Somebody has ended it.
    Cancelled,
}

/// How far an analysis is.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Progress {
    /// Share that is done, where the command counts.
    pub done: Option<f64>,
    /// What it is doing.
    pub words: String,
}

/// An analysis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Analysis {
    /// Its name.
    pub id: String,
    /// Its kind.
    pub kind: Kind,
    /// The runs.
    pub runs: Vec<String>,
    /// The spectra, where not all are meant.
    #[serde(default)]
    pub spectra: Vec<String>,
    /// Options.
    pub options: Options,
    /// Who asked for it.
    pub by: String,
    /// When, s since 1970.
    pub submitted_unix_s: f64,
    /// When its process began, s since 1970.
    pub began_unix_s: Option<f64>,
    /// When it ended, s since 1970.
    pub ended_unix_s: Option<f64>,
    /// State.
    pub state: State,
    /// How far it is.
    pub progress: Progress,
    /// Time left, s; none where nobody knows.
    pub left_s: Option<f64>,
    /// Why it has no results; a remark on them.
    pub message: Option<String>,
    /// The same on a command line.
    pub command: String,
}

/// An analysis with its results.
#[derive(Debug, Serialize, ToSchema)]
pub struct WithResults {
    /// The analysis.
    #[serde(flatten)]
    pub analysis: Analysis,
    /// Files of results.
    pub files: Vec<ResultFile>,
    /// What a diagnosis says, for each cell.
    pub stories: Vec<Story>,
}

/// A file of results.
#[derive(Debug, Serialize, ToSchema)]
pub struct ResultFile {
    /// Its path among the results.
    pub path: String,
    /// Its length.
    pub bytes: u64,
}

/// Why an analysis is not taken or not cancelled.
#[derive(Debug, thiserror::Error)]
pub enum AnalysisError {
    /// It cannot be done as it is asked for.
    #[error("{0}")]
    Unfit(String),
    /// No such analysis.
    #[error("expected the name of an analysis, found {0:?}")]
    Unknown(String),
    /// Not as things are.
    #[error("{0}")]
    Conflict(String),
    /// The file system.
    #[error("{0}")]
    Io(String),
}

/// All analyses of a server.
#[derive(Debug)]
pub struct Analyses {
    folder: PathBuf,
    all: Mutex<Vec<Analysis>>,
    /// Something waits.
    more: Notify,
    /// The one in work is to end.
    cancel: Notify,
}

impl Analyses {
    /// Those of a data folder; what was in work has ended with its server.
    pub fn open(data: &Path) -> Self {
        let folder = data.join("analyses");
        let entries = std::fs::read_dir(&folder).into_iter().flatten().flatten();
        let read = |entry: std::fs::DirEntry| -> Option<Analysis> {
            let text = std::fs::read_to_string(entry.path().join("analysis.json")).ok()?;
            serde_json::from_str(&text).ok()
        };
        let mut all: Vec<Analysis> = entries.filter_map(read).collect();
        all.sort_by(|a, b| a.submitted_unix_s.total_cmp(&b.submitted_unix_s));
        for one in &mut all {
            if one.state == State::InWork {
                one.state = State::Failed;
                one.message = Some("its server ended before it".to_owned());
                one.left_s = None;
            }
        }
        Self {
            folder,
            all: Mutex::new(all),
            more: Notify::new(),
            cancel: Notify::new(),
        }
    }

    fn lock(&self) -> MutexGuard<'_, Vec<Analysis>> {
        self.all.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The latest first.
    pub fn list(&self) -> Vec<Analysis> {
        self.lock().iter().rev().take(MOST_TOLD).cloned().collect()
    }

    /// One by its name, with its results.
    pub fn read(&self, server: &Server, id: &str) -> Option<WithResults> {
        let analysis = self.lock().iter().find(|one| one.id == id).cloned()?;
        let results = self.results(id);
        let found = confined_path::list(&results).unwrap_or_default();
        let files = found.into_iter().map(|(path, bytes)| ResultFile { path, bytes });
        let stories = if analysis.kind == Kind::Diagnose {
            story::all(server, &analysis, &results)
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
        let text = tail(&self.folder.join(id).join("log.txt"));
        let lines = text.lines().filter(|line| !line.starts_with(PROGRESS_LINE));
        lines.map(str::to_owned).collect()
    }

    /// Takes an analysis.
    ///
    /// # Errors
    /// [`AnalysisError`].
    pub fn submit(&self, server: &Server, request: Request, by: &str) -> Result<Analysis, AnalysisError> {
        let mut all = self.lock();
        if all.iter().filter(|one| one.state == State::Waiting).count() >= MOST_WAITING {
            let text = format!("expected at most {MOST_WAITING} analyses that wait, found as many");
            return Err(AnalysisError::Conflict(text));
        }
        let latest = all.iter().filter_map(|one| one.id.rsplit('-').next()?.parse().ok()).max();
        let id = format!("{}-{}", request.kind.name(), latest.unwrap_or(0_u64) + 1);
        let out = self.results(&id);
        let arguments = arguments::arguments(server, &request, &out)?;
        let analysis = Analysis {
            id: id.clone(),
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
        };
        self.keep(&analysis)?;
        all.push(analysis.clone());
        drop(all);
        self.more.notify_one();
        server.hub.tell("analysis", &analysis);
        Ok(analysis)
    }

    fn keep(&self, analysis: &Analysis) -> Result<(), AnalysisError> {
        let failed = |error: &dyn std::fmt::Display| AnalysisError::Io(error.to_string());
        let folder = self.folder.join(&analysis.id);
        std::fs::create_dir_all(&folder).map_err(|error| failed(&error))?;
        let text = serde_json::to_string_pretty(analysis).map_err(|error| failed(&error))?;
        write_atomically(&folder.join("analysis.json"), text.as_bytes()).map_err(|error| failed(&error))
    }

    /// Ends an analysis that waits or is in work.
    ///
    /// # Errors
    /// [`AnalysisError`].
    pub fn cancel(&self, server: &Server, id: &str) -> Result<Analysis, AnalysisError> {
        let state = self.lock().iter().find(|one| one.id == id).map(|one| one.state);
        match state {
            None => return Err(AnalysisError::Unknown(id.to_owned())),
            Some(State::Waiting) => {}
            Some(State::InWork) => self.cancel.notify_one(),
            Some(_) => {
                let text = "expected an analysis that waits or is in work, found one that has ended";
                return Err(AnalysisError::Conflict(text.to_owned()));
            }
        }
        self.change(server, id, |one| {
            one.state = State::Cancelled;
            one.ended_unix_s = Some(clock::unix_time_s());
            one.left_s = None;
        })
        .ok_or_else(|| AnalysisError::Unknown(id.to_owned()))
    }

    /// Changes one, keeps and tells it.
    fn change(&self, server: &Server, id: &str, change: impl FnOnce(&mut Analysis)) -> Option<Analysis> {
        let mut all = self.lock();
        let one = all.iter_mut().find(|one| one.id == id)?;
        change(one);
        let changed = one.clone();
        drop(all);
        if let Err(error) = self.keep(&changed) {
            tracing::error!("{error}");
        }
        server.hub.tell("analysis", &changed);
        Some(changed)
    }

    fn next(&self, server: &Server) -> Option<Analysis> {
        let waiting = self.lock().iter().find(|one| one.state == State::Waiting)?.id.clone();
        self.change(server, &waiting, |one| {
            one.state = State::InWork;
            one.began_unix_s = Some(clock::unix_time_s());
        })
    }
}

/// Does one analysis after the other, for ever.
pub async fn work(server: Arc<Server>) {
    loop {
        match server.analyses.next(&server) {
            Some(analysis) => one(&server, &analysis).await,
            None => server.analyses.more.notified().await,
        }
    }
}

async fn one(server: &Server, analysis: &Analysis) {
    let analyses = &server.analyses;
    let outcome = process(server, analysis).await;
    analyses.change(server, &analysis.id, |one| {
        one.left_s = None;
        if one.state != State::InWork {
            return;
        }
        one.ended_unix_s = Some(clock::unix_time_s());
        (one.state, one.message) = match outcome {
            Ok(message) => (State::Done, message),
            Err(message) => (State::Failed, Some(message)),
        };
        if one.state == State::Done {
            one.progress.done = Some(1.0);
        }
    });
}

/// Runs the process; gives a remark on its results.
async fn process(server: &Server, analysis: &Analysis) -> Result<Option<String>, String> {
    let failed = |error: &dyn std::fmt::Display| error.to_string();
    let folder = server.analyses.folder.join(&analysis.id);
    let request = Request {
        kind: analysis.kind,
        runs: analysis.runs.clone(),
        spectra: analysis.spectra.clone(),
        options: analysis.options.clone(),
    };
    let arguments = arguments::arguments(server, &request, &folder.join("out"))
        .map_err(|error| failed(&error))?;
    let path = folder.join("log.txt");
    let log = File::options()
        .create(true)
        .append(true)
        .mode(0o640)
        .open(&path)
        .map_err(|error| failed(&error))?;
    let errors = log.try_clone().map_err(|error| failed(&error))?;
    // The cores are the runs' first.
    let threads = std::thread::available_parallelism().map_or(1, |cores| cores.get().div_ceil(2));
    let mut child = Command::new("nice")
        .arg("-n10")
        .arg(&server.program)
        .args(&arguments)
        .current_dir(&folder)
        .stdin(Stdio::null())
        .stdout(log)
        .stderr(errors)
        .process_group(0)
        .kill_on_drop(true)
        .env("RAYON_NUM_THREADS", threads.to_string())
        .env("POLARS_MAX_THREADS", threads.to_string())
        .env(PROGRESS_VARIABLE, "lines")
        .env_remove("NOTIFY_SOCKET")
        .env_remove("WATCHDOG_USEC")
        .spawn()
        .map_err(|error| failed(&error))?;
    let group = Pid::from_raw(-child.id().and_then(|id| i32::try_from(id).ok()).unwrap_or(0));
    let status = loop {
        tokio::select! {
            status = child.wait() => break status.map_err(|error| failed(&error))?,
            () = server.analyses.cancel.notified() => {
                // A process that is gone needs none.
                let _ = kill(group, Signal::SIGTERM);
                if server.clock.deadline(std::time::Duration::from_secs_f64(PATIENCE_S), child.wait()).await.is_err() {
                    let _ = kill(group, Signal::SIGKILL);
                }
            }
            () = server.clock.sleep_s(LOOK_S) => look(server, analysis, &path),
        }
    };
    look(server, analysis, &path);
    let text = tail(&path);
    let last = text.lines().rev().find_map(|line| line.strip_prefix("eis-bench: "));
    match status.code() {
        Some(0) => Ok(None),
        Some(INVALID) => Ok(last.map(str::to_owned)),
        _ => Err(last.map_or_else(|| format!("its process ended with {status}"), str::to_owned)),
    }
}

/// Reads how far a process is, and tells it where it has changed.
fn look(server: &Server, analysis: &Analysis, log: &Path) {
    let text = tail(log);
    let Some(words) = text.lines().rev().find_map(|line| line.strip_prefix(PROGRESS_LINE)) else {
        return;
    };
    let known = server.analyses.lock().iter().any(|one| {
        one.id == analysis.id && one.progress.words == words && one.state == State::InWork
    });
    if known {
        return;
    }
    let elapsed_s = clock::unix_time_s() - analysis.began_unix_s.unwrap_or_else(clock::unix_time_s);
    server.analyses.change(server, &analysis.id, |one| {
        let done = share(words);
        one.left_s = done.filter(|done| *done > 0.0).map(|done| elapsed_s * (1.0 - done) / done);
        one.progress = Progress { done, words: words.to_owned() };
    });
}

/// The share in words such as `searches: 3 of 12`.
fn share(words: &str) -> Option<f64> {
    let (before, after) = words.rsplit_once(" of ")?;
    let done: f64 = before.rsplit(' ').next()?.parse().ok()?;
    let of: f64 = after.split(' ').next()?.parse().ok()?;
    (of > 0.0 && done <= of).then(|| done / of)
}

/// The end of a text file.
fn tail(path: &Path) -> String {
    let bytes = std::fs::read(path).unwrap_or_default();
    String::from_utf8_lossy(&bytes[bytes.len().saturating_sub(TAIL)..]).into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_share_is_read_where_the_words_count() {
        assert_eq!(share("searches: 3 of 12"), Some(0.25));
        assert_eq!(share("demo, 4 RC: 12 of 12 starts"), Some(1.0));
        assert_eq!(share("the ranking of effects"), None);
        assert_eq!(share("13 of 12"), None);
    }
}
