//! Reads and writes data sets for a diagnosis: a folder with `dataset.toml`, or a run folder of
//! this program.
//!
//! `dataset.toml` holds a name, perhaps a model and an OCV curve, perhaps `[bench]` (the fields of
//! [`BenchHistory`](analysis::diagnosis::BenchHistory)), perhaps `[calibration]` (the fields of
//! [`CommonError`](analysis::calibration::CommonError)), and a `[[runs]]` for each run.
//! `docs/reference-dataset.md` lists all keys.
//!
//! A mistake in `dataset.toml` is an error. A file that is there but damaged is a
//! (`DataSetProblem`): the diagnosis then ends as invalid, with the reason.

mod files;
mod loaded;
mod named;
mod raw;
mod resolve;
mod run_folder;
mod write;

use std::path::{Path, PathBuf};

use bench_plan::config::ConfigError;

pub use files::DataSetProblem;
use loaded::Flagged;
pub use loaded::{DATASET_FILE, Loaded, Reading};
pub use named::{NamedFile, NamedFiles};
pub use raw::Accept;
pub use write::write_dataset;

/// Reads a data set: a `dataset.toml`, the folder that holds one, or a run folder.
///
/// # Errors
/// [`ConfigError`] with file, line and field for an unexpected value, and for a missing file.
pub fn read_dataset(path: &Path) -> Result<Loaded, ConfigError> {
    read_as(path, Reading::default())
}

/// Reads a data set like [`read_dataset`], with options.
///
/// # Errors
/// As [`read_dataset`].
pub fn read_as(path: &Path, how: Reading) -> Result<Loaded, ConfigError> {
    match listing(path) {
        Some(file) => resolve::read(&file, how),
        None => run_folder::read(path, how),
    }
}

/// Returns the files that a data set names for a diagnosis; empty for a run folder.
///
/// # Errors
/// [`ConfigError`] for a `dataset.toml` that is not as expected.
pub fn named_files(path: &Path) -> Result<NamedFiles, ConfigError> {
    match listing(path) {
        Some(file) => resolve::named_files(&file),
        None => Ok(NamedFiles::default()),
    }
}

/// Returns the file that lists the runs, if there is one.
fn listing(path: &Path) -> Option<PathBuf> {
    if path.is_file() {
        return Some(path.to_owned());
    }
    Some(path.join(DATASET_FILE)).filter(|file| file.is_file())
}

#[cfg(test)]
mod tests;
