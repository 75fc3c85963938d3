//! The runs of a server's data folder.

use std::{collections::BTreeSet, fs, io, path::Path};

use analysis_catalog::rows::diagnoses_below;
use analysis_files::run_folder::{JOURNAL, MANIFEST};
use bench_archive::snapshot::RunSource;

use crate::failure::Failure;

/// Folder of the analyses in the data folder.
const ANALYSES: &str = "analyses";
/// Folder of the runs.
const RUNS: &str = "runs";
/// Folder of the records of the server about its runs.
const JOBS: &str = "jobs";

/// Returns the named runs of a data folder, or all runs if none is named, each with the folders of
/// its diagnoses.
///
/// # Errors
/// A name has no run folder, or the data folder cannot be read.
pub(crate) fn run_sources(data: &Path, named: &[String]) -> Result<Vec<RunSource>, Failure> {
    let mut diagnoses = diagnoses_below(&data.join(ANALYSES));
    let runs = data.join(RUNS);
    let names = match named {
        [] => list_runs(&runs)?,
        named => named.iter().cloned().collect(),
    };
    let source = |name: String| {
        let folder = runs.join(&name);
        if !is_plain_name(&name) || !is_run(&folder) {
            return Err(Failure::Usage(format!(
                "expected the name of a run of {}, found {name:?}",
                runs.display()
            )));
        }
        Ok(RunSource {
            diagnoses: diagnoses.remove(&folder).unwrap_or_default(),
            name,
            folder,
        })
    };
    names.into_iter().map(source).collect()
}

fn list_runs(runs: &Path) -> Result<BTreeSet<String>, Failure> {
    let entries = match fs::read_dir(runs) {
        Ok(entries) => entries,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(BTreeSet::new()),
        Err(error) => return Err(Failure::Usage(format!("{}: {error}", runs.display()))),
    };
    let folders = entries.flatten().filter(|entry| is_run(&entry.path()));
    let names = folders.filter_map(|entry| entry.file_name().into_string().ok());
    Ok(names.filter(|name| is_plain_name(name)).collect())
}

fn is_run(folder: &Path) -> bool {
    [MANIFEST, JOURNAL]
        .iter()
        .any(|file| folder.join(file).is_file())
}

/// Checks whether a name is a plain path component. Hidden folders are not runs.
fn is_plain_name(name: &str) -> bool {
    !name.is_empty() && !name.starts_with('.') && !name.contains(['/', '\0'])
}

/// Returns the user who requested a run from the record of the server; `None` for a run that no
/// server started.
pub(crate) fn read_operator(data: &Path, run: &str) -> Option<String> {
    let text = fs::read(data.join(JOBS).join(format!("{run}.json"))).ok()?;
    let job: serde_json::Value = serde_json::from_slice(&text).ok()?;
    Some(job.pointer("/item/by")?.as_str()?.to_owned())
}
