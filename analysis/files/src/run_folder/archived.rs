//! Captures of a run that were moved from its folder to an archive.
//!
//! The file [`ARCHIVED`] lists the hash, the size, the archive and the time of each. It is written
//! before the first capture is removed, so that moved captures can always be distinguished from lost
//! ones.

use std::{fs, path::Path};

use serde::{Deserialize, Serialize};

use super::ARCHIVED;
use crate::dataset::{DatasetError, write_atomically};

/// Name of the schema of [`ARCHIVED`].
pub const ARCHIVED_SCHEMA: &str = "eis-bench/archived";
/// Version of that schema.
pub const ARCHIVED_SCHEMA_VERSION: u32 = 1;

/// Files of a run that were moved to an archive.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Archived {
    /// [`ARCHIVED_SCHEMA`].
    pub schema: String,
    /// [`ARCHIVED_SCHEMA_VERSION`].
    pub schema_version: u32,
    /// The archive.
    pub store: String,
    /// The files.
    pub files: Vec<ArchivedFile>,
}

/// A file that was moved.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ArchivedFile {
    /// Its path in the run folder.
    pub path: String,
    /// SHA-256 of its bytes.
    pub sha256: String,
    /// Its size.
    pub bytes: u64,
    /// When it was moved, s since 1970.
    pub moved_unix_s: f64,
}

impl Archived {
    /// A list without files.
    pub fn of(store: &str) -> Self {
        Self {
            schema: ARCHIVED_SCHEMA.to_owned(),
            schema_version: ARCHIVED_SCHEMA_VERSION,
            store: store.to_owned(),
            files: Vec::new(),
        }
    }

    /// Reads the list of a run folder; returns `None` if nothing was moved.
    ///
    /// # Errors
    /// In words: a file that cannot be read or is not such a list.
    pub fn read(folder: &Path) -> Result<Option<Self>, String> {
        let path = folder.join(ARCHIVED);
        let text = match fs::read(&path) {
            Ok(text) => text,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(format!("{}: {error}", path.display())),
        };
        let list: Self = serde_json::from_slice(&text).map_err(|error| {
            let path = path.display();
            format!("{path}: expected a list of archived files, found {error}")
        })?;
        if list.schema != ARCHIVED_SCHEMA || list.schema_version != ARCHIVED_SCHEMA_VERSION {
            return Err(format!(
                "{}, schema: expected {ARCHIVED_SCHEMA} version {ARCHIVED_SCHEMA_VERSION}, \
                 found {} version {}",
                path.display(),
                list.schema,
                list.schema_version
            ));
        }
        Ok(Some(list))
    }

    /// Writes the list, whole or not at all.
    ///
    /// # Errors
    /// [`DatasetError`].
    pub fn write(&self, folder: &Path) -> Result<(), DatasetError> {
        let text = serde_json::to_vec_pretty(self).unwrap_or_default();
        write_atomically(&folder.join(ARCHIVED), &text)
    }

    /// Returns the files that are not in the folder.
    pub fn absent(&self, folder: &Path) -> Vec<&ArchivedFile> {
        let gone = |file: &&ArchivedFile| !folder.join(&file.path).exists();
        self.files.iter().filter(gone).collect()
    }

    /// Returns the entry of a path that is not in the folder.
    pub fn absent_file(&self, folder: &Path, path: &str) -> Option<&ArchivedFile> {
        self.absent(folder)
            .into_iter()
            .find(|file| file.path == path)
    }

    /// Describes where the moved files are and how to fetch them.
    pub fn words(&self) -> String {
        format!(
            "moved to the archive {}, `eis-archive fetch` brings it back",
            self.store
        )
    }
}

/// Describes the captures of a run that are in an archive; returns `None` if all are in its folder.
///
/// # Errors
/// As [`Archived::read`].
pub fn moved_captures(folder: &Path) -> Result<Option<String>, String> {
    let Some(list) = Archived::read(folder)? else {
        return Ok(None);
    };
    let absent = list.absent(folder);
    Ok(absent.first().map(|first| {
        format!(
            "{}, {}: {}; {} files of this run are there",
            folder.display(),
            first.path,
            list.words(),
            absent.len()
        )
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn list() -> Archived {
        let mut list = Archived::of("s3://lab/eis");
        list.files.push(ArchivedFile {
            path: "captures/cell/a.parquet".to_owned(),
            sha256: "cd".to_owned(),
            bytes: 3,
            moved_unix_s: 1.5,
        });
        list
    }

    #[test]
    fn a_moved_file_is_reported_until_it_is_back() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(moved_captures(folder.path()), Ok(None));
        list().write(folder.path()).unwrap();
        let message = moved_captures(folder.path()).unwrap().unwrap();
        assert!(message.contains("captures/cell/a.parquet: moved to the archive s3://lab/eis"));
        fs::create_dir_all(folder.path().join("captures/cell")).unwrap();
        fs::write(folder.path().join("captures/cell/a.parquet"), "abc").unwrap();
        assert_eq!(moved_captures(folder.path()), Ok(None));
    }

    #[test]
    fn another_file_of_this_name_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join(ARCHIVED), "{}").unwrap();
        let message = Archived::read(folder.path()).unwrap_err();
        assert!(
            message.contains("expected a list of archived files"),
            "{message}"
        );
        let newer = Archived {
            schema_version: 2,
            ..list()
        };
        newer.write(folder.path()).unwrap();
        let message = Archived::read(folder.path()).unwrap_err();
        assert!(message.contains("version 1, found eis-bench/archived version 2"));
    }
}
