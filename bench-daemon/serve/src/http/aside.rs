//! Runs work that reads files outside the threads that serve requests.

use bench_http::Refusal;

/// Runs blocking work on a thread for such work.
///
/// # Errors
/// Those of the work; work that has panicked.
pub(super) async fn aside<T: Send + 'static>(
    work: impl FnOnce() -> Result<T, Refusal> + Send + 'static,
) -> Result<T, Refusal> {
    tokio::task::spawn_blocking(work)
        .await
        .map_err(|error| Refusal::machine(&error))?
}
