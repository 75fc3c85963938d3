//! Configuration files that users change over the API. The configuration folder is never written.
//! A changed file is stored as a version in the data folder, with its author and reason, and the
//! latest version is used instead of the file. Versions are never deleted.
//!
//! A version of a bench does not take effect that way: its guardian and `eis-bench safe` read the
//! bench's own file. It is a proposal, until `eis-bench config take` writes it into that file.

use std::{
    fs::File,
    path::{Path, PathBuf},
};

use analysis::dataset::write_atomically;
use instruments::clock;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::settings::Settings;
use bench_core::safety::failure::Failure;
use bench_plan::{
    config::{self, Copies},
    support::{
        confined_path::{self, plain},
        hash,
    },
};

/// Most versions of a file.
const MOST_VERSIONS: usize = 1000;
/// File in the folder of a submission: the SHA-256 of the bench file that its plan was checked with.
pub const BENCH_SHA256: &str = "bench.sha256";

/// Kind of a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum FileKind {
    /// Procedure of a measurement.
    Experiments,
    /// Limits and properties of a cell.
    Cells,
    /// Instruments and wiring.
    Benches,
}

impl FileKind {
    /// Name of its folder.
    pub fn folder(self) -> &'static str {
        match self {
            Self::Experiments => "experiments",
            Self::Cells => "cells",
            Self::Benches => "benches",
        }
    }
}

/// A file of a kind.
#[derive(Debug, Serialize, ToSchema)]
pub struct Listed {
    /// Its name, without extension.
    pub name: String,
    /// True if it was changed or created on this server.
    edited: bool,
    /// Number of its versions on this server.
    versions: usize,
    /// For a bench: the version that is proposed but not in force; null if there is none.
    proposed: Option<usize>,
}

/// Origin of a version.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum VersionKind {
    /// Written by a person; for a bench, a proposal.
    #[default]
    Written,
    /// For a bench: the text in force was saved again, which withdraws the proposal.
    Withdrawn,
    /// For a bench: its file before another text was put in force.
    Before,
    /// For a bench: the text was put in force and became its file.
    Taken,
}

/// A version of a file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Version {
    /// Its number, from 1; 0 is the file of the configuration.
    pub version: usize,
    /// Time of creation, s since 1970; null for the file of the configuration.
    pub unix_s: Option<f64>,
    /// Author.
    pub by: String,
    /// Reason for the change.
    pub why: String,
    /// SHA-256 of its text.
    pub sha256: String,
    /// Its origin.
    #[serde(default)]
    pub kind: VersionKind,
}

/// A stored version with its text.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct Kept {
    #[serde(flatten)]
    version: Version,
    text: String,
}

/// A file with its history.
#[derive(Debug, Clone)]
pub struct Shelved {
    /// Text of the version that was asked for.
    pub text: String,
    /// Its checksum.
    pub sha256: String,
    /// All versions, the oldest first.
    pub versions: Vec<Version>,
    /// Text of the file of the configuration, where there is one.
    pub original: Option<String>,
    /// Of a bench: the version that is proposed and not in force, where there is one.
    pub proposed: Option<usize>,
}

/// Why a file is not changed.
#[derive(Debug, thiserror::Error)]
pub enum ShelfError {
    /// Another user has changed the file in the meantime.
    #[error(
        "expected the text that is there now (SHA-256 {found}), found another one: it was changed meanwhile"
    )]
    Changed {
        /// Checksum of the present text.
        found: String,
    },
    /// Too many.
    #[error("expected at most {MOST_VERSIONS} versions of a file, found as many")]
    Full,
    /// The file system.
    #[error("{0}")]
    Io(String),
}

impl From<ShelfError> for Failure {
    fn from(error: ShelfError) -> Self {
        Self::Usage(error.to_string())
    }
}

/// A new version.
#[derive(Debug, Clone, Copy)]
pub struct Change<'a> {
    /// The text.
    pub text: &'a str,
    /// Its author.
    pub by: &'a str,
    /// Why.
    pub why: &'a str,
    /// Checksum of the text that it was made from; `None` for a new file.
    pub was_sha256: Option<&'a str>,
}

