//! The watch of a bench: reads the meters of everything that can drive a current, and judges values
//! and ages, on a thread and a clock of its own.
//!
//! It begins before the first output may go on and ends when a safe state is about to be verified.
//! In between no step, wait, download or computation delays it: each drive is read at least once a
//! second over a second handle on its connection ([`instruments::link::Link::share`]). Readings of
//! the procedure count as readings of the watch, so that no meter is asked twice.
//!
//! What it finds ([`Alarm`]) ends the run. It takes the connections over, switches everything off
//! and reads it back before the procedure has returned.
//!
//! In virtual time nothing runs beside the procedure, and nothing can be harmed: there the
//! procedure makes the same checks with each of its own readings.

mod alarm;
mod envelope;
mod judge;
mod log;
mod pace;
mod rounds;
mod shared;
mod unwatched;

use std::{
    sync::{Arc, Mutex},
    thread::JoinHandle,
};

use instruments::clock::{Clock, TimeMode};
use tokio::{runtime::Handle, sync::watch};

pub use alarm::Alarm;
pub use envelope::Envelope;
pub use log::WatchLog;
pub use pace::Pace;
pub use unwatched::unwatched;

use crate::bench::{Bench, SafeReport};
use envelope::InForce;
use shared::{Shared, locked};

/// The procedure's end of the watch.
#[derive(Debug, Clone)]
pub struct WatchLink {
    shared: Arc<Shared>,
    clock: Clock,
    settle_s: f64,
}

impl WatchLink {
    /// From now on a step's envelope holds. What held before is allowed until the procedure has
    /// read a current that the step allows, or for a bounded time.
    pub fn allow(&self, envelope: Envelope) {
        let until_s = self.clock.machine_s() + self.settle_s;
        locked(&self.shared.force).change(envelope, until_s);
    }

    /// The procedure has read a current that the present step allows.
    pub fn settle(&self) {
        locked(&self.shared.force).settle();
    }
}

/// A watch at work.
#[derive(Debug)]
pub struct Watch {
    link: WatchLink,
    alarm: watch::Receiver<Option<Alarm>>,
    stop: watch::Sender<bool>,
    thread: JoinHandle<(Bench, Option<SafeReport>)>,
}

impl Watch {
    /// Starts a watch beside a procedure; nothing may flow until [`WatchLink::allow`]. Returns `None`
    /// in virtual time. Must be called inside the runtime of the clock.
    ///
    /// # Errors
    /// The system has no thread.
    pub fn start(bench: &Bench, pace: Pace, clock: &Clock) -> std::io::Result<Option<Self>> {
        Self::begin(bench, pace, clock, false)
    }

    /// As [`Self::start`], for a wait in which no procedure runs. A drive that shows a current is
    /// switched off at once, and judged by its next reading.
    ///
    /// # Errors
    /// The system has no thread.
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

    /// The procedure's end.
    pub fn link(&self) -> WatchLink {
        self.link.clone()
    }

    /// Whether every drive of the bench was read a moment ago, and answers in time.
    pub fn sees_every_drive(&self) -> bool {
        locked(&self.link.shared.log).sees_every_drive
    }

    /// Waits for an alarm. When this returns the watch is already switching everything off.
    pub async fn alarm(&mut self) -> Alarm {
        match self.alarm.wait_for(Option::is_some).await {
            Ok(alarm) => alarm.clone(),
            Err(_) => None,
        }
        .unwrap_or_else(|| Alarm::Lost("its thread has ended".to_owned()))
    }

    /// As [`Self::alarm`]; for ever where there is no watch.
    pub async fn alarm_of(watch: Option<&mut Self>) -> Alarm {
        match watch {
            Some(watch) => watch.alarm().await,
            None => std::future::pending().await,
        }
    }

    /// Ends the watch. If it has raised an alarm, this waits until it has switched everything off;
    /// what it has learnt about outputs that report a wrong state goes to `bench`.
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
