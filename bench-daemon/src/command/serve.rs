//! `eis-bench serve`: benches over HTTP.

use std::path::PathBuf;

use clap::Args;

use bench_core::safety::failure::Failure;
use bench_serve::settings::Settings;

/// Arguments of `serve`.
#[derive(Debug, Args)]
pub struct ServeArgs {
    /// The server's file.
    pub config: PathBuf,
}

/// Serves until a signal requests a stop; active runs continue.
///
/// # Errors
/// A mistake in the file; an address, a certificate or a data folder that cannot be used.
pub fn serve(args: &ServeArgs) -> Result<(), Failure> {
    bench_serve::serve(Settings::load(&args.config)?)
}
