//! Settles a bench after a run that died together with its guardian, for example by a reboot:
//! nobody has switched it off. The state of the instruments is reported first, then they are
//! switched off. Where a current may have flowed unwatched, the bench is latched: a person has to
//! look at the cell.

use std::collections::BTreeMap;

use instruments::{clock::Clock, transport::MemoryHub};

use crate::{
    bench::state_readback,
    bench::{Bench, Connections},
    config,
    interlock::NO_CURRENT_A,
    journal::{self, Entry, Line},
    safety::failure::Failure,
    safety::guardian::last_cell_c,
    safety::state::{Latched, OpenRun, State, StateError},
    support::terminal::remark,
};

/// Settles what an earlier run has left; the bench is locked, and no guardian is at work on it.
///
/// # Errors
/// [`crate::safety::state::StateError::Latched`] where a person has to look, [`Failure::Unsafe`] where
/// something cannot be switched off.
pub(super) async fn settle(
    bench: &config::Bench,
    state: &State,
    clock: &Clock,
) -> Result<(), Failure> {
    let Some(open) = state.open_run()? else {
        return Ok(());
    };
    let flowing = match journal::read(&open.holder.run) {
        Ok(read) => flowing(&read.lines),
        // Nobody knows what it was doing.
        Err(error) => Some(format!("(unknown: {error})")),
    };
    let connections = Connections {
        clock: clock.clone(),
        hub: MemoryHub::new(),
        taps: BTreeMap::new(),
    };
    let mut bench = Bench::unconnected(bench, &connections)?;
    let found = state_readback::look_each(&mut bench).await;
    let quiet = found.iter().all(|found| {
        found
            .as_ref()
            .is_ok_and(|found| found.off && found.amps.unwrap_or(0.0).abs() <= NO_CURRENT_A)
    });
    // A bath moves no charge: what it does is told, and judged by nobody but the reader.
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
    let text = format!("{}; {}", died(&open), listed.join("; "));
    if quiet && flowing.is_none() {
        // It died while nothing was on.
        remark!("eis-bench: {text}");
        tracing::warn!("{text}");
        return Ok(state.settle(&open)?);
    }
    let switched = bench.safe_state().await;
    let bath = bench.bath(last_cell_c(state)).await;
    let switched = switched.with_bath(bath);
    let outcome = if switched.verified {
        "now every output is off and read back".to_owned()
    } else {
        format!("NOT SWITCHED OFF: {}", switched.message)
    };
    let bath = switched
        .bath
        .as_ref()
        .map_or_else(String::new, |bath| format!("; {bath}"));
    let cause = format!("{text}{bath}; {outcome}: a current that nobody watched may have flowed");
    remark!("eis-bench: {cause}");
    let step = flowing.unwrap_or_default();
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

/// Settles what an earlier run has left after a person has switched everything off, and that was
/// verified: as [`settle`], without looking once more.
///
/// # Errors
/// A file that cannot be written.
pub(crate) fn settle_verified(state: &State) -> Result<(), StateError> {
    let Some(open) = state.open_run()? else {
        return Ok(());
    };
    // Whoever has the bench, or is at work on it, settles it himself.
    let (Ok(_lock), Some(_guardian)) = (state.lock(&open.holder.run), state.lock_guardian()?)
    else {
        return Ok(());
    };
    let flowing = journal::read(&open.holder.run).map_or_else(
        |error| Some(format!("(unknown: {error})")),
        |read| flowing(&read.lines),
    );
    if let Some(step) = flowing {
        let cause = format!(
            "{}; now every output is off and read back: a current that nobody watched may have \
            flowed",
            died(&open)
        );
        remark!("eis-bench: {cause}");
        state.latch_with(
            &Latched::new("safe", &cause).during(&open.holder.run, &step),
            &open,
        )?;
    }
    state.settle(&open)
}

fn died(open: &OpenRun) -> String {
    let file = open.holder.file.display();
    format!(
        "process {} on {file} died, and so did its guardian: nobody has switched off after it",
        open.holder.pid
    )
}

/// The step in which a current may have flowed when the journal ended; none where every output was
/// off.
fn flowing(lines: &[Line]) -> Option<String> {
    lines.iter().fold(None, |flowing, line| match &line.entry {
        Entry::Intent {
            live: true, text, ..
        } => Some(text.clone()),
        // What needs no current needs every output off.
        Entry::Intent { live: false, .. }
        | Entry::StageDone { .. }
        | Entry::Safe
        | Entry::Started(_) => None,
        // What was powered before the pause is powered again.
        Entry::GoneOn => Some("going on after a pause".to_owned()),
        _ => flowing,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::journal::Note;

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
            // The output stays on when the step that has switched it on is done.
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
            // Ended without safe state.
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
                    time_s: 0.0,
                    entry,
                })
                .collect();
            assert_eq!(flowing(&lines).as_deref(), expected, "{lines:?}");
        }
    }
}
