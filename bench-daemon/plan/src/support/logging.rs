//! Tracing to the terminal and to the run folder, stamped with bench time, so that two runs in
//! virtual time write equal logs.

use std::{
    fmt,
    fs::File,
    io::{self, IsTerminal, Write},
    path::{Path, PathBuf},
    sync::{Mutex, OnceLock},
};

use instruments::clock::Clock;
use tracing::level_filters::LevelFilter;
use tracing_subscriber::{
    Layer, Registry,
    filter::filter_fn,
    fmt::{format::Writer, time::FormatTime},
    layer::{Filter, SubscriberExt},
    util::SubscriberInitExt,
};

static BENCH_CLOCK: OnceLock<Clock> = OnceLock::new();
static RUN_LOG: Mutex<Option<Box<dyn Write + Send>>> = Mutex::new(None);

/// How much the terminal shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verbosity {
    /// Errors only: the command itself prints what a warning would say.
    Quiet,
    /// Warnings and errors.
    Normal,
    /// Every step.
    Verbose,
    /// Everything.
    Debug,
}

/// Log target of messages about telemetry. They go to the terminal and not into the run folder,
/// whose content must not depend on a collector.
pub const TELEMETRY: &str = "telemetry";

/// Starts logging to the terminal, and to the file of [`log_to`] once there is one; `spans` gets the
/// spans. Once per process.
pub fn start(verbosity: Verbosity, spans: Option<impl Layer<Registry> + Send + Sync + 'static>) {
    let level = match verbosity {
        Verbosity::Quiet => LevelFilter::ERROR,
        Verbosity::Normal => LevelFilter::WARN,
        Verbosity::Verbose => LevelFilter::INFO,
        Verbosity::Debug => LevelFilter::DEBUG,
    };
    let terminal = tracing_subscriber::fmt::layer()
        .with_writer(io::stderr)
        .with_ansi(io::stderr().is_terminal())
        .with_timer(BenchTime)
        .with_target(false)
        .with_filter(lines(level, |_| true));
    let file = tracing_subscriber::fmt::layer()
        .with_writer(|| RunLog)
        .with_timer(BenchTime)
        .with_target(false)
        .with_ansi(false)
        .with_filter(lines(LevelFilter::INFO, |target| target != TELEMETRY));
    // A second start in one process (tests) keeps the first one's subscriber.
    let _ = tracing_subscriber::registry()
        .with(spans)
        .with(terminal)
        .with(file)
        .try_init();
}

/// Lines of a log: events, and no spans, which would stand before every line.
fn lines<S>(level: LevelFilter, of: fn(&str) -> bool) -> impl Filter<S> {
    filter_fn(move |meta| meta.is_event() && *meta.level() <= level && of(meta.target()))
        .with_max_level_hint(level)
}

/// From now on the log goes to this file too, stamped by this clock.
///
/// # Errors
/// A file that cannot be made.
pub fn log_to(path: &Path, clock: &Clock) -> io::Result<()> {
    let _ = BENCH_CLOCK.set(clock.clone());
    let file = File::options().append(true).create(true).open(path)?;
    write_to(file);
    Ok(())
}

/// As [`log_to`], into a file of limited size.
///
/// # Errors
/// As [`log_to`].
pub fn log_to_limited(path: &Path, clock: &Clock) -> io::Result<()> {
    let _ = BENCH_CLOCK.set(clock.clone());
    write_to(Limited::open(path)?);
    Ok(())
}

fn write_to(file: impl Write + Send + 'static) {
    if let Ok(mut log) = RUN_LOG.lock() {
        *log = Some(Box::new(file));
    }
}

/// A file of limited size: a full file is renamed to `.old`, and the previous one is deleted.
pub struct Limited {
    path: PathBuf,
    file: File,
    left: u64,
}

/// Most bytes of a limited file: a day of a guardian's attempts without success.
const MOST_BYTES: u64 = 8 << 20;

impl Limited {
    /// Creates a file, or appends to it.
    ///
    /// # Errors
    /// A file that cannot be opened.
    pub fn open(path: &Path) -> io::Result<Self> {
        let file = File::options().append(true).create(true).open(path)?;
        let left = MOST_BYTES.saturating_sub(file.metadata()?.len());
        Ok(Self {
            path: path.to_owned(),
            file,
            left,
        })
    }
}

impl Write for Limited {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if self.left < bytes.len() as u64 {
            std::fs::rename(&self.path, self.path.with_added_extension("old"))?;
            self.file = File::options().append(true).create(true).open(&self.path)?;
            self.left = MOST_BYTES;
        }
        let written = self.file.write(bytes)?;
        self.left = self.left.saturating_sub(written as u64);
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
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
        match RUN_LOG.lock().as_deref_mut() {
            Ok(Some(file)) => file.write(bytes),
            _ => Ok(bytes.len()),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
