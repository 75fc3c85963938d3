//! Progress for the person at the terminal: a bar with the time left.

use std::{
    cell::Cell,
    io::IsTerminal,
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
    time::Duration,
};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use instruments::fixture::Fixture;

use bench_plan::{
    plan::{Plan, Step},
    support::terminal::remark,
};

/// Environment variable; if it is set, the content of a terminal's status line is written as
/// separate lines, each after [`PROGRESS_LINE`], for a program that displays it.
pub const PROGRESS_VARIABLE: &str = "EIS_BENCH_PROGRESS";
/// Prefix of such a line.
pub const PROGRESS_LINE: &str = "progress: ";

/// Time between two drawings of the line, which shows the elapsed time.
const TICK: Duration = Duration::from_millis(200);

/// A line on a terminal's standard error that shows what a computation is doing, and since when.
pub struct Waiting {
    bar: ProgressBar,
    lines: bool,
}

/// Shows a text on the line.
fn put(bar: &ProgressBar, lines: bool, words: String) {
    if lines {
        remark!("{PROGRESS_LINE}{words}");
    }
    bar.set_message(words);
}

impl Waiting {
    /// Shows the line on a terminal only, or with [`PROGRESS_VARIABLE`].
    pub fn shown() -> Self {
        let bar = ProgressBar::with_draw_target(None, ProgressDrawTarget::stderr_with_hz(10));
        if let Ok(style) = ProgressStyle::with_template("{elapsed:>4}  {msg}") {
            bar.set_style(style);
        }
        bar.enable_steady_tick(TICK);
        Self {
            bar,
            lines: std::env::var_os(PROGRESS_VARIABLE).is_some(),
        }
    }

    /// Shows the line with a first text.
    pub fn on(step: impl Into<String>) -> Self {
        let waiting = Self::shown();
        waiting.say(step);
        waiting
    }

    /// Shows a text on the line.
    pub fn say(&self, step: impl Into<String>) {
        put(&self.bar, self.lines, step.into());
    }

    /// Returns a function that shows a text on the line.
    pub fn listener(&self) -> impl Fn(&str) + Send + Sync + use<> {
        let (bar, lines) = (self.bar.clone(), self.lines);
        move |step| put(&bar, lines, step.to_owned())
    }

    /// Returns a counter of finished items, for use from any thread.
    pub fn counter(&self, of: u64, what: &str) -> impl Fn() + Sync + use<> {
        let (bar, lines) = (self.bar.clone(), self.lines);
        let (what, done) = (what.to_owned(), AtomicU64::new(0));
        move || {
            let done = done.fetch_add(1, Ordering::Relaxed) + 1;
            put(&bar, lines, format!("{what}: {done} of {of}"));
        }
    }

    /// Clears the line, as its drop does.
    pub fn end(self) {}
}

impl Drop for Waiting {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}

/// Seconds between two progress lines without a terminal.
const QUIET_S: u64 = 10;
/// Number of ticks for a share of 1.
const WHOLE: u64 = 10_000;

/// Progress through many items, with the time left.
pub struct Share {
    bar: ProgressBar,
    terminal: bool,
    printed_s: Cell<u64>,
}

impl Share {
    /// Shows a bar on standard error; without a terminal, occasional lines.
    pub fn shown() -> Self {
        let terminal = std::io::stderr().is_terminal();
        let bar =
            ProgressBar::with_draw_target(Some(WHOLE), ProgressDrawTarget::stderr_with_hz(10));
        if let Ok(style) =
            ProgressStyle::with_template("{bar:30} {percent:>3} %  left {eta:>4}  {msg}")
        {
            bar.set_style(style);
        }
        Self {
            bar,
            terminal,
            printed_s: Cell::new(0),
        }
    }

