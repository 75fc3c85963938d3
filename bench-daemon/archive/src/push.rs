//! Pushes a run to the store.
//!
//! 1. The receipt lists the new state of the run and its previous state.
//! 2. Every absent file is sent, and every file is read back.
//! 3. The rows are written, and read back.
//! 4. The folder is read again: it must not have changed.
//! 5. The list of the run is created, unless it exists.
//! 6. The rows of the previous state of the run are removed.
//! 7. The receipt marks the run as archived.
//!
//! The procedure can be repeated after an interruption at any point.

use std::collections::BTreeSet;

use analysis_catalog::{
    record::CatalogVerdict,
    rows::{RunRows, TABLES},
    scan::Beside,
};
use futures_util::{StreamExt, TryStreamExt, stream};

use crate::{
    ArchiveError, Store,
    hash::Hashed,
    layout::{self, FileEntry, Partition, Placed, RunList, STORE_FORMAT, STORE_VERSION, is_sha256},
    objects::Source,
    receipt::{Kept, Receipt, Receipts, Trouble, TroubleKind},
    snapshot::{RunSource, Snapshot},
    tables::{self, TableFile},
};

/// Number of small files that are sent at the same time.
const AT_ONCE: usize = 4;
/// Files up to this size are small, bytes: `AT_ONCE` of them are in memory at once.
const SMALL: u64 = 1 << 20;
/// Number of attempts for a run that changes during the push.
const BEGINNINGS: usize = 3;

/// Result of a push.
#[derive(Debug, Clone, PartialEq)]
pub enum Outcome {
    /// The store already contained it in its present state.
    Unchanged(Kept),
    /// The store contains it now.
    Archived(Kept),
}

/// Conditions of a push.
#[derive(Debug, Clone, Default)]
pub struct Now {
    /// Time, s since 1970.
    pub unix_s: f64,
    /// The user that requested the run.
    pub operator: Option<String>,
    /// Also pushes a run whose journal contains no end.
    pub unfinished: bool,
    /// Reads back the objects in the store even if the receipt lists the run as archived.
    pub again: bool,
}

/// Pushes runs to a store.
#[derive(Debug)]
pub struct Pusher<'a> {
    store: &'a Store,
    receipts: &'a Receipts,
    site: &'a str,
    /// Hashes of the objects that were read back since the beginning.
    verified: BTreeSet<String>,
    /// Whether the store was verified to be one of this program.
    begun: bool,
}

/// A run during a push.
struct Going<'a> {
    source: &'a RunSource,
    now: &'a Now,
    snapshot: Snapshot,
    stamp: String,
    finished: bool,
    partition: Partition,
}

impl Going<'_> {
    fn placed(&self, partition: &Partition) -> Placed {
        Placed {
            run_sha256: self.snapshot.run_sha256.clone(),
            partition: partition.clone(),
        }
    }
}

fn waiting(source: &RunSource, in_use: bool) -> ArchiveError {
    let why = match in_use {
        true => "a process works in its folder",
        false => "its journal has no end; `--unfinished` archives it as it is",
    };
    ArchiveError::Waiting {
        run: source.name.clone(),
        in_use,
        why: why.to_owned(),
    }
}

fn rows(source: &RunSource, now: &Now) -> RunRows {
    let beside = Beside {
        operator: now.operator.clone(),
        ..Beside::default()
    };
    RunRows::read(&source.folder, beside, &source.diagnoses)
}

impl<'a> Pusher<'a> {
    /// Creates the value for a store.
    pub fn of(store: &'a Store, receipts: &'a Receipts, site: &'a str) -> Self {
        Self {
            store,
            receipts,
            site,
            verified: BTreeSet::new(),
            begun: false,
        }
    }

    /// Uploads a run in its present state.
    ///
    /// # Errors
    /// [`ArchiveError`], which is also written to the receipt of the run.
    pub async fn push(&mut self, source: &RunSource, now: &Now) -> Result<Outcome, ArchiveError> {
        let _lock = self.receipts.lock()?;
        let mut pushed = Err(waiting(source, true));
        for _ in 0..BEGINNINGS {
            pushed = self.once(source, now).await;
            if !matches!(pushed, Err(ArchiveError::Changed { .. })) {
                break;
            }
        }
        if let Err(error) = &pushed {
            self.tell(source, now, error)?;
        }
        pushed
    }

