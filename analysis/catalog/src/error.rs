//! Reasons why a catalogue cannot be built or queried.

use std::path::PathBuf;

use analysis_files::{batch::BatchError, dataset::DatasetError};
use rusqlite::ErrorCode;

/// Reason why a catalogue cannot be built or queried.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CatalogError {
    /// SQLite refuses.
    #[error("{}: could not {action}: {source}", path.display())]
    Sql {
        /// The catalogue.
        path: PathBuf,
        /// Action that failed, as text.
        action: &'static str,
        /// SQLite's answer.
        source: rusqlite::Error,
    },
    /// No such file.
    #[error(
        "{}: expected a catalogue, found no file: `eis-bench catalog scan` makes one",
        path.display()
    )]
    Absent {
        /// The catalogue.
        path: PathBuf,
    },
    /// A catalogue of a newer program.
    #[error(
        "{}, user_version: expected at most {expected}, found {found}: a newer version of this \
        program made this catalogue; it can be deleted and built again",
        path.display()
    )]
    Newer {
        /// The catalogue.
        path: PathBuf,
        /// Version of this program's tables.
        expected: i32,
        /// Version of the file's tables.
        found: i32,
    },
    /// A catalogue of an older program.
    #[error(
        "{}, user_version: expected {expected}, found {found}: `eis-bench catalog scan` builds it \
        again from the run folders",
        path.display()
    )]
    Older {
        /// The catalogue.
        path: PathBuf,
        /// Version of this program's tables.
        expected: i32,
        /// Version of the file's tables.
        found: i32,
    },
    /// A file of another program.
    #[error(
        "{}, application_id: expected {expected:#010x} of a catalogue, found {found:#010x}: this \
        file is something else, and nothing is written into it",
        path.display()
    )]
    Foreign {
        /// The file.
        path: PathBuf,
        /// Mark of a catalogue.
        expected: i32,
        /// Mark of the file.
        found: i32,
    },
    /// A folder to be scanned that is not there.
    #[error(
        "{}: expected a folder to scan: {source}; its runs stay in the catalogue as they are",
        path.display()
    )]
    Root {
        /// The folder.
        path: PathBuf,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// Nothing to scan.
    #[error("{}: expected a folder to scan, found none given and none remembered", path.display())]
    NoRoot {
        /// The catalogue.
        path: PathBuf,
    },
    /// A cursor that no reply contained.
    #[error("after: expected the `after` of an answer before, found {found:?}")]
    Cursor {
        /// The text.
        found: String,
    },
    /// Several runs, or none, match a request for one run.
    #[error(
        "run: expected the identity, the folder or the name of one run, found {number} for {found:?}{listed}"
    )]
    Run {
        /// The text.
        found: String,
        /// Number of runs that it means.
        number: usize,
        /// Some of them, as the text that follows.
        listed: String,
    },
    /// A table that cannot be written.
    #[error(transparent)]
    Table(#[from] BatchError),
    /// A file that cannot be written.
    #[error(transparent)]
    File(#[from] DatasetError),
}

impl CatalogError {
    /// Returns whether the file is no longer a valid catalogue: SQLite reports that it is not a
    /// database or is damaged. A full disk or a file locked by another process does not count.
    pub fn is_damaged(&self) -> bool {
        let Self::Sql { source, .. } = self else {
            return false;
        };
        let damaged = [ErrorCode::NotADatabase, ErrorCode::DatabaseCorrupt];
        let code = source.sqlite_error_code();
        code.is_some_and(|code| damaged.contains(&code))
    }
}

/// Errors of SQLite on a file, while something is done.
pub(crate) fn sql(
    path: &std::path::Path,
    action: &'static str,
) -> impl Fn(rusqlite::Error) -> CatalogError {
    let path = path.to_path_buf();
    move |source| CatalogError::Sql {
        path: path.clone(),
        action,
        source,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_damaged_file_is_one() {
        use rusqlite::ffi;
        let is_damaged = |code| {
            let source = rusqlite::Error::SqliteFailure(ffi::Error::new(code), None);
            sql("c.sqlite".as_ref(), "open it")(source).is_damaged()
        };
        assert!(is_damaged(ffi::SQLITE_NOTADB) && is_damaged(ffi::SQLITE_CORRUPT));
        for code in [
            ffi::SQLITE_BUSY,
            ffi::SQLITE_FULL,
            ffi::SQLITE_IOERR,
            ffi::SQLITE_CANTOPEN,
        ] {
            assert!(!is_damaged(code), "{code}");
        }
    }
}
