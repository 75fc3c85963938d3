//! Benches that measure wrong numbers: none ends with exit code 0 and a number without a flag, and
//! the message names the cause. Sound benches are not refused.

use bench_daemon::{command::run::run_experiment, safety::failure::Failure};

use crate::support::{BENCH, EXPERIMENT, Files, SCENARIO, program};

/// How a run ended: its exit code, and everything that it says of its results.
struct Told {
    code: u8,
    words: String,
    files: Files,
}

fn told(files: Files) -> Told {
    let outcome = run_experiment(&files.load(), &files.path("run"));
    let (code, words) = match outcome {
        Ok(finished) => {
            let refused = finished.measured.refused();
            let failure = Failure::Refused { count: refused };
            let code = if refused > 0 { failure.exit_code() } else { 0 };
            (code, finished.summary)
        }
        Err(failure) => (failure.exit_code(), failure.to_string()),
    };
    Told { code, words, files }
}

/// Controls, and the cell from 3 Hz to 300 Hz.
fn with_controls(points: usize) -> Files {
    Files::short(points).edit(EXPERIMENT, "start = \"100 Hz\"", "start = \"3 Hz\"")
}

/// The cell alone.
fn alone(points: usize) -> Files {
    with_controls(points).without(EXPERIMENT, "fixture_check")
}

/// Bench time at which the controls are done and the cell is not yet measured, s.
const BETWEEN_S: f64 = 20.0;

fn faulty(files: Files, fault: &str) -> Files {
    files.append(SCENARIO, fault)
}

fn channel(from_s: f64, channel: u8, gain: f64) -> String {
    format!("[faults.channel_fails]\nfrom_s = {from_s}\nchannel = {channel}\ngain = {gain:.1}")
}

fn probes(from_s: f64, probes: [u8; 4]) -> String {
    format!("[faults.probes_move]\nfrom_s = {from_s}\nprobes = {probes:?}")
}

fn offset(from_s: f64) -> String {
    format!("[faults.offset_with_sine]\nfrom_s = {from_s}\namps = 0.34")
}

const DEAD: &str = "C3 shows nothing of the sinusoid: its lead is off, or the channel is dead";
const FACTOR: &str = "C3 reads 10 times its voltage: its probe factor is wrong";

#[test]
fn wrong_numbers_are_refused_and_the_channel_or_the_scope_is_named() {
    let late = "[faults.scope_repeats]\nfrom_s = 0.0\nlate = true";
    let repeats = "[faults.scope_repeats]\nfrom_s = 0.0";
    let again = "the scope repeats an old record";
    let first = BETWEEN_S;
    let swapped = |one, other| format!("the leads of C{one} and C{other} are exchanged");
    let since = "interlock: mean of the cell current since the zero of the channels";
    let cases = [
        (
            "C3 dead",
            with_controls(3),
            channel(first, 3, 0.0),
            DEAD.to_owned(),
            3,
        ),
        (
            "C3 dead, no controls",
            alone(2),
            channel(0.0, 3, 0.0),
            DEAD.to_owned(),
            3,
        ),
        (
            "C3 at 10",
            with_controls(3),
            channel(first, 3, 10.0),
            FACTOR.to_owned(),
            3,
        ),
        (
            "C3 at 10, no controls",
            alone(2),
            channel(0.0, 3, 10.0),
            FACTOR.to_owned(),
            3,
        ),
        (
            "C1 C2",
            with_controls(3),
            probes(first, [2, 1, 3, 4]),
            swapped(1, 2),
            3,
        ),
        (
            "C1 C2, no controls",
            alone(2),
            probes(0.0, [2, 1, 3, 4]),
            swapped(1, 2),
            3,
        ),
        (
            "C1 C3",
            with_controls(3),
            probes(first, [3, 2, 1, 4]),
            swapped(1, 3),
            3,
        ),
        (
            "C1 C3, no controls",
            alone(2),
            probes(0.0, [3, 2, 1, 4]),
            swapped(1, 3),
            3,
        ),
        ("repeats", alone(3), repeats.to_owned(), again.to_owned(), 3),
        ("previous", alone(3), late.to_owned(), again.to_owned(), 3),
        (
            "offset, no controls",
            alone(3),
            offset(0.0),
            since.to_owned(),
            5,
        ),
        (
            "offset",
            with_controls(3),
            offset(first),
            since.to_owned(),
            5,
        ),
    ];
    let mut wrong = Vec::new();
    for (name, files, fault, cause, code) in cases {
        let told = told(faulty(files, &fault));
        if told.code != code || !told.words.contains(&cause) {
            wrong.push(format!("{name}: code {}: {}", told.code, told.words));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// Models of a run folder.
fn models(files: &Files) -> usize {
    std::fs::read_dir(files.path("run"))
        .unwrap()
        .filter_map(|entry| entry.ok()?.file_name().into_string().ok())
        .filter(|name| name.starts_with("model_"))
        .count()
}

#[test]
fn a_model_at_its_bounds_or_of_too_few_points_is_no_result_of_run_or_fit() {
    let sound = told(alone(7));
    assert_eq!(sound.code, 0, "{}", sound.words);
    let refused = sound.words.contains("no model with 1 RC: R");
    assert!(
        refused && !sound.words.contains("1 RC: R ") && models(&sound.files) == 0,
        "{}",
        sound.words
    );
    let few = told(alone(2));
    let words = "no model with 1 RC: fit: 1 RC branches have 3 parameters and need as many points, \
    met 2 distinct frequencies";
    assert!(
        few.words.contains(words) && models(&few.files) == 0,
        "{}",
        few.words
    );
}

#[test]
fn points_that_are_let_through_beside_many_that_are_refused_are_refused_and_give_no_model() {
    let files = with_controls(7).append(EXPERIMENT, "[eis.quality]\nagain = 0");
    // 18° at 300 Hz.
    let fault = format!("{}\nlate_s = 1.67e-4", channel(BETWEEN_S, 4, 1.0));
    let told = told(faulty(files, &fault));
    let rows = told.files.text("run/spectrum.csv");
    let believed = rows
        .lines()
        .skip(1)
        .filter(|row| row.ends_with(','))
        .count();
    assert_eq!(
        (told.code, believed, models(&told.files)),
        (11, 0, 0),
        "{rows}\n{}",
        told.words
    );
}
