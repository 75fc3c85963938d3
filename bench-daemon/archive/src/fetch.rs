//! Fetches files from the store: moved captures into their run folder, or a whole run into a new
//! folder.

use std::{
    fs,
    path::{Component, Path, PathBuf},
};

use analysis_files::run_folder::{ARCHIVED, Archived};

use crate::{
    ArchiveError, Store,
    hash::Hashed,
    layout::{self, FileEntry, RunList, is_sha256},
    receipt::{Kept, Receipts},
    snapshot::{ANALYSES, RunSource},
};

/// Result of a fetch.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Fetched {
    /// Number of fetched files.
    pub files: usize,
    /// Their size.
    pub bytes: u64,
}

/// Downloads the moved captures of a run into its folder. Each is put in place once its bytes are
/// verified.
///
/// # Errors
/// [`ArchiveError`]; captures that were restored before the error stay.
pub async fn fetch_moved(
    store: &Store,
    receipts: &Receipts,
    source: &RunSource,
) -> Result<Fetched, ArchiveError> {
    let _lock = receipts.lock()?;
    let mut fetched = Fetched::default();
    let Some(moved) = Archived::read(&source.folder).map_err(ArchiveError::Record)? else {
        return Ok(fetched);
    };
    if moved.store != store.name() && !moved.absent(&source.folder).is_empty() {
        let why = format!(
            "its captures are in {}, found {}",
            moved.store,
            store.name()
        );
        return Err(source.refused(why));
    }
    let partial = receipts.partial()?;
    for file in moved.absent(&source.folder) {
        let wanted = Hashed {
            sha256: file.sha256.clone(),
            bytes: file.bytes,
        };
        let target = within(&source.folder, &file.path).filter(|_| is_sha256(&file.sha256));
        let target = target.ok_or_else(|| {
            let (path, sha256) = (&file.path, &file.sha256);
            source.refused(format!(
                "{ARCHIVED}: expected a path in the run folder and a SHA-256, found {path} and {sha256}"
            ))
        })?;
        let place = partial.join(&file.sha256);
        let object = layout::object(&file.sha256);
        store.fetch(&object, &wanted, &place).await?;
        put(&place, &target)?;
        fetched.files += 1;
        fetched.bytes += file.bytes;
    }
    let list = source.folder.join(ARCHIVED);
    fs::remove_file(&list).map_err(ArchiveError::io(list, "remove the list"))?;
    settle(receipts, source)?;
    Ok(fetched)
}

/// Updates the receipt after captures were moved or restored. Neither changes the identity of the
/// run.
pub(crate) fn settle(receipts: &Receipts, source: &RunSource) -> Result<(), ArchiveError> {
    let mut receipt = receipts.read(&source.name)?;
    let moved = Archived::read(&source.folder).map_err(ArchiveError::Record)?;
    let absent: Vec<u64> = moved
        .iter()
        .flat_map(|list| list.absent(&source.folder))
        .map(|file| file.bytes)
        .collect();
    let Some(kept) = receipt.kept.take() else {
        return Ok(());
    };
    receipt.kept = Some(Kept {
        moved_files: absent.len(),
        moved_bytes: absent.iter().sum(),
        ..kept
    });
    receipts.write(&receipt)
}

/// Downloads a whole run into a new folder. Diagnoses that were stored beside it are written to a
/// second folder, whose name ends in `.analyses`.
///
/// # Errors
/// The folder already exists, or the run is not in the store; [`ArchiveError`].
pub async fn fetch_run(
    store: &Store,
    run_sha256: &str,
    out: &Path,
) -> Result<Fetched, ArchiveError> {
    let path = RunList::path(run_sha256);
    let list = store.run_list(run_sha256).await?;
    let list = list.ok_or_else(|| store.content(&path, "expected a run, found none".to_owned()))?;
    if fs::read_dir(out).is_ok_and(|mut entries| entries.next().is_some()) {
        return Err(ArchiveError::Refused {
            run: list.name,
            why: format!("expected a new folder, found files in {}", out.display()),
        });
    }
    let mut fetched = Fetched::default();
    for file in &list.files {
        let target = target(out, file).ok_or_else(|| {
            let why = format!("expected paths within the run, found {:?}", file.path);
            store.content(&path, why)
        })?;
        folder_of(&target)?;
        let object = layout::object(&file.sha256);
        store.fetch(&object, &file.hashed(), &target).await?;
        fetched.files += 1;
        fetched.bytes += file.bytes;
    }
    Ok(fetched)
}

fn target(out: &Path, file: &FileEntry) -> Option<PathBuf> {
    let beside = file.path.strip_prefix(ANALYSES);
    match beside.and_then(|rest| rest.strip_prefix('/')) {
        Some(rest) => {
            let mut name = out.file_name()?.to_owned();
            name.push(".analyses");
            within(&out.with_file_name(name), rest)
        }
        None => within(out, &file.path),
    }
}

/// Returns a path in a folder, or `None` if it leads out of the folder.
fn within(folder: &Path, path: &str) -> Option<PathBuf> {
    let path = Path::new(path);
    let plain = path
        .components()
        .all(|part| matches!(part, Component::Normal(_)));
    (plain && !path.as_os_str().is_empty()).then(|| folder.join(path))
}

fn folder_of(target: &Path) -> Result<(), ArchiveError> {
    let folder = target.parent().unwrap_or(target);
    fs::create_dir_all(folder).map_err(ArchiveError::io(folder, "make the folder"))
}

/// Moves a complete file to its place.
fn put(file: &Path, target: &Path) -> Result<(), ArchiveError> {
    folder_of(target)?;
    fs::rename(file, target).map_err(ArchiveError::io(target, "put the file in place"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_path_leads_out_of_the_folder() {
        let folder = Path::new("/data/runs/one");
        for path in ["../x", "a/../../x", "/etc/passwd", ""] {
            assert_eq!(within(folder, path), None, "{path}");
        }
        assert_eq!(within(folder, "a/b"), Some(folder.join("a/b")));
        let file = FileEntry {
            path: "analyses/fit-1/diagnosis.json".to_owned(),
            sha256: String::new(),
            bytes: 0,
        };
        let beside = Path::new("/data/runs/one.analyses/fit-1/diagnosis.json");
        assert_eq!(target(folder, &file).as_deref(), Some(beside));
    }
}
