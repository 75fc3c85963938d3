//! The crash drill: a short campaign is killed (SIGKILL) at its messages to the instruments and at
//! its writes to the journal, over real sockets, and is resumed each time. `EIS_BENCH_CRASHES=all`
//! uses every point; otherwise a share of them, distributed over all by a seed.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    io::Write,
    path::{Path, PathBuf},
    sync::{
        Mutex,
        atomic::{AtomicUsize, Ordering},
    },
};

use analysis::{dataset::read_spectrum_csv, spectrum::ImpedancePoint};
use bench_core::journal::Entry;

use crate::{
    guardian::{amps, state},
    resume::resume,
    support::{EXPERIMENT, Files, Ports, SCENARIO, command, files_below, poll},
};

/// Bench seconds per second.
const FACTOR: f64 = 50.0;
/// Number of crashes without the variable.
const SHARE: usize = 16;
/// One in this number of crashes is at the journal.
const JOURNAL: usize = 4;
/// One in this number of runs dies a second time, after it was resumed.
const TWICE: usize = 3;
/// Number of concurrent crashes; they mostly wait.
const AT_ONCE: usize = 6;
/// One in this number of kills may be excused by the same text; one is allowed in any drill. A
/// forgotten frame contains no information about the current, and occurs in two of eighteen kills
/// on a busy machine; a fault of the program could also cause the other texts.
const EXCUSED: [usize; 3] = [3, 10, 10];
/// Number of drills in which a correct program fails once by chance.
const BY_CHANCE: f64 = 0.01;

/// Returns the greatest distance of a point from that of the undisturbed run, in standard
/// deviations of the difference: among this number of comparisons noise alone exceeds it with a
/// probability of at most [`BY_CHANCE`]. The union bound over Mills' bound of the normal tail,
/// 2φ(b)/b.
pub(crate) fn bound(comparisons: usize) -> f64 {
    let chance = |b: f64| {
        comparisons as f64 * 2.0 * (-0.5 * b * b).exp() / (b * std::f64::consts::TAU.sqrt())
    };
    let (mut low, mut high) = (1.0, 10.0);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if chance(middle) > BY_CHANCE {
            low = middle;
        } else {
            high = middle;
        }
    }
    high
}

#[test]
fn the_bound_grows_with_the_comparisons_as_the_normal_tail_says() {
    // Twice the normal tail beyond 4 is 6.3e-5, beyond 5 it is 5.7e-7.
    assert!(
        (3.9..4.1).contains(&bound(158)) && (4.95..5.05).contains(&bound(17_450)),
        "{} {}",
        bound(158),
        bound(17_450)
    );
}

/// A step that moves an unknown charge if the process dies during it. The current is so small that
/// a late step, at fifty times the pace, does not count as a violation of the command.
const TRACE: &str = r#"
[[traces]]
name = "pulse"
rest_first = "2 s"
start_voltage = ["3.6 V", "4.0 V"]
resistance_max = "30 mΩ"
segments = [{ current = "-0.25 A", duration = "2 s" }, { current = "0 A", duration = "2 s" }]
"#;

/// Returns files with two cells, one sweep of two points and a pulse each, and a SOC reset of some
/// minutes before each.
fn files() -> Files {
    Files::brief(2)
        .without(EXPERIMENT, "fixture_check")
        .edit(
            EXPERIMENT,
            "discharge_until = \"3.52 V\"",
            "discharge_until = \"3.665 V\"",
        )
        .edit(
            EXPERIMENT,
            "charge_until = \"3.80 V\"",
            "charge_until = \"3.87 V\"",
        )
        .edit(EXPERIMENT, "rest_min = \"5 min\"", "rest_min = \"10 s\"")
        .edit(
            EXPERIMENT,
            "rest_slope = \"0.2 mV/min\"",
            "rest_slope = \"50 mV/min\"",
        )
        .append(EXPERIMENT, TRACE)
        .append(
            EXPERIMENT,
            "[campaign]\nrepeats = 1\ncells = [{ name = \"A\" }, { name = \"B\" }]",
        )
        .append(SCENARIO, "[specimens]\ncount = 2\nsoc = 0.001")
}

