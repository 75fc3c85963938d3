//! `eis-bench effects`: the catalogue of effects that a model may lack, the effects that a data
//! set can distinguish, and the thresholds of the diagnosis.

use std::path::PathBuf;

use analysis::{
    contract::Card,
    diagnosis::{
        distinguish, report,
        thresholds::{self, THRESHOLDS},
    },
    effects::catalogue,
};
use serde::Serialize;

use super::{diagnose::Judged, model_args::ModelArgs};
use bench_core::safety::failure::Failure;
use bench_evaluate::files;
use bench_plan::support::terminal::say;

/// Arguments of `effects`.
#[derive(Debug, clap::Args)]
pub struct EffectsArgs {
    /// A data set: print which effects it can distinguish. Needs --model or --erm, unless its
    /// `dataset.toml` names a model.
    #[arg(value_name = "DATASET")]
    pub data: Option<PathBuf>,
    /// The model of the data set's cell: a file of `fit`, `joint` or a run, JSON of `r_ohm` and
    /// `branches` alone, or circuit.json of `fit --circuit`.
    #[arg(long, value_name = "FILE", requires = "data")]
    pub model: Option<PathBuf>,
    /// The model as text: "6.43 mΩ; 1.51 mΩ, 0.553 F; 0.66 mΩ, 4.6 ms".
    #[arg(long, value_name = "TEXT", requires = "data", conflicts_with = "model")]
    pub erm: Option<String>,
    /// The OCV curve from `ocv --out` or a cell file, if the model file has none or to replace it.
    #[arg(long, value_name = "JSON")]
    pub ocv: Option<PathBuf>,
    /// Write `effects.md` and the pictures of the matrix into this folder.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Print the thresholds of the diagnosis instead, with units and sources.
    #[arg(long, conflicts_with_all = ["data", "out"])]
    pub thresholds: bool,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}

/// The catalogue and the matrix.
#[derive(Serialize)]
struct Listing<'a> {
    effects: &'a [&'a Card],
    #[serde(skip_serializing_if = "Option::is_none")]
    distinguishability: Option<&'a report::Distinguishability>,
}

/// Prints the catalogue, or the thresholds.
///
/// # Errors
/// A file or an argument that is not as expected; a folder that cannot be written.
pub fn effects(args: &EffectsArgs) -> Result<(), Failure> {
    if args.thresholds {
        return print_thresholds(args.json);
    }
    let cards: Vec<&Card> = catalogue().iter().map(|effect| effect.card()).collect();
    let matrix = match &args.data {
        Some(data) => {
            let named = ModelArgs {
                model: args.model.clone(),
                erm: args.erm.clone(),
                ladder_band_hz: None,
            };
            let judged = Judged::read(data, &named, args.ocv.as_deref(), false)?;
            let matrix = distinguish(&judged.loaded.set, &judged.model, catalogue());
            Some(matrix.map_err(|error| Failure::Usage(error.to_string()))?)
        }
        None => None,
    };
    if let Some(folder) = &args.out {
        let pictures = matrix
            .as_ref()
            .map_or(Vec::new(), report::Distinguishability::pictures);
        files::make_folder(folder)?;
        for picture in &pictures {
            files::write_picture(folder, &picture.name, |path| picture.drawing.write(path))?;
        }
        files::write_text(
            folder,
            "effects.md",
            &report::catalogue_markdown(&cards, matrix.as_ref(), &pictures),
        )?;
    }
    if args.json {
        let listing = Listing {
            effects: &cards,
            distinguishability: matrix.as_ref(),
        };
        print_json(&listing)?;
    } else {
        say!("{}", report::catalogue_text(&cards, matrix.as_ref()));
    }
    Ok(())
}

fn print_thresholds(json: bool) -> Result<(), Failure> {
    if json {
        return print_json(THRESHOLDS);
    }
    say!("{}", thresholds::markdown().trim_end());
    Ok(())
}

fn print_json(value: &(impl Serialize + ?Sized)) -> Result<(), Failure> {
    let text = serde_json::to_string_pretty(value);
    say!(
        "{}",
        text.map_err(|error| Failure::Analysis(error.to_string()))?
    );
    Ok(())
}
