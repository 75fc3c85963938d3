//! `eis-bench config`: files to begin with, their schema, whether they are right, and a proposed
//! bench file that is put in force.

use crate::command::{
    printed::say_json,
    take::{self, TakeArgs},
};
use std::fs;
use std::path::{Path, PathBuf};

use clap::{Args, Subcommand};

use bench_core::safety::failure::Failure;
use bench_evaluate::files;
use bench_plan::{
    config::{Source, load_any_bench, load_experiment, schema::Kind},
    procedure,
    support::terminal::say,
};
use bench_serve::settings::Settings;

/// Text of a file of the repository's `configs`.
macro_rules! configs {
    ($($path:literal),* $(,)?) => {
        &[$(($path, include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/../configs/", $path)))),*]
    };
}

/// Files of the simulated bench, of a bench of real instruments, and of the server.
const FILES: &[(&str, &str)] = configs![
    "experiments/demo.toml",
    "benches/demo.toml",
    "experiments/thesis.toml",
    "benches/thesis.toml",
    "benches/thesis-network.toml",
    "cells/p45b.toml",
    "scenarios/p45b.toml",
    "serve.toml",
];

/// The experiment among them that runs without hardware.
pub const DEMO: &str = "experiments/demo.toml";

/// Arguments of `config`.
#[derive(Debug, Args)]
pub struct ConfigArgs {
    #[command(subcommand)]
    act: Act,
}

#[derive(Debug, Subcommand)]
enum Act {
    /// Write files to begin with: an experiment and a bench that are simulated, the same for real
    /// instruments, a cell, a server. Nothing that is there is written over.
    New {
        /// The folder.
        folder: PathBuf,
    },
    /// Print the JSON Schema of a kind of file, for editors and forms.
    Schema {
        /// Kind of file.
        kind: Kind,
    },
    /// Read files, and say whether they are right. Touches no instrument.
    Check {
        /// Experiments, benches, files of a server.
        #[arg(required = true, value_name = "FILE")]
        files: Vec<PathBuf>,
        /// Print JSON.
        #[arg(long)]
        json: bool,
    },
    /// Put a bench file in force that was proposed on the page of a server: print every key that
    /// changes, and write the file after a confirmation. Refused while the bench is in use, latched
    /// or not verified off. The previous file stays available as a version.
    Take(TakeArgs),
}

/// Outcome of a check.
#[derive(Debug, serde::Serialize)]
struct Checked {
    file: PathBuf,
    kind: &'static str,
    /// The first mistake; `None` for a valid file.
    mistake: Option<String>,
}

/// Writes, prints, checks or puts in force.
///
/// # Errors
/// A folder that cannot be written; an invalid file, after all files were read; those of
/// [`take::take`].
pub fn config(args: &ConfigArgs) -> Result<(), Failure> {
    match &args.act {
        Act::New { folder } => {
            for path in write(folder)? {
                say!("{}", path.display());
            }
            Ok(())
        }
        Act::Schema { kind } => {
            say!("{}", kind.schema().trim_end());
            Ok(())
        }
        Act::Check { files, json } => check(files, *json),
        Act::Take(args) => take::take(args),
    }
}

/// Writes the files to begin with into a folder; gives their paths.
///
/// # Errors
/// A file that is there already; a folder that cannot be written.
pub fn write(folder: &Path) -> Result<Vec<PathBuf>, Failure> {
    let named: Vec<(PathBuf, &str)> = FILES
        .iter()
        .map(|(path, text)| (folder.join(path), *text))
        .collect();
    if let Some((taken, _)) = named.iter().find(|(path, _)| path.exists()) {
        return Err(Failure::Usage(format!(
            "{}: expected no such file, found one; choose another folder",
            taken.display()
        )));
    }
    for (path, text) in &named {
        files::make_folder(path.parent().unwrap_or(folder))?;
        fs::write(path, text)
            .map_err(|error| Failure::Usage(format!("{}: {error}", path.display())))?;
    }
    Ok(named.into_iter().map(|(path, _)| path).collect())
}

fn check(files: &[PathBuf], json: bool) -> Result<(), Failure> {
    let checked: Vec<Checked> = files.iter().map(|file| of_file(file)).collect();
    if json {
        say_json(&checked)?;
    } else {
        for one in &checked {
            match &one.mistake {
                Some(mistake) => say!("{mistake}"),
                None => {
                    let article = if one.kind.starts_with('e') { "an" } else { "a" };
                    say!(
                        "{}: {article} {} that is right",
                        one.file.display(),
                        one.kind
                    );
                }
            }
        }
    }
    match checked.iter().filter(|one| one.mistake.is_some()).count() {
        0 => Ok(()),
        wrong => Err(Failure::Usage(format!(
            "{wrong} of {} files are wrong",
            files.len()
        ))),
    }
}

fn of_file(file: &Path) -> Checked {
    let kind = Source::read(file).and_then(|source| {
        source.parse::<toml::Table>()?;
        Ok(Kind::of(source.text()))
    });
    let (kind, outcome) = match kind {
        Err(error) => ("file", Err(Failure::from(error))),
        Ok(Some(Kind::Bench)) => (
            "bench",
            load_any_bench(file).map(|_| ()).map_err(Failure::from),
        ),
        Ok(Some(Kind::Server)) => (
            "server",
            Settings::load(file).map(|_| ()).map_err(Failure::from),
        ),
        Ok(Some(Kind::Experiment)) => ("experiment", of_experiment(file)),
        Ok(_) => {
            let expected = "expected an experiment (key `cell`), a bench (`[instruments]`) or a \
                            server (`listen`, `benches`); a cell and a scenario are checked with \
                            what names them";
            (
                "file",
                Err(Failure::Usage(format!("{}: {expected}", file.display()))),
            )
        }
    };
    Checked {
        file: file.to_owned(),
        kind,
        mistake: outcome.err().map(|failure| failure.to_string()),
    }
}

/// An experiment with its bench and cell, and whether its plan keeps the limits.
fn of_experiment(file: &Path) -> Result<(), Failure> {
    let experiment = load_experiment(file, None)?;
    procedure::plan(&experiment).check(&experiment.cell.limits)?;
    Ok(())
}