/// Returns the points at which a run can die: messages, writes.
fn points(run: &Path) -> (usize, usize) {
    let lines = |path: PathBuf| fs::read_to_string(path).unwrap().lines().count();
    let exchanges = files_below(&run.join("transcripts"))
        .into_iter()
        .map(|name| lines(run.join("transcripts").join(name)))
        .sum();
    (exchanges, 2 * lines(run.join("journal.jsonl")))
}

/// Returns every point, or a share that a seed distributes over them.
fn chosen((exchanges, writes): (usize, usize)) -> Vec<String> {
    let asked = std::env::var("EIS_BENCH_CRASHES").unwrap_or_default();
    if asked == "all" {
        let all = (1..=exchanges).map(|number| format!("exchange:{number}"));
        return all
            .chain((1..=writes).map(|number| format!("journal:{number}")))
            .collect();
    }
    let share: usize = asked.parse().unwrap_or(SHARE);
    let spread = |kind: &str, points: usize, share: usize| {
        let width = points / share;
        let at =
            |index: usize| 1 + index * points / share + (index.wrapping_mul(7919) + 13) % width;
        (0..share)
            .map(|index| format!("{kind}:{}", at(index)))
            .collect::<Vec<_>>()
    };
    let journal = (share / JOURNAL).min(writes);
    [
        spread("exchange", exchanges, (share - journal).min(exchanges)),
        spread("journal", writes, journal),
    ]
    .concat()
}

/// Returns the complete lines of the tables of a run.
pub(crate) fn rows(run: &Path) -> BTreeMap<PathBuf, String> {
    let table = |name: &PathBuf| {
        name.extension().is_some_and(|extension| extension == "csv") && !name.starts_with("config")
    };
    let whole = |name: PathBuf| {
        let text = fs::read_to_string(run.join(&name)).unwrap();
        let end = text.rfind('\n').map_or(0, |at| at + 1);
        (name, text[..end].to_owned())
    };
    files_below(run)
        .into_iter()
        .filter(table)
        .map(whole)
        .collect()
}

/// Returns the sweeps as read: their uncertainty is their noise alone.
fn spectra(run: &Path) -> Vec<ImpedancePoint> {
    ["cell", "cell_2"]
        .into_iter()
        .flat_map(|name| spectrum(run, name))
        .collect()
}

pub(crate) fn spectrum(run: &Path, name: &str) -> Vec<ImpedancePoint> {
    read_spectrum_csv(&run.join(format!("raw_{name}.csv"))).unwrap()
}

/// Messages of a run on a machine that is too slow for the pace. A simulated scope discards a
/// frame that is not fetched in time. A wave that is not replaced in time repeats. A wave whose
/// last message was late is not at its expected position. Each run has ended in a safe state, and
/// can be resumed. A fault of the program may give the same message, so that [`every`] limits how
/// often each may occur.
const TOO_SLOW: [&str; 3] = [
    "no frame was completed since the scope was armed",
    ": it began again",
    "trace jump: expected 0 A, measured ",
];

/// Result of one kill.
#[derive(Debug, Default)]
pub(crate) struct Fate {
    pub(crate) died: bool,
    /// Phase of the run when it died, if the drill distinguishes phases.
    pub(crate) phase: &'static str,
    /// Of [`TOO_SLOW`].
    excuses: BTreeSet<&'static str>,
}

impl Fate {
    /// Records that a run was not completed: it must have an excuse.
    #[track_caller]
    pub(crate) fn excuse(&mut self, text: &str, drill: &str) {
        let excuse = TOO_SLOW.into_iter().find(|slow| text.contains(slow));
        self.excuses
            .insert(excuse.unwrap_or_else(|| panic!("{drill}: {text}")));
    }
}

