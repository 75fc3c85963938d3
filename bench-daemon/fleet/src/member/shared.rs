//! State that the benches of a daemon share.

use std::{path::PathBuf, sync::Arc};

use crate::{
    error::FleetError, job::Job, link::Link, local::LocalBench, standing::Standing,
    watched::Watched,
};

/// State that the benches of a daemon share.
pub(crate) struct Shared {
    /// The broker.
    pub(crate) link: Arc<Link>,
    /// Known jobs.
    pub(crate) jobs: Arc<Watched<Job>>,
    /// Known standing orders.
    pub(crate) orders: Arc<Watched<Standing>>,
    /// Time after which an unchanged claim is revoked, s.
    pub(crate) lease_s: f64,
    /// The site.
    pub(crate) site: String,
    /// Number of this process.
    pub(crate) nonce: String,
    /// Number of this data folder: a process that owns it succeeds one that has ended.
    pub(crate) home: String,
    /// The fleet's part of the data folder.
    pub(crate) folder: PathBuf,
}

/// Runs work that waits for a disk on a blocking thread.
pub(super) async fn aside<T: Send + 'static>(
    bench: &Arc<dyn LocalBench>,
    work: impl FnOnce(&dyn LocalBench) -> T + Send + 'static,
) -> Result<T, FleetError> {
    let bench = bench.clone();
    let done = tokio::task::spawn_blocking(move || work(bench.as_ref())).await;
    done.map_err(|error| FleetError::File(error.to_string()))
}
