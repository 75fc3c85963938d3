//! Arguments of `campaign`.

use std::path::PathBuf;

use clap::{Args, Subcommand};

/// Arguments of `campaign`.
#[derive(Debug, Args)]
pub struct CampaignArgs {
    #[command(subcommand)]
    pub(super) act: Act,
}

#[derive(Debug, Subcommand)]
pub(super) enum Act {
    /// Plan which bench measures which cells, and write the experiments.
    Plan(PlanArgs),
    /// Print how much cells, batches and benches differ, from catalogues of the runs.
    Report(ReportArgs),
}

#[derive(Debug, Args)]
pub(super) struct PlanArgs {
    /// The file of the campaign.
    #[arg(value_name = "FILE")]
    pub(super) file: PathBuf,
    /// Write the experiments into this folder, one folder for each bench.
    #[arg(long, value_name = "FOLDER")]
    pub(super) out: Option<PathBuf>,
    /// Print every experiment as JSON, in the order in which `eis-fleet campaign` submits them.
    #[arg(long, conflicts_with = "out")]
    pub(super) json: bool,
}

#[derive(Debug, Args)]
pub(super) struct ReportArgs {
    /// The catalogue of the runs.
    #[arg(value_name = "DB")]
    pub(super) catalog: PathBuf,
    /// Name of the campaign and of its experiments.
    #[arg(value_name = "NAME")]
    pub(super) campaign: String,
    /// Another catalogue, such as that of another machine; may be given several times.
    #[arg(long, value_name = "DB")]
    pub(super) and: Vec<PathBuf>,
    /// Number of RC pairs of the models [default: the greatest available]
    #[arg(long, value_name = "N")]
    pub(super) rc: Option<u32>,
    /// Write a table of the cells and pictures into this folder.
    #[arg(long, value_name = "FOLDER")]
    pub(super) out: Option<PathBuf>,
    /// Print JSON.
    #[arg(long)]
    pub(super) json: bool,
}