/// Resumes the run until it is finished.
#[track_caller]
fn finish(run: &Path, drill: &str, fate: &mut Fate) {
    for _ in 0..5 {
        let ended = resume(run, &[]);
        if ended.code == Some(0) {
            return;
        }
        fate.excuse(ended.message(), &format!("{drill}: {}", ended.stderr));
    }
    panic!("{drill}: the machine is too slow for {FACTOR} bench seconds in one");
}

/// Starts or resumes the run until it dies at a point; returns whether it died.
pub(crate) fn dies(mut command: std::process::Command, drill: &str, fate: &mut Fate) -> bool {
    let ended = command.env("EIS_BENCH_DRILL", drill).output().unwrap();
    if std::os::unix::process::ExitStatusExt::signal(&ended.status) == Some(9) {
        fate.died = true;
        return true;
    }
    // It sent fewer messages than the undisturbed run: the point was not reached.
    if ended.status.code() != Some(0) {
        fate.excuse(&String::from_utf8_lossy(&ended.stderr), drill);
    }
    false
}

/// Returns the greatest distance from the result of an undisturbed run, in standard deviations.
#[track_caller]
pub(crate) fn distance(found: &[ImpedancePoint], reference: &[ImpedancePoint]) -> f64 {
    assert_eq!(found.len(), reference.len());
    let one = |(a, b): (&ImpedancePoint, &ImpedancePoint)| {
        assert_eq!(a.freq_hz, b.freq_hz);
        let z = a.z_ohm - b.z_ohm;
        let sigma = |a: f64, b: f64| (a + b).sqrt();
        let re = z.re.abs() / sigma(a.covariance.re_re, b.covariance.re_re);
        re.max(z.im.abs() / sigma(a.covariance.im_im, b.covariance.im_im))
    };
    found.iter().zip(reference).map(one).fold(0.0, f64::max)
}

/// Asserts that every trace exists once, and that an interrupted trace was repeated only after the
/// charge of the cell had been restored.
#[track_caller]
fn assert_charge_is_known(run: &Path, drill: &str) {
    let index = crate::support::json(&run.join("traces.json"));
    let traces: Vec<&str> = index["traces"]
        .as_array()
        .unwrap()
        .iter()
        .map(|trace| trace["file"].as_str().unwrap())
        .collect();
    assert_eq!(
        traces,
        ["series_pulse_1.bdf.csv", "series_pulse_2.bdf.csv"],
        "{drill}"
    );
    assert!(traces.iter().all(|file| run.join(file).exists()), "{drill}");
    let (mut moved, mut played) = (false, BTreeMap::new());
    for line in bench_core::journal::read(run).unwrap().lines {
        match line.entry {
            Entry::Intent { text, .. } if text.starts_with("trace pulse") => {
                assert!(
                    !moved,
                    "{drill}: {text} was started although the charge moved before was unknown"
                );
                (moved, *played.entry(text).or_insert(0)) = (true, 1);
            }
            Entry::Done { .. } => moved = false,
            // A reset is absolute: after it the charge is known, whatever was moved before.
            Entry::Intent { text, .. } if text.starts_with("charge at") => moved = false,
            _ => {}
        }
    }
    assert_eq!(played.len(), 2, "{drill}: {played:?}");
}

/// Returns the guardian's action after the death; it must have switched everything off and read it
/// back. The duration is in bench seconds, which are shorter than real ones, so that the machine's
/// own speed is visible: `guardian` asserts the bound of five seconds in real time.
pub(crate) fn guarded(files: &Files, drill: &str) -> String {
    let Ok(_) = fs::read(state(files, "guardian.json")) else {
        return "no guardian yet".to_owned();
    };
    let report = poll("the guardian's end", || {
        let report: serde_json::Value =
            serde_json::from_str(&fs::read_to_string(state(files, "guardian.json")).ok()?).ok()?;
        (report["status"] == "verified" || report["status"] == "dismissed").then_some(report)
    });
    if report["status"] == "dismissed" {
        return "was dismissed".to_owned();
    }
    assert_eq!(report["attempts"], 1, "{drill}: {report}");
    for role in ["supply4q", "load", "supply"] {
        assert!(amps(&report, role).abs() < 0.1, "{drill}: {report}");
    }
    format!("off after {:.1} s", report["took_s"].as_f64().unwrap())
}