/// A version of a bench that is put in force.
#[derive(Debug, Clone, Copy)]
pub struct Taking<'a> {
    /// Its number.
    pub version: usize,
    /// Its text.
    pub text: &'a str,
    /// The text in force until now.
    pub before: &'a str,
    /// Name of the caller.
    pub by: &'a str,
}

/// A version that is about to be stored.
#[derive(Clone, Copy)]
struct New<'a> {
    kind: VersionKind,
    text: &'a str,
    by: &'a str,
    why: &'a str,
}

fn kind_folder(settings: &Settings, kind: FileKind) -> PathBuf {
    settings.data.join("files").join(kind.folder())
}

fn folder_of(settings: &Settings, kind: FileKind, name: &str) -> PathBuf {
    kind_folder(settings, kind).join(name)
}

/// Returns the file of the configuration, without changes made over the API.
fn original(settings: &Settings, kind: FileKind, name: &str) -> Option<String> {
    if kind == FileKind::Benches {
        return std::fs::read_to_string(&settings.bench(name)?.path).ok();
    }
    let file = format!("{}/{name}.toml", kind.folder());
    std::io::read_to_string(confined_path::open(&settings.configs, &file)?).ok()
}

/// Numbers of the versions that were made here, rising.
fn numbers(settings: &Settings, kind: FileKind, name: &str) -> Result<Vec<usize>, ShelfError> {
    let folder = folder_of(settings, kind, name);
    let entries = match std::fs::read_dir(&folder) {
        Ok(entries) => entries,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(error) => return Err(ShelfError::Io(format!("{}: {error}", folder.display()))),
    };
    let number = |name: std::ffi::OsString| name.to_str()?.strip_suffix(".json")?.parse().ok();
    let mut numbers: Vec<usize> = entries
        .flatten()
        .filter_map(|entry| number(entry.file_name()))
        .collect();
    numbers.sort_unstable();
    Ok(numbers)
}

/// A version that was made here. One that cannot be read is an error: the one before it may have
/// wider limits.
fn version(
    settings: &Settings,
    kind: FileKind,
    name: &str,
    number: usize,
) -> Result<Kept, ShelfError> {
    let path = folder_of(settings, kind, name).join(file_name(number));
    let failed =
        |error: &dyn std::fmt::Display| ShelfError::Io(format!("{}: {error}", path.display()));
    let text = std::fs::read_to_string(&path).map_err(|error| failed(&error))?;
    serde_json::from_str(&text).map_err(|error| failed(&error))
}

/// Versions that were made here, the oldest first.
fn kept(settings: &Settings, kind: FileKind, name: &str) -> Result<Vec<Kept>, ShelfError> {
    let all = numbers(settings, kind, name)?;
    all.into_iter()
        .map(|number| version(settings, kind, name, number))
        .collect()
}

fn file_name(number: usize) -> String {
    format!("{number:04}.json")
}

/// Names of folders or of files with the ending, that are plain.
fn names(folder: &Path, ending: &str) -> Vec<String> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let name = |entry: std::fs::DirEntry| {
        let name = entry.file_name().to_str()?.strip_suffix(ending)?.to_owned();
        plain(&name).then_some(name)
    };
    entries.filter_map(name).collect()
}

/// All files of a kind, by name.
pub fn list(settings: &Settings, kind: FileKind) -> Vec<Listed> {
    let mut all = if kind == FileKind::Benches {
        settings
            .benches
            .iter()
            .map(|bench| bench.name.clone())
            .collect()
    } else {
        let mut all = names(&settings.configs.join(kind.folder()), ".toml");
        all.extend(names(&kind_folder(settings, kind), ""));
        all
    };
    all.sort();
    all.dedup();
    all.into_iter()
        .map(|name| {
            let versions = numbers(settings, kind, &name).map_or(0, |all| all.len());
            Listed {
                proposed: proposed(settings, kind, &name),
                name,
                edited: versions > 0,
                versions,
            }
        })
        .collect()
}

/// Number of the version of a bench that is proposed and not in force.
fn proposed(settings: &Settings, kind: FileKind, name: &str) -> Option<usize> {
    if kind != FileKind::Benches {
        return None;
    }
    read(settings, kind, name, None).ok()??.proposed
}

/// The file of the configuration among the versions of a file.
fn first(all: &[Kept]) -> Option<&Kept> {
    all.iter().find(|kept| kept.version.version == 0)
}