    /// Sets the finished share, and its description.
    pub fn at(&self, share: f64, done: &str) {
        self.bar.set_position((share * WHOLE as f64) as u64);
        self.bar.set_message(done.to_owned());
        let elapsed_s = self.bar.elapsed().as_secs();
        if !self.terminal && elapsed_s >= self.printed_s.get() + QUIET_S {
            self.printed_s.set(elapsed_s);
            let left_s = elapsed_s as f64 * (1.0 - share) / share.max(f64::EPSILON);
            remark!("{done}, {:.0} %, about {left_s:.0} s left", 100.0 * share);
        }
    }

    /// Clears the bar.
    pub fn end(self) {
        self.bar.finish_and_clear();
    }
}

/// Progress through a plan, by expected bench time.
#[derive(Debug)]
pub struct Progress {
    bar: ProgressBar,
    terminal: bool,
    stage: Cell<u64>,
    doing: Doing,
}

/// Present action of the run; clones share it, also across threads.
#[derive(Debug, Clone, Default)]
pub struct Doing(Arc<Mutex<Now>>);

/// The present step.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Now {
    /// Text; empty before the first step.
    pub step: String,
    /// Fixture in the jig, if known.
    pub fixture: Option<Fixture>,
    /// Set-point at which this run has started a bath that closes its own loop, °C.
    pub bath_degc: Option<f64>,
}

impl Doing {
    /// Returns the present action.
    pub fn now(&self) -> Now {
        self.0
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clone()
    }

    fn set(&self, change: impl FnOnce(&mut Now)) {
        change(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner));
    }
}

impl Progress {
    /// Shows a bar on standard error for a plan; without a terminal, one line per stage instead.
    pub fn new(plan: &Plan) -> Self {
        let terminal = std::io::stderr().is_terminal();
        let bar = ProgressBar::with_draw_target(
            Some(milliseconds(plan.expected_s().value())),
            ProgressDrawTarget::stderr_with_hz(10),
        );
        if let Ok(style) =
            ProgressStyle::with_template("{bar:30} {percent:>3} %  left {eta:>4}  {msg}")
        {
            bar.set_style(style);
        }
        Self {
            bar,
            terminal,
            stage: Cell::new(0),
            doing: Doing::default(),
        }
    }

    /// Creates progress without output.
    pub fn hidden() -> Self {
        Self {
            bar: ProgressBar::hidden(),
            terminal: true,
            stage: Cell::new(0),
            doing: Doing::default(),
        }
    }

    /// Returns the present action, as a handle that others can read later.
    pub fn doing(&self) -> &Doing {
        &self.doing
    }

    /// Shows the beginning of a step.
    pub fn begin(&self, stage: &str, step: &Step) {
        self.bar.set_message(format!("{stage}: {step}"));
        self.doing.set(|now| {
            now.step = step.to_string();
            // While the fixture is being changed, the contents of the jig are unknown.
            now.fixture = now.fixture.filter(|_| !matches!(step, Step::Mount(_)));
        });
        let known = stage.bytes().fold(1_u64, |hash, byte| {
            hash.wrapping_mul(31).wrapping_add(u64::from(byte))
        });
        if !self.terminal && self.stage.replace(known) != known {
            remark!("{stage} …");
        }
    }

    /// Records that the bath was started at a set-point, °C, which it holds on its own.
    pub fn bath(&self, setpoint_degc: f64) {
        self.doing.set(|now| now.bath_degc = Some(setpoint_degc));
    }

    /// Shows a text until the next step begins.
    pub fn say(&self, text: &str) {
        self.bar.set_message(text.to_owned());
        if !self.terminal {
            remark!("{text}");
        }
    }

    /// Shows the end of a step.
    pub fn end(&self, step: &Step) {
        if let Step::Mount(fixture) = *step {
            self.doing.set(|now| now.fixture = Some(fixture));
        }
        self.bar.inc(milliseconds(step.expected_s().value()));
    }

    /// Shows that nothing remains.
    pub fn finish(&self) {
        self.bar.finish_and_clear();
    }
}

fn milliseconds(seconds: f64) -> u64 {
    (seconds * 1.0e3) as u64
}
