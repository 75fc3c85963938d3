//! The watch of a bench: reads the meters of every drive, that is, everything that can drive a
//! current, and judges values and ages, on its own thread and clock.
//!
//! It starts before the first output may be switched on and ends immediately before a safe state
//! is verified. In between no step, wait, download or computation delays it: each drive is read at
//! least once a second over a second handle on its connection
//! ([`instruments::link::Link::share`]). Readings of the procedure count as readings of the watch,
//! so that no meter is queried twice.
//!
//! An [`Alarm`] of the watch ends the run. The watch then takes over the connections, switches
//! everything off and reads it back before the procedure has returned.
//!
//! In virtual time nothing runs concurrently with the procedure, and nothing can be harmed: there
//! the procedure makes the same checks with each of its own readings.

mod alarm;
mod envelope;
mod judge;
mod log;
mod pace;
mod rounds;
mod shared;
mod unwatched;

use std::{
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, Ordering},
    },
    thread::JoinHandle,
};

use instruments::{
    clock::{Clock, TimeMode},
    units::Seconds,
};
use tokio::{runtime::Handle, sync::watch};

pub use alarm::Alarm;
pub use envelope::Envelope;
pub use log::WatchLog;
pub use pace::Pace;
pub use unwatched::unwatched;

use crate::{
    bench::{Bench, SafeReport},
    clock::TypedClock,
};
use envelope::InForce;
use shared::{Shared, locked};

/// The procedure's handle on the watch.
#[derive(Debug, Clone)]
pub struct WatchLink {
    shared: Arc<Shared>,
    clock: Clock,
    settle_s: Seconds,
}

impl WatchLink {
    /// Checks whether every drive of the bench was read recently and answers in time.
    pub fn sees_every_drive(&self) -> bool {
        self.shared.sees_every_drive.load(Ordering::Relaxed)
    }

    /// Sets the envelope of a new step. The previous envelope stays allowed until the procedure
    /// has read a current that the new step allows, or for a bounded time.
    pub fn allow(&self, envelope: Envelope) {
        let until_s = self.clock.machine() + self.settle_s;
        locked(&self.shared.force).change(envelope, until_s);
    }

    /// Notifies the watch that the procedure has read a current that the present step allows.
    pub fn settle(&self) {
        locked(&self.shared.force).settle();
    }
}

/// A running watch.
#[derive(Debug)]
pub struct Watch {
    link: WatchLink,
    alarm: watch::Receiver<Option<Alarm>>,
    stop: watch::Sender<bool>,
    thread: JoinHandle<(Bench, Option<SafeReport>)>,
}

impl Watch {
    /// Starts a watch beside a procedure; nothing may flow until [`WatchLink::allow`]. Returns
    /// `None` in virtual time. Must be called inside the runtime of the clock.
    ///
    /// # Errors
    /// Fails if the system cannot start a thread.
    pub fn start(bench: &Bench, pace: Pace, clock: &Clock) -> std::io::Result<Option<Self>> {
        Self::begin(bench, pace, clock, false)
    }

    /// As [`Self::start`], for a wait in which no procedure runs. A drive that shows a current is
    /// switched off at once, and its next reading is judged.
    ///
    /// # Errors
    /// Fails if the system cannot start a thread.
    pub fn start_waiting(
        bench: &Bench,
        pace: Pace,
        clock: &Clock,
    ) -> std::io::Result<Option<Self>> {
        Self::begin(bench, pace, clock, true)
    }

    fn begin(
        bench: &Bench,
        pace: Pace,
        clock: &Clock,
        waits: bool,
    ) -> std::io::Result<Option<Self>> {
        if clock.mode() == TimeMode::Virtual {
            return Ok(None);
        }
        let shared = Arc::new(Shared {
            force: Mutex::new(InForce::new()),
            log: Mutex::new(WatchLog::default()),
            waits,
            sees_every_drive: AtomicBool::new(false),
        });
        let (found, alarm) = watch::channel(None);
        let (stop, stopped) = watch::channel(false);
        let link = WatchLink {
            shared: shared.clone(),
            clock: clock.clone(),
            settle_s: pace.settle_s(),
        };
        let work = rounds::Rounds {
            bench: bench.share(clock),
            shared,
            clock: clock.clone(),
            pace,
        };
        let runtime = Handle::current();
        let thread = std::thread::Builder::new()
            .name("watch".to_owned())
            .stack_size(Clock::STACK_BYTES)
            .spawn(move || runtime.block_on(work.keep(found, stopped)))?;
        Ok(Some(Self {
            link,
            alarm,
            stop,
            thread,
        }))
    }

    /// Returns the procedure's handle.
    pub fn link(&self) -> WatchLink {
        self.link.clone()
    }

    /// Waits for an alarm. When this returns, the watch is already switching everything off.
    pub async fn alarm(&mut self) -> Alarm {
        match self.alarm.wait_for(Option::is_some).await {
            Ok(alarm) => alarm.clone(),
            Err(_) => None,
        }
        .unwrap_or_else(|| Alarm::Lost("its thread has ended".to_owned()))
    }

    /// As [`Self::alarm`]; never returns without a watch.
    pub async fn alarm_of(watch: Option<&mut Self>) -> Alarm {
        match watch {
            Some(watch) => watch.alarm().await,
            None => std::future::pending().await,
        }
    }

    /// Ends the watch. If it has raised an alarm, this waits until it has switched everything off.
    /// Passes on to `bench` which outputs were found to report a wrong state.
    pub async fn end(self, bench: &mut Bench) -> (Option<Alarm>, WatchLog) {
        let _ = self.stop.send(true);
        let thread = self.thread;
        let joined = tokio::task::spawn_blocking(move || thread.join()).await;
        let mut alarm = self.alarm.borrow().clone();
        match joined {
            Ok(Ok((mut own, report))) => {
                own.release_to(bench);
                if let Some(report) = report {
                    tracing::info!("the watch has switched off: {}", report.message);
                }
            }
            Ok(Err(_)) | Err(_) => {
                alarm = alarm.or(Some(Alarm::Lost("it has panicked".to_owned())));
            }
        }
        let log = std::mem::take(&mut *locked(&self.link.shared.log));
        (alarm, log)
    }
}
