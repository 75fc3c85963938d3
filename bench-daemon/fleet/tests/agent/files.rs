//! Altered copies of the demo's files, with a server and an agent of their own.

use std::{
    fs,
    os::unix::fs::PermissionsExt,
    path::{Path, PathBuf},
};

pub(crate) use crate::under_test::Files;

pub(crate) const EXPERIMENT: &str = "experiments/demo.toml";
pub(crate) const BENCH: &str = "benches/demo.toml";
pub(crate) const SCENARIO: &str = "scenarios/p45b.toml";

/// Returns the root of the repository.
pub(crate) fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

impl Files {
    fn demo() -> Self {
        let names = [EXPERIMENT, BENCH, "cells/p45b.toml", SCENARIO];
        Self::copies(&root().join("configs"), &names)
            .without(EXPERIMENT, "temperature")
            .without(EXPERIMENT, "soc_reset")
            .edit(EXPERIMENT, "rc = [1, 2, 3, 4]", "rc = [1]")
            .edit(EXPERIMENT, "start = \"0.1 Hz\"", "start = \"100 Hz\"")
    }

    /// The cell alone and two points: a run of less than a second.
    pub(crate) fn tiny() -> Self {
        Self::demo().without(EXPERIMENT, "fixture_check").edit(
            EXPERIMENT,
            "points = 20",
            "points = 2",
        )
    }

    /// In scaled time, so that there is a run to be stopped.
    pub(crate) fn slow() -> Self {
        let scaled = "[simulation]\ntime = \"scaled:1\"";
        Self::tiny().edit(BENCH, "[simulation]", scaled)
    }

    /// Controls, and a sweep to which a model with two pairs is fitted.
    pub(crate) fn measuring() -> Self {
        Self::demo()
            .edit(EXPERIMENT, "points = 20", "points = 8")
            .edit(EXPERIMENT, "rc = [1]", "rc = [2]")
            .edit(EXPERIMENT, "start = \"100 Hz\"", "start = \"0.5 Hz\"")
            .append(SCENARIO, "[specimens]\nstore = 5\n")
    }

    /// Its bench is named `second`.
    pub(crate) fn second(self) -> Self {
        self.edit(BENCH, "name = \"demo\"", "name = \"second\"")
    }

    /// Writes a file that only its owner may read.
    pub(crate) fn write_private(&self, name: &str, text: &str) {
        self.write(name, text);
        let mode = fs::Permissions::from_mode(0o600);
        fs::set_permissions(self.path(name), mode).unwrap();
    }

    /// Returns the names of the run folders, sorted.
    pub(crate) fn runs(&self) -> Vec<String> {
        let Ok(runs) = fs::read_dir(self.path("data/runs")) else {
            return Vec::new();
        };
        let name =
            |run: std::io::Result<fs::DirEntry>| run.unwrap().file_name().into_string().unwrap();
        let mut runs: Vec<String> = runs.map(name).collect();
        runs.sort();
        runs
    }

    /// Returns how often the run of a job was begun, by the journals.
    pub(crate) fn begins(&self, run: &str) -> usize {
        let journal = self.path(&format!("data/runs/{run}/journal.jsonl"));
        let journal = fs::read_to_string(journal).unwrap_or_default();
        journal.matches("\"started\"").count()
    }
}
