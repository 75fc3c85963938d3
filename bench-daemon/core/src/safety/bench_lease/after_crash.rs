//! Settles a bench after a run that left no record of its end, for example after a reboot. Reports
//! what the records show about the end of the run, then the state of the instruments, and then
//! switches the instruments off. If a current may have flowed unwatched, the bench is latched: a
//! person must inspect the cell.

use std::collections::BTreeMap;

use instruments::{
    clock::{self, Clock},
    transport::MemoryHub,
};

use crate::{
    bench::outputs::{OutputReading, OutputsState},
    bench::state_readback::{self, InstrumentReadback},
    bench::{Bench, Connections},
    journal::{self, Entry, Line},
    safety::failure::Failure,
    safety::guardian::{Report, last_cell_degc},
    safety::state::{Latched, OpenRun, State, StateError},
};
use bench_plan::{config, support::terminal::remark};

/// Settles an earlier run. The bench must be locked and no guardian may be working on it.
///
/// # Errors
/// [`crate::safety::state::StateError::Latched`] if a person must inspect the cell, or
/// [`Failure::Unsafe`] if an instrument cannot be switched off.
pub(super) async fn settle(
    bench: &config::Bench,
    state: &State,
    clock: &Clock,
) -> Result<(), Failure> {
    let Some(open) = state.open_run()? else {
        return Ok(());
    };
    let end = RunEnd::read(state, &open);
    let connections = Connections {
        clock: clock.clone(),
        hub: MemoryHub::new(),
        taps: BTreeMap::new(),
    };
    let mut bench = Bench::unconnected(bench, &connections)?;
    let found = state_readback::look_each(&mut bench).await;
    let quiet = found
        .iter()
        .all(|found| found.as_ref().is_ok_and(InstrumentReadback::is_quiet));
    keep(state, &state_readback::readings(&bench, &found, NEXT_RUN));
    // A bath moves no charge: its state is reported but not judged.
    let bath = state_readback::look_bath(&mut bench).await;
    let listed: Vec<String> = found
        .iter()
        .chain(&bath)
        .map(|found| {
            found
                .as_ref()
                .map_or_else(|error| format!("not reached: {error}"), ToString::to_string)
        })
        .collect();
    let text = format!("{}; {}", end.words, listed.join("; "));
    if quiet && end.flowing.is_none() {
        // The process died while all outputs were off.
        remark!("eis-bench: {text}");
        tracing::warn!("{text}");
        return Ok(state.settle(&open)?);
    }
    let switched = bench.safe_state().await;
    let bath = bench.bath(last_cell_degc(state)).await;
    let switched = switched.with_bath(bath);
    keep(state, &switched.readings(NEXT_RUN));
    let outcome = if switched.verified {
        format!("now {}", switched.read)
    } else {
        format!("NOT SWITCHED OFF: {}", switched.message)
    };
    let bath = switched
        .bath
        .as_ref()
        .map_or_else(String::new, |bath| format!("; {bath}"));
    let cause = format!("{text}{bath}; {outcome}: {UNWATCHED}");
    remark!("eis-bench: {cause}");
    let step = end.flowing.unwrap_or_default();
    state.latch_with(
        &Latched::new("daemon", &cause).during(&open.holder.run, &step),
        &open,
    )?;
    if !switched.verified {
        return Err(Failure::Unsafe {
            failures: cause,
            cause: String::new(),
        });
    }
    state.settle(&open)?;
    Ok(state.refuse_latched()?)
}

/// Settles an earlier run after a person has switched everything off and that was verified. Works
/// as `settle`, but does not query the instruments again.
///
/// # Errors
/// Fails if a file cannot be written.
pub fn settle_verified(state: &State) -> Result<(), StateError> {
    let Some(open) = state.open_run()? else {
        return Ok(());
    };
    // The process that holds the bench, or works on it, settles the run.
    let (Ok(_lock), Some(_guardian)) = (state.lock(&open.holder.run), state.lock_guardian()?)
    else {
        return Ok(());
    };
    let end = RunEnd::read(state, &open);
    if let Some(step) = end.flowing {
        let cause = format!("{}; now {}: {UNWATCHED}", end.words, state.outputs().words);
        remark!("eis-bench: {cause}");
        state.latch_with(
            &Latched::new("safe", &cause).during(&open.holder.run, &step),
            &open,
        )?;
    }
    state.settle(&open)
}

/// Reader name for readings that are taken before a run begins.
const NEXT_RUN: &str = "next run";
const UNWATCHED: &str = "a current may have flowed unwatched";

/// Stores the readings. Ignores write errors.
fn keep(state: &State, readings: &[OutputReading]) {
    if let Err(error) = state.keep_readings(readings) {
        tracing::warn!("{error}");
    }
}

