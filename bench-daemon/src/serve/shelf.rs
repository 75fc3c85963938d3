//! Files of the configuration as people change them over the API. The folder of the configuration
//! is never written: a changed file is a version in the data folder, with who changed it and why,
//! and the latest version is read in the place of the file. No version is ever taken away.

use std::path::{Path, PathBuf};

use analysis::dataset::write_atomically;
use instruments::clock;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::settings::Settings;
use crate::{
    config::Copies,
    support::{
        confined_path::{self, plain},
        hash,
    },
};

/// Most versions of a file.
const MOST_VERSIONS: usize = 1000;

/// Kind of a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum FileKind {
    /// Course of a measurement.
    Experiments,
    /// Limits of a cell, and facts of it.
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
    /// Its name, without the ending.
    pub name: String,
    /// It was changed here, or is from here.
    edited: bool,
    /// Number of its versions here.
    versions: usize,
}

/// A version of a file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Version {
    /// Its number, from 1; 0 is the file of the configuration.
    pub version: usize,
    /// When it was made, s since 1970; none for the file of the configuration.
    pub unix_s: Option<f64>,
    /// Who made it.
    pub by: String,
    /// Why.
    pub why: String,
    /// SHA-256 of its text.
    pub sha256: String,
}

/// A version with its text, as it is kept.
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
}

/// Why a file is not changed.
#[derive(Debug, thiserror::Error)]
pub enum ShelfError {
    /// Somebody else was faster.
    #[error(
        "expected the text that is there now (SHA-256 {found}), found another one: it was changed meanwhile"
    )]
    Changed {
        /// Checksum of what is there.
        found: String,
    },
    /// Too many.
    #[error("expected at most {MOST_VERSIONS} versions of a file, found as many")]
    Full,
    /// The file system.
    #[error("{0}")]
    Io(String),
}

/// A new version.
#[derive(Debug, Clone, Copy)]
pub struct Change<'a> {
    /// The text.
    pub text: &'a str,
    /// Who makes it.
    pub by: &'a str,
    /// Why.
    pub why: &'a str,
    /// Checksum of the text that it was made from; none for a file that is new.
    pub was_sha256: Option<&'a str>,
}

fn folder_of(settings: &Settings, kind: FileKind, name: &str) -> PathBuf {
    settings.data.join("files").join(kind.folder()).join(name)
}

/// The file of the configuration, without what was changed here.
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
        all.extend(names(&settings.data.join("files").join(kind.folder()), ""));
        all
    };
    all.sort();
    all.dedup();
    all.into_iter()
        .map(|name| {
            let versions = numbers(settings, kind, &name).map_or(0, |all| all.len());
            Listed {
                name,
                edited: versions > 0,
                versions,
            }
        })
        .collect()
}

/// A file; the version of this number, else the latest. None where there is no such file.
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
    let first = original(settings, kind, name).map(|text| Kept {
        version: Version {
            version: 0,
            unix_s: None,
            by: "file of the configuration".to_owned(),
            why: String::new(),
            sha256: hash::sha256(&text),
        },
        text,
    });
    let all: Vec<Kept> = first
        .into_iter()
        .chain(kept(settings, kind, name)?)
        .collect();
    let wanted = match version {
        Some(number) => all.iter().find(|kept| kept.version.version == number),
        None => all.last(),
    };
    Ok(wanted.map(|wanted| Shelved {
        text: wanted.text.clone(),
        sha256: wanted.version.sha256.clone(),
        versions: all.iter().map(|kept| kept.version.clone()).collect(),
    }))
}

/// Adds a version. The caller has checked its text, and lets nobody else do this meanwhile.
///
/// # Errors
/// [`ShelfError`].
pub fn write(
    settings: &Settings,
    kind: FileKind,
    name: &str,
    change: Change<'_>,
) -> Result<(), ShelfError> {
    let now = read(settings, kind, name, None)?;
    let found = now.as_ref().map(|now| now.sha256.as_str());
    if found != change.was_sha256 {
        return Err(ShelfError::Changed {
            found: found.unwrap_or("none").to_owned(),
        });
    }
    let number = numbers(settings, kind, name)?
        .last()
        .map_or(1, |last| last + 1);
    if number > MOST_VERSIONS {
        return Err(ShelfError::Full);
    }
    let kept = Kept {
        version: Version {
            version: number,
            unix_s: Some(clock::unix_time_s()),
            by: change.by.to_owned(),
            why: change.why.to_owned(),
            sha256: hash::sha256(change.text),
        },
        text: change.text.to_owned(),
    };
    let folder = folder_of(settings, kind, name);
    let failed = |error: &dyn std::fmt::Display| ShelfError::Io(error.to_string());
    std::fs::create_dir_all(&folder).map_err(|error| failed(&error))?;
    let text = serde_json::to_string_pretty(&kept).map_err(|error| failed(&error))?;
    write_atomically(&folder.join(file_name(number)), text.as_bytes())
        .map_err(|error| failed(&error))
}

/// The latest texts of all files that were changed here, by their paths in the folder of the
/// configuration.
///
/// # Errors
/// A version that cannot be read.
pub fn changed(settings: &Settings) -> Result<Copies, ShelfError> {
    let mut copies = Copies::new();
    for kind in [FileKind::Experiments, FileKind::Cells] {
        for name in names(&settings.data.join("files").join(kind.folder()), "") {
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

    #[test]
    fn a_version_that_cannot_be_read_brings_no_older_one_back() {
        let folder = tempfile::tempdir().unwrap();
        let bench = concat!(env!("CARGO_MANIFEST_DIR"), "/../configs/benches/demo.toml");
        let text = format!(
            "listen = \"127.0.0.1:0\"\ndata = \"data\"\nconfigs = \".\"\nbenches = [{bench:?}]\n"
        );
        std::fs::write(folder.path().join("serve.toml"), text).unwrap();
        let settings = Settings::load(&folder.path().join("serve.toml")).unwrap();
        let add = |text: &str, was: Option<&str>| {
            let change = Change {
                text,
                by: "ann",
                why: "x",
                was_sha256: was,
            };
            write(&settings, FileKind::Cells, "c", change)
        };
        add("one", None).unwrap();
        add("two", Some(&hash::sha256("one"))).unwrap();
        assert_eq!(
            changed(&settings)
                .unwrap()
                .into_values()
                .collect::<Vec<_>>(),
            ["two"]
        );
        let path = folder_of(&settings, FileKind::Cells, "c").join(file_name(2));
        std::fs::write(path, "torn").unwrap();
        assert!(changed(&settings).is_err());
        assert!(read(&settings, FileKind::Cells, "c", None).is_err());
        assert!(add("three", Some(&hash::sha256("one"))).is_err());
    }
}
