//! `eis-bench config take`: an operator at the machine puts a proposed version of a bench in
//! force.
//!
//! The server stores proposals and does not write bench files, because the guardian and
//! `eis-bench safe` read them. This command writes the file while the bench is not in use, after
//! it has shown the keys that change.

use std::{
    fs,
    io::{BufRead, IsTerminal},
    os::unix::fs::{MetadataExt, PermissionsExt, chown},
    path::{Path, PathBuf},
};

use analysis::dataset::write_private;
use clap::Args;

use bench_core::safety::{
    failure::Failure,
    guardian::GuardianError,
    state::{Lock, State},
};
use bench_plan::{
    config,
    support::{
        account::who,
        terminal::{remark, say},
    },
};
use bench_serve::{
    draft::{self, KeyChange},
    settings::Settings,
    shelf::{self, FileKind, Taking, Version},
};

/// Arguments of `config take`.
#[derive(Debug, Args)]
pub struct TakeArgs {
    /// The file of the server that keeps the proposal.
    #[arg(value_name = "SERVER")]
    server: PathBuf,
    /// Name of the bench.
    bench: String,
    /// Number of the version [default: the proposed one]
    #[arg(long, value_name = "N")]
    version: Option<usize>,
    /// Confirm the changed keys without being asked.
    #[arg(long)]
    yes: bool,
}

/// A version of a bench, and the file in force.
struct Proposal {
    version: Version,
    text: String,
    in_force: String,
}

/// Shows which keys change, and writes the file of the bench after a confirmation.
///
/// # Errors
/// No such version; a text that is wrong; a bench that is in use, latched or not verified off; no
/// confirmation; a file that cannot be written.
pub fn take(args: &TakeArgs) -> Result<(), Failure> {
    let settings = Settings::load(&args.server)?;
    let bench = settings.bench(&args.bench).ok_or_else(|| {
        let names: Vec<&str> = settings
            .benches
            .iter()
            .map(|one| one.name.as_str())
            .collect();
        Failure::Usage(format!(
            "expected a bench of this server ({}), found {:?}",
            names.join(", "),
            args.bench
        ))
    })?;
    let proposal = proposal(&settings, bench, args.version)?;
    if proposal.text == proposal.in_force {
        say!(
            "version {} of {} is in force already",
            proposal.version.version,
            bench.name
        );
        return Ok(());
    }
    draft::check(&settings, FileKind::Benches, &bench.name, &proposal.text).map_err(|mistake| {
        Failure::Usage(format!(
            "version {} of {}: {}",
            proposal.version.version,
            bench.name,
            mistake.in_words()
        ))
    })?;
    show(bench, &proposal);
    refuse_in_use(bench)?;
    if !(args.yes || confirmed()) {
        return Err(Failure::Usage(
            "nothing was changed: expected --yes, or `take` typed on a terminal".to_owned(),
        ));
    }
    put_in_force(&settings, bench, &proposal)?;
    say!(
        "version {} of {} is in force: {}",
        proposal.version.version,
        bench.name,
        bench.path.display()
    );
    say!(
        "a server that runs knows the file as it was, and begins nothing on this bench until it is \
        restarted"
    );
    Ok(())
}

/// Returns the requested version, otherwise the proposed one.
fn proposal(
    settings: &Settings,
    bench: &config::Bench,
    number: Option<usize>,
) -> Result<Proposal, Failure> {
    let missing = |what: &str| Failure::Usage(format!("{}: {what}", bench.name));
    let file = shelf::read(settings, FileKind::Benches, &bench.name, number)?.ok_or_else(|| {
        let number = number.map_or_else(String::new, |number| format!(" {number}"));
        missing(&format!("expected a version{number}, found none"))
    })?;
    let number = number.or(file.proposed).ok_or_else(|| {
        missing(
            "expected a version that is proposed and not in force, found none; --version names \
            another one",
        )
    })?;
    let version = file.versions.iter().find(|one| one.version == number);
    let unreadable = || missing("expected the file in force, found none that can be read");
    Ok(Proposal {
        version: version.cloned().ok_or_else(|| missing("no such version"))?,
        text: file.text,
        in_force: file.original.ok_or_else(unreadable)?,
    })
}

