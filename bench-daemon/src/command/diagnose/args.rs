//! Arguments of `eis-bench diagnose`.

use std::path::PathBuf;

use crate::{command::model_args::DatasetModelArgs, investigate::dataset::Accept};

/// Arguments of `diagnose`.
#[derive(Debug, clap::Args)]
pub struct DiagnoseArgs {
    /// The data set: a folder with `dataset.toml`, or a run folder; several, or folders of them, for
    /// --table.
    #[arg(value_name = "DATASET", required = true)]
    pub data: Vec<PathBuf>,
    /// The model to be judged.
    #[command(flatten)]
    pub model: DatasetModelArgs,
    /// The OCV curve, as `ocv --out` writes it (`ocv.json`), where the model file holds none or
    /// another is wanted [default: `ocv` of dataset.toml]
    #[arg(long, value_name = "JSON")]
    pub ocv: Option<PathBuf>,
    /// Write `diagnosis.html`, `diagnosis.json`, `diagnosis.md` with its pictures, `story.json` and,
    /// where effects were added, `model_augmented.json` and, where no name is certain,
    /// `model_predictive.json` into this folder.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// The bench's file: with --cell and --out, the recommended run is written as
    /// `next_experiment.toml` for it.
    #[arg(long, value_name = "FILE", requires_all = ["cell", "out"])]
    pub bench: Option<PathBuf>,
    /// The cell's file, for the same.
    #[arg(long, value_name = "FILE", requires = "bench")]
    pub cell: Option<PathBuf>,
    /// The one cell of a campaign that is meant [default: each of them by itself].
    #[arg(long, value_name = "NAME")]
    pub specimen: Option<String>,
    /// Use points that the quality gate of their measurement refused, too.
    #[arg(long)]
    pub refused_points: bool,
    /// Use the correction of this finding on the data in the place of the raw data; every result
    /// says so.
    #[arg(long, value_name = "FINDING", value_enum)]
    pub accept: Vec<Accept>,
    /// Look at the data only: what is odd in them and what makes them unusable, within a second and
    /// without a diagnosis.
    #[arg(long, conflicts_with_all = ["out", "accept"])]
    pub findings: bool,
    /// Write one table, .parquet or .csv: a row for each held-out run of each data set. A call that
    /// was killed goes on where it was.
    #[arg(long, value_name = "FILE")]
    pub table: Option<PathBuf>,
    /// For the table, fit the extended Randles model alone and look for no effect: how far it is
    /// from each record, within seconds.
    #[arg(long, requires = "table")]
    pub base_only: bool,
    /// Print JSON; of several cells, a list.
    #[arg(long)]
    pub json: bool,
}
