//! `eis-archive thin`: removes captures after reading them back from the store.

use bench_archive::{
    snapshot::RunSource,
    thin::{ThinPolicy, thin},
};
use instruments_link::clock::unix_time_s;

use super::arguments::ThinArgs;
use crate::{failure::Failure, open::Archive, print::print_line};

/// Captures that were moved, or would be moved in a dry run.
#[derive(Debug, Default)]
pub(super) struct Moved {
    files: usize,
    bytes: u64,
    runs: usize,
}

pub(super) async fn thin_runs(args: &ThinArgs) -> Result<(), Failure> {
    let archive = Archive::load(&args.config)?;
    let after_s = args.captures_after_s.or(archive.settings.captures_after_s);
    let Some(captures_after_s) = after_s else {
        return Err(Failure::Usage(
            "thin.captures_after: expected a time, or --captures-after, found neither".to_owned(),
        ));
    };
    let sources = archive.sources(&args.runs)?;
    let moved = move_captures(&archive, &sources, captures_after_s, args.dry_run).await?;
    let words = if args.dry_run {
        "would be moved"
    } else {
        "moved"
    };
    print_line(format_args!(
        "{} captures of {} runs {words} to the archive: {} bytes",
        moved.files, moved.runs, moved.bytes
    ));
    archive.update_status()
}

pub(super) async fn move_captures(
    archive: &Archive,
    sources: &[RunSource],
    captures_after_s: f64,
    dry: bool,
) -> Result<Moved, Failure> {
    let policy = ThinPolicy {
        captures_after_s,
        unix_s: unix_time_s(),
        dry,
    };
    let mut moved = Moved::default();
    for source in sources {
        let thinned = thin(&archive.store, &archive.receipts, source, &policy).await?;
        moved.runs += usize::from(thinned.files > 0);
        moved.files += thinned.files;
        moved.bytes += thinned.bytes;
    }
    Ok(moved)
}
