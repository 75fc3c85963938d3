//! Arguments of `eis-bench diagnose`.

use std::path::PathBuf;

use analysis::effects;

use crate::command::model_args::ModelArgs;
use bench_evaluate::investigate::dataset::Accept;

const MODEL: &str = "The cell's model: a file of `fit`, `joint` or a run; JSON of `r_ohm` and \
`branches` alone; or `circuit.json` of `fit --circuit`, followed by RC branches [default: `model` \
of dataset.toml]";

/// Arguments of `diagnose`.
#[derive(Debug, clap::Args)]
#[command(mut_arg("model", |model| model.help(MODEL)))]
pub struct DiagnoseArgs {
    /// The data set: a folder with `dataset.toml`, or a run folder; several, or folders of them,
    /// for
    /// --table.
    #[arg(value_name = "DATASET", required = true)]
    pub data: Vec<PathBuf>,
    /// The model to be judged.
    #[command(flatten)]
    pub model: ModelArgs,
    /// The OCV curve, from `ocv --out` (`ocv.json`) or a cell file (.toml), if the model file has none or to
    /// replace it [default: `ocv` of dataset.toml]
    #[arg(long, value_name = "JSON")]
    pub ocv: Option<PathBuf>,
    /// Write `diagnosis.html`, `diagnosis.json`, `diagnosis.md` with its pictures, `story.json`
    /// and, where effects were added, `model_augmented.json` and, where no name is certain,
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
    /// The cell of a campaign to diagnose [default: each cell separately].
    #[arg(long, value_name = "NAME")]
    pub specimen: Option<String>,
    /// Also use points that the quality gate of their measurement refused.
    #[arg(long)]
    pub refused_points: bool,
    /// Use the data as corrected for this finding instead of the raw data; every result states
    /// this.
    #[arg(long, value_name = "FINDING", value_enum)]
    pub accept: Vec<Accept>,
    /// Put this effect of the catalogue into the base by hand, whatever it gains, and show the gap of
    /// each held-out run before and after; may be given several times.
    #[arg(long, value_name = "EFFECT", value_parser = effect)]
    pub add: Vec<&'static str>,
    /// Leave this addition of the model out of the base, do not look for it, and show the same gaps;
    /// may be given several times.
    #[arg(long, value_name = "EFFECT", value_parser = effect)]
    pub without: Vec<&'static str>,
    /// Check the data only: print findings and reasons that make them unusable, within a second and
    /// without a diagnosis.
    #[arg(long, conflicts_with_all = ["out", "accept"])]
    pub findings: bool,
    /// Write one table, .parquet or .csv: a row for each held-out run of each data set. If the
    /// call is interrupted, the next call with the same arguments continues it.
    #[arg(long, value_name = "FILE")]
    pub table: Option<PathBuf>,
    /// For the table, fit only the extended Randles model and search no effects: its error on each
    /// record, within seconds.
    #[arg(long, requires = "table")]
    pub base_only: bool,
    /// Print JSON; of several cells, a list.
    #[arg(long)]
    pub json: bool,
}

/// Returns the catalogue's own name of an effect.
fn effect(name: &str) -> Result<&'static str, String> {
    effects::find(name)
        .map(|effect| effect.card().name)
        .ok_or_else(|| {
            "expected the name of an effect of the catalogue (`eis-bench effects` lists them)"
                .to_owned()
        })
}
