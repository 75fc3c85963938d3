//! Retries a run after failures that pass by themselves, such as a late answer or a broken
//! connection. Before each retry the bench is in verified safe state. Then the run goes on as
//! `eis-bench resume` does: every connection is new, every instrument is identified, checked, set
//! and read back. No current flows meanwhile.

use std::{collections::BTreeMap, path::Path};

use instruments::transport::MemoryHub;

use super::{Accepted, Finished, ResumeContext, Session, stop::StopSignals};
use crate::{
    bench::{Bench, BenchError, Connections},
    config::{AutoResume, Experiment},
    executor::ExecuteError,
    journal::{self, Entry},
    operator::run_control::{RunAction, RunControl},
    safety::bench_lease,
    safety::failure::Failure,
    safety::guardian::GuardianError,
    safety::state::{Lock, State},
    support::terminal::remark,
    watch::{Alarm, Pace, Watch, WatchLog},
};

/// Interval at which it looks for a run control request while it waits, s.
const LOOK_S: f64 = 0.5;

/// Longest wait beyond the one of the budget for drives that do not answer in time, s.
const MOST_LONGER_S: f64 = 60.0;

/// How often it may still go on by itself.
#[derive(Debug, Clone, Copy)]
pub(super) struct Budget {
    policy: AutoResume,
    passing: usize,
    others: usize,
    /// Points that were finished when it went on last, when that was, bench s, how often nothing
    /// was done in between, and how often of these it had come so far that an output might have
    /// been on.
    points: usize,
    since_s: f64,
    stalled: usize,
    driven: usize,
}

/// Most retries without progress. A failure that comes again behind an output that was on, with
/// nothing done in between, does not pass.
const MOST_STALLED: usize = 2;
/// The wait before it goes on is doubled so often at most.
const MOST_DOUBLED: usize = 6;
/// A step that takes long is done in part, s.
const DONE_S: f64 = 600.0;

impl Budget {
    pub(super) fn of(policy: AutoResume) -> Self {
        Self {
            policy,
            passing: 0,
            others: 0,
            points: 0,
            since_s: f64::NEG_INFINITY,
            stalled: 0,
            driven: 0,
        }
    }

    /// The wait before it goes on after this failure, with so many points finished at `now_s`, s,
    /// and in words which time it is; none where it does not. What comes again with nothing done in
    /// between does not pass at once: each wait is twice the one before, and behind an output that
    /// was on there is no third. An instrument that was not even reached is waited for as long as
    /// the budget lasts: nothing was switched on.
    fn next(&mut self, failure: &Failure, points: usize, now_s: f64) -> Option<(f64, String)> {
        let moved = points > self.points || now_s - self.since_s > DONE_S;
        (self.stalled, self.driven) = if moved {
            (0, 0)
        } else {
            (
                self.stalled + 1,
                self.driven + usize::from(!unreached(failure)),
            )
        };
        (self.points, self.since_s) = (points, now_s);
        if passes(failure) && self.passing < self.policy.passing && self.driven < MOST_STALLED {
            self.passing += 1;
            let wait_s = self.policy.pause_s * f64::from(1 << self.stalled.min(MOST_DOUBLED));
            return Some((
                wait_s,
                format!(
                    "{} of {} for faults that pass",
                    self.passing, self.policy.passing
                ),
            ));
        }
        if may_pass(failure) && self.others < self.policy.most {
            self.others += 1;
            return Some((
                self.policy.after_s,
                format!("{} of {} by [resume]", self.others, self.policy.most),
            ));
        }
        None
    }
}

/// A fault of the wire or of one answer.
fn passes(failure: &Failure) -> bool {
    match failure {
        Failure::Bench(BenchError::Link { source, .. })
        | Failure::Execute(ExecuteError::Bench(BenchError::Link { source, .. })) => {
            source.may_pass()
        }
        Failure::Execute(ExecuteError::Watch(Alarm::Blind { .. } | Alarm::Slow { .. })) => true,
        // The next guardian connects before anybody else.
        Failure::Guardian(error) => error.may_pass(),
        _ => false,
    }
}

/// It came while the bench was connected to: no output was on by this run since it was verified to
/// be off.
fn unreached(failure: &Failure) -> bool {
    matches!(failure, Failure::Bench(_) | Failure::Guardian(_))
}

/// Decides whether a failure of an instrument may pass with time. No limit of the cell was touched
/// and every output is off. A person, a file, a plan and a control that is wrong do not change by
/// waiting.
fn may_pass(failure: &Failure) -> bool {
    matches!(
        failure,
        Failure::Bench(BenchError::Link { .. })
            // The next guardian does not reach an instrument that is away for longer.
            | Failure::Guardian(GuardianError::Refused(_) | GuardianError::Unreached(_) | GuardianError::Bench(_))
            | Failure::Execute(
                ExecuteError::Bench(BenchError::Link { .. })
                    | ExecuteError::Disobeyed { .. }
                    | ExecuteError::Meddled { .. }
                    | ExecuteError::Disagree { .. }
                    | ExecuteError::Frozen { .. }
                    | ExecuteError::Signal { .. }
                    | ExecuteError::Frame { .. }
            )
    )
}

