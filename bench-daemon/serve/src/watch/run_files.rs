//! The files of a run folder that grow.

use std::{
    os::unix::fs::MetadataExt,
    path::{Path, PathBuf},
    time::SystemTime,
};

use analysis::run_folder::{ENVELOPE, EnvelopeRow, JOURNAL, READINGS, RUN_CONTROL};

use crate::follow::Follow;
use bench_core::operator::run_control::{RunAction, RunControl};

/// A run folder, and how far its journal and readings were read.
#[derive(Debug)]
pub(super) struct RunFiles {
    folder: PathBuf,
    /// The journal's inode when it was looked at last; 0 before there was one.
    inode: u64,
    journal: Follow,
    readings: Follow,
    envelope: Follow,
    /// The run control request, and the time of its file when it was read.
    request: (Option<SystemTime>, RunAction),
}

impl RunFiles {
    /// A run folder that may not be there yet.
    pub(super) fn new(folder: &Path) -> Self {
        Self {
            folder: folder.to_owned(),
            inode: 0,
            journal: Follow::new(folder.join(JOURNAL)),
            readings: Follow::new(folder.join(READINGS)),
            envelope: Follow::new(folder.join(ENVELOPE)),
            request: (None, RunAction::GoOn),
        }
    }

    /// The folder.
    pub(super) fn folder(&self) -> &Path {
        &self.folder
    }

    /// Returns the files of another run that has replaced the one that was read, if one has.
    pub(super) fn replaced(&mut self) -> Option<Self> {
        let inode = std::fs::metadata(self.folder.join(JOURNAL)).map_or(0, |meta| meta.ino());
        let known = std::mem::replace(&mut self.inode, inode);
        (known != 0 && known != inode).then(|| Self {
            inode,
            ..Self::new(&self.folder)
        })
    }

    /// Returns new lines of the journal, if there are any.
    pub(super) fn journal(&mut self) -> Option<Vec<String>> {
        grown(&mut self.journal)
    }

    /// Returns the latest new bounds of the readings, if there are any.
    pub(super) fn envelope(&mut self) -> Option<EnvelopeRow> {
        let rows = std::iter::from_fn(|| grown(&mut self.envelope));
        rows.flatten()
            .filter_map(|row| EnvelopeRow::parse(&row))
            .last()
    }

    /// Returns the action that a person has requested last.
    pub(super) fn request(&self) -> RunAction {
        self.request.1
    }

    /// Reads the action that a person has requested, if its file has changed.
    pub(super) fn read_request(&mut self) {
        let file = std::fs::metadata(self.folder.join(RUN_CONTROL));
        let time = file.and_then(|meta| meta.modified()).ok();
        if time != self.request.0 {
            self.request = (time, RunControl::read(&self.folder).action);
        }
    }

    /// Returns new rows of the readings, if there are any.
    pub(super) fn readings(&mut self) -> Option<Vec<String>> {
        grown(&mut self.readings)
    }
}

/// Returns the complete new lines, if there are any. Lines that cannot be read now are read at
/// the next poll.
fn grown(file: &mut Follow) -> Option<Vec<String>> {
    file.look()
        .ok()
        .map(|grown| grown.lines)
        .filter(|lines| !lines.is_empty())
}
