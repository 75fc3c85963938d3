//! Benches that measure wrong numbers: no run ends with exit code 0 and a number without a flag,
//! and the message names the cause. Sound benches are not refused.

use bench_core::safety::failure::Failure;
use bench_daemon::command::run::run_experiment;

use crate::support::{BENCH, EXPERIMENT, Files, SCENARIO, program};

/// Result of a run: its exit code, and everything that it reports about its results.
struct RunResult {
    code: u8,
    words: String,
    files: Files,
}

fn run_result(files: Files) -> RunResult {
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
    RunResult { code, words, files }
}

/// Controls, and the cell from 3 Hz to 300 Hz.
fn with_controls(points: usize) -> Files {
    Files::short(points).edit(EXPERIMENT, "start = \"100 Hz\"", "start = \"3 Hz\"")
}

/// Returns files with the cell alone.
fn alone(points: usize) -> Files {
    with_controls(points).without(EXPERIMENT, "fixture_check")
}

/// Bench time at which the controls are done and the cell is not yet measured, s.
const BETWEEN_S: f64 = 30.0;
/// The time with seven points.
const CELL_OF_7_S: f64 = 54.0;

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

/// Returns files with a larger current, at which the meter of the supply allows this offset.
fn strong(files: Files) -> Files {
    files.edit(EXPERIMENT, "amplitude = \"1 A\"", "amplitude = \"3 A\"")
}

const DEAD: &str = "C3 shows nothing of the sinusoid: its lead is off, or the channel is dead";
const ONE_TWO: &str = "the leads of C1 and C2 are exchanged";
const ONE_THREE: &str = "the leads of C1 and C3 are exchanged";
const AGAIN: &str = "the scope repeats an old record";
const OLDER: &str = "Hz in the record: is it an older one?";
const SINCE_ZERO: &str = "interlock: mean of the cell current since the zero of the channels";
const FACTOR: &str = "C3 reads 10 times its voltage: its probe factor is wrong";

