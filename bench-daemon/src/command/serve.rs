//! `eis-bench serve`: benches over HTTP.

use std::path::PathBuf;

use clap::Args;

use crate::{
    safety::failure::Failure,
    serve::{self, settings::Settings},
};

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
    serve::serve(Settings::load(&args.config)?)
}
