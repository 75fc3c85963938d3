//! What the person watching sees: a bar with the time left.

use std::{
    cell::Cell,
    io::{IsTerminal, Write},
};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use crate::plan::{Plan, Step};

/// Progress through a plan, by expected bench time.
#[derive(Debug)]
pub struct Progress {
    bar: ProgressBar,
    terminal: bool,
    stage: Cell<u64>,
}

impl Progress {
    /// A bar on standard error for a plan; on anything else than a terminal one line per stage instead.
    pub fn new(plan: &Plan) -> Self {
        let terminal = std::io::stderr().is_terminal();
        let bar = ProgressBar::with_draw_target(Some(milliseconds(plan.expected_s())), ProgressDrawTarget::stderr_with_hz(10));
        if let Ok(style) = ProgressStyle::with_template("{bar:30} {percent:>3} %  left {eta:>4}  {msg}") {
            bar.set_style(style);
        }
        Self { bar, terminal, stage: Cell::new(0) }
    }

    /// No output at all.
    pub fn hidden() -> Self {
        Self { bar: ProgressBar::hidden(), terminal: true, stage: Cell::new(0) }
    }

    /// A step begins.
    pub fn begin(&self, stage: &str, step: &Step) {
        self.bar.set_message(format!("{stage}: {step}"));
        let known = stage.bytes().fold(1_u64, |hash, byte| hash.wrapping_mul(31).wrapping_add(u64::from(byte)));
        if !self.terminal && self.stage.replace(known) != known {
            // A reader that is gone is no reason to stop a measurement.
            let _ = writeln!(std::io::stderr(), "{stage} …");
        }
    }

    /// A step ended.
    pub fn end(&self, step: &Step) {
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
