//! `eis-bench run`: from an experiment file to a fitted model.

use std::path::{Path, PathBuf};

use analysis::run_folder::{self, INDEX, REPORT};

use crate::command::diagnose;
use bench_core::safety::failure::Failure;
use bench_evaluate::{
    files,
    run::{Finished, Session},
};
use bench_plan::{
    config::{Experiment, load_experiment},
    support::terminal::say,
};

/// Arguments of `run`.
#[derive(Debug, clap::Args)]
pub struct RunArgs {
    /// The experiment file.
    pub experiment: PathBuf,
    /// A bench file instead of the one that the experiment names.
    #[arg(long, value_name = "FILE")]
    pub bench: Option<PathBuf>,
    /// The run folder [default: runs/NAME, runs/NAME-2, …]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// A seed instead of the experiment's, for the simulation and the fits' searches.
    #[arg(long)]
    pub seed: Option<u64>,
    /// Print JSON: the folder, its files with the results of the run (`model` is the recommended
    /// one), and the number of points that the quality gate refused.
    #[arg(long)]
    pub json: bool,
}

/// Runs an experiment.
///
/// # Errors
/// A mistake in the files, before anything is energised; later anything that ended the run, the
/// bench in safe state.
pub fn run(args: &RunArgs) -> Result<(), Failure> {
    let mut experiment = load_experiment(&args.experiment, args.bench.as_deref())?;
    experiment.seed = args.seed.unwrap_or(experiment.seed);
    let folder = args
        .out
        .clone()
        .unwrap_or_else(|| free_folder(&experiment.name));
    let finished = run_experiment(&experiment, &folder)?;
    if args.json {
        let recommended = files::recommended_order(&folder);
        let there = |name: &str| Some(folder.join(name)).filter(|path| path.exists());
        let summary = serde_json::json!({
            "folder": folder,
            "report": there(REPORT),
            "model": recommended.and_then(|rc| there(&run_folder::model(rc))),
            "recommended_rc": recommended,
            "index": there(INDEX),
            "refused_points": finished.measured.refused(),
        });
        say!("{summary:#}");
    } else {
        say!("{}", finished.summary.trim_end());
    }
    finished.gated()
}

/// Runs an experiment into a folder.
///
/// # Errors
/// As [`run`].
pub fn run_experiment(experiment: &Experiment, folder: &Path) -> Result<Finished, Failure> {
    let mut finished = Session::new(&experiment.bench)?.run(experiment, folder)?;
    diagnose::finished(experiment, folder, &mut finished)?;
    Ok(finished)
}

fn free_folder(name: &str) -> PathBuf {
    let taken =
        |path: &Path| std::fs::read_dir(path).is_ok_and(|mut entries| entries.next().is_some());
    let first = PathBuf::from("runs").join(name);
    if !taken(&first) {
        return first;
    }
    (2_u32..)
        .map(|number| PathBuf::from("runs").join(format!("{name}-{number}")))
        .find(|path| !taken(path))
        .unwrap_or(first)
}
