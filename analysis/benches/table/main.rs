//! One table: our speeds, each beside an alternative that a user could choose, measured in the same
//! run.
//!
//! `cargo bench -p analysis` runs all groups; `cargo bench -p analysis -- kk` runs only those whose
//! name contains a word. The peers are Python programs (`benches/peers`, with their own
//! requirements). If they are not installed, the table explains how to install them and shows only
//! our part.
#![allow(
    clippy::disallowed_methods,
    reason = "a benchmark measures the machine's time"
)]
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a benchmark may end with its reason"
)]

mod circuit;
mod fit;
mod forward;
mod forward_map;
mod kk;
mod peers;
mod sine;

/// Unit of a figure.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Unit {
    /// Work per second of processor time: more is better.
    PerSecond(&'static str),
    /// Seconds of processor time for one piece of work: less is better.
    Seconds,
}

/// One of our figures.
#[derive(Debug, Clone)]
pub(crate) struct Row {
    /// The work, as the peers name it; empty for what has no peer.
    pub(crate) work: &'static str,
    /// Description of the work.
    pub(crate) what: String,
    /// The figure.
    pub(crate) value: f64,
    /// Its unit.
    pub(crate) unit: Unit,
    /// Words beside it, as how often the best optimum was reached.
    pub(crate) note: String,
}

impl Row {
    /// Creates a figure without a note.
    pub(crate) fn new(work: &'static str, what: &str, value: f64, unit: Unit) -> Self {
        Self {
            work,
            what: what.to_owned(),
            value,
            unit,
            note: String::new(),
        }
    }

    /// Returns the same figure with a note.
    pub(crate) fn noted(self, note: String) -> Self {
        Self { note, ..self }
    }
}

/// Name of a group and what measures it.
type Group = (&'static str, fn() -> Vec<Row>);

fn main() {
    let wanted: Vec<String> = std::env::args()
        .skip(1)
        .filter(|a| !a.starts_with('-'))
        .collect();
    let fits = || fit::rows().into_iter().chain(circuit::rows()).collect();
    let groups: [Group; 4] = [
        ("sine", sine::rows),
        ("fits", fits),
        ("kk", kk::rows),
        ("forward", forward::rows),
    ];
    let chosen = |name: &str| wanted.is_empty() || wanted.iter().any(|w| name.contains(w.as_str()));
    println!("{:<64} {:>18} {:>14}  ", "work", "figure", "ours is");
    for (name, rows) in groups.into_iter().filter(|(name, _)| chosen(name)) {
        let ours = rows();
        let theirs = peers::run(name);
        print_group(&ours, &theirs);
    }
    if let Some(hint) = peers::hint() {
        println!("{hint}");
    }
}

/// Prints our rows, each followed by the peers at the same work.
fn print_group(ours: &[Row], theirs: &[peers::Peer]) {
    for row in ours {
        println!(
            "{:<64} {:>18} {:>14}  {}",
            row.what,
            figure(row.value, row.unit),
            "",
            row.note
        );
        for peer in theirs
            .iter()
            .filter(|p| !row.work.is_empty() && p.work == row.work)
        {
            let ratio = if row.unit == Unit::Seconds {
                peer.value / row.value
            } else {
                row.value / peer.value
            };
            println!(
                "    {:<60} {:>18} {:>12.1} ×  ",
                peer.name,
                figure(peer.value, row.unit),
                ratio
            );
        }
    }
}

fn figure(value: f64, unit: Unit) -> String {
    match unit {
        Unit::PerSecond(what) => format!("{:.1} M{what}/s", 1e-6 * value),
        Unit::Seconds if value < 1e-3 => format!("{:.1} µs", 1e6 * value),
        Unit::Seconds if value < 1.0 => format!("{:.2} ms", 1e3 * value),
        Unit::Seconds => format!("{value:.2} s"),
    }
}

/// Seconds of processor time that this thread has used.
pub(crate) fn cpu_s() -> f64 {
    // Nanoseconds on the processor come first; the files are Linux', as the peers' processor times
    // are on any system.
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    text.split_whitespace()
        .next()
        .and_then(|ns| ns.parse::<f64>().ok())
        .map_or(f64::NAN, |ns| 1e-9 * ns)
}

/// Returns the least processor time of `repeats` calls on this thread, s, or the wall time if the
/// system does not report processor time.
pub(crate) fn best_s(repeats: usize, mut work: impl FnMut()) -> f64 {
    let once = |work: &mut dyn FnMut()| {
        let (cpu, wall) = (cpu_s(), std::time::Instant::now());
        work();
        let used = cpu_s() - cpu;
        if used.is_finite() && used > 0.0 {
            used
        } else {
            wall.elapsed().as_secs_f64()
        }
    };
    (0..repeats)
        .map(|_| once(&mut work))
        .fold(f64::INFINITY, f64::min)
}
