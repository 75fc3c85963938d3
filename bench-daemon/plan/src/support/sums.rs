//! The hashes of a finished run: `SHA256SUMS`, one line for every other file of the folder, in
//! the format of `sha256sum --check`.
//!
//! They detect accidental changes, including changes of the list itself. They do not protect
//! against an attacker, who can write another list.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs, io,
    path::{Path, PathBuf},
};

use analysis_files::{
    dataset::{self, DatasetError},
    run_folder::{
        Archived, SUMS,
        sums::{self, Sums},
    },
};
use rayon::prelude::*;

use crate::support::hash;

/// Hashes that cannot be written or read.
#[derive(Debug, thiserror::Error)]
pub enum SumsError {
    /// The file system.
    #[error("{path}: cannot be read: {source}", path = path.display())]
    Read {
        /// The file or folder.
        path: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
    /// The list of files that were moved to an archive.
    #[error("{0}")]
    Archived(String),
    /// The list itself.
    #[error(transparent)]
    Write(#[from] DatasetError),
}

/// A file that differs from its state at the end of the run.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct Altered {
    /// The file, relative to the folder.
    pub file: String,
    /// Difference of the file, in words.
    pub what: String,
}

/// Comparison of a folder with its list of hashes.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct Checked {
    /// Number of its files.
    pub files: usize,
    /// Number of listed files that were moved to an archive.
    pub moved: usize,
    /// Files that are not what they were.
    pub altered: Vec<Altered>,
}

/// Writes the hashes of all files of a folder, including those that were moved to an archive.
///
/// # Errors
/// [`SumsError`].
pub fn write(folder: &Path) -> Result<(), SumsError> {
    let names = sums::files_of(folder).map_err(|source| unreadable(folder, source))?;
    let lines = names
        .par_iter()
        .map(|name| Ok((name.clone(), sum(folder, name)?)));
    let mut lines: BTreeMap<String, String> = lines.collect::<Result<_, SumsError>>()?;
    lines.extend(moved(folder)?);
    let text: String = lines
        .iter()
        .map(|(name, sum)| format!("{sum}  {name}\n"))
        .collect();
    Ok(dataset::write_atomically(
        &folder.join(SUMS),
        text.as_bytes(),
    )?)
}

/// Compares all files of a folder with their hashes. A file that was moved to an archive does not
/// count as missing if its hash was the listed one.
///
/// # Errors
/// [`SumsError`]; missing files count as altered.
pub fn check(folder: &Path) -> Result<Checked, SumsError> {
    let path = folder.join(SUMS);
    let bytes = fs::read(&path).map_err(|source| SumsError::Read { path, source })?;
    let text = String::from_utf8_lossy(&bytes);
    let Sums { files, wrong } = Sums::of(&text);
    let names = sums::files_of(folder).map_err(|source| unreadable(folder, source))?;
    let mut checked = Checked {
        files: names.len(),
        altered: wrong.into_iter().map(|what| altered(SUMS, what)).collect(),
        ..Checked::default()
    };
    let differs = |name: &String| differing(folder, name, files.get(name.as_str()).copied());
    let differing: Vec<Option<Altered>> = names
        .par_iter()
        .map(differs)
        .collect::<Result<_, SumsError>>()?;
    checked.altered.extend(differing.into_iter().flatten());
    let there: BTreeSet<&str> = names.iter().map(String::as_str).collect();
    let moved = moved(folder)?;
    for (name, sum) in files.iter().filter(|(name, _)| !there.contains(**name)) {
        match moved.get(*name) {
            Some(moved) if moved == sum => checked.moved += 1,
            _ => checked.altered.push(altered(name, "missing".to_owned())),
        }
    }
    Ok(checked)
}

/// Describes a file that does not match the list, or that the list does not contain.
fn differing(
    folder: &Path,
    name: &str,
    listed: Option<&str>,
) -> Result<Option<Altered>, SumsError> {
    let Some(expected) = listed else {
        return Ok(Some(altered(name, format!("not in {SUMS}"))));
    };
    let met = sum(folder, name)?;
    let what = || format!("expected the SHA-256 {expected}, found {met}");
    Ok((met != expected).then(|| altered(name, what())))
}

