//! Bench time. The only module of the project that asks the machine for the time or sleeps (`clippy.toml` forbids it elsewhere).
//!
//! Bench time is counted in seconds since the clock was made. It runs as fast as the wall clock (`Real`), a fixed factor faster (`Scaled`, for
//! mocks), or jumps ahead as soon as nobody has anything left to do (`Virtual`).
//!
//! The virtual clock is tokio's paused clock: exact as long as every stream is in-process, and wrong as soon as a real socket is in flight
//! (tokio issue 4522), so the caller must refuse to combine the two. Its resolution is one millisecond.

use std::{fmt, future::Future, str::FromStr, time::Duration};

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
#[error("expected `real`, `virtual` or `scaled:FACTOR` with a factor from 0.01 to 1000, found `{0}`")]
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

/// Bench time; cheap to clone, all clones agree.
#[derive(Debug, Clone)]
pub struct Clock {
    mode: TimeMode,
    start: Instant,
    /// Bench time at the start, s.
    origin_s: f64,
}

impl Clock {
    /// Starts a clock at bench time zero. Must be called inside a runtime made by [`Clock::runtime`] for the same mode.
    pub fn start(mode: TimeMode) -> Self {
        Self::start_at(mode, 0.0)
    }

    /// Starts a clock that goes on from another one's bench time, s. Otherwise as [`Clock::start`].
    pub fn start_at(mode: TimeMode, origin_s: f64) -> Self {
        Self { mode, start: instant_now(), origin_s }
    }

    /// The single-threaded runtime on which a clock of this mode runs; paused, and so deterministic, when the mode is virtual.
    ///
    /// # Errors
    /// What the operating system says when it cannot give an event queue.
    pub fn runtime(mode: TimeMode) -> std::io::Result<tokio::runtime::Runtime> {
        tokio::runtime::Builder::new_current_thread().enable_all().start_paused(mode == TimeMode::Virtual).build()
    }

    /// The mode that this clock was started with.
    pub fn mode(&self) -> TimeMode {
        self.mode
    }

    /// Bench time, s.
    pub fn now_s(&self) -> f64 {
        let elapsed = instant_now().duration_since(self.start).as_secs_f64();
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
        tokio_sleep(wall).await;
    }

    /// Waits for `seconds` of bench time; nothing for zero, negative and not-a-number.
    pub async fn sleep_s(&self, seconds: f64) {
        if seconds > 0.0 {
            self.sleep(Duration::from_secs_f64(seconds.min(1.0e9))).await;
        }
    }

    /// Awaits `future` for at most `duration` on the wire. Deadlines guard sockets, and sockets do not run faster in scaled time, so that here a
    /// scaled clock counts wall time.
    ///
    /// # Errors
    /// [`Elapsed`] when the time ran out first; the future is dropped then.
    pub async fn deadline<F: Future>(&self, duration: Duration, future: F) -> Result<F::Output, Elapsed> {
        tokio::time::timeout(duration, future).await.map_err(|_| Elapsed(duration))
    }
}

#[expect(clippy::disallowed_methods, reason = "the one place that may ask for the time")]
fn instant_now() -> Instant {
    Instant::now()
}

#[expect(clippy::disallowed_methods, reason = "the one place that may sleep")]
async fn tokio_sleep(duration: Duration) {
    tokio::time::sleep(duration).await;
}

/// Seconds since 1970 by the machine's calendar; for provenance, never for measuring.
#[expect(clippy::disallowed_methods, reason = "the one place that may ask for the date")]
pub fn unix_time_s() -> f64 {
    std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).map_or(0.0, |since| since.as_secs_f64())
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
        assert!(now >= 1.0, "one bench second was slept, the clock says {now}");
    }

    #[test]
    fn modes_are_read_and_written_alike_and_nonsense_is_named() {
        for text in ["real", "virtual", "scaled:20", "scaled:0.5"] {
            assert_eq!(text.parse::<TimeMode>().unwrap().to_string(), text);
        }
        for text in ["scaled:", "scaled:0", "scaled:NaN", "scaled:1e9", "fast"] {
            let message = text.parse::<TimeMode>().unwrap_err().to_string();
            assert!(message.contains(text) && message.contains("scaled:FACTOR"), "{message}");
        }
    }
}
