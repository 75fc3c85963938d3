//! `eis-bench diagnose`: where a model and a data set disagree, what is missing, and whether adding it closes the gap.

use std::path::{Path, PathBuf};

use analysis::diagnosis::{BaseModel, Diagnosis, DiagnosisOptions, Outcome, Verdict, gate};

use super::{Failure, files};
use crate::{
    dataset::{Loaded, read_dataset},
    present::significant,
    terminal::say,
};

/// Arguments of `diagnose`.
#[derive(Debug, clap::Args)]
pub struct DiagnoseArgs {
    /// The data set: a folder with `dataset.toml`, or a run folder.
    #[arg(value_name = "DATASET")]
    pub data: PathBuf,
    /// The model to be judged, as `fit`, `joint` or a run writes it.
    #[arg(long, value_name = "FILE")]
    pub model: PathBuf,
    /// The OCV curve, as `ocv --out` writes it (`ocv.json`), where the model file holds none or another is wanted.
    #[arg(long, value_name = "JSON")]
    pub ocv: Option<PathBuf>,
    /// Write `diagnosis.json` into this folder.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}

/// Diagnoses, prints, and writes into a folder if asked to.
///
/// # Errors
/// A file or an argument that is not as expected; a folder that cannot be written. Any verdict, `invalid` too, is a result and no error.
pub fn diagnose(args: &DiagnoseArgs) -> Result<(), Failure> {
    let model = base_model(args)?;
    let loaded = read_dataset(&args.data)?;
    let outcome = judge(&loaded, &model)?;
    let json = || serde_json::to_string_pretty(&outcome.diagnosis).map_err(|error| Failure::Analysis(error.to_string()));
    if let Some(folder) = &args.out {
        write(folder, &(json()? + "\n"))?;
    }
    if args.json {
        say!("{}", json()?);
        return Ok(());
    }
    print(&outcome.diagnosis);
    if let Some(folder) = &args.out {
        say!("written to {}", folder.display());
    }
    Ok(())
}

/// The diagnosis of what could be read; what could not makes the data invalid.
fn judge(loaded: &Loaded, model: &BaseModel) -> Result<Outcome, Failure> {
    let unreadable = loaded.problems.iter().map(|problem| gate::Reason::unreadable(&problem.run, &problem.text)).collect();
    let mut outcome = gate::diagnose_gated(&loaded.set, unreadable, model, &DiagnosisOptions::default())
        .map_err(|error| Failure::Usage(error.to_string()))?;
    outcome.diagnosis.notes.extend(loaded.notes.iter().cloned());
    Ok(outcome)
}

fn base_model(args: &DiagnoseArgs) -> Result<BaseModel, Failure> {
    let file = files::read_model(&args.model)?;
    let given = args.ocv.as_deref().map(files::read_curve).transpose()?;
    let ocv = given.or(file.ocv).ok_or_else(|| {
        Failure::Usage(format!("--model {}: expected an OCV curve in it, found none; give one with --ocv", args.model.display()))
    })?;
    Ok(BaseModel { name: file.name, erm: file.fit.erm, ocv })
}

fn write(folder: &Path, json: &str) -> Result<(), Failure> {
    files::make_folder(folder)?;
    files::write_text(folder, "diagnosis.json", json)
}

pub(super) fn print(diagnosis: &Diagnosis) {
    say!("{} against {}: {}", diagnosis.data_set, diagnosis.model, word(diagnosis.verdict));
    say!("  {}", diagnosis.summary);
    for effect in &diagnosis.effects {
        say!("  {} ({}):", effect.title, effect.name);
        for p in &effect.parameters {
            let sigma = p.sigma.map_or_else(|| "not fixed by these data".to_owned(), |sigma| format!("± {}", significant(sigma, 2)));
            say!("    {} = {} {} {sigma}", p.name, significant(p.value, 4), p.unit);
        }
    }
    for gap in &diagnosis.gap {
        say!(
            "  {}: {:.2} mV by the model file, {:.2} refitted, {:.2} augmented, floor {:.2}",
            gap.run,
            gap.eis_only_mv,
            gap.base_mv,
            gap.augmented_mv,
            gap.floor_mv
        );
    }
    for note in &diagnosis.notes {
        say!("  note: {note}");
    }
}

pub(crate) fn word(verdict: Verdict) -> &'static str {
    match verdict {
        Verdict::AtNoiseFloor => "at the noise floor",
        Verdict::Explained => "explained",
        Verdict::Ambiguous => "ambiguous",
        Verdict::Unexplained => "unexplained",
        Verdict::Invalid => "invalid",
    }
}
