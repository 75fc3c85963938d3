//! Judges a trial: the load on the cell, whether numbers are right, and whether final messages are
//! true.

use std::{collections::BTreeMap, path::Path, sync::Mutex};

use analysis::dataset::read_spectrum_csv;
use instruments::fixture::Fixture;
use nix::sys::signal::Signal;
use num_complex::Complex64;

use super::{
    deed::{Attack, Deed},
    job::Job,
    scene::{Sample, Scene, lock},
    table::Row,
};

/// Current that counts as none, A.
pub(crate) const NOTHING_A: f64 = 0.1;
/// Current above which the envelope is exceeded if none should flow, A.
const IDLE_A: f64 = 0.2;
/// Greatest tolerated error of a number, as a share.
const OFF: f64 = 0.01;
/// Time before or after a change of the current within which the journal is seen, s.
const BLUR_S: f64 = 0.3;
/// Time without a heartbeat of the daemon after which the guardian acts, s.
const LEASE_S: f64 = 5.0;
/// Time from the cause to zero current on fast instruments, s: the longer of a period and the
/// first value, plus the second.
const DEADLINE_S: (f64, f64) = (2.0, 1.0);
/// Delay of answers above which the deadline is extended, s.
const FAST_ANSWER_S: f64 = 0.3;
/// How long a run may continue without its folder, s: all its measurements are lost.
const FOLDER_S: f64 = 15.0;
/// Time before a statement about an output for which the statement must be true, s.
const BEFORE_S: f64 = 1.0;
/// Messages that state that everything is off.
const OFF_WORDS: [&str; 4] = [
    "every output is off",
    "every output is verified off",
    "every output was read back as off",
    "outputs verified off",
];

/// Returns the charge beyond the envelope, A·s, and the longest interval beyond it, s; gaps
/// shorter than `gap_s` do not end an interval.
pub(crate) fn beyond(samples: &[Sample], envelope: &[(f64, (f64, f64))], gap_s: f64) -> (f64, f64) {
    let (mut charge, mut longest) = (0.0, 0.0);
    let mut stretch: Option<(f64, f64)> = None;
    for pair in samples.windows(2) {
        let (before_s, Sample { now_s, amps, .. }) = (pair[0].now_s, pair[1]);
        let (least, most) = asked(envelope, now_s);
        let over = (least - amps).max(amps - most);
        if over <= 0.0 {
            continue;
        }
        charge += over * (now_s - before_s);
        let start_s = match stretch {
            Some((start_s, end_s)) if now_s - end_s <= gap_s => start_s,
            _ => before_s,
        };
        stretch = Some((start_s, now_s));
        longest = f64::max(longest, now_s - start_s);
    }
    (charge, longest)
}

/// Returns the allowed currents at a time, A, including the margin and the neighbours in time.
fn asked(envelope: &[(f64, (f64, f64))], now_s: f64) -> (f64, f64) {
    let from = envelope
        .iter()
        .rposition(|(at_s, _)| *at_s <= now_s - BLUR_S)
        .unwrap_or(0);
    let near = envelope
        .iter()
        .skip(from)
        .take_while(|(at_s, _)| *at_s <= now_s + BLUR_S);
    let (least, most) = near.fold((0.0_f64, 0.0_f64), |(least, most), (_, (low, high))| {
        (least.min(*low), most.max(*high))
    });
    let margin = |amps: f64| {
        if amps == 0.0 {
            IDLE_A
        } else {
            1.1f64.mul_add(amps.abs(), NOTHING_A)
        }
    };
    (-margin(least), margin(most))
}

/// Returns the deadline of an attack, s: for late answers, the bound that the program's plan
/// prints.
pub(crate) fn deadline_s(attack: &Attack, bound_s: Option<f64>) -> f64 {
    let base_s = attack.window.period_s().max(DEADLINE_S.0) + DEADLINE_S.1;
    let lease_s = if attack.deed.takes_lease() {
        LEASE_S
    } else {
        0.0
    };
    let bound_s = bound_s.filter(|_| attack.deed.late_s() > FAST_ANSWER_S);
    bound_s.map_or(base_s, |bound_s| bound_s.max(base_s)) + lease_s
}

/// Parses the bound in a line of a plan: `watch: from a cause to zero within 3.0 s (…)`.
pub(crate) fn printed_bound_s(text: &str) -> Option<f64> {
    let line = text
        .lines()
        .rev()
        .find(|line| line.trim_start().starts_with("watch:"))?;
    let number = line.split_once("within ")?.1.split_whitespace().next()?;
    number.parse().ok()
}

