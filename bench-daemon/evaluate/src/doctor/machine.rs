//! Checks of the machine on which the daemon runs: its clock, the folder for data, the disk, the
//! state of the bench.

use std::{fs, io::Write, path::Path};

use instruments::clock::{self, Clock, TimeMode};

use super::{Findings, Texts, Verdict};
use bench_core::{
    safety::failure::Failure,
    safety::guardian::wait_for_earlier,
    safety::state::{State, StateError},
};
use bench_plan::config;

/// Free space that is sufficient for a run, and free space below which a run must not begin,
/// bytes.
const ROOM: (f64, f64) = (2.0e9, 1.0e8);
/// Greatest difference between the clock of the bench and the calendar over a short wait, s.
const DRIFT_S: f64 = 0.05;
const WAIT_S: f64 = 0.5;

/// Returns an error if a process runs the bench, and waits for a guardian that is still switching
/// it off. A query to an instrument empties its error queue, and many instruments accept one
/// client only.
///
/// # Errors
/// [`StateError::Busy`], a guardian that does not finish, or a state that cannot be read.
pub async fn free(config: &config::Bench, clock: &Clock) -> Result<(), Failure> {
    let Some(state) = State::of(config)? else {
        return Ok(());
    };
    state.refuse_busy()?;
    Ok(wait_for_earlier(&state, clock).await?)
}

/// Checks the machine without accessing an instrument.
pub async fn machine(
    findings: &mut Findings,
    config: &config::Bench,
    clock: &Clock,
    folder: &Path,
) {
    calendar(findings, config, clock).await;
    data(findings, folder);
    state(findings, config);
}

async fn calendar(findings: &mut Findings, config: &config::Bench, clock: &Clock) {
    let id = "machine.clock";
    let now_s = clock::unix_time_s();
    let written_s = fs::metadata(&config.path)
        .and_then(|data| data.modified())
        .ok()
        .and_then(|time| time.duration_since(std::time::UNIX_EPOCH).ok())
        .map_or(0.0, |since| since.as_secs_f64());
    let expected =
        "a calendar not before the date of the bench file, that runs as the bench's clock does";
    if now_s + 1.0 < written_s {
        let met = format!("{:.0} s before it", written_s - now_s);
        findings.judge(
            id,
            Texts { expected, met },
            false,
            "set the date of this machine: every record carries it",
        );
        return;
    }
    if clock.mode() == TimeMode::Virtual {
        findings.add(
            id,
            Texts {
                expected,
                met: "a calendar not before it; bench time is virtual",
            },
            Verdict::Ok,
            "",
        );
        return;
    }
    let (machine_s, unix_s) = (clock.machine_s(), clock::unix_time_s());
    clock.sleep_s(WAIT_S).await;
    let apart_s = ((clock::unix_time_s() - unix_s) - (clock.machine_s() - machine_s)).abs();
    let advice = "the calendar of this machine jumps: let one time service set it, and no other";
    findings.judge(
        id,
        Texts {
            expected,
            met: format!("{:.1} ms apart after a moment", 1.0e3 * apart_s),
        },
        apart_s <= DRIFT_S,
        advice,
    );
}

fn data(findings: &mut Findings, folder: &Path) {
    let tried = fs::create_dir_all(folder).and_then(|()| {
        let path = folder.join(".doctor");
        let mut file = fs::File::create(&path)?;
        file.write_all(b"written").and_then(|()| file.sync_all())?;
        let read = fs::read(&path)?;
        fs::remove_file(&path)?;
        if read == b"written" {
            Ok(())
        } else {
            Err(std::io::Error::other(
                "something else was read than was written",
            ))
        }
    });
    let met = tried
        .as_ref()
        .map_or_else(ToString::to_string, |()| "written and read back".to_owned());
    let expected = format!("{} can be written", folder.display());
    findings.judge(
        "machine.folder",
        Texts { expected, met },
        tried.is_ok(),
        "give this account the right to write there, or name another folder",
    );
    if tried.is_err() {
        findings.stop();
        return;
    }
    let Ok(disk) = nix::sys::statvfs::statvfs(folder) else {
        findings.skip(&["machine.disk"], "the system does not report it", "");
        return;
    };
    #[expect(clippy::cast_precision_loss, reason = "gigabytes")]
    let free = disk.blocks_available() as f64 * disk.fragment_size() as f64;
    let verdict = if free >= ROOM.0 {
        Verdict::Ok
    } else if free >= ROOM.1 {
        Verdict::Warn
    } else {
        Verdict::Fail
    };
    let advice = if verdict == Verdict::Ok {
        ""
    } else {
        "make room: every capture is on disk before it is analysed"
    };
    let texts = Texts {
        expected: format!("{:.1} GB free", 1.0e-9 * ROOM.0),
        met: format!("{:.1} GB", 1.0e-9 * free),
    };
    findings.add("machine.disk", texts, verdict, advice);
}

fn state(findings: &mut Findings, config: &config::Bench) {
    let state = match State::of(config) {
        Ok(None) => {
            findings.skip(
                &["bench.free", "bench.latch"],
                "the bench is simulated in this process",
                "",
            );
            return;
        }
        Ok(Some(state)) => state,
        Err(error) => {
            findings.judge(
                "bench.free",
                Texts {
                    expected: "a state folder",
                    met: error.to_string(),
                },
                false,
                "see to the state folder",
            );
            findings.stop();
            return;
        }
    };
    let check = |findings: &mut Findings,
                 id: &str,
                 expected: &str,
                 found: Result<(), StateError>,
                 advice: &str| {
        let met = found
            .as_ref()
            .map_or_else(ToString::to_string, |()| "it is so".to_owned());
        if !findings.judge(id, Texts { expected, met }, found.is_ok(), advice) {
            findings.stop();
        }
    };
    check(
        findings,
        "bench.free",
        "the bench is not in use",
        state.refuse_busy(),
        "wait for that run, or end it with `eis-bench abort`",
    );
    check(
        findings,
        "bench.latch",
        "no latch",
        state.refuse_latched(),
        "look at the bench and the cell, then `eis-bench clear`",
    );
}
