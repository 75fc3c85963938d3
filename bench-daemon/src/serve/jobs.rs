//! Record of each run that was begun here: one small file each beside the run folders. It is
//! written when the run begins and when it has ended.

use std::path::{Path, PathBuf};

use analysis::dataset::write_atomically;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::queue::Item;

/// A run that was begun here.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Job {
    /// Request for the run.
    pub item: Item,
    /// How it ended; none while it goes on.
    pub ended: Option<Ended>,
}

/// The end of a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Ended {
    /// Exit code of its process; none where it was killed, or ended while no server was there.
    pub code: Option<i32>,
    /// Nothing of it is left to do.
    pub finished: bool,
    /// How, in words.
    pub how: String,
    /// When it was noticed, s since 1970.
    pub unix_s: f64,
}

fn path(data: &Path, run: &str) -> PathBuf {
    data.join("jobs").join(format!("{run}.json"))
}

/// Writes what is known of a run, whole or not at all.
///
/// # Errors
/// In words: a file that cannot be written.
pub fn write(data: &Path, job: &Job) -> Result<(), String> {
    let text = serde_json::to_string_pretty(job).map_err(|error| error.to_string())?;
    write_atomically(&path(data, &job.item.run), text.as_bytes()).map_err(|error| error.to_string())
}

/// Reads the record of a run; `run` must be a plain name.
pub fn read(data: &Path, run: &str) -> Option<Job> {
    serde_json::from_str(&std::fs::read_to_string(path(data, run)).ok()?).ok()
}

/// All of them, the latest first.
pub fn all(data: &Path) -> Vec<Job> {
    let entries = std::fs::read_dir(data.join("jobs"))
        .into_iter()
        .flatten()
        .flatten();
    let read = |entry: std::fs::DirEntry| {
        serde_json::from_str::<Job>(&std::fs::read_to_string(entry.path()).ok()?).ok()
    };
    let mut jobs: Vec<Job> = entries
        .filter(|entry| entry.path().extension().is_some_and(|end| end == "json"))
        .filter_map(read)
        .collect();
    jobs.sort_by(|a, b| {
        b.item
            .submitted_unix_s
            .total_cmp(&a.item.submitted_unix_s)
            .then(b.item.id.cmp(&a.item.id))
    });
    jobs
}
