//! Input files, named directly or by their folder, and the data that detects changes of them.

use std::fs;
use std::path::{Path, PathBuf};

use bench_core::safety::failure::Failure;

/// Returns the named files and the files of named folders, sorted by name within a folder; hidden
/// files and subfolders are skipped. `of` names what the files contain, for errors.
pub fn files_of(paths: &[PathBuf], of: &str) -> Result<Vec<PathBuf>, Failure> {
    let mut files = Vec::new();
    for path in paths {
        if path.is_dir() {
            files.extend(in_folder(path, of)?);
        } else if path.exists() {
            files.push(path.clone());
        } else {
            let shown = path.display();
            return Err(Failure::Usage(format!(
                "{shown}: expected a file or a folder, found nothing"
            )));
        }
    }
    Ok(files)
}

/// Absolute path, size and time of change of a file, as a line.
pub fn identity(file: &Path) -> Result<String, Failure> {
    let failed = |error| Failure::Usage(format!("{}: {error}", file.display()));
    let about = fs::metadata(file).map_err(failed)?;
    let changed = about
        .modified()
        .ok()
        .and_then(|at| at.duration_since(std::time::UNIX_EPOCH).ok())
        .map_or(0, |since| since.as_nanos());
    let absolute = fs::canonicalize(file).map_err(failed)?;
    Ok(format!(
        "{} {} {changed}\n",
        absolute.display(),
        about.len()
    ))
}

fn in_folder(folder: &Path, of: &str) -> Result<Vec<PathBuf>, Failure> {
    let failed = |error| Failure::Usage(format!("{}: {error}", folder.display()));
    let mut files = Vec::new();
    for entry in fs::read_dir(folder).map_err(failed)? {
        let entry = entry.map_err(failed)?;
        let hidden = entry.file_name().to_string_lossy().starts_with('.');
        if !hidden && entry.path().is_file() {
            files.push(entry.path());
        }
    }
    if files.is_empty() {
        return Err(Failure::Usage(format!(
            "{}: expected files of {of}, found none",
            folder.display()
        )));
    }
    files.sort();
    Ok(files)
}
