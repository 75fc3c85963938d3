//! Bench time: real, scaled or virtual. This is the only module of the project that reads the
//! machine's clock or sleeps (`clippy.toml` forbids both elsewhere).
//!
//! Bench time is counted in seconds since the clock was created. It runs as fast as the wall clock
//! (`Real`), a fixed factor faster (`Scaled`, for mocks), or jumps ahead as soon as every task is
//! waiting (`Virtual`).
//!
//! The virtual clock is tokio's paused clock. It is exact as long as every stream is in-process,
//! and wrong as soon as a real socket is in flight (tokio issue 4522), so the caller must refuse to
//! combine the two. Its resolution is one millisecond.

use std::{
    collections::BTreeMap,
    fmt,
    future::Future,
    str::FromStr,
    sync::{Arc, Mutex, PoisonError},
    time::Duration,
};

use tokio::time::Instant;

/// How bench time runs against the wall clock.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum TimeMode {
    /// One bench second is one second.
    Real,
    /// `factor` bench seconds pass in one second; for mocks only.
    Scaled(f64),
    /// Time jumps to the next timer as soon as every task waits; in-process mocks only.
    Virtual,
}

/// A time mode that could not be read.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "expected `real`, `virtual` or `scaled:FACTOR` with a factor from 0.01 to 1000, found `{0}`"
)]
pub struct TimeModeError(String);

impl FromStr for TimeMode {
    type Err = TimeModeError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        match text {
            "real" => Ok(Self::Real),
            "virtual" => Ok(Self::Virtual),
            other => other
                .strip_prefix("scaled:")
                .and_then(|factor| factor.parse::<f64>().ok())
                .filter(|factor| (0.01..=1000.0).contains(factor))
                .map(Self::Scaled)
                .ok_or_else(|| TimeModeError(other.to_owned())),
        }
    }
}

impl fmt::Display for TimeMode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Real => write!(f, "real"),
            Self::Scaled(factor) => write!(f, "scaled:{factor}"),
            Self::Virtual => write!(f, "virtual"),
        }
    }
}

/// A wait that ran out before the awaited thing happened.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("no result within {0:?}")]
pub struct Elapsed(pub Duration);

/// Bench time. Cheap to clone; all clones return the same time.
///
/// ```
/// use instruments_link::clock::{Clock, TimeMode};
/// # fn main() -> std::io::Result<()> {
/// let runtime = Clock::runtime(TimeMode::Virtual)?;
/// let now_s = runtime.block_on(async {
///     let clock = Clock::start(TimeMode::Virtual);
///     clock.sleep_s(3600.0).await; // An hour of bench time passes at once.
///     clock.now_s()
/// });
/// assert!((now_s - 3600.0).abs() < 0.01);
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone)]
pub struct Clock {
    mode: TimeMode,
    start: Instant,
    /// Bench time at the start, s.
    origin_s: f64,
    waits: Arc<Mutex<Waits>>,
}

/// Waits of tasks on a clock. They distinguish a task that waits from a task that hangs.
#[derive(Debug, Default)]
struct Waits {
    next: u64,
    /// When each wait is over at the latest; `None` for one without a bound.
    under_way: BTreeMap<u64, Option<Instant>>,
    ended: Option<Instant>,
}

/// Something is being waited for until this is dropped; see [`Clock::overdue_s`].
#[derive(Debug)]
pub struct Wait {
    id: u64,
    waits: Arc<Mutex<Waits>>,
}

impl Drop for Wait {
    fn drop(&mut self) {
        let mut waits = self.waits.lock().unwrap_or_else(PoisonError::into_inner);
        waits.under_way.remove(&self.id);
        waits.ended = Some(instant_now());
    }
}

impl Clock {
    /// Starts a clock at bench time zero. Must be called inside a runtime made by
    /// [`Clock::runtime`] for the same mode.
    pub fn start(mode: TimeMode) -> Self {
        Self::start_at(mode, 0.0)
    }

    /// Starts a clock that continues from another one's bench time, s. Otherwise as
    /// [`Clock::start`].
    pub fn start_at(mode: TimeMode, origin_s: f64) -> Self {
        Self {
            mode,
            start: instant_now(),
            origin_s,
            waits: Arc::default(),
        }
    }

