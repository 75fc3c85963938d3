//! `eis-archive fetch`: brings captures, or a whole run, back.

use bench_archive::{
    fetch::{fetch_moved, fetch_run},
    layout::is_sha256,
};

use super::arguments::FetchArgs;
use crate::{failure::Failure, open::Archive, print::print_line};

pub(super) async fn fetch(args: &FetchArgs) -> Result<(), Failure> {
    let archive = Archive::load(&args.config)?;
    let fetched = match &args.out {
        Some(out) => {
            let run = find_run_hash(&archive, &args.run)?;
            fetch_run(&archive.store, &run, out).await?
        }
        None => {
            let sources = archive.sources(std::slice::from_ref(&args.run))?;
            let unknown = || Failure::Usage(format!("expected a run, found {:?}", args.run));
            let source = sources.first().ok_or_else(unknown)?;
            fetch_moved(&archive.store, &archive.receipts, source).await?
        }
    };
    print_line(format_args!(
        "{}: {} files of {} bytes are back, each with its hash",
        args.run, fetched.files, fetched.bytes
    ));
    archive.update_status()
}

/// Returns the hash of a run of the store, by the hash itself or by the receipt of its name.
fn find_run_hash(archive: &Archive, run: &str) -> Result<String, Failure> {
    if is_sha256(run) {
        return Ok(run.to_owned());
    }
    let receipt = archive.receipts.read(run)?;
    let is_here = receipt.store == archive.store.name();
    let kept = receipt.kept.filter(|_| is_here);
    kept.map(|kept| kept.placed.run_sha256).ok_or_else(|| {
        Failure::Usage(format!(
            "expected an archived run or the SHA-256 of one, found {run:?}"
        ))
    })
}
