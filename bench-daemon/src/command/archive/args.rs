//! Arguments of `archive`.

use std::path::PathBuf;

use clap::{Args, Subcommand};

use crate::{command::units, config::quantity::Duration};

/// Arguments of `archive`.
#[derive(Debug, Args)]
pub struct ArchiveArgs {
    #[command(subcommand)]
    pub(super) act: Act,
}

#[derive(Debug, Subcommand)]
pub(super) enum Act {
    /// Send runs that have ended, and read every byte back.
    Push(PushArgs),
    /// Show which runs are in the archive, and which are not.
    Status(StatusArgs),
    /// Read archived runs back, and compare them with their hashes.
    Verify(VerifyArgs),
    /// Bring captures back into their run folder, or a whole run into a new folder.
    Fetch(FetchArgs),
    /// Remove captures from run folders, once the archive has given them back.
    Thin(ThinArgs),
}

#[derive(Debug, Args)]
pub(super) struct PushArgs {
    /// The server's file.
    #[arg(value_name = "CONFIG")]
    pub(super) config: PathBuf,
    /// Names of runs [default: all that are not in the archive as they are]
    #[arg(value_name = "RUN")]
    pub(super) runs: Vec<String>,
    /// Send runs whose journal tells no end, too.
    #[arg(long)]
    pub(super) unfinished: bool,
    /// Read back what is in the archive already, and try runs that were refused again.
    #[arg(long)]
    pub(super) again: bool,
    /// Tries of each run, with a pause after each that doubles.
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..))]
    pub(super) tries: u32,
    /// Print JSON.
    #[arg(long)]
    pub(super) json: bool,
}

#[derive(Debug, Args)]
pub(super) struct StatusArgs {
    /// The server's file.
    #[arg(value_name = "CONFIG")]
    pub(super) config: PathBuf,
    /// Print JSON.
    #[arg(long)]
    pub(super) json: bool,
}

#[derive(Debug, Args)]
pub(super) struct VerifyArgs {
    /// The server's file.
    #[arg(value_name = "CONFIG")]
    pub(super) config: PathBuf,
    /// Names of runs [default: all that are in the archive]
    #[arg(value_name = "RUN")]
    pub(super) runs: Vec<String>,
    /// All runs of the store, those of other benches included: their files, without their rows, whose
    /// hashes only the bench knows that sent them.
    #[arg(long, conflicts_with = "runs")]
    pub(super) all: bool,
    /// Print JSON.
    #[arg(long)]
    pub(super) json: bool,
}

#[derive(Debug, Args)]
pub(super) struct FetchArgs {
    /// The server's file.
    #[arg(value_name = "CONFIG")]
    pub(super) config: PathBuf,
    /// Name of the run; with --out also the SHA-256 of a run of the store.
    #[arg(value_name = "RUN")]
    pub(super) run: String,
    /// Write the whole run into this new folder.
    #[arg(long, value_name = "DIR")]
    pub(super) out: Option<PathBuf>,
}

#[derive(Debug, Args)]
pub(super) struct ThinArgs {
    /// The server's file.
    #[arg(value_name = "CONFIG")]
    pub(super) config: PathBuf,
    /// Names of runs [default: all]
    #[arg(value_name = "RUN")]
    pub(super) runs: Vec<String>,
    /// Time since the verified upload, in the place of that of the file: a duration such as "30 d".
    #[arg(long = "captures-after", value_name = "DURATION", value_parser = since)]
    pub(super) captures_after_s: Option<f64>,
    /// Remove nothing; print what would be.
    #[arg(long)]
    pub(super) dry_run: bool,
}

/// A time since an upload, s.
fn since(text: &str) -> Result<f64, String> {
    match units::of::<Duration>(text) {
        Ok(since_s) if since_s >= 0.0 => Ok(since_s),
        _ => Err("expected a duration such as \"30 d\"".to_owned()),
    }
}