    /// Returns a clock with the same bench time and separate waits, for a task that must not hide
    /// that another one hangs.
    #[must_use]
    pub fn apart(&self) -> Self {
        Self {
            waits: Arc::new(Mutex::new(Waits {
                ended: Some(instant_now()),
                ..Waits::default()
            })),
            ..self.clone()
        }
    }

    /// Announces a wait of at most `at_most` on the wall, or without a bound, until the returned
    /// value is dropped. Sleeps and deadlines announce themselves.
    pub fn wait(&self, at_most: Option<Duration>) -> Wait {
        let mut waits = self.waits.lock().unwrap_or_else(PoisonError::into_inner);
        let id = waits.next;
        waits.next += 1;
        let end = at_most.and_then(|at_most| instant_now().checked_add(at_most));
        waits.under_way.insert(id, end);
        Wait {
            id,
            waits: self.waits.clone(),
        }
    }

    /// Returns the wall-clock seconds since the last wait ended or should have ended, and zero
    /// while a wait is under way within its bound. A task that computes without end, or waits for
    /// an event that never comes, is overdue.
    pub fn overdue_s(&self) -> f64 {
        let waits = self.waits.lock().unwrap_or_else(PoisonError::into_inner);
        if waits.under_way.values().any(Option::is_none) {
            return 0.0;
        }
        let latest = waits
            .under_way
            .values()
            .flatten()
            .copied()
            .chain(waits.ended)
            .max()
            .unwrap_or(self.start);
        instant_now()
            .saturating_duration_since(latest)
            .as_secs_f64()
    }

    /// Seconds on the wall since the start: for what does not run faster in scaled time, the
    /// machine itself and its ports.
    pub fn machine_s(&self) -> f64 {
        instant_now().duration_since(self.start).as_secs_f64()
    }

    /// Stack of a thread that drives instruments, bytes: as much as the main thread has. The futures
    /// of a run nest deep, and an unoptimised build keeps each of them on the stack while it makes
    /// it.
    pub const STACK_BYTES: usize = 8 << 20;

    /// Creates the runtime on which a clock of this mode runs. In virtual time it is paused and
    /// single-threaded, and therefore deterministic. Otherwise a separate thread serves sockets and
    /// timers, so that a task that computes does not delay the others.
    ///
    /// # Errors
    /// The operating system's error if it cannot provide an event queue.
    pub fn runtime(mode: TimeMode) -> std::io::Result<tokio::runtime::Runtime> {
        if mode == TimeMode::Virtual {
            return tokio::runtime::Builder::new_current_thread()
                .enable_all()
                .start_paused(true)
                .build();
        }
        tokio::runtime::Builder::new_multi_thread()
            .worker_threads(1)
            .thread_stack_size(Self::STACK_BYTES)
            .enable_all()
            .build()
    }

    /// Returns the mode with which this clock was started.
    pub fn mode(&self) -> TimeMode {
        self.mode
    }

    /// Returns the bench time, s.
    pub fn now_s(&self) -> f64 {
        let elapsed = self.machine_s();
        self.origin_s
            + match self.mode {
                TimeMode::Scaled(factor) => elapsed * factor,
                TimeMode::Real | TimeMode::Virtual => elapsed,
            }
    }

    /// Waits for `duration` of bench time.
    pub async fn sleep(&self, duration: Duration) {
        let wall = match self.mode {
            TimeMode::Scaled(factor) => duration.div_f64(factor),
            TimeMode::Real | TimeMode::Virtual => duration,
        };
        let _wait = self.wait(Some(wall));
        tokio_sleep(wall).await;
    }

    /// Waits for `seconds` of bench time; nothing for zero, negative and not-a-number.
    pub async fn sleep_s(&self, seconds: f64) {
        if seconds > 0.0 {
            self.sleep(Duration::from_secs_f64(seconds.min(1.0e9)))
                .await;
        }
    }

