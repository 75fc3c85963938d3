//! Options of a sweep on the simulated bench: any order, up and down on a cell that changes,
//! several amplitudes; and the valid frequency range of the bench.

use std::fs;

use analysis::dataset::RunIndex;
use bench_daemon::command::run::run_experiment;
use bench_evaluate::run::Finished;
use instruments::transcript::{Direction, Payload, Record};

use crate::support::{EXPERIMENT, Files, SCENARIO, json, transcript};

fn run(files: &Files) -> Finished {
    run_experiment(&files.load(), &files.path("run")).unwrap()
}

/// Returns files with a sweep of the cell from 1 Hz to 300 Hz with more lines in `[eis]`.
fn swept(points: usize, eis: &str) -> Files {
    Files::short(points)
        .edit(EXPERIMENT, "start = \"100 Hz\"", "start = \"1 Hz\"")
        .edit(
            EXPERIMENT,
            "amplitude = \"1 A\"",
            &format!("amplitude = \"1 A\"\n{eis}"),
        )
}

#[test]
#[ignore = "drill"]
fn the_order_of_the_frequencies_changes_the_way_and_not_the_spectrum() {
    let ascending = run(&swept(6, "")).measured.spectrum;
    for order in ["descending", "random", "alternating"] {
        let files = swept(6, &format!("order = \"{order}\""));
        let measured = run(&files).measured.spectrum;
        for (a, b) in ascending.points.iter().zip(&measured.points) {
            assert_eq!(a.freq_hz, b.freq_hz, "{order}");
            assert!(
                (a.z_ohm - b.z_ohm).norm() < 2.0e-3 * a.z_ohm.norm(),
                "{order}: {a:?} {b:?}"
            );
        }
        let events = fs::read_to_string(files.path("run/events.csv")).unwrap();
        let driven: Vec<&str> = events
            .lines()
            .filter(|line| line.contains("\"point "))
            .collect();
        // The twelve points of the controls come first.
        let slowest = driven[12..]
            .iter()
            .position(|line| line.contains(" 1.0000 Hz, 1 A"));
        let fastest = driven[12..]
            .iter()
            .position(|line| line.contains(" 300.0000 Hz, 1 A"));
        let expected = match order {
            "descending" => slowest == Some(5) && fastest == Some(0),
            "alternating" => slowest == Some(0) && fastest == Some(1),
            _ => slowest != Some(0) || fastest != Some(5),
        };
        assert!(expected, "{order}: {driven:#?}");
    }
}

#[test]
#[ignore = "drill"]
fn there_and_back_cancels_what_a_cell_changes_linearly() {
    // A leak takes a per mille of the charge in two seconds, and the resistances go with it; the
    // voltage at rest hardly moves.
    let flat = |files: Files| {
        let curve =
            "initial_soc = 0.60\nocv = [{ soc = 0.0, ocv_v = 3.70 }, { soc = 1.0, ocv_v = 3.80 }]";
        files.edit(SCENARIO, "initial_soc = 0.60", curve)
    };
    const CHANGES: &str = "[effects.self_discharge]\ncurrent_a = 10.0\n[effects.soc_resistance]\n\
    slope = 2.0\nreference_soc = 0.5";
    let spread = |options: &str| {
        let changing = run(&flat(swept(6, options)).append(SCENARIO, CHANGES))
            .measured
            .spectrum;
        let still = run(&flat(swept(6, options))).measured.spectrum;
        let ratio: Vec<f64> = changing
            .points
            .iter()
            .zip(&still.points)
            .map(|(a, b)| a.z_ohm.norm() / b.z_ohm.norm())
            .collect();
        let (least, greatest) = ratio
            .iter()
            .fold((f64::INFINITY, 0.0_f64), |(a, b), r| (a.min(*r), b.max(*r)));
        greatest / least - 1.0
    };
    let (once, both) = (spread(""), spread("compensate_drift = true"));
    // Up alone, the points of one sweep are of different cells.
    assert!(
        once > 4.0e-3 && both < 0.3 * once,
        "once {once}, there and back {both}"
    );
}

