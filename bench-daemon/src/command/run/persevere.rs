//! A run that goes on by itself after what passes by itself: an answer that came late, a connection that broke. Each time the bench was in safe state,
//! verified, before it goes on as `eis-bench resume` does: every connection is new, every instrument is identified, looked at, set and read back. No
//! current flows meanwhile.

use std::path::Path;

use super::{Finished, Past, Session, stop::StopSignals};
use crate::{
    bench::BenchError,
    command::Failure,
    config::{Experiment, Perseverance},
    custody,
    executor::ExecuteError,
    terminal::remark,
    wishes::{Course, Wishes},
};

/// How often a wish to end is looked for while it waits, s.
const LOOK_S: f64 = 0.5;

/// How often it may still go on by itself.
#[derive(Debug, Clone, Copy)]
pub(super) struct Budget {
    policy: Perseverance,
    passing: usize,
    others: usize,
    /// Points that were finished when it went on last, when that was, bench s, and how often nothing was done in between.
    points: usize,
    since_s: f64,
    stalled: usize,
}

/// What comes again and again with nothing done in between does not pass.
const MOST_STALLED: usize = 2;
/// A step that takes long is done in part, s.
const DONE_S: f64 = 600.0;

impl Budget {
    pub(super) fn of(policy: Perseverance) -> Self {
        Self { policy, passing: 0, others: 0, points: 0, since_s: f64::NEG_INFINITY, stalled: 0 }
    }

    /// Whether anything was done since it went on last, or that was tried less often than `MOST_STALLED`.
    fn moves(&mut self, points: usize, now_s: f64) -> bool {
        let moved = points > self.points || now_s - self.since_s > DONE_S;
        self.stalled = if moved { 0 } else { self.stalled + 1 };
        (self.points, self.since_s) = (points, now_s);
        self.stalled < MOST_STALLED
    }

    /// The wait before it goes on after this failure, s, and in words which time it is; none where it does not.
    fn next(&mut self, failure: &Failure) -> Option<(f64, String)> {
        if passes(failure) && self.passing < self.policy.passing {
            self.passing += 1;
            return Some((self.policy.pause_s, format!("{} of {} for faults that pass", self.passing, self.policy.passing)));
        }
        if may_pass(failure) && self.others < self.policy.most {
            self.others += 1;
            return Some((self.policy.after_s, format!("{} of {} by [resume]", self.others, self.policy.most)));
        }
        None
    }
}

/// A fault of the wire or of one answer.
fn passes(failure: &Failure) -> bool {
    let (Failure::Bench(BenchError::Link { source, .. }) | Failure::Execute(ExecuteError::Bench(BenchError::Link { source, .. }))) =
        failure
    else {
        return false;
    };
    source.may_pass()
}

/// Whatever an instrument did, as long as no limit of the cell was touched and every output is off. A person, a file, a plan and a control that is wrong do not
/// change by waiting.
fn may_pass(failure: &Failure) -> bool {
    matches!(
        failure,
        Failure::Bench(BenchError::Link { .. })
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

impl Session {
    /// What becomes of a run whose first part ended so.
    pub(super) fn persevere(
        &mut self,
        (experiment, folder): (&Experiment, &Path),
        mut outcome: Result<Finished, Failure>,
    ) -> Result<Finished, Failure> {
        let mut budget = Budget::of(experiment.perseverance);
        loop {
            let Err(failure) = &outcome else { return outcome };
            let Some((wait_s, which)) = budget.next(failure) else { return outcome };
            let text = format!("went on by itself ({which}) after: {failure}");
            remark!("eis-bench: {failure}; every output is off: going on by itself in {wait_s:.0} s ({which})");
            if !self.waited(wait_s, folder)? {
                return outcome;
            }
            let (experiment, past) = match Past::read(folder, false, |experiment| custody::refuse(&experiment.bench)) {
                Ok(read) => read,
                Err(stuck) => {
                    remark!("eis-bench: it cannot go on by itself: {stuck}");
                    return outcome;
                }
            };
            if !budget.moves(past.points(), self.now_s()) {
                remark!("eis-bench: nothing was done since it went on by itself the last times: it does not go on again");
                return outcome;
            }
            outcome = self.play(&experiment, folder, Some(past.after(text)));
        }
    }

    /// Waits unless a person wants the run to end; whether to go on.
    fn waited(&self, wait_s: f64, folder: &Path) -> Result<bool, Failure> {
        let Some(runtime) = &self.runtime else { return Ok(false) };
        runtime.block_on(async {
            let mut stop = StopSignals::install()?;
            let end_s = self.clock.now_s() + wait_s;
            while self.clock.now_s() < end_s {
                if Wishes::read(folder).course == Course::Abort {
                    return Ok(false);
                }
                tokio::select! {
                    () = self.clock.sleep_s(LOOK_S.min(wait_s)) => {}
                    () = stop.requested() => return Ok(false),
                }
            }
            Ok(true)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_comes_again_with_nothing_done_in_between_ends_the_run_before_the_budget_does() {
        let budget = || Budget::of(Perseverance { passing: 5, pause_s: 5.0, most: 0, after_s: 0.0 });
        // A point each, or ten minutes of a discharge: all five.
        let mut sweeping = budget();
        assert!((1..=5).all(|points| sweeping.moves(points, 20.0 * points as f64)));
        let mut discharging = budget();
        assert!((1..=5).all(|time| discharging.moves(0, 700.0 * f64::from(time))));
        let mut stuck = budget();
        assert_eq!([10.0, 40.0, 70.0].map(|now_s| stuck.moves(3, now_s)), [true, true, false]);
    }
}
