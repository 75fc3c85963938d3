//! The files in the folders of a bench, and how they are written to disk.

use std::{
    fs::{self, File, OpenOptions},
    io::{Seek, Write},
    path::{Path, PathBuf},
};

use analysis_files::dataset::write_atomically;
use instruments::clock;
use serde::{Deserialize, Serialize, de::DeserializeOwned};

use super::{Latched, StateError, began, io};
use crate::record::with_causes;

/// The process that runs a bench.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Holder {
    /// Process ID.
    pub pid: i32,
    /// Start time of the process, as [`began`] returns it.
    pub began: Option<u64>,
    /// Its run folder.
    pub run: PathBuf,
    /// The bench by its name.
    pub bench: String,
    /// The bench file.
    pub file: PathBuf,
}

impl Holder {
    /// Checks whether the process still exists and its process ID was not reused.
    pub fn lives(&self) -> bool {
        // 0 and 1 are excluded, because they stand for whole process groups.
        self.pid > 1 && self.began.is_some() && self.began == began(self.pid)
    }
}

/// A run that may have left outputs on: it was begun, and no safe state has been verified since.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct OpenRun {
    /// The process that runs or ran it.
    pub holder: Holder,
    /// When it was begun, s since 1970.
    pub unix_s: f64,
    /// Every folder that records this run.
    pub(super) places: Vec<PathBuf>,
}

/// Line after an open run that states that its outputs were read back as off. It is written in
/// place, so that it can be written even if no file can be created or removed any more.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Closed {
    /// Process ID of the reader.
    pub(super) pid: i32,
    /// When, s since 1970.
    pub(super) unix_s: f64,
}

/// A run that died together with its guardian, and after which another process read back every
/// output as off.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Settled {
    /// Its folder.
    pub run: PathBuf,
    /// When, s since 1970.
    pub unix_s: f64,
    /// What was read back, as text; absent in the file of an older version.
    #[serde(default)]
    pub read: String,
}

/// A latch as it is on disk.
#[derive(Serialize, Deserialize)]
pub(super) struct Latch {
    #[serde(flatten)]
    pub(super) latched: Latched,
    /// The bench file through which it was latched.
    pub(super) file: PathBuf,
    /// Every folder that contains the latch.
    pub(super) places: Vec<PathBuf>,
}

pub(super) fn make(folder: &Path) -> Result<(), StateError> {
    fs::create_dir_all(folder).map_err(io(folder, "has no folder, and none can be made"))
}

pub(super) fn open(path: &Path) -> Result<File, StateError> {
    let opened = OpenOptions::new()
        .create(true)
        .truncate(false)
        .read(true)
        .write(true)
        .open(path);
    opened.map_err(io(path, "cannot be written"))
}

pub(super) fn named_holder(path: &Path) -> Holder {
    let text = fs::read_to_string(path).unwrap_or_default();
    let unknown = |_| Holder {
        pid: 0,
        began: None,
        run: PathBuf::new(),
        bench: "it".to_owned(),
        file: PathBuf::new(),
    };
    serde_json::from_str(&text).unwrap_or_else(unknown)
}

/// Reads a JSON file. Returns `None` if the file does not exist.
pub(super) fn read<T: DeserializeOwned>(
    path: &Path,
) -> Result<Option<Result<T, serde_json::Error>>, StateError> {
    match fs::read_to_string(path) {
        Ok(text) => Ok(Some(serde_json::from_str(&text))),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(None),
        Err(source) => Err(io(path, "cannot be read")(source)),
    }
}

/// Reads the open run of a file. Returns `None` if a line after it states that its outputs were
/// read back as off.
pub(super) fn read_open(
    path: &Path,
) -> Result<Option<Result<OpenRun, serde_json::Error>>, StateError> {
    let text = match fs::read_to_string(path) {
        Ok(text) => text,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        Err(source) => return Err(io(path, "cannot be read")(source)),
    };
    let mut values = serde_json::Deserializer::from_str(&text).into_iter::<serde_json::Value>();
    let open = match values.next() {
        Some(open) => open.and_then(serde_json::from_value),
        None => serde_json::from_str(&text),
    };
    let closed = values
        .next()
        .and_then(Result::ok)
        .and_then(|value| serde_json::from_value::<Closed>(value).ok());
    Ok(closed.is_none().then_some(open))
}

/// Appends to an open run that its outputs were read back as off.
pub(super) fn close_open(file: &mut File) -> std::io::Result<()> {
    let closed = Closed {
        pid: super::pid(),
        unix_s: clock::unix_time_s(),
    };
    let line = serde_json::to_string(&closed)?;
    file.seek(std::io::SeekFrom::End(0))?;
    // Not synced to disk, because the file is usually removed next.
    writeln!(file, "{line}")
}

pub(super) fn json<T: Serialize>(path: &Path, value: &T) -> Result<(), StateError> {
    let mut text = serde_json::to_string_pretty(value)
        .map_err(|error| io(path, "cannot be put into JSON")(error.into()))?;
    text.push('\n');
    write_atomically(path, text.as_bytes())
        .map_err(|error| io(path, "cannot be written")(std::io::Error::other(with_causes(&error))))
}

/// Removes a file that may already be gone. The removal is durable only after the folder is
/// synced.
pub(super) fn remove(folder: &Path, name: &str) -> Result<(), StateError> {
    let path = folder.join(name);
    match fs::remove_file(&path) {
        Ok(()) => File::open(folder)
            .and_then(|folder| folder.sync_all())
            .map_err(io(folder, "cannot be written")),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(()),
        Err(source) => Err(io(&path, "cannot be removed")(source)),
    }
}
