//! Files that `dataset.toml` names for a diagnosis beside its runs.

use std::path::PathBuf;

use bench_plan::config::{ConfigError, Source};

/// Files that a diagnosis takes where its arguments name none.
#[derive(Debug, Clone, Default)]
pub struct NamedFiles {
    /// Model of the cell.
    pub model: Option<NamedFile>,
    /// OCV curve of the cell.
    pub ocv: Option<NamedFile>,
}

/// One such file, with the place that names it.
#[derive(Debug, Clone)]
pub struct NamedFile {
    /// Path of the file.
    pub path: PathBuf,
    key: &'static str,
    source: Source,
}

impl NamedFile {
    /// File that a key of the source names.
    pub(super) fn new(source: &Source, key: &'static str, path: &str) -> Self {
        Self {
            path: source.relative(path),
            key,
            source: source.clone(),
        }
    }

    /// Complaint about the file, with file, line and key of the place that names it.
    pub fn complain(&self, reason: impl Into<String>) -> ConfigError {
        self.source.complain(self.key, reason)
    }
}
