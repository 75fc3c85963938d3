//! An open archive: its settings, its store and its receipts.

use std::path::Path;

use bench_archive::{Store, receipt::Receipts, snapshot::RunSource};
use instruments_link::clock::unix_time_s;

use crate::{
    data_folder::run_sources,
    failure::Failure,
    settings::Settings,
    status::{read_status, write_status},
};

/// An open archive.
pub(crate) struct Archive {
    pub(crate) settings: Settings,
    pub(crate) store: Store,
    pub(crate) receipts: Receipts,
}

impl Archive {
    /// Reads the file of an archive, and opens its store.
    pub(crate) fn load(config: &Path) -> Result<Self, Failure> {
        Self::open(Settings::load(config)?)
    }

    /// Opens the store.
    pub(crate) fn open(settings: Settings) -> Result<Self, Failure> {
        Ok(Self {
            store: Store::open(&settings.place)?,
            receipts: Receipts::of(&settings.data)?,
            settings,
        })
    }

    pub(crate) fn sources(&self, named: &[String]) -> Result<Vec<RunSource>, Failure> {
        run_sources(&self.settings.data, named)
    }

    /// Updates the status that the server shows.
    pub(crate) fn update_status(&self) -> Result<(), Failure> {
        let mut status = read_status(&self.settings)?;
        status.written_unix_s = unix_time_s();
        write_status(&self.settings.data, &status)
    }
}