fn altered(file: &str, what: String) -> Altered {
    Altered {
        file: file.to_owned(),
        what,
    }
}

fn unreadable(path: &Path, source: io::Error) -> SumsError {
    SumsError::Read {
        path: path.to_owned(),
        source,
    }
}

/// SHA-256 of the files that were moved to an archive, by name.
fn moved(folder: &Path) -> Result<BTreeMap<String, String>, SumsError> {
    let list = Archived::read(folder).map_err(SumsError::Archived)?;
    let files = list.iter().flat_map(|list| list.absent(folder));
    Ok(files
        .map(|file| (file.path.clone(), file.sha256.clone()))
        .collect())
}

fn sum(folder: &Path, name: &str) -> Result<String, SumsError> {
    let path = folder.join(name);
    hash::sha256_of(&path).map_err(|source| SumsError::Read { path, source })
}

#[cfg(test)]
mod tests {
    use analysis_files::run_folder::ArchivedFile;

    use super::*;

    #[test]
    fn what_was_altered_is_named() {
        let folder = tempfile::tempdir().unwrap();
        fs::create_dir(folder.path().join("b")).unwrap();
        for name in ["a.csv", "b/c", "d"] {
            fs::write(folder.path().join(name), name).unwrap();
        }
        write(folder.path()).unwrap();
        let whole = Checked {
            files: 3,
            ..Checked::default()
        };
        assert_eq!(check(folder.path()).unwrap(), whole);
        fs::write(folder.path().join("b/c"), "b/d").unwrap();
        fs::rename(folder.path().join("d"), folder.path().join("e")).unwrap();
        let found = check(folder.path()).unwrap().altered;
        let messages: Vec<String> = found
            .iter()
            .map(|one| format!("{}: {}", one.file, one.what))
            .collect();
        assert!(
            messages[0].starts_with("b/c: expected the SHA-256 ")
                && messages[0].contains(", found "),
            "{messages:?}"
        );
        assert_eq!(messages[1..], ["e: not in SHA256SUMS", "d: missing"]);
    }

    #[test]
    fn no_bit_of_the_list_can_be_flipped() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["a", "f"] {
            fs::write(folder.path().join(name), name).unwrap();
        }
        write(folder.path()).unwrap();
        let list = folder.path().join(SUMS);
        let bytes = fs::read(&list).unwrap();
        for bit in 0..8 * bytes.len() {
            let mut flipped = bytes.clone();
            flipped[bit / 8] ^= 1 << (bit % 8);
            fs::write(&list, flipped).unwrap();
            assert!(
                !check(folder.path()).unwrap().altered.is_empty(),
                "bit {bit}"
            );
        }
    }

    #[test]
    fn a_moved_file_is_not_missing_and_stays_in_the_list() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["a", "b", "c"] {
            fs::write(folder.path().join(name), name).unwrap();
        }
        write(folder.path()).unwrap();
        let list = fs::read(folder.path().join(SUMS)).unwrap();
        let mut moved = Archived::of("s3://lab/eis");
        moved.files.push(ArchivedFile {
            path: "b".to_owned(),
            sha256: sum(folder.path(), "b").unwrap(),
            bytes: 1,
            moved_unix_s: 0.0,
        });
        fs::remove_file(folder.path().join("b")).unwrap();
        moved.write(folder.path()).unwrap();
        let checked = check(folder.path()).unwrap();
        assert_eq!(
            (checked.moved, checked.altered.as_slice()),
            (1, [].as_slice())
        );
        write(folder.path()).unwrap();
        assert_eq!(fs::read(folder.path().join(SUMS)).unwrap(), list);
        moved.files[0].sha256 = "00".repeat(32);
        moved.write(folder.path()).unwrap();
        let checked = check(folder.path()).unwrap();
        assert_eq!(checked.altered, [altered("b", "missing".to_owned())]);
    }
}