/// Returns the last version of a bench by a user if it is a proposal whose text is not in force.
fn open_proposal(all: &[Kept]) -> Option<&Kept> {
    let in_force = first(all).map(|kept| &kept.version.sha256);
    let last = all
        .iter()
        .rfind(|kept| kept.version.kind != VersionKind::Before)?;
    let Version {
        version,
        kind,
        sha256,
        ..
    } = &last.version;
    let is_open = *version > 0 && *kind == VersionKind::Written && Some(sha256) != in_force;
    is_open.then_some(last)
}

/// Returns a file: the version of this number, otherwise the latest. The latest version of a bench
/// is its proposal, otherwise its file. Returns `None` if the file does not exist.
///
/// # Errors
/// A version that cannot be read.
pub fn read(
    settings: &Settings,
    kind: FileKind,
    name: &str,
    version: Option<usize>,
) -> Result<Option<Shelved>, ShelfError> {
    if !plain(name) {
        return Ok(None);
    }
    let file = original(settings, kind, name).map(|text| Kept {
        version: Version {
            version: 0,
            unix_s: None,
            by: "file of the configuration".to_owned(),
            why: String::new(),
            sha256: hash::sha256(&text),
            kind: VersionKind::Written,
        },
        text,
    });
    let all: Vec<Kept> = file
        .into_iter()
        .chain(kept(settings, kind, name)?)
        .collect();
    let open = open_proposal(&all).filter(|_| kind == FileKind::Benches);
    let wanted = match version {
        Some(number) => all.iter().find(|kept| kept.version.version == number),
        None if kind == FileKind::Benches => open.or_else(|| first(&all)),
        None => all.last(),
    };
    Ok(wanted.map(|wanted| Shelved {
        text: wanted.text.clone(),
        sha256: wanted.version.sha256.clone(),
        versions: all.iter().map(|kept| kept.version.clone()).collect(),
        original: first(&all).map(|kept| kept.text.clone()),
        proposed: open.map(|kept| kept.version.version),
    }))
}

/// Locks the files of a kind against other processes, as long as the returned file lives.
fn alone(settings: &Settings, kind: FileKind) -> Result<File, ShelfError> {
    let path = kind_folder(settings, kind);
    let failed = |error: std::io::Error| ShelfError::Io(format!("{}: {error}", path.display()));
    std::fs::create_dir_all(&path).map_err(failed)?;
    let folder = File::open(&path).map_err(failed)?;
    folder.lock().map_err(failed)?;
    Ok(folder)
}

/// Adds a version. The caller must have checked its text, and must hold the lock against other
/// writers of this process.
///
/// # Errors
/// [`ShelfError`].
pub fn write(
    settings: &Settings,
    kind: FileKind,
    name: &str,
    change: Change<'_>,
) -> Result<(), ShelfError> {
    let _alone = alone(settings, kind)?;
    let now = read(settings, kind, name, None)?;
    let found = now.as_ref().map(|now| now.sha256.as_str());
    if found != change.was_sha256 {
        return Err(ShelfError::Changed {
            found: found.unwrap_or("none").to_owned(),
        });
    }
    let original = now.and_then(|now| now.original);
    let is_in_force = kind == FileKind::Benches && original.as_deref() == Some(change.text);
    let new = New {
        kind: if is_in_force {
            VersionKind::Withdrawn
        } else {
            VersionKind::Written
        },
        text: change.text,
        by: change.by,
        why: change.why,
    };
    add(settings, kind, name, new)
}

/// Returns the number of the next version, if the limit allows another one.
fn next_number(
    settings: &Settings,
    kind: FileKind,
    name: &str,
    room: usize,
) -> Result<usize, ShelfError> {
    let last = numbers(settings, kind, name)?.last().copied().unwrap_or(0);
    if last + room > MOST_VERSIONS {
        return Err(ShelfError::Full);
    }
    Ok(last + 1)
}

