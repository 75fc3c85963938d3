//! The lease that a run holds on a bench: lock, latch, and guardian. Only a bench with instruments
//! outside this process needs one.

mod after_crash;

pub use after_crash::settle_verified;

use std::path::Path;

use instruments::clock::Clock;

use crate::{
    bench::SafeReport,
    executor::ExecuteError,
    operator::progress::Doing,
    safety::failure::Failure,
    safety::guardian::{Charge, GuardianError, Keeper, wait_for_earlier},
    safety::state::{Latched, Lock, OpenFiles, State, StateError},
};
use bench_plan::{
    config::{self, Experiment},
    support::{hash, terminal::remark},
};

/// Returns an error if the bench is latched or another process runs it. Call this before creating
/// anything for a run. It also settles an earlier run that died together with its guardian.
///
/// # Errors
/// [`StateError::Latched`], [`StateError::Busy`], or a bench that cannot be switched off.
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

/// Waits for the guardian of an earlier run to end, then settles that run. This may latch the
/// bench.
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
    /// Locks the bench, checks that it is not latched, starts the guardian, and records that
    /// outputs may be on from this point. Call this before connecting to any instrument, while all
    /// outputs are off. The lease is renewed as long as neither the procedure nor the watch hangs;
    /// `clocks` count the waits of each.
    ///
    /// # Errors
    /// Fails if another process runs the bench, if the bench is latched, or if the guardian cannot
    /// reach its instruments.
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
                cell_degc: Some((limits.min_degc, limits.max_degc)),
                sha256,
            },
            clocks,
            doing,
        )
        .await
    }

    /// As [`BenchLease::take`], for any purpose: `charge.run` describes it.
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
            cell_degc: charge.cell_degc,
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

    /// Waits until the guardian process has ended. Never returns without a guardian.
    pub async fn lost(&mut self) -> GuardianError {
        match &mut self.held {
            Some(held) => held.keeper.lost().await,
            None => std::future::pending().await,
        }
    }

    /// Releases the bench. Latches it if a person must inspect it, then dismisses the guardian, or
    /// leaves an unverified safe state to the guardian. The bench's connections must be closed;
    /// `read` is what was read back before they were closed.
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
            // If the latch cannot be written, the run stays open and the next run latches the
            // bench.
            latched = latched.and_then(|()| state.settled_by(&mut open));
        }
        if let Err(error) = latched {
            remark!("eis-bench: {error}");
            tracing::error!("{error}");
        }
        outcome
    }
}

/// Returns the cause that latches the bench, or `None` if the failure does not latch it.
pub fn latching_cause(failure: &Failure) -> Option<Latched> {
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