#[test]
#[ignore = "drill"]
fn amplitude_steps_tell_a_cell_that_is_linear_from_one_that_is_not() {
    let steps = |files: Files| {
        files
            .edit(
                EXPERIMENT,
                "amplitude = \"1 A\"",
                "amplitude = \"3 A\"\namplitude_steps = [\"3 A\", \"0.5 A\"]",
            )
            .edit(EXPERIMENT, "start = \"1 Hz\"", "start = \"2 Hz\"")
    };
    let one_branch = |files: Files| {
        files.edit(
            SCENARIO,
            "initial_soc = 0.60",
            "initial_soc = 0.60\nbranches = [{ r_ohm = 0.02, c_f = 0.05 }]",
        )
    };
    let linear = one_branch(steps(swept(3, "")));
    let finished = run(&linear);
    assert!(
        finished.summary.contains("the cell answers in proportion"),
        "{}",
        finished.summary
    );
    let index: RunIndex =
        serde_json::from_str(&fs::read_to_string(linear.path("run/traces.json")).unwrap()).unwrap();
    let groups: Vec<(f64, &str)> = index
        .sweeps
        .iter()
        .map(|sweep| (sweep.amplitude_a, sweep.repeat_group.as_str()))
        .collect();
    assert_eq!(groups, [(3.0, "eis_3A"), (0.5, "eis_0.5A")]);
    let nonlinear = one_branch(steps(swept(3, "")))
        .append(SCENARIO, "[effects.butler_volmer]\nbranch = 1\nalpha = 0.5");
    let summary = run(&nonlinear).summary;
    assert!(
        summary.contains("the cell does not answer in proportion"),
        "{summary}"
    );
}

#[test]
#[ignore = "drill"]
fn the_controls_tell_how_far_the_bench_goes_with_and_without_correction() {
    let files = swept(3, "").edit(
        EXPERIMENT,
        "corrected_tolerance = \"1 %\"",
        "corrected_tolerance = \"1 %\"\nbeyond = [\"1 kHz\", \"3 kHz\"]",
    );
    let finished = run(&files);
    let controls = json(&files.path("run/controls.json"));
    let fake = &controls[1];
    assert_eq!(fake["control"], "fake_cell");
    // The probes' pick-up is a per cent of 3.75 mΩ at 100 Hz; the correction carries it to 3 kHz.
    let as_read = &fake["believed_as_read"];
    assert!(
        as_read["believed_to_hz"].is_null() || as_read["believed_to_hz"].as_f64().unwrap() < 300.0,
        "{as_read}"
    );
    assert!(
        fake["believed"]["believed_to_hz"].as_f64().unwrap() >= 300.0,
        "{fake}"
    );
    assert!(
        controls[0]["believed"].is_null(),
        "the shunt is the correction's own reference"
    );
    assert!(
        finished
            .summary
            .contains("the bench is accurate within 1.0 % up to "),
        "{}",
        finished.summary
    );
    assert!(
        fs::read_to_string(files.path("run/report.html"))
            .unwrap()
            .contains("the bench is accurate within 1.0 %")
    );
    // Beyond the sweep nothing is judged, and the spectrum of the cell ends where it ended before.
    assert_eq!(
        finished.measured.spectrum.points.last().unwrap().freq_hz,
        300.0
    );
}

#[test]
fn the_bench_is_not_looked_at_beyond_what_its_supply_follows() {
    let files = swept(3, "").edit(
        EXPERIMENT,
        "corrected_tolerance = \"1 %\"",
        "corrected_tolerance = \"1 %\"\nbeyond = [\"1 kHz\", \"5 kHz\"]",
    );
    let refused = bench_plan::config::load_experiment(&files.experiment(), None)
        .unwrap_err()
        .to_string();
    let text = "fixture_check.beyond: expected at most 3000 Hz, up to which the bipolar supply \
    kepco-bop-mg follows its command, found 5000 Hz";
    assert!(refused.contains(text), "{refused}");
}

#[test]
#[ignore = "drill"]
fn the_bipolar_supply_goes_off_only_when_the_least_sine_has_taken_the_place_of_the_current() {
    let files = swept(2, "");
    run(&files);
    let of = |role: &str| {
        transcript(&files.path("run"), role)
            .records
            .into_iter()
            .filter(|record| record.direction == Direction::Sent)
    };
    let text = |record: Record| match record.payload {
        Payload::Text(text) => (record.time_s, text),
        Payload::Block(block) => (record.time_s, block.prefix),
    };
    let sines: Vec<(f64, String)> = of("generator")
        .map(text)
        .filter(|(_, text)| text.contains("WVTP,SINE"))
        .collect();
    let (mut on, mut ended) = (false, 0);
    for (time_s, message) in of("supply4q")
        .map(text)
        .filter(|(_, text)| text.starts_with("OUTP O"))
    {
        if message == "OUTP OFF" && std::mem::take(&mut on) {
            let (_, sine) = sines.iter().rfind(|(sent_s, _)| *sent_s < time_s).unwrap();
            assert!(
                sine.contains("AMP,0.0020,"),
                "off at {time_s} s under {sine}"
            );
            ended += 1;
        }
        on |= message == "OUTP ON";
    }
    assert!(ended >= 3, "two controls and the cell: {ended}");
}
