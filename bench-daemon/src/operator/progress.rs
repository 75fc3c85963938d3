//! Progress for the person at the terminal: a bar with the time left.

use std::{
    cell::Cell,
    io::IsTerminal,
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
};

use analysis::diagnosis::Progress as Listener;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use instruments::fixture::Fixture;

use crate::{
    plan::{Plan, Step},
    support::terminal::remark,
};

/// With this variable set, what is shown on a terminal's line is written as a line each, behind
/// [`PROGRESS_LINE`]: for a program that shows it.
pub const PROGRESS_VARIABLE: &str = "EIS_BENCH_PROGRESS";
/// Beginning of such a line.
pub const PROGRESS_LINE: &str = "progress: ";

/// A line on a terminal's standard error that says what a computation is doing, and since when.
pub struct Waiting {
    bar: ProgressBar,
    lines: bool,
}

/// Puts words on the line.
fn put(bar: &ProgressBar, lines: bool, words: String) {
    if lines {
        remark!("{PROGRESS_LINE}{words}");
    }
    bar.set_message(words);
}

impl Waiting {
    /// Shows the line; nothing on anything else than a terminal, but for [`PROGRESS_VARIABLE`].
    pub fn shown() -> Self {
        let bar = ProgressBar::with_draw_target(None, ProgressDrawTarget::stderr_with_hz(10));
        if let Ok(style) = ProgressStyle::with_template("{elapsed:>4}  {msg}") {
            bar.set_style(style);
        }
        Self {
            bar,
            lines: std::env::var_os(PROGRESS_VARIABLE).is_some(),
        }
    }

    /// A listener that puts its words on the line.
    pub fn listener(&self) -> Listener {
        let (bar, lines) = (self.bar.clone(), self.lines);
        Listener::new(move |step| put(&bar, lines, step.to_owned()))
    }

    /// Counts what is done of so many things, from any thread.
    pub fn counter(&self, of: u64, what: &str) -> impl Fn() + Sync + use<> {
        let (bar, lines) = (self.bar.clone(), self.lines);
        let (what, done) = (what.to_owned(), AtomicU64::new(0));
        move || {
            let done = done.fetch_add(1, Ordering::Relaxed) + 1;
            put(&bar, lines, format!("{what}: {done} of {of}"));
        }
    }

    /// Clears the line.
    pub fn end(self) {
        self.bar.finish_and_clear();
    }
}

/// Seconds between two lines about progress where there is no terminal.
const QUIET_S: u64 = 10;
/// Ticks of a share of 1.
const WHOLE: u64 = 10_000;

/// Progress through many things, with the time left.
pub struct Share {
    bar: ProgressBar,
    terminal: bool,
    told_s: Cell<u64>,
}

impl Share {
    /// A bar on standard error; on anything else than a terminal a line now and then.
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
            told_s: Cell::new(0),
        }
    }

    /// This share is done, which is so much.
    pub fn at(&self, share: f64, done: &str) {
        self.bar.set_position((share * WHOLE as f64) as u64);
        self.bar.set_message(done.to_owned());
        let elapsed_s = self.bar.elapsed().as_secs();
        if !self.terminal && elapsed_s >= self.told_s.get() + QUIET_S {
            self.told_s.set(elapsed_s);
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

/// The step in work.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Now {
    /// In words; empty before the first.
    pub step: String,
    /// Fixture in the jig, where it is known.
    pub fixture: Option<Fixture>,
    /// At which set-point this run has started a bath that closes its own loop, °C.
    pub bath_c: Option<f64>,
}

impl Doing {
    /// Present action.
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
    /// A bar on standard error for a plan; on anything else than a terminal one line per stage
    /// instead.
    pub fn new(plan: &Plan) -> Self {
        let terminal = std::io::stderr().is_terminal();
        let bar = ProgressBar::with_draw_target(
            Some(milliseconds(plan.expected_s())),
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

    /// No output at all.
    pub fn hidden() -> Self {
        Self {
            bar: ProgressBar::hidden(),
            terminal: true,
            stage: Cell::new(0),
            doing: Doing::default(),
        }
    }

    /// Present action, as a handle that others can read later.
    pub fn doing(&self) -> &Doing {
        &self.doing
    }

    /// A step begins.
    pub fn begin(&self, stage: &str, step: &Step) {
        self.bar.set_message(format!("{stage}: {step}"));
        self.doing.set(|now| {
            now.step = step.to_string();
            // Nobody knows what is in the jig while it is being changed.
            now.fixture = now.fixture.filter(|_| !matches!(step, Step::Mount(_)));
        });
        let known = stage.bytes().fold(1_u64, |hash, byte| {
            hash.wrapping_mul(31).wrapping_add(u64::from(byte))
        });
        if !self.terminal && self.stage.replace(known) != known {
            remark!("{stage} …");
        }
    }

    /// The bath was started at a set-point, °C, and holds it by itself.
    pub fn bath(&self, setpoint_c: f64) {
        self.doing.set(|now| now.bath_c = Some(setpoint_c));
    }

    /// Something that holds until the next step begins.
    pub fn say(&self, text: &str) {
        self.bar.set_message(text.to_owned());
        if !self.terminal {
            remark!("{text}");
        }
    }

    /// A step ended.
    pub fn end(&self, step: &Step) {
        if let Step::Mount(fixture) = *step {
            self.doing.set(|now| now.fixture = Some(fixture));
        }
        self.bar.inc(milliseconds(step.expected_s()));
    }

    /// Nothing is left.
    pub fn finish(&self) {
        self.bar.finish_and_clear();
    }
}

fn milliseconds(seconds: f64) -> u64 {
    (seconds * 1.0e3) as u64
}