    fn tell(
        &self,
        source: &RunSource,
        now: &Now,
        error: &ArchiveError,
    ) -> Result<(), ArchiveError> {
        let kind = match error {
            ArchiveError::Refused { .. } => TroubleKind::Refused,
            ArchiveError::Waiting { .. } => TroubleKind::Waiting,
            // Do not overwrite a receipt that cannot be read.
            ArchiveError::Record(_) => return Ok(()),
            _ => TroubleKind::Failed,
        };
        let mut receipt = self.receipts.read(&source.name)?;
        // An older receipt of another store stays valid until this store has the run.
        if receipt.kept.is_none() {
            self.store.name().clone_into(&mut receipt.store);
        }
        // The process that works in the folder may end and leave every file unchanged; therefore
        // the run is checked again.
        let stamp = match error {
            ArchiveError::Waiting { in_use: true, .. } => String::new(),
            _ => source.stamp(),
        };
        receipt.trouble = Some(Trouble {
            why: error.to_string(),
            unix_s: now.unix_s,
            kind,
            stamp,
        });
        self.receipts.write(&receipt)
    }

    async fn once(&mut self, source: &RunSource, now: &Now) -> Result<Outcome, ArchiveError> {
        let mut receipt = self.receipts.read(&source.name)?;
        let stamp = source.stamp();
        if let Some(kept) = self.unchanged(&receipt, &stamp, now) {
            return Ok(Outcome::Unchanged(kept));
        }
        let going = self.look(source, now, stamp)?;
        if let Some(kept) = self.same_content(&mut receipt, &going)? {
            return Ok(Outcome::Unchanged(kept));
        }
        if !self.begun {
            self.store.begin().await?;
            self.begun = true;
        }
        let listed = self.list(&going.snapshot).await?;
        let rows_stay = listed.is_some() && !now.again;
        let partition =
            listed.map_or_else(|| going.partition.clone(), |list| list.placed.partition);
        let placed = going.placed(&partition);
        receipt.begin(self.store.name(), placed.clone());
        self.receipts.write(&receipt)?;
        let sent_bytes = self.objects(&going).await?;
        let at = RowsAt { placed, rows_stay };
        let (placed, tables) = self.rows_and_list(&going, &mut receipt, at).await?;
        self.remove_stale(&mut receipt).await?;
        let kept = self.kept(
            &going,
            &receipt,
            Sent {
                placed,
                tables,
                sent_bytes,
            },
        );
        receipt = Receipt {
            kept: Some(kept.clone()),
            going: None,
            trouble: None,
            ..receipt
        };
        self.receipts.write(&receipt)?;
        Ok(Outcome::Archived(kept))
    }

    /// Returns the record of the receipt if nothing has changed since.
    fn unchanged(&self, receipt: &Receipt, stamp: &str, now: &Now) -> Option<Kept> {
        let is_there = receipt.store == self.store.name()
            && receipt.stale.is_empty()
            && receipt.going.is_none()
            && !now.again;
        let kept = receipt.kept.as_ref().filter(|_| is_there)?;
        (kept.stamp == stamp).then(|| kept.clone())
    }