/// Writes a version. The caller must have exclusive access to the folder.
fn add(settings: &Settings, kind: FileKind, name: &str, new: New<'_>) -> Result<(), ShelfError> {
    let number = next_number(settings, kind, name, 1)?;
    let kept = Kept {
        version: Version {
            version: number,
            unix_s: Some(clock::unix_time_s()),
            by: new.by.to_owned(),
            why: new.why.to_owned(),
            sha256: hash::sha256(new.text),
            kind: new.kind,
        },
        text: new.text.to_owned(),
    };
    let failed = |error: &dyn std::fmt::Display| ShelfError::Io(error.to_string());
    let text = serde_json::to_string_pretty(&kept).map_err(|error| failed(&error))?;
    let folder = folder_of(settings, kind, name);
    std::fs::create_dir_all(&folder).map_err(|error| failed(&error))?;
    write_atomically(&folder.join(file_name(number)), text.as_bytes())
        .map_err(|error| failed(&error))
}

/// Saves the text of a bench that is in force if no version contains it, calls `put` to write the
/// file, and records who put which version in force. No version can be written meanwhile.
///
/// # Errors
/// [`ShelfError`]; where the file could not be written, that of `put`.
pub fn take<E: From<ShelfError>>(
    settings: &Settings,
    name: &str,
    taking: Taking<'_>,
    put: impl FnOnce() -> Result<(), E>,
) -> Result<(), E> {
    let kind = FileKind::Benches;
    let _alone = alone(settings, kind)?;
    // One for the text before, and one for the text that is put in force.
    next_number(settings, kind, name, 2)?;
    let before = hash::sha256(taking.before);
    let is_kept = kept(settings, kind, name)?
        .iter()
        .any(|kept| kept.version.sha256 == before);
    if !is_kept {
        let new = New {
            kind: VersionKind::Before,
            text: taking.before,
            by: taking.by,
            why: "file in force before",
        };
        add(settings, kind, name, new)?;
    }
    put()?;
    let new = New {
        kind: VersionKind::Taken,
        text: taking.text,
        by: taking.by,
        why: &format!("version {} put in force", taking.version),
    };
    Ok(add(settings, kind, name, new)?)
}

/// Returns the message for a bench whose file differs from the one the server read at its start.
pub fn restart(bench: &str) -> String {
    format!("the file of the bench {bench} was changed since the server began: restart the server")
}

/// Returns why no run may begin on a bench: its file differs from the one that the server read at
/// its start.
pub fn restart_needed(bench: &config::Bench) -> Option<String> {
    match std::fs::read_to_string(&bench.path) {
        Ok(text) if hash::sha256(&text) == bench.sha256 => None,
        Ok(_) => Some(restart(&bench.name)),
        Err(error) => Some(format!("{}: {error}", bench.path.display())),
    }
}

/// Why a submitted run must not be begun: the file of its bench is another one than the server read
/// at its start, or than the plan of the run was checked with.
pub fn why_not_begun(data: &Path, bench: &config::Bench, run: &str) -> Option<String> {
    let replanned = || {
        let path = data.join("submitted").join(run).join(BENCH_SHA256);
        let planned = std::fs::read_to_string(path).ok()?;
        (planned.trim() != bench.sha256).then(|| {
            format!(
                "{run} was planned with another file of the bench {}: take it out of the queue and \
                submit it again",
                bench.name
            )
        })
    };
    restart_needed(bench).or_else(replanned)
}

/// The latest texts of all files that were changed here, by their paths in the folder of the
/// configuration.
///
/// # Errors
/// A version that cannot be read.
pub fn changed(settings: &Settings) -> Result<Copies, ShelfError> {
    let mut copies = Copies::new();
    for kind in [FileKind::Experiments, FileKind::Cells] {
        for name in names(&kind_folder(settings, kind), "") {
            if let Some(last) = numbers(settings, kind, &name)?.last() {
                let text = version(settings, kind, &name, *last)?.text;
                copies.insert(Path::new(kind.folder()).join(format!("{name}.toml")), text);
            }
        }
    }
    Ok(copies)
}

#[cfg(test)]
mod tests {
    use super::*;

