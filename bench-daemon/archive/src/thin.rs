//! Removes captures of archived runs from their folders; they remain only in the store.
//!
//! A capture is removed only after the run was verified and the store has just returned the file with
//! the right hash. The list of moved files is written first, so that a moved capture is never mistaken
//! for a lost one.

use std::{collections::BTreeSet, fs};

use analysis_files::run_folder::{Archived, ArchivedFile, CAPTURES};

use crate::{
    ArchiveError, Store,
    fetch::settle,
    layout::{self, FileEntry, RunList},
    receipt::{Kept, Receipts},
    snapshot::RunSource,
};

/// Number of captures that are checked before they are removed together.
const AT_ONCE: usize = 32;

/// Policy for moving captures.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ThinPolicy {
    /// Time since the verified upload after which captures are moved, s.
    pub captures_after_s: f64,
    /// Time now, s since 1970.
    pub unix_s: f64,
    /// Only count the captures that would be removed.
    pub dry: bool,
}

/// Captures that were moved.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Thinned {
    /// Their number.
    pub files: usize,
    /// Their size.
    pub bytes: u64,
}

/// Moves the captures of a run if the policy requires it.
///
/// # Errors
/// [`ArchiveError`]; a capture is removed only after all its checks.
pub async fn thin(
    store: &Store,
    receipts: &Receipts,
    source: &RunSource,
    policy: &ThinPolicy,
) -> Result<Thinned, ArchiveError> {
    let _lock = receipts.lock()?;
    let receipt = receipts.read(&source.name)?;
    let whole = receipt.store == store.name() && receipt.going.is_none();
    let Some(kept) = receipt.kept.filter(|kept| whole && is_due(kept, policy)) else {
        return Ok(Thinned::default());
    };
    let captures = here(source, &kept)?;
    let mut thinned = Thinned::default();
    if captures.is_empty() || policy.dry {
        return Ok(counted(&captures));
    }
    let list = store.run_list(&kept.placed.run_sha256).await?;
    let absent = || {
        let path = RunList::path(&kept.placed.run_sha256);
        store.content(
            &path,
            "expected the list of an archived run, found none".to_owned(),
        )
    };
    let list = list.ok_or_else(absent)?;
    let listed: BTreeSet<&str> = list.files.iter().map(|file| file.sha256.as_str()).collect();
    let captures = captures
        .iter()
        .filter(|file| listed.contains(file.sha256.as_str()));
    for some in captures.collect::<Vec<_>>().chunks(AT_ONCE) {
        for file in some {
            let object = layout::object(&file.sha256);
            store.check(&object, &file.hashed()).await?;
        }
        remove(store, source, some, policy)?;
        thinned.files += some.len();
        thinned.bytes += some.iter().map(|file| file.bytes).sum::<u64>();
    }
    settle(receipts, source)?;
    Ok(thinned)
}

fn is_due(kept: &Kept, policy: &ThinPolicy) -> bool {
    kept.finished && policy.unix_s - kept.verified_unix_s >= policy.captures_after_s
}

fn counted(captures: &[FileEntry]) -> Thinned {
    Thinned {
        files: captures.len(),
        bytes: captures.iter().map(|file| file.bytes).sum(),
    }
}

/// Returns the captures in the folder. The folder must match the archived run exactly.
fn here(source: &RunSource, kept: &Kept) -> Result<Vec<FileEntry>, ArchiveError> {
    let within = format!("{CAPTURES}/");
    if !source.folder.join(CAPTURES).is_dir() || source.is_in_use() {
        return Ok(Vec::new());
    }
    let snapshot = source.snapshot(kept.finished)?;
    if snapshot.run_sha256 != kept.placed.run_sha256 {
        return Ok(Vec::new());
    }
    let mut captures = snapshot.files;
    captures
        .retain(|file| file.path.starts_with(&within) && source.folder.join(&file.path).is_file());
    Ok(captures)
}

/// Records that captures are moved, then removes them.
fn remove(
    store: &Store,
    source: &RunSource,
    files: &[&FileEntry],
    policy: &ThinPolicy,
) -> Result<(), ArchiveError> {
    let known = Archived::read(&source.folder).map_err(ArchiveError::Record)?;
    let known = known.map_or_else(Vec::new, |list| list.files);
    let mut moved = Archived::of(store.name());
    let kept = |known: &ArchivedFile| files.iter().all(|file| file.path != known.path);
    moved.files.extend(known.into_iter().filter(kept));
    moved.files.extend(files.iter().map(|file| ArchivedFile {
        path: file.path.clone(),
        sha256: file.sha256.clone(),
        bytes: file.bytes,
        moved_unix_s: policy.unix_s,
    }));
    moved.write(&source.folder)?;
    for file in files {
        let path = source.folder.join(&file.path);
        fs::remove_file(&path).map_err(ArchiveError::io(path, "remove the capture"))?;
    }
    Ok(())
}