/// Prints the author of the proposal, and every key that changes.
fn show(bench: &config::Bench, proposal: &Proposal) {
    let Version {
        version, by, why, ..
    } = &proposal.version;
    say!(
        "version {version} of {}, by {}: {}",
        bench.name,
        by.escape_debug(),
        why.escape_debug()
    );
    let changes = draft::key_changes(&proposal.in_force, &proposal.text).unwrap_or_default();
    if changes.is_empty() {
        say!("  no key changes: comments, or the order of keys");
    }
    for change in &changes {
        say!("  {}", in_words(change));
    }
}

/// A change in one line, without anything that a terminal would obey.
fn in_words(change: &KeyChange) -> String {
    let plain = |value: &Option<String>| {
        value
            .as_deref()
            .map_or_else(|| "left out".to_owned(), printable)
    };
    format!(
        "{}: {} -> {}",
        printable(&change.key),
        plain(&change.was),
        plain(&change.now)
    )
}

/// Escapes all characters except those that files may contain: characters that reverse the
/// direction of a line could hide what is put in force.
fn printable(text: &str) -> String {
    let is_plain = |c: char| c.is_ascii_graphic() || c == ' ' || "µμΩ°²³·−äöüÄÖÜß".contains(c);
    let plain = |c: char| {
        if is_plain(c) {
            c.to_string()
        } else {
            c.escape_unicode().to_string()
        }
    };
    text.chars().map(plain).collect()
}

/// Refuses a bench that is in use, latched, or left by a run whose outputs have not all been
/// verified off. No guardian can start on it as long as the lock is held.
fn refuse_in_use(bench: &config::Bench) -> Result<Option<Lock>, Failure> {
    let Some(state) = State::of(bench)? else {
        return Ok(None);
    };
    state.refuse_latched()?;
    state.refuse_busy()?;
    let lock = state
        .lock_guardian()?
        .ok_or(Failure::Guardian(GuardianError::Another))?;
    if let Some(open) = state.open_run()? {
        return Err(Failure::Usage(format!(
            "expected a bench that is verified off, found one that {} has left: `eis-bench safe {}` \
            first, with the file in force",
            open.holder.run.display(),
            bench.path.display()
        )));
    }
    Ok(Some(lock))
}

fn confirmed() -> bool {
    if !std::io::stdin().is_terminal() {
        return false;
    }
    remark!("Is the bench wired as this says, and are its limits right? Type `take`:");
    let mut line = String::new();
    std::io::stdin().lock().read_line(&mut line).is_ok() && line.trim() == "take"
}

/// Writes the file while the bench is not in use and no version of it is being written.
fn put_in_force(
    settings: &Settings,
    bench: &config::Bench,
    proposal: &Proposal,
) -> Result<(), Failure> {
    let by = format!("{}, at the machine", who());
    let taking = Taking {
        version: proposal.version.version,
        text: &proposal.text,
        before: &proposal.in_force,
        by: &by,
    };
    // A person may have taken some time to answer.
    let _lock = refuse_in_use(bench)?;
    shelf::take(settings, &bench.name, taking, || -> Result<(), Failure> {
        let path = fs::canonicalize(&bench.path)?;
        if fs::read_to_string(&path)? != proposal.in_force {
            return Err(Failure::Usage(format!(
                "{}: the file was changed meanwhile: nothing was written, begin again",
                path.display()
            )));
        }
        replace(&path, &proposal.text)
    })
}

/// Replaces a file atomically. Its folder, permissions and owner stay, so that every account that
/// could read it still can.
fn replace(path: &Path, text: &str) -> Result<(), Failure> {
    let folder = path.parent().unwrap_or(path);
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let beside = folder.join(format!(".{name}.taken"));
    let was = fs::metadata(path)?;
    let mode = was.permissions().mode() & 0o7777;
    write_private(&beside, text.as_bytes(), mode)
        .map_err(|error| Failure::Usage(error.to_string()))?;
    let put = || -> std::io::Result<()> {
        let is = fs::metadata(&beside)?;
        if (is.uid(), is.gid()) != (was.uid(), was.gid()) {
            chown(&beside, Some(was.uid()), Some(was.gid()))?;
        }
        fs::set_permissions(&beside, was.permissions())?;
        fs::rename(&beside, path)?;
        fs::File::open(folder)?.sync_all()
    };
    put().map_err(|error| {
        // The first failure matters.
        let _ = fs::remove_file(&beside);
        Failure::Usage(format!(
            "{}: cannot be written anew: {error}",
            path.display()
        ))
    })
}