/// Returns messages of the program that were false when they were written.
pub(crate) fn false_words(lines: &[(f64, String)], samples: &[Sample]) -> Vec<String> {
    let live = |now_s: f64| {
        let mut before = samples
            .iter()
            .filter(|sample| (now_s - BEFORE_S..=now_s).contains(&sample.now_s))
            .peekable();
        before.peek()?;
        let flags: Vec<bool> = before.map(|sample| sample.live).collect();
        Some((
            flags.iter().all(|live| *live),
            flags.iter().any(|live| *live),
        ))
    };
    let mut wrong = Vec::new();
    for (now_s, line) in lines {
        let Some((all, any)) = live(*now_s) else {
            continue;
        };
        let says_off = OFF_WORDS.iter().any(|words| line.contains(words));
        if says_off && all {
            wrong.push(format!("an output was on, but: {line}"));
        }
        if line.contains("nobody has switched off") && !any {
            wrong.push(format!("every output was off, but: {line}"));
        }
    }
    wrong
}

/// Ratio of measured to true impedance at each point of an undisturbed run, by job.
pub(crate) type Usual = Mutex<BTreeMap<Job, Vec<Complex64>>>;

/// Returns the points of the cell's first spectrum, each relative to the truth, with their
/// frequencies, Hz.
pub(crate) fn shares(run: &Path, scene: &Scene) -> Vec<(f64, Complex64)> {
    let Ok(points) = read_spectrum_csv(&run.join("spectrum.csv")) else {
        return Vec::new();
    };
    let world = lock(&scene.world);
    points
        .iter()
        .map(|point| {
            let truth = world.truth_impedance(Fixture::Cell, point.freq_hz);
            (point.freq_hz, point.z_ohm / truth)
        })
        .collect()
}

/// Returns the number of points that are off by more than a hundredth without a remark of the
/// program.
pub(crate) fn wrong_points(
    shares: &[(f64, Complex64)],
    usual: Option<&Vec<Complex64>>,
    messages: &str,
) -> usize {
    let Some(usual) = usual else { return 0 };
    let off = |((freq_hz, share), usual): &(&(f64, Complex64), &Complex64)| {
        (*share / *usual - 1.0).norm() > OFF && !messages.contains(&format!("{freq_hz:.4} Hz"))
    };
    shares.iter().zip(usual).filter(off).count()
}

impl Row {
    /// Returns the violations as text; empty if there are none.
    pub(crate) fn wrong(&self) -> Vec<String> {
        let mut wrong = self.false_words.clone();
        if !self.happened {
            return Vec::new();
        }
        // A run that refuses to begin leaves the bench to the present client.
        let watched = self.attack.window.is_watched() && self.began;
        if watched && self.beyond_s > self.deadline_s {
            wrong.push(format!(
                "{:.1} s beyond the envelope, deadline {:.1} s",
                self.beyond_s, self.deadline_s
            ));
        }
        if watched && self.still {
            wrong.push("a current still flows at the end".to_owned());
        }
        if self.wrong_points > 0 && self.code == Some(0) {
            let count = self.wrong_points;
            wrong.push(format!(
                "{count} points are wrong, without a flag and with exit code 0"
            ));
        }
        wrong.extend(self.unfinished());
        if self.attack.deed == Deed::FolderGone && self.went_on_s > FOLDER_S {
            wrong.push(format!(
                "went on for {:.0} s without its folder",
                self.went_on_s
            ));
        }
        // A process that was stopped does not end unless another process ends it.
        let is_stopped = matches!(self.attack.deed, Deed::Signal(_, Signal::SIGSTOP));
        if self.hung && !is_stopped {
            wrong.push("did not end by itself".to_owned());
        }
        wrong
    }

    /// Returns a violation if a run does not continue after an outage that has passed, or without
    /// an attack.
    fn unfinished(&self) -> Option<String> {
        let must = self.attack.deed.is_transient() || self.attack.deed == Deed::Nothing;
        if !must {
            return None;
        }
        let is_right = self.code == Some(0) && self.wrong_points == 0 && self.points == self.usual;
        let is_latched = self.code == Some(6);
        let fails = if self.attack.window.ends_soon() {
            !is_right
        } else {
            is_latched
        };
        fails.then(|| {
            let code = self.code.map_or("none".to_owned(), |code| code.to_string());
            format!(
                "did not end right after it had passed: code {code}, {} of {} points",
                self.points, self.usual
            )
        })
    }
}