/// Points that the journal holds.
fn finished_points(folder: &Path) -> usize {
    journal::read(folder).map_or(0, |read| {
        read.lines
            .iter()
            .filter(|line| matches!(line.entry, Entry::Point(_)))
            .count()
    })
}

/// The bench, kept from others; nothing where it is simulated in this process.
fn held(experiment: &Experiment, folder: &Path) -> Result<Option<(State, Lock)>, Failure> {
    let Some(state) = State::of(&experiment.bench)? else {
        return Ok(None);
    };
    let lock = state.lock(&std::path::absolute(folder)?)?;
    Ok(Some((state, lock)))
}

/// A failure between two parts of a run, by which the bench is latched where it must be.
fn latched(failure: Failure, held: Option<&(State, Lock)>, folder: &Path) -> Failure {
    let cause = bench_lease::latching_cause(&failure);
    if let Some(((state, _), cause)) = held.zip(cause)
        && let Err(error) = state.latch(&cause.during(folder, "waiting to go on by itself"))
    {
        remark!("eis-bench: {error}");
    }
    failure
}

impl Session {
    /// Continues a run whose first part ended with `outcome`, where a retry is allowed.
    pub(super) fn resume_by_itself(
        &mut self,
        experiment: &Experiment,
        folder: &Path,
        mut outcome: Result<Finished, Failure>,
        mut stop: StopSignals,
    ) -> Result<Finished, Failure> {
        let mut budget = Budget::of(experiment.auto_resume);
        loop {
            let Err(failure) = &outcome else {
                return outcome;
            };
            let Some((wait_s, which)) = budget.next(failure, finished_points(folder), self.now_s())
            else {
                return outcome;
            };
            // Whoever asks for the end while it waits must find somebody to ask, and nobody else
            // may take the bench or the folder.
            let (Ok(held), Ok(writing)) = (held(experiment, folder), journal::hold(folder)) else {
                return outcome;
            };
            let mut text = format!("went on by itself ({which}) after: {failure}");
            // An output that another program has switched on is not this run's to report as off.
            let outputs = if unreached(failure) {
                "this run has switched nothing on since"
            } else {
                "every output is off"
            };
            remark!(
                "eis-bench: {failure}; {outputs}: going on by itself in {wait_s:.0} s ({which})"
            );
            match self.waited(wait_s, experiment, folder, &mut stop) {
                Ok(Some(remarks)) => {
                    for remark in remarks {
                        text = format!("{text}; {remark}");
                    }
                }
                Ok(None) => return outcome,
                Err(failure) => return Err(latched(failure, held.as_ref(), folder)),
            }
            let free = |_: &Experiment| {
                held.as_ref()
                    .map_or(Ok(()), |(state, _)| Ok(state.refuse_latched()?))
            };
            let (experiment, context) = match ResumeContext::read(folder, Accepted::default(), free)
            {
                // Instruments that did not even answer at the start are not waited for: their
                // addresses may be wrong.
                Ok((_, context)) if !context.has_reached_the_bench() => return outcome,
                Ok(read) => read,
                Err(error) => {
                    remark!("eis-bench: it cannot go on by itself: {error}");
                    return outcome;
                }
            };
            drop((held, writing));
            outcome = self.play(&experiment, folder, Some(context.after(text)));
        }
    }

