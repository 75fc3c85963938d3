//! `eis-bench pack`: what a pack of cells can do.

use std::path::Path;

use analysis::{dataset, fit::ModelFile};
use clap::{Args, Subcommand};

use super::{Failure, pack_simulate, pack_size};

/// Arguments of `pack`.
#[derive(Debug, Args)]
pub struct PackArgs {
    #[command(subcommand)]
    command: PackCommand,
}

#[derive(Debug, Subcommand)]
enum PackCommand {
    /// Peak, crossing and regeneration power by the simple-IR model, and how warm the cells get.
    Size(pack_size::SizeArgs),
    /// A profile through many packs of cells that differ: current shares, worst cell, how often the window is left.
    Simulate(pack_simulate::PackSimulateArgs),
}

/// Runs a subcommand of `pack`.
///
/// # Errors
/// As the subcommands.
pub fn pack(args: &PackArgs) -> Result<(), Failure> {
    match &args.command {
        PackCommand::Size(args) => pack_size::size(args),
        PackCommand::Simulate(args) => pack_simulate::simulate(args),
    }
}

/// Reads a model file.
pub(super) fn read_model(path: &Path) -> Result<ModelFile, Failure> {
    let fail = |error: &dyn std::fmt::Display| Failure::Usage(format!("--model {}: {error}", path.display()));
    let text = std::fs::read_to_string(path).map_err(|error| fail(&error))?;
    ModelFile::from_json(&text).map_err(|error| fail(&error))
}

/// Makes the folder of `--out` if need be and writes a text into it.
pub(super) fn folder(out: &Path, name: &str, text: &str) -> Result<(), Failure> {
    std::fs::create_dir_all(out).map_err(|error| Failure::Usage(format!("--out {}: {error}", out.display())))?;
    dataset::write_atomically(&out.join(name), format!("{text}\n").as_bytes()).map_err(|error| Failure::Analysis(error.to_string()))
}