#[test]
fn wrong_numbers_are_refused_and_the_channel_or_the_scope_is_named() {
    let late = "[faults.scope_repeats]\nfrom_s = 0.0\nlate = true";
    let repeats = "[faults.scope_repeats]\nfrom_s = 0.0";
    let later = format!("[faults.scope_repeats]\nfrom_s = {BETWEEN_S}\nlate = true");
    let first = BETWEEN_S;
    let cases = [
        ("C3 dead", with_controls(3), channel(first, 3, 0.0), DEAD, 3),
        ("C3 dead, alone", alone(2), channel(0.0, 3, 0.0), DEAD, 3),
        (
            "C3 at 10",
            with_controls(3),
            channel(first, 3, 10.0),
            FACTOR,
            3,
        ),
        (
            "C3 at 10, alone",
            alone(2),
            channel(0.0, 3, 10.0),
            FACTOR,
            3,
        ),
        (
            "C1 C2",
            with_controls(3),
            probes(first, [2, 1, 3, 4]),
            ONE_TWO,
            3,
        ),
        (
            "C1 C2, alone",
            alone(2),
            probes(0.0, [2, 1, 3, 4]),
            ONE_TWO,
            3,
        ),
        (
            "C1 C3",
            with_controls(3),
            probes(first, [3, 2, 1, 4]),
            ONE_THREE,
            3,
        ),
        (
            "C1 C3, alone",
            alone(2),
            probes(0.0, [3, 2, 1, 4]),
            ONE_THREE,
            3,
        ),
        ("repeats", alone(3), repeats.to_owned(), AGAIN, 3),
        ("previous", alone(3), late.to_owned(), AGAIN, 3),
        ("previous, later", with_controls(4), later, OLDER, 3),
        (
            "offset, alone",
            strong(alone(3)),
            offset(0.0),
            SINCE_ZERO,
            5,
        ),
        (
            "offset",
            strong(with_controls(3)),
            offset(first),
            SINCE_ZERO,
            5,
        ),
    ];
    let mut wrong = Vec::new();
    for (name, files, fault, cause, code) in cases {
        let result = run_result(faulty(files, &fault));
        if result.code != code || !result.words.contains(cause) {
            wrong.push(format!("{name}: code {}: {}", result.code, result.words));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// Returns the number of models in a run folder.
fn models(files: &Files) -> usize {
    std::fs::read_dir(files.path("run"))
        .unwrap()
        .filter_map(|entry| entry.ok()?.file_name().into_string().ok())
        .filter(|name| name.starts_with("model_"))
        .count()
}

#[test]
fn a_model_at_its_bounds_or_of_too_few_points_is_not_a_result_of_run_or_fit() {
    let sound = run_result(alone(7));
    assert_eq!(sound.code, 0, "{}", sound.words);
    let refused = sound.words.contains("no model with 1 RC: R");
    assert!(
        refused && !sound.words.contains("DC resistance") && models(&sound.files) == 0,
        "{}",
        sound.words
    );
    let few = run_result(alone(2));
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
    let files = with_controls(7).append(EXPERIMENT, "[eis.quality]\nagain = 1");
    // Some 18° at every frequency: 100 of 10 000 samples of five periods.
    let fault = format!("{}\nlate_samples = 100.0", channel(CELL_OF_7_S, 4, 1.0));
    let result = run_result(faulty(files, &fault));
    let rows = result.files.text("run/spectrum.csv");
    let believed = rows
        .lines()
        .skip(1)
        .filter(|row| row.ends_with(','))
        .count();
    assert!(rows.contains("refused neighbours"), "{rows}");
    assert_eq!(
        (result.code, believed, models(&result.files)),
        (11, 0, 0),
        "{rows}\n{}",
        result.words
    );
    // The recomputed results of the captures get the same verdict.
    let again = result.files.path("again");
    let ended = program(&[
        "replay".as_ref(),
        result.files.path("run").as_os_str(),
        "--out".as_ref(),
        again.as_os_str(),
    ]);
    ended.expect_code(11);
    let again = result.files.text("again/spectrum.csv");
    assert_eq!(
        again.matches("refused neighbours").count(),
        rows.matches("refused neighbours").count(),
        "{again}"
    );
}

#[test]
fn a_zero_of_the_scope_that_has_moved_since_the_controls_is_a_note_and_no_current() {
    let moved = "[effects.after_controls]\nshunt_zero_v_per_h = 0.1";
    let result = run_result(faulty(with_controls(7), moved));
    assert_eq!(result.code, 0, "{}", result.words);
    let note = "note: the zero of C1 and C2 moved by ";
    assert!(result.words.contains(note), "{}", result.words);
}

/// Sound benches: with controls, alone, the accurate one, a second one; some noise levels.
fn sound(number: u64) -> Files {
    let noise = ["1.0e-4", "3.0e-4", "1.0e-3"][(number / 5 % 3) as usize];
    let gate = "[eis.quality]\nnoise = \"2 %\"\nagain = 2";
    let files = match number % 5 {
        0 => with_controls(7).append(EXPERIMENT, gate),
        1 => alone(7).append(EXPERIMENT, gate),
        2 => strong(with_controls(7)),
        3 => {
            let files = with_controls(5);
            let bench = crate::configuration::configs().join("benches/second.toml");
            files.write(BENCH, &std::fs::read_to_string(bench).unwrap());
            files
        }
        _ => with_controls(9).edit(EXPERIMENT, "start = \"3 Hz\"", "start = \"0.5 Hz\""),
    };
    files
        .edit(EXPERIMENT, "seed = 1", &format!("seed = {}", 1000 + number))
        .append(SCENARIO, &format!("[harness]\nnoise_fraction = {noise}"))
}

/// Executes 40 sound runs, or the number in `EIS_BENCH_SOUND`.
#[test]
#[ignore = "drill"]
fn no_sound_bench_is_refused_or_flagged() {
    let count: u64 = std::env::var("EIS_BENCH_SOUND").map_or(40, |count| count.parse().unwrap());
    let mut flagged = Vec::new();
    let mut no_model = 0;
    for number in 0..count {
        let result = run_result(sound(number));
        no_model += u64::from(result.words.contains("no model with"));
        let noted = ["flagged by the quality gate", "the zero of C1 and C2 moved"];
        if result.code != 0 || noted.iter().any(|words| result.words.contains(words)) {
            flagged.push(format!(
                "run {number}: code {}: {}",
                result.code, result.words
            ));
        }
    }
    // Clopper and Pearson's bound for zero events; exact if none is flagged.
    let most = 1.0 - 0.05_f64.powf(1.0 / count as f64);
    println!(
        "{count} sound runs, {} flagged; 95 % upper bound of the rate where none is: {:.2} %; {} \
        runs without one of their models",
        flagged.len(),
        100.0 * most,
        no_model
    );
    assert!(flagged.is_empty(), "{}", flagged.join("\n"));
}
