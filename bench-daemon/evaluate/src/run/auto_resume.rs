//! Retries a run after transient failures, such as a late answer or a broken connection. Before
//! each retry the bench is in a verified safe state. Then the run is resumed as `eis-bench resume`
//! does: every connection is new, every instrument is identified, checked, set and read back. No
//! current flows in the meantime.

use std::{collections::BTreeMap, path::Path};

use instruments::transport::MemoryHub;

use super::{Accepted, Finished, ResumeContext, Session, stop::StopSignals};
use bench_core::{
    bench::{Bench, BenchError, Connections},
    executor::ExecuteError,
    journal::{self, Entry},
    operator::run_control::{RunAction, RunControl},
    safety::bench_lease,
    safety::failure::Failure,
    safety::guardian::GuardianError,
    safety::state::{Lock, State},
    watch::{Alarm, Pace, Watch, WatchLog},
};
use bench_plan::{
    config::{AutoResume, Experiment},
    support::terminal::remark,
};

/// Interval between checks for a run control request during a wait, s.
const LOOK_S: f64 = 0.5;

/// Longest additional wait for drives that do not answer in time, beyond the wait of the budget,
/// s.
const MOST_LONGER_S: f64 = 60.0;

/// Remaining automatic retries.
#[derive(Debug, Clone, Copy)]
pub(super) struct Budget {
    policy: AutoResume,
    passing: usize,
    others: usize,
    /// State at the last retry: number of finished points, time, bench s, number of retries
    /// without progress, and how many of these came after an output might have been on.
    points: usize,
    since_s: f64,
    stalled: usize,
    driven: usize,
}

/// Most retries without progress. A failure that repeats after an output was on, without any
/// progress, is not transient.
const MOST_STALLED: usize = 2;
/// Greatest number of doublings of the wait before a retry.
const MOST_DOUBLED: usize = 6;
/// Time after which a long step counts as progress, s.
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

    /// Returns the wait before the retry after this failure, with `points` finished points at
    /// `now_s`, s, and a text with the number of the retry; `None` if the run must not be retried.
    /// A failure that repeats without progress is not transient: each wait is twice the previous
    /// one, and after an output was on, the run is not tried a third time. An instrument that was
    /// not reached at all is retried as long as the budget lasts, because nothing was switched on.
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
                wait_s.0,
                format!(
                    "{} of {} for faults that pass",
                    self.passing, self.policy.passing
                ),
            ));
        }
        if may_pass(failure) && self.others < self.policy.most {
            self.others += 1;
            return Some((
                self.policy.after_s.0,
                format!("{} of {} by [resume]", self.others, self.policy.most),
            ));
        }
        None
    }
}

/// Checks whether a failure is a fault of the wire or of a single answer.
fn passes(failure: &Failure) -> bool {
    match failure {
        Failure::Bench(BenchError::Link { source, .. })
        | Failure::Execute(ExecuteError::Bench(BenchError::Link { source, .. })) => {
            source.may_pass()
        }
        Failure::Execute(ExecuteError::Watch(Alarm::Blind { .. } | Alarm::Slow { .. })) => true,
        // The next guardian connects before any other process.
        Failure::Guardian(error) => error.may_pass(),
        _ => false,
    }
}

/// Checks whether the failure occurred while connecting to the bench: this run has switched no
/// output on since the bench was verified to be off.
fn unreached(failure: &Failure) -> bool {
    matches!(failure, Failure::Bench(_) | Failure::Guardian(_))
}

/// Checks whether a failure of an instrument may pass with time. No limit of the cell was exceeded
/// and every output is off. Waiting does not help if the fault is in a person's action, a file, a
/// plan or a control.
fn may_pass(failure: &Failure) -> bool {
    matches!(
        failure,
        Failure::Bench(BenchError::Link { .. })
            // The next guardian cannot reach an instrument that is away for longer.
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

/// Returns the number of points in the journal.
fn finished_points(folder: &Path) -> usize {
    journal::read(folder).map_or(0, |read| {
        read.lines
            .iter()
            .filter(|line| matches!(line.entry, Entry::Point(_)))
            .count()
    })
}

/// Locks the bench; returns nothing if it is simulated in this process.
fn held(experiment: &Experiment, folder: &Path) -> Result<Option<(State, Lock)>, Failure> {
    let Some(state) = State::of(&experiment.bench)? else {
        return Ok(None);
    };
    let lock = state.lock(&std::path::absolute(folder)?)?;
    Ok(Some((state, lock)))
}

/// Latches the bench, if necessary, for a failure between two parts of a run.
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
    /// Continues a run whose first part ended with `outcome`, if a retry is allowed.
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
            // Stop requests must be accepted during the wait, and no other process may take the
            // bench or the folder.
            let (Ok(held), Ok(writing)) = (held(experiment, folder), journal::hold(folder)) else {
                return outcome;
            };
            let mut text = format!("went on by itself ({which}) after: {failure}");
            // An output that another program has switched on is not this run's to report as off.
            let outputs = if unreached(failure) {
                "this run has switched nothing on since"
            } else if experiment.bench.wiring.analog.is_some() {
                "the generator commands zero, and the bipolar supply is not switched"
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
                // Instruments that did not answer at the start are not waited for: their addresses
                // may be wrong.
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

    /// Waits, or returns `None` if a person ends the run. Meanwhile a watch reads every meter that
    /// answers: no current may flow. Returns the remarks of the watch. The wait ends once the
    /// watch sees every drive, because the next part of the run needs all of them; otherwise it
    /// lasts a minute longer.
    ///
    /// # Errors
    /// The alarm of the watch. In that case everything that answers was switched off.
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
            let link = watch.as_ref().map(Watch::link);
            let waiting = async {
                let mut goes_on = self.wait_for_person(wait_s, folder, stop).await;
                let until_s = self.clock.now_s() + MOST_LONGER_S;
                while goes_on
                    && link.as_ref().is_some_and(|link| !link.sees_every_drive())
                    && self.clock.now_s() < until_s
                {
                    goes_on = self.wait_for_person(LOOK_S, folder, stop).await;
                }
                goes_on
            };
            let waited = tokio::select! {
                goes_on = waiting => Ok(goes_on),
                alarm = Watch::alarm_of(watch.as_mut()) => {
                    Err(Failure::from(ExecuteError::from(alarm)))
                }
            };
            let (alarm, log) = match watch {
                Some(watch) => watch.end(&mut bench).await,
                None => (None, WatchLog::default()),
            };
            // The alarm may have occurred at the moment the wait ended.
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

    /// Waits for `wait_s`, or until a person ends the run. Returns whether to continue.
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
    use instruments::units::Seconds;

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

    /// Returns the waits before six attempts; `at` returns finished points and time, s, of each
    /// failure.
    fn waits(most: usize, at: impl Fn(usize) -> (Failure, usize, f64)) -> Vec<Option<f64>> {
        let mut budget = Budget::of(AutoResume {
            passing: 5,
            pause_s: Seconds(5.0),
            most,
            after_s: Seconds(300.0),
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
        // One point each, or ten minutes of a discharge.
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
        // The first fault occurred while a current flowed.
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
        // A refusal of the guardian for another reason is not transient.
        let refused = || Failure::Guardian(GuardianError::Refused("another model".to_owned()));
        assert_eq!(
            waits(0, |k| (first(k, refused()), 3, 30.0 * k as f64))[..2],
            [Some(5.0), None]
        );
    }
}
