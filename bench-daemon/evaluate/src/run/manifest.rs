//! Identity of a run in its folder: the manifest, from which the run can be repeated, and the
//! first entry of the journal.

use std::collections::BTreeMap;

use analysis::run_folder::{self, MANIFEST};
use instruments::clock::{self, TimeMode};
use serde::Serialize;
use sha2::{Digest, Sha256};

use super::{folder_of, play::Run, resume_context};
use bench_core::{
    bench::Identified,
    journal::{ConfigCopy, Entry, Started},
    safety::failure::Failure,
};
use bench_plan::{config, support::hash};

/// Manifest of a run, from which the run can be repeated.
#[derive(Debug, Serialize)]
struct Manifest<'a> {
    program: &'static str,
    version: &'static str,
    experiment: &'a str,
    bench: &'a str,
    cell: &'a config::Cell,
    #[serde(skip_serializing_if = "Option::is_none")]
    specimen: Option<&'a str>,
    seed: u64,
    time: String,
    simulated: bool,
    config_sha256: String,
    files: BTreeMap<String, String>,
    started_unix_s: Option<f64>,
    instruments: &'a [Identified],
    status: &'a str,
    bench_time_s: f64,
}

/// Returns the copies of the configuration in the run folder, in the order of its sources. They do
/// not depend on the directory from which the run was started.
///
/// # Errors
/// Errors of the file system.
pub(super) fn copies(experiment: &config::Experiment) -> std::io::Result<Vec<ConfigCopy>> {
    let mut files: Vec<ConfigCopy> = Vec::new();
    for source in &experiment.sources {
        // The run may be resumed from any directory: the state of the bench is stored beside its
        // file.
        let path = std::path::absolute(source.path())?;
        let name = path
            .file_name()
            .map_or_else(|| "config.toml".into(), |name| name.to_string_lossy());
        let mut named = format!("{}_{name}", folder_of(&path));
        while files
            .iter()
            .any(|known| known.copy == run_folder::config_copy(&named) && known.path != path)
        {
            named.insert_str(0, "other_");
        }
        files.push(ConfigCopy {
            path,
            copy: run_folder::config_copy(&named),
            sha256: hash::sha256(source.text()),
        });
    }
    Ok(files)
}

impl Run<'_> {
    /// Copies the configuration, and begins the journal: from here on the run can be resumed.
    pub(super) fn begin(&mut self) -> Result<(), Failure> {
        let files = copies(self.experiment)?;
        for (source, file) in self.experiment.sources.iter().zip(&files) {
            self.recorder.text(&file.copy, source.text())?;
        }
        let started = Started {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            experiment: self.experiment.name.clone(),
            seed: self.experiment.seed,
            time: self.clock.mode().to_string(),
            inherited: self.inherited_world || self.before.1.is_some(),
            files,
            plan: resume_context::fingerprints(self.plan.plan()),
        };
        Ok(self.recorder.journal(Entry::Started(Box::new(started)))?)
    }

    pub(super) fn manifest(&self, instruments: &[Identified], status: &str) -> Result<(), Failure> {
        let mode = self.clock.mode();
        let mut whole = Sha256::new();
        let mut files = BTreeMap::new();
        for source in &self.experiment.sources {
            whole.update(source.text());
            files.insert(
                source.path().display().to_string(),
                hash::sha256(source.text()),
            );
        }
        let manifest = Manifest {
            program: "eis-bench",
            version: env!("CARGO_PKG_VERSION"),
            experiment: &self.experiment.name,
            bench: &self.experiment.bench.name,
            cell: &self.experiment.cell,
            specimen: self
                .experiment
                .specimen
                .as_ref()
                .map(|one| one.name.as_str()),
            seed: self.experiment.seed,
            time: mode.to_string(),
            simulated: self.experiment.bench.simulation.is_some(),
            config_sha256: hash::hex(&whole.finalize()),
            files,
            // In virtual time the calendar has no meaning, and two runs must write the same file.
            started_unix_s: (mode != TimeMode::Virtual)
                .then(|| clock::unix_time_s() - self.clock.now_s()),
            instruments,
            status,
            bench_time_s: (self.clock.now_s() * 1.0e3).round() / 1.0e3,
        };
        Ok(self.recorder.json(MANIFEST, &manifest)?)
    }
}
