//! `eis-bench safe` without a bench file: switches off every bench that runs or ran on this
//! machine, each in a separate process, all at the same time.

use std::{
    path::Path,
    process::{Command, Output, Stdio},
    thread,
};

use bench_core::safety::{
    failure::Failure,
    state::{KnownBench, known_benches},
};
use bench_plan::support::terminal::{remark, say};

/// How each bench is switched off; see the arguments of `safe`.
pub(super) struct SafeOptions<'a> {
    pub(super) kill: bool,
    pub(super) json: bool,
    pub(super) by: &'a str,
}

/// Exit code of a bench whose file is invalid.
const NOT_LOADED: i32 = 2;

/// Switches off every known bench, and prints the readback of each.
///
/// # Errors
/// [`Failure::Unsafe`] if one of them is not verified or its file no longer exists, or if the
/// list of benches is unknown.
pub(super) fn safe_every(options: &SafeOptions<'_>) -> Result<(), Failure> {
    let known = known_benches().map_err(|error| unverified(&[error.to_string()]))?;
    let known: Vec<KnownBench> = known.into_iter().filter(|known| !is_over(known)).collect();
    if known.is_empty() {
        remark!(
            "no bench is known to run or to have run on this machine by this account: nothing was \
            switched off. Name the bench file: `eis-bench safe BENCH.toml`. For a bench that runs \
            under another account, run this as that account, or name the common state folder in \
            EIS_BENCH_STATE"
        );
        return Err(unverified(&["no bench is known".to_owned()]));
    }
    let mut wrong = Vec::new();
    thread::scope(|scope| {
        let begun: Vec<_> = known
            .iter()
            .map(|known| (known, scope.spawn(|| switch_off(known, options))))
            .collect();
        for (known, work) in begun {
            let ended = work
                .join()
                .unwrap_or_else(|_| Err("the process that switches off was lost".to_owned()));
            if let Err(why) = tell(known, ended, options.json) {
                wrong.push(format!("{} ({}): {why}", known.bench, known.file.display()));
            }
        }
    });
    if wrong.is_empty() {
        Ok(())
    } else {
        Err(unverified(&wrong))
    }
}

fn unverified(wrong: &[String]) -> Failure {
    Failure::Unsafe {
        failures: wrong.join("; "),
        cause: String::new(),
    }
}

/// Mocks that are gone with their file: nothing is left of that bench.
fn is_over(known: &KnownBench) -> bool {
    let is_gone = known.mocked && !known.file.exists();
    if is_gone && let Err(error) = known.forget() {
        tracing::warn!("{error}");
    }
    is_gone
}

/// Switches one bench off.
fn switch_off(known: &KnownBench, options: &SafeOptions<'_>) -> Result<Output, String> {
    if !known.file.exists() {
        let record = known
            .record()
            .map_or_else(|error| error.to_string(), |path| path.display().to_string());
        return Err(format!(
            "its file does not exist any more, so that it cannot be switched off: look at the bench; \
            where it is gone for good, remove {record}"
        ));
    }
    let mut command = Command::new(program());
    command
        .arg("safe")
        .arg(&known.file)
        .args(["--by", options.by]);
    command.args(options.kill.then_some("--kill"));
    command.args(options.json.then_some("--json"));
    command.stdin(Stdio::null());
    command.output().map_err(|error| error.to_string())
}

/// The program that runs, even where its file has been replaced meanwhile.
fn program() -> &'static Path {
    Path::new("/proc/self/exe")
}

/// Prints the readback of a bench.
fn tell(known: &KnownBench, ended: Result<Output, String>, json: bool) -> Result<(), String> {
    if !json {
        say!("{} ({})", known.bench, known.file.display());
    }
    let output = ended.inspect_err(|why| {
        if !json {
            say!("  NOT VERIFIED: {why}");
        }
    })?;
    for line in String::from_utf8_lossy(&output.stdout).lines() {
        say!("{}{line}", if json { "" } else { "  " });
    }
    let errors = String::from_utf8_lossy(&output.stderr).into_owned();
    errors.lines().for_each(|line| remark!("  {line}"));
    let message = || {
        let last = errors
            .lines()
            .rev()
            .find_map(|line| line.strip_prefix("eis-bench: "));
        last.unwrap_or("it did not say why").to_owned()
    };
    match output.status.code() {
        Some(0) => Ok(()),
        Some(NOT_LOADED) => Err(format!("its file is not as expected: {}", message())),
        _ => Err(message()),
    }
}
