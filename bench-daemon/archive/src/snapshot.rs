//! A snapshot of a run folder: its files with their hashes, compared with its own list of hashes.

use std::{
    collections::BTreeMap,
    fs::{self, File, TryLockError},
    io,
    os::unix::fs::MetadataExt,
    path::{Path, PathBuf},
};

use analysis_catalog::rows::{DiagnosisFolder, diagnoses_within};
use analysis_files::run_folder::{
    ARCHIVED, Archived, DIAGNOSIS, INDEX, JOURNAL, MANIFEST, SUMS,
    sums::{self, Sums},
};

use crate::{
    ArchiveError,
    hash::Hashed,
    layout::{FileEntry, run_sha256},
};

/// Folder of the diagnoses beside a run folder, in the paths of its files.
pub(crate) const ANALYSES: &str = "analyses";

/// A run to be archived.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RunSource {
    /// Its name.
    pub name: String,
    /// Its folder.
    pub folder: PathBuf,
    /// Its diagnoses beside it.
    pub diagnoses: Vec<DiagnosisFolder>,
}

/// Snapshot of the files of a run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Snapshot {
    /// Identity of the run, from its content.
    pub run_sha256: String,
    /// Its files by path, including those that were moved to an archive.
    pub files: Vec<FileEntry>,
}

impl RunSource {
    /// Creates a run without diagnoses beside it.
    pub fn of(folder: &Path) -> Self {
        let name = folder.file_name().unwrap_or_default();
        Self {
            name: name.to_string_lossy().into_owned(),
            folder: folder.to_path_buf(),
            diagnoses: Vec::new(),
        }
    }

    /// Returns the location of the bytes of a file.
    pub(crate) fn place(&self, path: &str) -> PathBuf {
        let beside = path.strip_prefix(ANALYSES).and_then(|rest| {
            let (name, file) = rest.strip_prefix('/')?.rsplit_once('/')?;
            let own = |one: &&DiagnosisFolder| one.name == name;
            Some(self.diagnoses.iter().find(own)?.folder.join(file))
        });
        beside.unwrap_or_else(|| self.folder.join(path))
    }

    /// Returns the state of the files that change when the run continues, is recomputed or
    /// diagnosed. Moving its captures does not change it.
    pub fn stamp(&self) -> String {
        let entries = fs::read_dir(&self.folder).into_iter().flatten().flatten();
        let mut names: Vec<_> = entries.map(|entry| entry.file_name()).collect();
        names.retain(|name| name != ARCHIVED);
        names.sort();
        let within = [MANIFEST, JOURNAL, INDEX, SUMS].map(|name| self.folder.join(name));
        let diagnosed = names
            .iter()
            .map(|name| self.folder.join(name).join(DIAGNOSIS));
        // Diagnoses of single cells lie one folder deeper. Without them the state equals that of
        // earlier versions.
        let of_cells = diagnoses_within(&self.folder).into_iter();
        let of_cells = of_cells.filter(|folder| folder.parent() != Some(self.folder.as_path()));
        let beside = self.diagnoses.iter().map(|one| one.folder.clone());
        let deeper = of_cells.chain(beside).map(|folder| folder.join(DIAGNOSIS));
        let of = |path: PathBuf| {
            fs::metadata(path).map_or_else(
                |_| "-".to_owned(),
                |meta| format!("{}:{}.{}", meta.len(), meta.mtime(), meta.mtime_nsec()),
            )
        };
        let files = within.into_iter().chain(diagnosed).chain(deeper).map(of);
        let state = format!("{names:?} {:?}", files.collect::<Vec<_>>());
        Hashed::of(state.as_bytes()).sha256
    }

    /// Returns whether a process works in the folder: it holds the lock of the journal.
    pub(crate) fn is_in_use(&self) -> bool {
        File::open(self.folder.join(JOURNAL))
            .is_ok_and(|journal| matches!(journal.try_lock_shared(), Err(TryLockError::WouldBlock)))
    }