    /// Reads the present state of the run, if it may be archived.
    fn look<'b>(
        &self,
        source: &'b RunSource,
        now: &'b Now,
        stamp: String,
    ) -> Result<Going<'b>, ArchiveError> {
        if source.is_in_use() {
            return Err(waiting(source, true));
        }
        let rows = rows(source, now);
        if rows.run().verdict == CatalogVerdict::Unfinished && !now.unfinished {
            return Err(waiting(source, false));
        }
        let finished = rows.is_finished();
        Ok(Going {
            source,
            now,
            snapshot: source.snapshot(finished)?,
            stamp,
            finished,
            partition: Partition::of(self.site, rows.run()),
        })
    }

    /// Returns the stored record if only the stamp of the folder has changed and not its content.
    fn same_content(
        &self,
        receipt: &mut Receipt,
        going: &Going<'_>,
    ) -> Result<Option<Kept>, ArchiveError> {
        let Some(kept) = &receipt.kept else {
            return Ok(None);
        };
        let is_same = kept.placed.run_sha256 == going.snapshot.run_sha256;
        let same_stamp = Kept {
            stamp: going.stamp.clone(),
            ..kept.clone()
        };
        let found = self.unchanged(
            &Receipt {
                kept: Some(same_stamp),
                ..receipt.clone()
            },
            &going.stamp,
            going.now,
        );
        let Some(found) = found.filter(|_| is_same) else {
            return Ok(None);
        };
        receipt.kept = Some(found.clone());
        receipt.trouble = None;
        self.receipts.write(receipt)?;
        Ok(Some(found))
    }

    /// Returns the list of a run in the store, or `None` if there is none. It must match these
    /// files.
    async fn list(&self, snapshot: &Snapshot) -> Result<Option<RunList>, ArchiveError> {
        let list = self.store.run_list(&snapshot.run_sha256).await?;
        match list {
            Some(list) if list.files != snapshot.files => {
                let path = RunList::path(&snapshot.run_sha256);
                let why = "expected the files of this run, found others".to_owned();
                Err(self.store.content(&path, why))
            }
            list => Ok(list),
        }
    }

    /// Sends the absent files, several small ones at a time; returns the number of bytes sent.
    async fn objects(&mut self, going: &Going<'_>) -> Result<u64, ArchiveError> {
        let mut wanted = BTreeSet::new();
        let files: Vec<&FileEntry> = going
            .snapshot
            .files
            .iter()
            .filter(|file| going.now.again || !self.verified.contains(&file.sha256))
            .filter(|file| wanted.insert(file.sha256.as_str()))
            .collect();
        let (small, large): (Vec<_>, Vec<_>) =
            files.into_iter().partition(|file| file.bytes <= SMALL);
        let store = self.store;
        let send = |file: &'_ FileEntry| {
            let (file, place) = (file.clone(), going.source.place(&file.path));
            async move {
                let (path, wanted) = (layout::object(&file.sha256), file.hashed());
                let sent = store.ensure(&path, &wanted, Source::File(&place)).await?;
                Ok::<_, ArchiveError>((file.sha256, sent))
            }
        };
        let mut sent_bytes = 0;
        let small = stream::iter(small.into_iter().map(send)).buffer_unordered(AT_ONCE);
        let large = stream::iter(large.into_iter().map(send)).buffered(1);
        let mut all = Box::pin(small.chain(large));
        while let Some((sha256, bytes)) = all.try_next().await? {
            sent_bytes += bytes;
            self.verified.insert(sha256);
        }
        Ok(sent_bytes)
    }

    /// Writes rows and list. If another process has written the list in the meantime, the rows go
    /// to the location in that list, so that the rows of a run have one location.
    async fn rows_and_list(
        &self,
        going: &Going<'_>,
        receipt: &mut Receipt,
        at: RowsAt,
    ) -> Result<(Placed, Vec<FileEntry>), ArchiveError> {
        let tables = self.write_tables(going, &at).await?;
        if going.source.snapshot(going.finished)? != going.snapshot {
            return Err(ArchiveError::Changed {
                file: going.source.folder.clone(),
            });
        }
        let list = self.make_list(going, receipt, &at.placed).await?;
        if list.placed == at.placed {
            return Ok((at.placed, tables));
        }
        receipt.begin(self.store.name(), list.placed.clone());
        self.receipts.write(receipt)?;
        let at = RowsAt {
            placed: list.placed,
            rows_stay: true,
        };
        let tables = self.write_tables(going, &at).await?;
        Ok((at.placed, tables))
    }

    async fn write_tables(
        &self,
        going: &Going<'_>,
        at: &RowsAt,
    ) -> Result<Vec<FileEntry>, ArchiveError> {
        let mut written = Vec::new();
        let rows = rows(going.source, going.now);
        for TableFile { path, bytes } in tables::tables(rows, &at.placed)? {
            let there = match at.rows_stay {
                true => self.store.hashed_twice(&path).await?,
                false => None,
            };
            let hashed = there.unwrap_or_else(|| Hashed::of(&bytes));
            let source = Source::Memory(&bytes);
            self.store.ensure(&path, &hashed, source).await?;
            let Hashed { sha256, bytes } = hashed;
            written.push(FileEntry {
                path,
                sha256,
                bytes,
            });
        }
        Ok(written)
    }

    async fn make_list(
        &self,
        going: &Going<'_>,
        receipt: &Receipt,
        placed: &Placed,
    ) -> Result<RunList, ArchiveError> {
        let own = RunList {
            format: STORE_FORMAT.to_owned(),
            version: STORE_VERSION,
            placed: placed.clone(),
            name: going.source.name.clone(),
            supersedes: receipt.before(&placed.run_sha256),
            files: going.snapshot.files.clone(),
        };
        if let Some(list) = self.list(&going.snapshot).await? {
            return Ok(list);
        }
        let path = RunList::path(&placed.run_sha256);
        let text = serde_json::to_vec_pretty(&own).unwrap_or_default();
        if self.store.create(&path, text).await?.is_none() {
            return Ok(own);
        }
        let made = self.list(&going.snapshot).await?;
        made.ok_or_else(|| {
            self.store
                .content(&path, "expected a list, found none".to_owned())
        })
    }

    /// Removes the rows of earlier states of the run.
    async fn remove_stale(&self, receipt: &mut Receipt) -> Result<(), ArchiveError> {
        for placed in &receipt.stale {
            if self.receipts.is_shared(&receipt.run, placed)? {
                continue;
            }
            for table in TABLES {
                self.store.remove(&placed.table(table)).await?;
            }
        }
        receipt.stale.clear();
        Ok(())
    }

    fn kept(&self, going: &Going<'_>, receipt: &Receipt, sent: Sent) -> Kept {
        let files = &going.snapshot.files;
        let moved = files
            .iter()
            .filter(|file| !going.source.place(&file.path).exists());
        let moved: Vec<&FileEntry> = moved.collect();
        let before = receipt.kept.as_ref();
        let is_same = before.is_some_and(|kept| kept.placed == sent.placed);
        let supersedes = receipt.before(&sent.placed.run_sha256);
        Kept {
            stamp: going.stamp.clone(),
            files: files.len(),
            bytes: files.iter().map(|file| file.bytes).sum(),
            sent_bytes: sent.sent_bytes,
            verified_unix_s: going.now.unix_s,
            supersedes: match before {
                Some(kept) if is_same => kept.supersedes.clone(),
                _ => supersedes,
            },
            tables: sent.tables,
            finished: going.finished,
            moved_files: moved.len(),
            moved_bytes: moved.iter().map(|file| file.bytes).sum(),
            placed: sent.placed,
        }
    }
}