/// What the records of an open run show about its end.
struct RunEnd {
    /// Text that names the process that read back the outputs, or states that they are unknown.
    words: String,
    /// The step in which a current may have flowed when the journal ended. `None` if every output
    /// was off at that time or was read back as off since.
    flowing: Option<String>,
}

impl RunEnd {
    fn read(state: &State, open: &OpenRun) -> Self {
        let process = format!(
            "process {} on {}",
            open.holder.pid,
            open.holder.file.display()
        );
        let verified = Report::read(state).filter(|report| report.has_verified(&open.holder.run));
        if let Some((report, safe)) = verified.and_then(|report| {
            let safe = report.safe.clone()?;
            Some((report, safe))
        }) {
            let readings = safe.readings("guardian");
            // Reports of older guardians do not contain the time of the reading.
            let read = if readings.is_empty() {
                safe.message
            } else {
                OutputsState::read_earlier(&readings, clock::unix_time_s()).words
            };
            return Self {
                words: format!(
                    "{process} died; its guardian, process {}: {read}",
                    report.pid
                ),
                flowing: None,
            };
        }
        let journal = journal::read(&open.holder.run);
        let ended = journal.as_ref().ok().and_then(|read| ended(&read.lines));
        let words = match ended {
            Some(how) => format!(
                "process {} ended its run ({how}) and could not write down what it read back of \
                the outputs: {}",
                open.holder.pid,
                open.holder.file.display()
            ),
            None => format!(
                "{process} died, and so did its guardian: whether they switched off is not known"
            ),
        };
        Self {
            words,
            flowing: match journal {
                Ok(read) => flowing(&read.lines),
                Err(error) => Some(format!("(unknown: {error})")),
            },
        }
    }
}

/// Returns how the run of a journal ended, if its process recorded that.
fn ended(lines: &[Line]) -> Option<&str> {
    lines.iter().rev().find_map(|line| match &line.entry {
        Entry::Ended { how } => Some(Some(how.as_str())),
        Entry::Safe | Entry::Note(_) => None,
        _ => Some(None),
    })?
}

/// Returns the step in which a current may have flowed when the journal ended, or `None` if every
/// output was off.
fn flowing(lines: &[Line]) -> Option<String> {
    lines.iter().fold(None, |flowing, line| match &line.entry {
        Entry::Intent {
            live: true, text, ..
        } => Some(text.clone()),
        // A step that needs no current requires every output to be off.
        Entry::Intent { live: false, .. }
        | Entry::StageDone { .. }
        | Entry::Safe
        | Entry::Started(_) => None,
        // Outputs that were on before the pause are switched on again.
        Entry::GoneOn => Some("going on after a pause".to_owned()),
        _ => flowing,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::journal::Note;
    use instruments::units::Seconds;

    #[test]
    fn a_current_may_flow_from_the_intent_until_something_says_that_everything_is_off() {
        let intent = |live, text: &str| Entry::Intent {
            stage: 0,
            step: 0,
            text: text.to_owned(),
            live,
        };
        let found = |text: &str| Entry::Note(Note::of(text));
        let done = Entry::Done { stage: 0, step: 0 };
        for (entries, expected) in [
            (vec![], None),
            (vec![intent(false, "mount"), done.clone()], None),
            (vec![Entry::Safe, intent(true, "up")], Some("up")),
            // The output stays on after the step that switched it on has ended.
            (
                vec![
                    intent(true, "up"),
                    done.clone(),
                    intent(true, "point"),
                    done.clone(),
                    found("odd"),
                ],
                Some("point"),
            ),
            (
                vec![intent(true, "down"), done.clone(), intent(false, "rest")],
                None,
            ),
            (
                vec![intent(true, "down"), done, Entry::StageDone { stage: 0 }],
                None,
            ),
            (
                vec![intent(true, "point"), Entry::Safe, Entry::Paused],
                None,
            ),
            (
                vec![
                    intent(true, "point"),
                    Entry::Safe,
                    Entry::Paused,
                    Entry::GoneOn,
                ],
                Some("going on after a pause"),
            ),
            // The run ended without a safe state.
            (
                vec![
                    intent(true, "point"),
                    Entry::Ended {
                        how: "ended early".to_owned(),
                    },
                ],
                Some("point"),
            ),
        ] {
            let lines: Vec<Line> = entries
                .into_iter()
                .enumerate()
                .map(|(at, entry)| Line {
                    number: at as u64 + 1,
                    time_s: Seconds(0.0),
                    entry,
                })
                .collect();
            assert_eq!(flowing(&lines).as_deref(), expected, "{lines:?}");
        }
    }
}
