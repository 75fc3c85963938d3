//! `eis-bench demo`: the whole job on the built-in simulated bench, from files that are written for
//! it.

use std::path::PathBuf;

use analysis::run_folder::REPORT;

use super::{
    config::{DEMO, write},
    run::run_experiment,
};
use bench_core::safety::failure::Failure;
use bench_plan::{config::load_experiment, support::terminal::say};

/// Arguments of `demo`.
#[derive(Debug, clap::Args)]
pub struct DemoArgs {
    /// The folder for the files and the run.
    #[arg(default_value = "eis-bench-demo", value_name = "DIR")]
    pub folder: PathBuf,
    /// Seed of the simulation and of the fits' searches, instead of the default.
    #[arg(long)]
    pub seed: Option<u64>,
}

/// Writes the files, runs the experiment, and prints possible next steps.
///
/// # Errors
/// A folder that contains such files already; as [`super::run::run`].
pub fn demo(args: &DemoArgs) -> Result<(), Failure> {
    let folder = &args.folder;
    write(folder)?;
    let file = folder.join(DEMO);
    let mut experiment = load_experiment(&file, None)?;
    experiment.seed = args.seed.unwrap_or(experiment.seed);
    let run = folder.join("run");
    let finished = run_experiment(&experiment, &run)?;
    say!("{}", finished.summary.trim_end());
    let (report, file) = (run.join(REPORT), file.display());
    say!(
        "\nnext: open {}, or change {file} and run it:",
        report.display()
    );
    say!("  eis-bench plan {file}");
    say!("  eis-bench run {file}");
    say!("  eis-bench serve {}/serve.toml", folder.display());
    finished.gated()
}