    /// Waits unless a person wants the run to end, in which case this returns `None`. A watch reads
    /// every meter that answers meanwhile: no current may flow. Returns the remarks of the watch. The
    /// wait ends once the watch sees every drive, for the next part of the run needs all of them; if
    /// it does not, the wait takes a minute longer.
    ///
    /// # Errors
    /// The alarm of the watch. Everything that answers was switched off then.
    fn waited(
        &self,
        wait_s: f64,
        experiment: &Experiment,
        folder: &Path,
        stop: &mut StopSignals,
    ) -> Result<Option<Vec<String>>, Failure> {
        let Some(runtime) = &self.runtime else {
            return Ok(None);
        };
        runtime.block_on(async {
            let connections = Connections {
                clock: self.clock.clone(),
                hub: MemoryHub::new(),
                taps: BTreeMap::new(),
            };
            let mut bench = Bench::unconnected(&experiment.bench, &connections)?;
            let pace = Pace::of(experiment);
            let mut watch = Watch::start_waiting(&bench, pace, &self.clock.apart())?;
            let mut waited = tokio::select! {
                goes_on = self.wait_for_person(wait_s, folder, stop) => Ok(goes_on),
                alarm = Watch::alarm_of(watch.as_mut()) => {
                    Err(Failure::from(ExecuteError::from(alarm)))
                }
            };
            let until_s = self.clock.now_s() + MOST_LONGER_S;
            while let (Ok(true), Some(watch)) = (&waited, watch.as_mut())
                && !watch.sees_every_drive()
                && self.clock.now_s() < until_s
            {
                waited = tokio::select! {
                    goes_on = self.wait_for_person(LOOK_S, folder, stop) => Ok(goes_on),
                    alarm = watch.alarm() => Err(ExecuteError::from(alarm).into()),
                };
            }
            let (alarm, log) = match watch {
                Some(watch) => watch.end(&mut bench).await,
                None => (None, WatchLog::default()),
            };
            // The alarm may have come in the moment in which the wait was over.
            let waited = waited.and_then(|waited| match alarm {
                Some(alarm) => Err(ExecuteError::from(alarm).into()),
                None => Ok(waited),
            });
            match waited {
                Ok(true) if !stop.came().await => Ok(Some(log.remarks)),
                Ok(_) => Ok(None),
                Err(failure) => Failure::unsafe_first(bench.made_safe().await, Err(failure)),
            }
        })
    }

    /// Waits for `wait_s`, or until a person wants the run to end; whether to go on.
    async fn wait_for_person(&self, wait_s: f64, folder: &Path, stop: &mut StopSignals) -> bool {
        let end_s = self.clock.now_s() + wait_s;
        while self.clock.now_s() < end_s {
            if RunControl::read(folder).action == RunAction::Abort {
                return false;
            }
            tokio::select! {
                () = self.clock.sleep_s(LOOK_S.min(wait_s)) => {}
                () = stop.requested() => return false,
            }
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lost() -> BenchError {
        let source = instruments::link::LinkError::Dropped {
            link: "scope".to_owned(),
            why: String::new(),
        };
        BenchError::Link {
            role: "scope",
            model: String::new(),
            source: Box::new(source),
        }
    }

    /// The waits before six attempts; `at` gives finished points and time, s, of each failure.
    fn waits(most: usize, at: impl Fn(usize) -> (Failure, usize, f64)) -> Vec<Option<f64>> {
        let mut budget = Budget::of(AutoResume {
            passing: 5,
            pause_s: 5.0,
            most,
            after_s: 300.0,
        });
        let next = |k| {
            let (failure, points, now_s) = at(k);
            budget
                .next(&failure, points, now_s)
                .map(|(wait_s, _)| wait_s)
        };
        (1..=6).map(next).collect()
    }

    #[test]
    fn what_comes_again_with_nothing_done_in_between_passes_later_or_not_at_all() {
        let driven = || Failure::Execute(ExecuteError::Bench(lost()));
        let five = [Some(5.0), Some(5.0), Some(5.0), Some(5.0), Some(5.0), None];
        // A point each, or ten minutes of a discharge.
        assert_eq!(waits(0, |k| (driven(), k, 20.0 * k as f64)), five);
        assert_eq!(waits(0, |k| (driven(), 0, 700.0 * k as f64)), five);
        assert_eq!(
            waits(0, |k| (driven(), 3, 30.0 * k as f64))[..3],
            [Some(5.0), Some(10.0), None]
        );
        assert_eq!(
            waits(2, |k| (driven(), 3, 30.0 * k as f64)),
            [Some(5.0), Some(10.0), Some(300.0), Some(300.0), None, None]
        );
    }

    #[test]
    fn a_drop_of_two_minutes_is_outlived_where_the_guardian_or_the_daemon_does_not_even_reach_the_bench()
     {
        let growing = [
            Some(5.0),
            Some(10.0),
            Some(20.0),
            Some(40.0),
            Some(80.0),
            None,
        ];
        // The first fault was met while a current flowed.
        let first = |k, other: Failure| {
            if k == 1 {
                Failure::Execute(ExecuteError::Bench(lost()))
            } else {
                other
            }
        };
        let unreached =
            || Failure::Guardian(GuardianError::Unreached("generator: no answer".to_owned()));
        assert_eq!(
            waits(0, |k| (first(k, unreached()), 3, 30.0 * k as f64)),
            growing
        );
        assert_eq!(
            waits(0, |k| (
                first(k, Failure::Bench(lost())),
                3,
                30.0 * k as f64
            )),
            growing
        );
        // What a guardian refuses for another reason does not pass by itself.
        let refused = || Failure::Guardian(GuardianError::Refused("another model".to_owned()));
        assert_eq!(
            waits(0, |k| (first(k, refused()), 3, 30.0 * k as f64))[..2],
            [Some(5.0), None]
        );
    }
}