/// Executes a run without a kill.
#[track_caller]
fn whole(files: &Files, out: &str, drill: &str, fate: &mut Fate) {
    let ended = files.run(out);
    if ended.code != Some(0) {
        fate.excuse(ended.message(), &format!("{drill}: {}", ended.stderr));
        finish(&files.path(out), drill, fate);
    }
}

/// Executes one crash, or two of one run, and returns the result as a row of the table.
fn crash(
    (index, drill): (usize, &str),
    fate: &mut Fate,
    (reference, agrees): (&[ImpedancePoint], f64),
) -> String {
    let files = files();
    let ports = Ports::serve(&files, FACTOR, 1);
    let run = files.path("run");
    let experiment = files.experiment();
    if !dies(
        command(&[
            "run".as_ref(),
            experiment.as_os_str(),
            "--out".as_ref(),
            run.as_os_str(),
        ]),
        drill,
        fate,
    ) {
        return format!("{drill:<14} not reached");
    }
    let current_a = ports.world.lock().unwrap().truth_current_a();
    let guarded = guarded(&files, drill);
    assert_eq!(
        ports.world.lock().unwrap().truth_current_a(),
        0.0,
        "{drill}: {guarded}"
    );
    let before = rows(&run);
    let journal_contains = |text: &str| {
        fs::read_to_string(run.join("journal.jsonl"))
            .unwrap_or_default()
            .contains(text)
    };
    if !journal_contains("\"started\"") {
        let refused = resume(&run, &[]);
        refused.expect_code(2);
        assert!(
            refused.message().contains("nothing was done yet"),
            "{drill}: {}",
            refused.message()
        );
        whole(&files, "again", drill, fate);
        return format!(
            "{drill:<14} nothing was done yet, run from the beginning, {:.1} σ",
            distance(&spectra(&files.path("again")), reference)
        );
    }
    let mut became = "was finished";
    if !journal_contains("{\"ended\":{\"how\":\"finished\"}}") {
        became = "went on";
        let again = command(&["resume".as_ref(), run.as_os_str()]);
        let twice =
            index % TWICE == 0 && dies(again, &format!("exchange:{}", 60 + 17 * index % 400), fate);
        if twice {
            became = "died again, went on";
        }
        if !journal_contains("{\"ended\":{\"how\":\"finished\"}}") {
            finish(&run, drill, fate);
        }
        let after = rows(&run);
        for (name, rows) in &before {
            assert!(
                after[name].starts_with(rows.as_str()),
                "{drill}: rows of {} were lost or changed",
                name.display()
            );
        }
    }
    let points = before
        .iter()
        .filter(|(name, _)| name.starts_with("spectra"))
        .map(|(_, text)| text.lines().count() - 1)
        .sum::<usize>();
    let sigmas = distance(&spectra(&run), reference);
    assert!(
        sigmas < agrees,
        "{drill}: {sigmas} standard deviations, {agrees} at most"
    );
    assert_charge_is_known(&run, drill);
    ports.assert_outputs_off();
    let witness = ports.world.lock().unwrap().witness();
    assert_eq!(witness.abuse, [], "{drill}: the cell left its envelope");
    let (least_v, greatest_v) = (witness.least_v, witness.greatest_v);
    format!(
        "{drill:<14} {current_a:>7.3} A | {guarded:<15} | {points} points kept | {became:<20} | \
        {sigmas:.1} σ | cell {least_v:.3} V to {greatest_v:.3} V"
    )
}

