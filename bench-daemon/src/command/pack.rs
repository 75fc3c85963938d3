//! `eis-bench pack`: power and voltage of a pack of cells.

use clap::{Args, Subcommand};

use super::{pack_rank, pack_simulate, pack_size};
use bench_core::safety::failure::Failure;

/// Arguments of `pack`.
#[derive(Debug, Args)]
pub struct PackArgs {
    #[command(subcommand)]
    command: PackCommand,
}

#[derive(Debug, Subcommand)]
enum PackCommand {
    /// Compute peak, crossing and regeneration power by the simple-IR model, and the heating of
    /// cells.
    Size(pack_size::SizeArgs),
    /// Rank cells of a table in packs of several sizes by power, energy, mass and margins.
    Rank(pack_rank::RankArgs),
    /// Run a profile through many packs of cells that differ: current shares, worst cell,
    /// violations of the voltage window.
    Simulate(Box<pack_simulate::PackSimulateArgs>),
}

/// Runs a subcommand of `pack`.
///
/// # Errors
/// As the subcommands.
pub fn pack(args: &PackArgs) -> Result<(), Failure> {
    match &args.command {
        PackCommand::Size(args) => pack_size::size(args),
        PackCommand::Rank(args) => pack_rank::rank(args),
        PackCommand::Simulate(args) => pack_simulate::simulate(args),
    }
}
