//! The commands: each reads the file of the archive, works on run folders and prints the result.

mod arguments;
mod fetch;
mod follow;
mod push;
mod status;
mod thin;
mod verify;

use crate::failure::Failure;
pub(crate) use arguments::Action;

/// Runs a command.
///
/// # Errors
/// A file is invalid, the store refuses or fails an operation, or runs fail their verification.
pub(crate) fn run(action: &Action) -> Result<(), Failure> {
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()
        .map_err(|error| Failure::Store(error.to_string()))?;
    runtime.block_on(async {
        match action {
            Action::Push(args) => push::push_runs(args).await,
            Action::Follow(args) => follow::follow(args).await,
            Action::Status(args) => status::print_status(args),
            Action::Verify(args) => verify::verify_runs(args).await,
            Action::Fetch(args) => fetch::fetch(args).await,
            Action::Thin(args) => thin::thin_runs(args).await,
        }
    })
}