    /// Awaits `future` for at most `duration` on the wire. Deadlines guard sockets, and sockets do
    /// not run faster in scaled time, so that here a scaled clock counts wall time.
    ///
    /// # Errors
    /// [`Elapsed`] when the time ran out first; the future is dropped then.
    pub async fn deadline<F: Future>(
        &self,
        duration: Duration,
        future: F,
    ) -> Result<F::Output, Elapsed> {
        let _wait = self.wait(Some(duration));
        tokio::time::timeout(duration, future)
            .await
            .map_err(|_| Elapsed(duration))
    }
}

#[expect(
    clippy::disallowed_methods,
    reason = "the one place that may ask for the time"
)]
fn instant_now() -> Instant {
    Instant::now()
}

#[expect(clippy::disallowed_methods, reason = "the one place that may sleep")]
async fn tokio_sleep(duration: Duration) {
    tokio::time::sleep(duration).await;
}

/// Seconds since 1970 by the machine's calendar; for provenance, never for measuring.
#[expect(
    clippy::disallowed_methods,
    reason = "the one place that may ask for the date"
)]
pub fn unix_time_s() -> f64 {
    std::time::SystemTime::now()
        .duration_since(std::time::UNIX_EPOCH)
        .map_or(0.0, |since| since.as_secs_f64())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn virtual_hours_pass_at_once_and_exactly() {
        let runtime = Clock::runtime(TimeMode::Virtual).unwrap();
        let times = runtime.block_on(async {
            let clock = Clock::start(TimeMode::Virtual);
            clock.sleep_s(36_000.0).await;
            let first = clock.now_s();
            clock.sleep_s(0.25).await;
            (first, clock.now_s())
        });
        assert_eq!(times, (36_000.0, 36_000.25));
    }

    #[test]
    fn a_clock_goes_on_from_another_ones_time() {
        let runtime = Clock::runtime(TimeMode::Virtual).unwrap();
        let now_s = runtime.block_on(async {
            let clock = Clock::start_at(TimeMode::Virtual, 120.5);
            clock.sleep_s(2.0).await;
            clock.now_s()
        });
        assert_eq!(now_s, 122.5);
    }

    #[test]
    fn a_scaled_clock_counts_faster_by_its_factor() {
        let runtime = Clock::runtime(TimeMode::Scaled(100.0)).unwrap();
        let now = runtime.block_on(async {
            let clock = Clock::start(TimeMode::Scaled(100.0));
            clock.sleep_s(1.0).await;
            clock.now_s()
        });
        assert!(
            now >= 1.0,
            "one bench second was slept, the clock says {now}"
        );
    }

    #[test]
    fn a_wait_within_its_bound_is_not_overdue_and_one_beyond_it_is() {
        let runtime = Clock::runtime(TimeMode::Virtual).unwrap();
        runtime.block_on(async {
            let clock = Clock::start(TimeMode::Virtual);
            // Time passes on another clock, which the first one does not hear of.
            let other = Clock::start(TimeMode::Virtual);
            other.sleep_s(3.0).await;
            assert_eq!(clock.overdue_s(), 3.0);
            let wait = clock.wait(Some(Duration::from_secs(5)));
            other.sleep_s(4.0).await;
            assert_eq!(clock.overdue_s(), 0.0);
            // A shorter one beside it does not shorten it.
            drop(clock.wait(Some(Duration::from_secs(1))));
            assert_eq!(clock.overdue_s(), 0.0);
            other.sleep_s(3.0).await;
            assert_eq!(clock.overdue_s(), 2.0);
            drop(wait);
            assert_eq!(clock.overdue_s(), 0.0);
            let person = clock.wait(None);
            other.sleep_s(1.0e6).await;
            assert_eq!(clock.overdue_s(), 0.0);
            drop(person);
            clock.sleep_s(2.0).await;
            assert_eq!(clock.overdue_s(), 0.0);
        });
    }

    #[test]
    fn modes_are_read_and_written_alike_and_nonsense_is_named() {
        for text in ["real", "virtual", "scaled:20", "scaled:0.5"] {
            assert_eq!(text.parse::<TimeMode>().unwrap().to_string(), text);
        }
        for text in ["scaled:", "scaled:0", "scaled:NaN", "scaled:1e9", "fast"] {
            let message = text.parse::<TimeMode>().unwrap_err().to_string();
            assert!(
                message.contains(text) && message.contains("scaled:FACTOR"),
                "{message}"
            );
        }
    }
}
