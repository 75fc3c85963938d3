//! Work that reads files: done beside the threads that serve others.

use super::problem::Refusal;

/// Does the work on a thread for work that waits.
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
