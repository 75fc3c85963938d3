//! State of the runs of a data folder in the store, from their receipts.

use std::path::Path;

use analysis_files::{
    dataset::write_atomically,
    run_folder::archive_status::{ArchiveStatus, ArchiveTrouble},
};
use bench_archive::{
    receipt::{Receipt, Receipts, RunState, TroubleKind},
    snapshot::RunSource,
};

use crate::{data_folder::run_sources, failure::Failure, settings::Settings};

/// Maximum number of failed or refused runs in the list.
const MOST_TROUBLES: usize = 20;

/// Reads the state of all runs from their receipts.
///
/// # Errors
/// A receipt or a folder cannot be read.
pub(crate) fn read_status(settings: &Settings) -> Result<ArchiveStatus, Failure> {
    let receipts = Receipts::of(&settings.data)?;
    let mut status = ArchiveStatus {
        store: settings.place.name(),
        site: settings.site.clone(),
        ..ArchiveStatus::default()
    };
    for source in run_sources(&settings.data, &[])? {
        let receipt = receipts.read(&source.name)?;
        add_run(&mut status, &receipt, &source);
    }
    Ok(status)
}

/// Counts a run.
fn add_run(status: &mut ArchiveStatus, receipt: &Receipt, source: &RunSource) {
    let state = receipt.state(&status.store, &source.stamp());
    let count = match state {
        RunState::Archived => &mut status.archived,
        RunState::Pending => &mut status.pending,
        RunState::Failed => &mut status.failed,
        RunState::Refused => &mut status.refused,
        RunState::Waiting => &mut status.waiting,
    };
    *count += 1;
    if let Some(kept) = receipt
        .kept
        .as_ref()
        .filter(|_| receipt.store == status.store)
    {
        status.bytes += kept.bytes;
        status.sent_bytes += kept.sent_bytes;
        status.moved_bytes += kept.moved_bytes;
        let last = status.last_verified_unix_s.unwrap_or(f64::MIN);
        status.last_verified_unix_s = Some(last.max(kept.verified_unix_s));
    }
    let has_failed = matches!(state, RunState::Failed | RunState::Refused);
    let trouble = receipt.trouble.as_ref().filter(|_| has_failed);
    if let Some(trouble) = trouble.filter(|_| status.troubles.len() < MOST_TROUBLES) {
        let kind = match trouble.kind {
            TroubleKind::Failed => "failed",
            TroubleKind::Refused => "refused",
            TroubleKind::Waiting => "waiting",
        };
        status.troubles.push(ArchiveTrouble {
            run: receipt.run.clone(),
            kind: kind.to_owned(),
            why: trouble.why.clone(),
        });
    }
}

/// Writes the status into the data folder, where the server reads it for its API and metrics.
///
/// # Errors
/// The file cannot be written.
pub(crate) fn write_status(data: &Path, status: &ArchiveStatus) -> Result<(), Failure> {
    let path = ArchiveStatus::path(data);
    let text = serde_json::to_vec_pretty(status).unwrap_or_default();
    write_atomically(&path, &text).map_err(|error| Failure::Store(error.to_string()))
}
