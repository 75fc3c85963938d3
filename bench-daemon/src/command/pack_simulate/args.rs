//! Arguments of `pack simulate`.

use crate::command::units;
use bench_plan::config::quantity::{Duration, Resistance, Voltage};
use std::path::PathBuf;

use clap::Args;

use super::super::{
    model_args::{ModelArgs, PackArgs, WindowArgs, required_sizes},
    profile_args::ProfileArgs,
};
use super::heat::HeatArgs;

const HELP: &str = "\
Draws many packs of cells that differ a little, runs the profile through each, and reports \
the results of the worst cells. Cells in parallel share a
voltage, so that the one with the smallest resistance takes the largest current; groups in series \
share the current, so that the weakest group
reaches a limit first. Compare with the column `identical`, a pack of cells that are all as \
--model has them.

--cells takes the cells from a CSV table instead: group and place (from 1), and any of name, model \
(a model file beside the table), r (factor of
all resistances), r1, c1, r2, ... (factors of one branch, instead of r), capacity (factor), soc, \
draw (several packs). What is empty is as
--model has it. --export-cells writes such a table of the cells that were drawn: given back by \
--cells it repeats the run exactly.

--links takes the interconnect as a network. A node is a terminal of the pack (pack-, pack+), a \
terminal of a cell by its group and place (1.3-,
16.2+), or a joint of any other name. Each link has its resistance in Ω, and may have a heat \
capacity in J/K for its temperature without
cooling. --interconnect-ohm adds to it.

--sigma-r is the spread of a cell's resistances all together; its default, 0.8 %, is what the \
thesis' 25 sweeps of P45B cells show, and that of
the capacitances is taken from there. The spread of capacities and states of charge has not been \
measured here: the 0.5 % are an assumption.
Power and current count discharge as positive. Margins are those of single cells, without tabs and \
interconnect.

With a map each cell has its own state of charge and temperature, which its resistances follow. \
Heat warms a cell by its heat capacity and
leaves it to the surroundings (--path-k-per-w), to its neighbours (--neighbour-w-per-k) and to the \
busbars (--busbar-w-per-k). The groups
form the rows of a grid of S by P cells. Without a map the temperatures do not change the \
resistances.

Example:
  eis-bench pack simulate --model p45b/model_4rc.json --profile spin_jump.txt --series 16 \
--parallel 3 --interconnect-ohm 0.03 \\
    --ocv-v 3.72 --draws 1000 --out jump";

/// Arguments of `pack simulate`.
#[derive(Debug, Args)]
#[command(after_help = HELP, mut_args(required_sizes))]
pub struct PackSimulateArgs {
    /// The nominal cell; the factors of all cells apply to it.
    #[command(flatten)]
    pub model: ModelArgs,
    /// The cell's OCV curve from `ocv --out` or a cell file, if the model has none or to replace it.
    #[arg(long, value_name = "JSON")]
    pub ocv: Option<PathBuf>,
    /// Two columns, time in s and power in W or current in A, with or without header.
    #[arg(long, value_name = "FILE")]
    pub profile: PathBuf,
    /// How the file is read.
    #[command(flatten)]
    pub read: ProfileArgs,
    /// The pack.
    #[command(flatten)]
    pub pack: PackArgs,
    /// Resistances between the cells, in place of busbars that the cells of a group share: a table with
    /// from, to, ohm, and any of heat_j_per_k.
    #[arg(long, value_name = "CSV")]
    pub links: Option<PathBuf>,
    /// Resistance between each cell and the busbar of its group, or its nodes of --links, Ω.
    #[arg(
        long,
        value_name = "OHM",
        default_value_t = 0.0,
        allow_hyphen_values = true,
        value_parser = units::of::<Resistance>
    )]
    pub tab_ohm: f64,
    /// State of charge at the start, 0 to 1; needs a model with an OCV curve, or --ocv.
    #[arg(
        long,
        value_name = "X",
        conflicts_with = "ocv_v",
        required_unless_present = "ocv_v",
        allow_negative_numbers = true
    )]
    pub soc: Option<f64>,
    /// Open-circuit voltage of a cell at the start, V; stays so where the model has no OCV curve.
    #[arg(long, value_name = "V", allow_hyphen_values = true, value_parser = units::of::<Voltage>)]
    pub ocv_v: Option<f64>,
    /// A table of cells with their places, instead of drawing them.
    #[arg(
        long,
        value_name = "CSV",
        conflicts_with_all = [
            "draws", "seed", "sigma_r", "sigma_rk", "sigma_ck", "sigma_capacity", "sigma_soc"
        ]
    )]
    pub cells: Option<PathBuf>,
    /// Write the cells of all packs as such a table.
    #[arg(long, value_name = "CSV")]
    pub export_cells: Option<PathBuf>,
    /// Packs to draw.
    #[arg(long, value_name = "N", default_value_t = 1000)]
    pub draws: usize,
    /// Seed of the draws.
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
    /// Spread of a cell's resistances all together, one relative standard deviation.
    #[arg(
        long,
        value_name = "X",
        default_value_t = 0.008,
        allow_negative_numbers = true
    )]
    pub sigma_r: f64,
    /// Spread of each branch resistance by itself, on top, relative.
    #[arg(
        long,
        value_name = "X",
        default_value_t = 0.0,
        allow_negative_numbers = true
    )]
    pub sigma_rk: f64,
    /// Spread of each branch capacitance, relative.
    #[arg(
        long,
        value_name = "X",
        default_value_t = 0.008,
        allow_negative_numbers = true
    )]
    pub sigma_ck: f64,
    /// Spread of the cells' capacities, relative. Without effect where the model has no OCV curve.
    #[arg(
        long,
        value_name = "X",
        default_value_t = 0.005,
        allow_negative_numbers = true
    )]
    pub sigma_capacity: f64,
    /// Spread of the groups' state of charge at the start, absolute. Without effect where the model
    /// has no OCV curve.
    #[arg(
        long,
        value_name = "X",
        default_value_t = 0.005,
        allow_negative_numbers = true
    )]
    pub sigma_soc: f64,
    /// Longest step, s [default: a 2000th of the profile, at least 1 ms]
    #[arg(long, value_name = "S", allow_hyphen_values = true, value_parser = units::of::<Duration>)]
    pub max_step_s: Option<f64>,
    /// Limits of a cell.
    #[command(flatten)]
    pub window: WindowArgs,
    /// Where the heat of the cells goes.
    #[command(flatten)]
    pub heat: HeatArgs,
    /// Write pack.json, draws.parquet and plots into this folder.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}
