//! Arguments of the commands.

use std::path::PathBuf;

use clap::{Args, Subcommand};

use crate::settings::parse_duration_s;

/// A command.
#[derive(Debug, Subcommand)]
pub(crate) enum Action {
    /// Send runs that have ended, and read every byte back.
    Push(PushArgs),
    /// Send runs as they end, retry while the store does not answer, and move captures when they are due.
    Follow(FollowArgs),
    /// Show which runs are in the archive, and which are not.
    Status(StatusArgs),
    /// Read archived runs back, and compare them with their hashes.
    Verify(VerifyArgs),
    /// Bring captures back into their run folder, or a whole run into a new folder.
    Fetch(FetchArgs),
    /// Remove captures from run folders after the archive has given them back.
    Thin(ThinArgs),
}

/// Arguments of `push`.
#[derive(Debug, Default, Args)]
pub(crate) struct PushArgs {
    /// File of the archive.
    #[arg(value_name = "FILE")]
    pub(super) config: PathBuf,
    /// Names of runs [default: all that are not in the archive in their present state]
    #[arg(value_name = "RUN")]
    pub(super) runs: Vec<String>,
    /// Also send runs whose journal has no end.
    #[arg(long)]
    pub(super) unfinished: bool,
    /// Read back what is in the archive already, and retry runs that were refused.
    #[arg(long)]
    pub(super) again: bool,
    /// Number of attempts for each run; the pause after each doubles.
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..))]
    pub(super) tries: u32,
    /// Print JSON.
    #[arg(long)]
    pub(super) json: bool,
}

/// Arguments of `follow`.
#[derive(Debug, Args)]
pub(crate) struct FollowArgs {
    /// File of the archive.
    #[arg(value_name = "FILE")]
    pub(super) config: PathBuf,
    /// Interval between two looks at the run folders, such as "30 s".
    #[arg(long = "every", value_name = "DURATION", default_value = "30 s", value_parser = parse_interval)]
    pub(super) every_s: f64,
}

/// Arguments of `status`.
#[derive(Debug, Args)]
pub(crate) struct StatusArgs {
    /// File of the archive.
    #[arg(value_name = "FILE")]
    pub(super) config: PathBuf,
    /// Print JSON.
    #[arg(long)]
    pub(super) json: bool,
}

/// Arguments of `verify`.
#[derive(Debug, Args)]
pub(crate) struct VerifyArgs {
    /// File of the archive.
    #[arg(value_name = "FILE")]
    pub(super) config: PathBuf,
    /// Names of runs [default: all that are in the archive]
    #[arg(value_name = "RUN")]
    pub(super) runs: Vec<String>,
    /// Verify all runs of the store, those of other sites included: their files, without their rows,
    /// whose hashes only the sender has.
    #[arg(long, conflicts_with = "runs")]
    pub(super) all: bool,
    /// Print JSON.
    #[arg(long)]
    pub(super) json: bool,
}

/// Arguments of `fetch`.
#[derive(Debug, Args)]
pub(crate) struct FetchArgs {
    /// File of the archive.
    #[arg(value_name = "FILE")]
    pub(super) config: PathBuf,
    /// Name of the run; with --out also the SHA-256 of a run of the store.
    #[arg(value_name = "RUN")]
    pub(super) run: String,
    /// Write the whole run into this new folder.
    #[arg(long, value_name = "DIR")]
    pub(super) out: Option<PathBuf>,
}

/// Arguments of `thin`.
#[derive(Debug, Args)]
pub(crate) struct ThinArgs {
    /// File of the archive.
    #[arg(value_name = "FILE")]
    pub(super) config: PathBuf,
    /// Names of runs [default: all]
    #[arg(value_name = "RUN")]
    pub(super) runs: Vec<String>,
    /// Time since the verified upload, instead of that of the file: a duration such as "30 d".
    #[arg(long = "captures-after", value_name = "DURATION", value_parser = parse_duration)]
    pub(super) captures_after_s: Option<f64>,
    /// Remove nothing; print what would be removed.
    #[arg(long)]
    pub(super) dry_run: bool,
}

fn parse_duration(text: &str) -> Result<f64, String> {
    parse_duration_s(text).ok_or_else(|| "expected a duration such as \"30 d\"".to_owned())
}

fn parse_interval(text: &str) -> Result<f64, String> {
    let seconds = parse_duration_s(text).filter(|seconds| (1.0..=86_400.0).contains(seconds));
    seconds.ok_or_else(|| "expected 1 s to 1 d, such as \"30 s\"".to_owned())
}