    const BENCH: &str = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../configs/benches/demo.toml"
    );

    /// Settings of a server with one bench whose file may be changed.
    fn settings(folder: &Path) -> Settings {
        std::fs::copy(BENCH, folder.join("demo.toml")).unwrap();
        let text = "listen = \"127.0.0.1:0\"\ndata = \"data\"\nconfigs = \".\"\n\
                    benches = [\"demo.toml\"]\n";
        std::fs::write(folder.join("serve.toml"), text).unwrap();
        Settings::load(&folder.join("serve.toml")).unwrap()
    }

    fn add_as_ann(
        settings: &Settings,
        kind: FileKind,
        text: &str,
        was: Option<&str>,
    ) -> Result<(), ShelfError> {
        let change = Change {
            text,
            by: "ann",
            why: "x",
            was_sha256: was,
        };
        write(settings, kind, "demo", change)
    }

    #[test]
    fn a_version_that_cannot_be_read_brings_no_older_one_back() {
        let folder = tempfile::tempdir().unwrap();
        let settings = settings(folder.path());
        let add = |text: &str, was: Option<&str>| add_as_ann(&settings, FileKind::Cells, text, was);
        add("one", None).unwrap();
        add("two", Some(&hash::sha256("one"))).unwrap();
        assert_eq!(
            changed(&settings)
                .unwrap()
                .into_values()
                .collect::<Vec<_>>(),
            ["two"]
        );
        let path = folder_of(&settings, FileKind::Cells, "demo").join(file_name(2));
        std::fs::write(path, "torn").unwrap();
        assert!(changed(&settings).is_err());
        assert!(read(&settings, FileKind::Cells, "demo", None).is_err());
        assert!(add("three", Some(&hash::sha256("one"))).is_err());
    }

    #[test]
    fn a_version_of_a_bench_is_a_proposal_until_it_is_taken() {
        let folder = tempfile::tempdir().unwrap();
        let settings = settings(folder.path());
        let path = folder.path().join("demo.toml");
        let before = std::fs::read_to_string(&path).unwrap();
        let shown = || {
            let file = read(&settings, FileKind::Benches, "demo", None);
            file.unwrap().unwrap()
        };
        assert_eq!((shown().text, shown().proposed), (before.clone(), None));
        add_as_ann(&settings, FileKind::Benches, "new", Some(&shown().sha256)).unwrap();
        assert_eq!((shown().text.as_str(), shown().proposed), ("new", Some(1)));
        assert_eq!(shown().original.as_ref(), Some(&before));
        add_as_ann(&settings, FileKind::Benches, &before, Some(&shown().sha256)).unwrap();
        assert_eq!((shown().text, shown().proposed), (before.clone(), None));
        add_as_ann(&settings, FileKind::Benches, "new", Some(&shown().sha256)).unwrap();
        assert_eq!(restart_needed(&settings.benches[0]), None);
        let taking = Taking {
            version: 3,
            text: "new",
            before: &before,
            by: "bob",
        };
        // A file that cannot be written stays in force, and the proposal stays one.
        let failed = || Err(ShelfError::Io("full".to_owned()));
        assert!(take(&settings, "demo", taking, failed).is_err());
        assert_eq!(shown().versions.len(), 4, "the file is version 0 and 2");
        assert_eq!(shown().proposed, Some(3));
        let put = || std::fs::write(&path, "new").map_err(|e| ShelfError::Io(e.to_string()));
        take(&settings, "demo", taking, put).unwrap();
        let kinds: Vec<_> = shown().versions.iter().map(|one| one.kind).collect();
        assert_eq!(
            kinds[2..],
            [
                VersionKind::Withdrawn,
                VersionKind::Written,
                VersionKind::Taken
            ]
        );
        assert_eq!((shown().text.as_str(), shown().proposed), ("new", None));
        assert!(restart_needed(&settings.benches[0]).is_some());
    }

    #[test]
    fn a_run_that_was_planned_with_another_bench_file_is_not_begun() {
        let folder = tempfile::tempdir().unwrap();
        let settings = settings(folder.path());
        let bench = &settings.benches[0];
        let submitted = settings.data.join("submitted/demo-1");
        std::fs::create_dir_all(&submitted).unwrap();
        let why = || why_not_begun(&settings.data, bench, "demo-1");
        assert_eq!(why(), None);
        std::fs::write(submitted.join(BENCH_SHA256), &bench.sha256).unwrap();
        assert_eq!(why(), None);
        std::fs::write(submitted.join(BENCH_SHA256), "another").unwrap();
        assert!(why().unwrap().contains("submit it again"));
    }
}
