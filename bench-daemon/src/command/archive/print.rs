//! Output of `archive`.

use bench_archive::receipt::Kept;
use serde::Serialize;

use crate::{serve::archive::ArchiveNow, support::terminal::say};

/// Findings of a verification.
#[derive(Debug, Default, Serialize)]
pub(super) struct Verified {
    pub(super) runs: usize,
    pub(super) files: usize,
    pub(super) bytes: u64,
    pub(super) wrong: Vec<String>,
}

/// A run that is in the archive now.
pub(super) fn archived(run: &str, kept: &Kept) {
    let sha256 = &kept.placed.run_sha256;
    say!(
        "{run}: {} files of {} bytes, {} sent, all read back; {sha256}",
        kept.files,
        kept.bytes,
        kept.sent_bytes
    );
    if let Some(before) = &kept.supersedes {
        say!("  in the place of {before}");
    }
}

/// Prints the state of the archive.
pub(super) fn status(now: &ArchiveNow) {
    say!("{}, site {}", now.store, now.site);
    for (words, count) in [
        ("archived", now.archived),
        ("not there yet", now.pending),
        ("failed", now.failed),
        ("refused", now.refused),
        ("not ended", now.waiting),
    ] {
        say!("  {count:>8} runs {words}");
    }
    say!(
        "  {} bytes, of which {} are in the store only",
        now.bytes,
        now.moved_bytes
    );
    for trouble in &now.troubles {
        say!("  {}: {}: {}", trouble.run, trouble.kind, trouble.why);
    }
}

/// Runs that were read back.
pub(super) fn verified(verified: &Verified) {
    let Verified {
        runs,
        files,
        bytes,
        wrong,
    } = verified;
    let told = match wrong.len() {
        0 => "all as they were sent".to_owned(),
        wrong => format!("{wrong} not as they were sent"),
    };
    say!("{runs} runs, {files} files, {bytes} bytes read back: {told}");
    for what in wrong {
        say!("  {what}");
    }
}
