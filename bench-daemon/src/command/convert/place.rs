//! Where converted files go.

use std::path::{Path, PathBuf};

use analysis::dataset;
use bench_core::{record::RecordError, safety::failure::Failure};

/// Returns the name of a file without its end.
pub(super) fn stem(file: &Path) -> String {
    file.file_stem().map_or_else(
        || "file".to_owned(),
        |stem| stem.to_string_lossy().into_owned(),
    )
}

/// Returns the path of a file of the folder that is not there yet.
///
/// # Errors
/// [`Failure::Usage`] if it is.
pub(super) fn free(out: &Path, name: &str, ending: &str) -> Result<PathBuf, Failure> {
    let safe: String = name
        .chars()
        .map(|c| if c == '/' || c.is_control() { '_' } else { c })
        .collect();
    let path = out.join(format!("{safe}{ending}"));
    if path.exists() {
        return Err(Failure::Usage(format!(
            "{}: expected no such file, found one; choose another folder with --out",
            path.display()
        )));
    }
    Ok(path)
}

/// Writes a text.
///
/// # Errors
/// [`Failure`] of the disk.
pub(super) fn write(path: &Path, text: &str) -> Result<(), Failure> {
    write_bytes(path, text.as_bytes())
}

/// Writes bytes.
///
/// # Errors
/// [`Failure`] of the disk.
pub(super) fn write_bytes(path: &Path, bytes: &[u8]) -> Result<(), Failure> {
    Ok(dataset::write_atomically(path, bytes).map_err(RecordError::from)?)
}