#[test]
#[ignore = "long drill"]
fn a_campaign_that_is_killed_anywhere_goes_on_and_loses_nothing() {
    let files = files();
    let ports = Ports::serve(&files, FACTOR, 1);
    whole(&files, "whole", "whole", &mut Fate::default());
    assert_eq!(ports.world.lock().unwrap().witness().abuse, []);
    drop(ports);
    let reference = spectra(&files.path("whole"));
    let all = points(&files.path("whole"));
    let mut kills = chosen(all);
    // For any share: before the first pulse flows, and after it has flowed but before this is
    // recorded.
    let journal = fs::read_to_string(files.path("whole/journal.jsonl")).unwrap();
    let pulse = 1 + journal
        .lines()
        .position(|line| line.contains("\"text\":\"trace pulse"))
        .unwrap();
    kills.extend([
        format!("journal:{}", 2 * pulse),
        format!("journal:{}", 2 * pulse + 1),
    ]);
    // Real and imaginary part of every point of every run.
    let agrees = bound(2 * reference.len() * kills.len());
    let head = format!(
        "bound {agrees:.2} σ; {} of {} exchanges and {} ends of writes to the journal",
        kills.len(),
        all.0,
        all.1
    );
    every(&kills, ("kills.txt", &head), |index, drill, fate| {
        crash((index, drill), fate, (&reference, agrees))
    });
    assert!(
        all.0 + all.1 >= 2000,
        "expected at least 2000 points to die at, found {all:?}"
    );
}

/// Executes every kill, some concurrently, and prints the table. It is also written beside the
/// test's binary as it grows, so that a drill of hours that is stopped shows its results, too. A
/// drill in which hardly any run died has shown nothing, and one that repeatedly excuses the same
/// text hides a fault.
pub(crate) fn every(
    kills: &[String],
    (name, head): (&str, &str),
    crash: impl Fn(usize, &str, &mut Fate) -> String + Sync,
) -> Vec<Fate> {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    fs::write(&path, format!("{head}\n")).unwrap();
    let (next, table) = (AtomicUsize::new(0), Mutex::new(BTreeMap::new()));
    std::thread::scope(|scope| {
        for _ in 0..AT_ONCE {
            scope.spawn(|| {
                while let Some((index, drill)) = Some(next.fetch_add(1, Ordering::Relaxed))
                    .and_then(|at| Some((at, kills.get(at)?)))
                {
                    let mut fate = Fate::default();
                    let mut row = crash(index, drill, &mut fate);
                    for excuse in &fate.excuses {
                        row += &format!(" | too slow: {}", excuse.trim_matches([' ', ':']));
                    }
                    let mut table = table.lock().unwrap();
                    writeln!(
                        fs::OpenOptions::new().append(true).open(&path).unwrap(),
                        "{row}"
                    )
                    .unwrap();
                    table.insert(index, (row, fate));
                }
            });
        }
    });
    let table = table.into_inner().unwrap();
    assert_eq!(table.len(), kills.len());
    let (rows, fates): (Vec<String>, Vec<Fate>) = table.into_values().unzip();
    std::io::stderr()
        .write_all(format!("{head}\n{}\n", rows.join("\n")).as_bytes())
        .unwrap();
    // The last messages of the undisturbed run need not be reached.
    let died = fates.iter().filter(|fate| fate.died).count();
    assert!(
        2 * died >= kills.len(),
        "{died} of {} kills were reached, expected half of them at least",
        kills.len()
    );
    for (slow, of) in TOO_SLOW.into_iter().zip(EXCUSED) {
        let excused = kills
            .iter()
            .zip(&fates)
            .filter(|(_, fate)| fate.excuses.contains(slow));
        let excused: Vec<&str> = excused.map(|(drill, _)| drill.as_str()).collect();
        let most = (kills.len() / of).max(1);
        assert!(
            excused.len() <= most,
            "{slow:?} of more than {most} of {} kills: {}",
            kills.len(),
            excused.join(", ")
        );
    }
    fates
}
