//! The run folder as a place for files. Structures and texts are written atomically.

use std::{
    io::Write,
    path::{Path, PathBuf},
};

use analysis_files::dataset;
use serde::Serialize;

use super::error::{RecordError, io};
use bench_plan::support::crash_point::Drill;

/// A run folder, and the crash drill whose points are its files.
pub(super) struct Folder {
    path: PathBuf,
    drill: Drill,
}

impl Folder {
    /// Creates a folder without a drill.
    pub(super) fn new(path: &Path) -> Self {
        Self {
            path: path.to_owned(),
            drill: Drill::none(),
        }
    }

    /// Returns its path.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Returns the path of a file in the folder.
    pub(super) fn file(&self, name: &str) -> PathBuf {
        self.path.join(name)
    }

    /// Makes its transcripts points of a crash drill, which may also fill the disk, from now on.
    pub(super) fn drill(&mut self, drill: &Drill) {
        self.drill = drill.clone();
    }

    /// Wraps a transcript so that each of its lines is a point of the drill.
    pub(super) fn transcript<W: Write + Send + 'static>(
        &self,
        file: W,
        name: String,
    ) -> impl Write + Send + 'static + use<W> {
        self.drill.transcript(file, name)
    }

    /// Checks whether there is room for a file; see [`Drill::room`].
    pub(super) fn room(&self, name: &str) -> Result<(), RecordError> {
        self.drill
            .room(name)
            .map_err(io(&self.file(name), "cannot be written"))
    }

    /// Writes a structure as JSON.
    pub(super) fn json<T: Serialize>(&self, name: &str, value: &T) -> Result<(), RecordError> {
        self.room(name)?;
        let path = self.file(name);
        let mut text = serde_json::to_string_pretty(value).map_err(|error| RecordError::Io {
            path: path.clone(),
            what: "cannot be put into JSON",
            source: std::io::Error::other(error),
        })?;
        text.push('\n');
        Ok(dataset::write_atomically(&path, text.as_bytes())?)
    }

    /// Writes a text.
    pub(super) fn text(&self, name: &str, text: &str) -> Result<(), RecordError> {
        self.room(name)?;
        Ok(dataset::write_atomically(
            &self.file(name),
            text.as_bytes(),
        )?)
    }
}
