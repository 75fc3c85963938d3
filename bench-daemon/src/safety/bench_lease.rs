//! Lease of a bench during a run: the lock, the latch, and the guardian. Only a bench with
//! instruments outside this process has one.

mod after_crash;

pub(crate) use after_crash::settle_verified;

use std::path::Path;

use instruments::clock::Clock;

use crate::{
    bench::SafeReport,
    config::{self, Experiment},
    executor::ExecuteError,
    operator::progress::Doing,
    safety::failure::Failure,
    safety::guardian::{Charge, GuardianError, Keeper, wait_for_earlier},
    safety::state::{Latched, Lock, OpenFiles, State, StateError},
    support::hash,
    support::terminal::remark,
};

/// Refuses a bench that is latched or run by somebody else, before anything is made for a run, and
/// settles what a run has left that died together with its guardian.
///
/// # Errors
/// [`StateError::Latched`], [`StateError::Busy`]; a bench that cannot be switched off.
pub fn refuse(bench: &config::Bench) -> Result<(), Failure> {
    let Some(state) = State::of(bench)? else {
        return Ok(());
    };
    state.refuse_latched()?;
    state.refuse_busy()?;
    let Some(open) = state.open_run()? else {
        return Ok(());
    };
    let _lock = state.lock(&open.holder.run)?;
    let _no_reader = state.end_reader();
    Clock::runtime(bench.time())?.block_on(async {
        let clock = Clock::start(bench.time());
        settle_earlier(bench, &state, &clock).await
    })
}

/// Handles what an earlier run has left, once its guardian has ended. This may latch the bench.
async fn settle_earlier(
    bench: &config::Bench,
    state: &State,
    clock: &Clock,
) -> Result<(), Failure> {
    wait_for_earlier(state, clock).await?;
    state.refuse_latched()?;
    after_crash::settle(bench, state, clock).await
}

/// A bench that this process runs.
pub struct BenchLease {
    held: Option<HeldBench>,
    clock: Clock,
}

struct HeldBench {
    state: State,
    keeper: Keeper,
    run: std::path::PathBuf,
    doing: Doing,
    open: OpenFiles,
    _locks: [Lock; 2],
}

impl BenchLease {
    /// Locks the bench, refuses a latched one, starts the guardian, and says that outputs may be on
    /// from here on. Nothing was connected to before, and no output is on. The lease is renewed as
    /// long as neither the procedure nor the watch hangs; `clocks` count the waits of each.
    ///
    /// # Errors
    /// A bench that is run by somebody else or latched; a guardian that cannot reach its
    /// instruments.
    pub async fn take(
        experiment: &Experiment,
        run: &Path,
        clocks: [&Clock; 2],
        doing: &Doing,
    ) -> Result<Self, Failure> {
        let limits = &experiment.cell.limits;
        let source = experiment
            .sources
            .iter()
            .find(|source| source.path() == experiment.bench.path);
        let sha256 = source.map_or_else(String::new, |source| hash::sha256(source.text()));
        Self::take_for(
            &Charge {
                bench: &experiment.bench,
                run,
                window_v: (limits.min_v, limits.max_v),
                cell_c: Some((limits.min_c, limits.max_c)),
                sha256,
            },
            clocks,
            doing,
        )
        .await
    }

    /// The same for whatever is written into `charge.run`.
    ///
    /// # Errors
    /// As [`BenchLease::take`].
    pub async fn take_for(
        charge: &Charge<'_>,
        clocks: [&Clock; 2],
        doing: &Doing,
    ) -> Result<Self, Failure> {
        let [clock, _] = clocks;
        let Some(state) = State::of(charge.bench)? else {
            return Ok(Self {
                held: None,
                clock: clock.clone(),
            });
        };
        let run = std::path::absolute(charge.run)?;
        let lock = state.lock(&run)?;
        let no_reader = state.end_reader();
        state.refuse_latched()?;
        settle_earlier(charge.bench, &state, clock).await?;
        let charge = Charge {
            bench: charge.bench,
            run: &run,
            window_v: charge.window_v,
            cell_c: charge.cell_c,
            sha256: charge.sha256.clone(),
        };
        let keeper = Keeper::start(&charge, clocks, doing).await?;
        let open = match state.begin(&run) {
            Ok(open) => open,
            Err(error) => {
                keeper.dismiss(clock).await;
                return Err(error.into());
            }
        };
        Ok(Self {
            held: Some(HeldBench {
                state,
                keeper,
                run,
                doing: doing.clone(),
                open,
                _locks: [lock, no_reader],
            }),
            clock: clock.clone(),
        })
    }

    /// Waits until the guardian is no longer there; for ever where there is none.
    pub async fn lost(&mut self) -> GuardianError {
        match &mut self.held {
            Some(held) => held.keeper.lost().await,
            None => std::future::pending().await,
        }
    }

    /// Gives the bench back: latches it where a person has to look, and dismisses the guardian, or
    /// leaves an unverified safe state to it. The bench's connections must be closed; `read` is what
    /// was read back before that.
    pub async fn end<T>(
        self,
        outcome: Result<T, Failure>,
        read: Option<SafeReport>,
    ) -> Result<T, Failure> {
        let Some(HeldBench {
            state,
            keeper,
            run,
            doing,
            mut open,
            _locks,
        }) = self.held
        else {
            return outcome;
        };
        if let Some(Err(error)) = read.map(|read| state.keep_readings(&read.readings("run"))) {
            tracing::warn!("{error}");
        }
        let mut latched = Ok(());
        if let Some(cause) = outcome.as_ref().err().and_then(latching_cause) {
            latched = state.latch(&cause.during(&run, &doing.now().step));
        }
        if matches!(outcome, Err(Failure::Unsafe { .. })) {
            tracing::warn!(
                "the guardian, process {}, goes on trying; {}",
                keeper.pid(),
                state.path("guardian.log").display()
            );
            keeper.hand_over();
        } else {
            keeper.dismiss(&self.clock).await;
            // A bench that could not be latched stays that of an open run: the next one latches it.
            latched = latched.and_then(|()| state.settled_by(&mut open));
        }
        if let Err(error) = latched {
            remark!("eis-bench: {error}");
            tracing::error!("{error}");
        }
        outcome
    }
}

/// Cause that latches a bench; `None` where the failure does not.
pub(crate) fn latching_cause(failure: &Failure) -> Option<Latched> {
    match failure {
        Failure::Execute(ExecuteError::Trip(trip)) => Some(Latched::of_trip("daemon", trip)),
        Failure::Unsafe { .. } | Failure::Execute(ExecuteError::CellLeftIn { .. }) => {
            Some(Latched::new("daemon", &failure.to_string()))
        }
        _ => None,
    }
}

impl From<StateError> for Failure {
    fn from(error: StateError) -> Self {
        Self::State(error)
    }
}
