//! Tracing to the terminal and to the run folder, stamped with bench time, so that two runs in virtual time write the same log.

use std::{
    fmt,
    fs::File,
    io::{self, IsTerminal, Write},
    path::Path,
    sync::{Arc, Mutex, OnceLock},
};

use instruments::clock::Clock;
use tracing::level_filters::LevelFilter;
use tracing_subscriber::{
    Layer,
    fmt::{format::Writer, time::FormatTime},
    layer::SubscriberExt,
    util::SubscriberInitExt,
};

static BENCH_CLOCK: OnceLock<Clock> = OnceLock::new();
static RUN_LOG: Mutex<Option<Arc<File>>> = Mutex::new(None);

/// How much the terminal shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verbosity {
    /// Warnings and errors.
    Normal,
    /// Every step.
    Verbose,
    /// Everything.
    Debug,
}

/// Starts logging to the terminal, and to the file of [`log_to`] once there is one. Once per process.
pub fn start(verbosity: Verbosity) {
    let level = match verbosity {
        Verbosity::Normal => LevelFilter::WARN,
        Verbosity::Verbose => LevelFilter::INFO,
        Verbosity::Debug => LevelFilter::DEBUG,
    };
    let terminal = tracing_subscriber::fmt::layer()
        .with_writer(io::stderr)
        .with_ansi(io::stderr().is_terminal())
        .with_timer(BenchTime)
        .with_target(false)
        .with_filter(level);
    let file = tracing_subscriber::fmt::layer()
        .with_writer(|| RunLog)
        .with_timer(BenchTime)
        .with_target(false)
        .with_ansi(false)
        .with_filter(LevelFilter::INFO);
    // A second start in one process (tests) keeps the first one's subscriber.
    let _ = tracing_subscriber::registry().with(terminal).with(file).try_init();
}

/// From now on the log goes to this file too, stamped by this clock.
///
/// # Errors
/// A file that cannot be made.
pub fn log_to(path: &Path, clock: &Clock) -> io::Result<()> {
    let _ = BENCH_CLOCK.set(clock.clone());
    let file = File::options().append(true).create(true).open(path)?;
    if let Ok(mut log) = RUN_LOG.lock() {
        *log = Some(Arc::new(file));
    }
    Ok(())
}

/// From now on the log goes to the terminal only.
pub fn log_off() {
    if let Ok(mut log) = RUN_LOG.lock() {
        *log = None;
    }
}

struct BenchTime;

impl FormatTime for BenchTime {
    fn format_time(&self, writer: &mut Writer<'_>) -> fmt::Result {
        match BENCH_CLOCK.get() {
            Some(clock) => write!(writer, "{:>10.3} s", clock.now_s()),
            None => write!(writer, "{:>10} s", "-"),
        }
    }
}

struct RunLog;

impl Write for RunLog {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match RUN_LOG.lock().ok().and_then(|log| log.clone()) {
            Some(file) => (&*file).write(bytes),
            None => Ok(bytes.len()),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