/// Location of rows, and whether existing rows are kept: they have equal content, and the run may
/// also exist in another folder.
struct RowsAt {
    placed: Placed,
    rows_stay: bool,
}

/// Parts of a run that were sent.
struct Sent {
    placed: Placed,
    tables: Vec<FileEntry>,
    sent_bytes: u64,
}

impl Store {
    /// Returns the list of a run, or `None` if there is none.
    ///
    /// # Errors
    /// [`ArchiveError::Content`] if the list does not match this hash.
    pub async fn run_list(&self, run_sha256: &str) -> Result<Option<RunList>, ArchiveError> {
        let path = RunList::path(run_sha256);
        let Some(bytes) = self.bytes(&path).await? else {
            return Ok(None);
        };
        let list: RunList = serde_json::from_slice(&bytes)
            .map_err(|error| self.content(&path, format!("expected a list of files: {error}")))?;
        let is_own = list.format == STORE_FORMAT
            && list.version == STORE_VERSION
            && list.files.iter().all(|file| is_sha256(&file.sha256));
        let found = layout::run_sha256(&list.files);
        if !is_own || found != run_sha256 || list.placed.run_sha256 != run_sha256 {
            let why = format!(
                "expected a list of version {STORE_VERSION} of files that give {run_sha256}, \
                 found version {} of files that give {found}",
                list.version
            );
            return Err(self.content(&path, why));
        }
        Ok(Some(list))
    }
}
