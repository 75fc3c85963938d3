//! Reads every byte of runs back from the store.

use std::collections::BTreeSet;

use futures_util::TryStreamExt;
use object_store::path::Path;

use crate::{
    ArchiveError, Store,
    layout::{self, FileEntry, RUNS, RunList, is_sha256},
    receipt::Kept,
};

/// Result of reading a run back.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct VerifiedRun {
    /// Number of its files that match what was sent.
    pub files: usize,
    /// Their size.
    pub bytes: u64,
    /// Descriptions of the files and tables that do not match.
    pub wrong: Vec<String>,
}

/// Reads runs back, each object once.
#[derive(Debug)]
pub struct Verifier<'a> {
    store: &'a Store,
    seen: BTreeSet<String>,
}

impl<'a> Verifier<'a> {
    /// Creates the value for a store.
    pub fn of(store: &'a Store) -> Self {
        Self {
            store,
            seen: BTreeSet::new(),
        }
    }

    /// Reads back a run that a receipt lists, with its rows.
    ///
    /// # Errors
    /// The store does not answer.
    pub async fn kept(&mut self, kept: &Kept) -> Result<VerifiedRun, ArchiveError> {
        let mut verified = self.run(&kept.placed.run_sha256).await?;
        for table in &kept.tables {
            self.file(&table.path, table, &mut verified).await?;
        }
        Ok(verified)
    }

    /// Reads the files of a run back.
    ///
    /// # Errors
    /// The store does not answer.
    pub async fn run(&mut self, run_sha256: &str) -> Result<VerifiedRun, ArchiveError> {
        let mut verified = VerifiedRun::default();
        let list = match self.store.run_list(run_sha256).await {
            Ok(Some(list)) => list,
            Ok(None) => {
                let path = RunList::path(run_sha256);
                verified
                    .wrong
                    .push(format!("{path}: expected a list, found none"));
                return Ok(verified);
            }
            Err(error @ ArchiveError::Content { .. }) => {
                verified.wrong.push(error.to_string());
                return Ok(verified);
            }
            Err(error) => return Err(error),
        };
        for file in &list.files {
            let path = layout::object(&file.sha256);
            self.file(&path, file, &mut verified).await?;
            verified.files += 1;
            verified.bytes += file.bytes;
        }
        Ok(verified)
    }

    async fn file(
        &mut self,
        path: &str,
        file: &FileEntry,
        verified: &mut VerifiedRun,
    ) -> Result<(), ArchiveError> {
        if self.seen.contains(path) {
            return Ok(());
        }
        match self.store.check(path, &file.hashed()).await {
            Ok(()) => {
                self.seen.insert(path.to_owned());
                Ok(())
            }
            Err(error @ ArchiveError::Bytes { .. }) => {
                verified.wrong.push(format!("{}: {error}", file.path));
                Ok(())
            }
            Err(error) => Err(error),
        }
    }
}

impl Store {
    /// Returns the hashes of all runs in the store, including those of other benches and
    /// superseded ones.
    ///
    /// # Errors
    /// The store does not answer.
    pub async fn runs(&self) -> Result<Vec<String>, ArchiveError> {
        let prefix = Path::from(RUNS);
        let mut listed = self.objects.list(Some(&prefix));
        let mut found = Vec::new();
        while let Some(meta) = listed
            .try_next()
            .await
            .map_err(self.failed(RUNS, "list it"))?
        {
            let name = meta.location.filename().unwrap_or_default();
            let run = name.strip_suffix(".json").filter(|run| is_sha256(run));
            found.extend(run.map(str::to_owned));
        }
        found.sort_unstable();
        Ok(found)
    }
}