    /// Reads every file. `is_finished` states that the run has a list of hashes.
    ///
    /// # Errors
    /// [`ArchiveError::Refused`] if the folder does not match its list of hashes.
    pub fn snapshot(&self, is_finished: bool) -> Result<Snapshot, ArchiveError> {
        let mut files = self.own_files()?;
        self.hold_against_sums(&files, is_finished)?;
        for DiagnosisFolder { name, folder } in &self.diagnoses {
            let path = format!("{ANALYSES}/{name}/{DIAGNOSIS}");
            files.push(entry(path, &folder.join(DIAGNOSIS))?);
        }
        files.sort_by(|a, b| a.path.cmp(&b.path));
        Ok(Snapshot {
            run_sha256: run_sha256(&files),
            files,
        })
    }

    fn own_files(&self) -> Result<Vec<FileEntry>, ArchiveError> {
        let names = sums::files_of(&self.folder);
        let mut names = names.map_err(ArchiveError::io(&self.folder, "read the folder"))?;
        if self.folder.join(SUMS).exists() {
            names.push(SUMS.to_owned());
        }
        let mut files = Vec::new();
        for name in names {
            let path = self.folder.join(&name);
            self.plain(&name, &path)?;
            files.push(entry(name, &path)?);
        }
        let moved = Archived::read(&self.folder).map_err(ArchiveError::Record)?;
        let absent = moved.iter().flat_map(|list| list.absent(&self.folder));
        files.extend(absent.map(|file| FileEntry {
            path: file.path.clone(),
            sha256: file.sha256.clone(),
            bytes: file.bytes,
        }));
        Ok(files)
    }

    /// Accepts only plain files, with names that a list of lines can represent.
    fn plain(&self, name: &str, path: &Path) -> Result<(), ArchiveError> {
        let meta = fs::symlink_metadata(path).map_err(|error| vanished(error, path))?;
        match meta.is_file() && !name.contains(['\n', '\r', '\\']) {
            true => Ok(()),
            false => Err(self.refused(format!("expected plain files, found {name:?}"))),
        }
    }

    fn hold_against_sums(
        &self,
        files: &[FileEntry],
        is_finished: bool,
    ) -> Result<(), ArchiveError> {
        let path = self.folder.join(SUMS);
        let bytes = match fs::read(&path) {
            Ok(bytes) => bytes,
            Err(error) if error.kind() == io::ErrorKind::NotFound && !is_finished => return Ok(()),
            Err(error) => return Err(self.refused(format!("{SUMS}: {error}"))),
        };
        let text = String::from_utf8_lossy(&bytes);
        let Sums {
            files: listed,
            wrong,
        } = Sums::of(&text);
        if let Some(wrong) = wrong.first() {
            return Err(self.refused(format!("{SUMS}, {wrong}")));
        }
        let found: BTreeMap<&str, &str> = files
            .iter()
            .filter(|file| file.path != SUMS)
            .map(|file| (file.path.as_str(), file.sha256.as_str()))
            .collect();
        let differing = listed.iter().find_map(|(name, sum)| match found.get(name) {
            Some(met) if met == sum => None,
            Some(met) => Some(format!("{name}: expected the SHA-256 {sum}, found {met}")),
            None => Some(format!("{name}: expected of {SUMS}, found none")),
        });
        let unlisted = found
            .keys()
            .find(|name| !listed.contains_key(**name) && !self.is_of_diagnosis(name))
            .map(|name| format!("{name}: expected in {SUMS}, found in the folder only"));
        match differing.or(unlisted) {
            Some(why) => Err(self.refused(why)),
            None => Ok(()),
        }
    }

    /// A diagnosis may be written into the run folder after the run.
    fn is_of_diagnosis(&self, name: &str) -> bool {
        let mut above = Path::new(name).ancestors().skip(1);
        above.any(|folder| {
            !folder.as_os_str().is_empty() && self.folder.join(folder).join(DIAGNOSIS).is_file()
        })
    }

    pub(crate) fn refused(&self, why: String) -> ArchiveError {
        ArchiveError::Refused {
            run: self.name.clone(),
            why,
        }
    }
}

fn entry(path: String, file: &Path) -> Result<FileEntry, ArchiveError> {
    let Hashed { sha256, bytes } = Hashed::of_file(file)?;
    Ok(FileEntry {
        path,
        sha256,
        bytes,
    })
}

/// A listed file that has disappeared counts as changed.
fn vanished(error: io::Error, path: &Path) -> ArchiveError {
    match error.kind() {
        io::ErrorKind::NotFound => ArchiveError::Changed {
            file: path.to_path_buf(),
        },
        _ => ArchiveError::io(path, "read the file")(error),
    }
}
