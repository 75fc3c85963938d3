//! Thermometers that are frozen from the start, or swapped with that of the air: the run ends with
//! the cause before the cell is hot. Sound thermometers do not end a run.

use bench_evaluate::run::Session;

use crate::support::{BENCH, EXPERIMENT, Files, SCENARIO};

/// How a brief run ended, with its code, and the greatest temperature of the cell, °C.
fn ended(files: &Files) -> (String, u8, f64) {
    let experiment = files.load();
    let mut session = Session::new(&experiment.bench).unwrap();
    let outcome = session.run(&experiment, &files.path("run"));
    let world = session.simulation().unwrap().world();
    let greatest_degc = world.lock().unwrap().witness().greatest_degc;
    match outcome {
        Ok(_) => (String::new(), 0, greatest_degc),
        Err(failure) => (failure.to_string(), failure.exit_code(), greatest_degc),
    }
}

fn brief() -> Files {
    Files::brief(2).without(EXPERIMENT, "fixture_check")
}

#[test]
fn frozen_and_swapped_thermometers_end_the_run_with_their_cause() {
    let heater = "heater = { from_s = 100.0, watts = 12.0 }";
    // A sweep moves no net charge, which would reveal a thermometer that does not change.
    let sweep = || {
        Files::demo()
            .without(EXPERIMENT, "temperature")
            .without(EXPERIMENT, "fixture_check")
            .without(EXPERIMENT, "soc_reset")
    };
    for (files, fault, words) in [
        (
            sweep(),
            "thermometer_freezes_s = 0.0",
            "interlock: thermometer: that of the cell has read 2",
        ),
        (
            brief(),
            "thermometer_freezes_s = 0.0",
            "charge while the cell temperature stood still",
        ),
        (
            sweep(),
            "thermometers_swapped_s = 0.0",
            "are the two swapped?",
        ),
        (
            brief(),
            "thermometers_swapped_s = 0.0",
            "are the two swapped?",
        ),
    ] {
        let files = files.append(SCENARIO, &format!("[faults]\n{fault}\n{heater}"));
        let (text, code, greatest_degc) = ended(&files);
        assert!(text.contains(words), "{fault}: {text}");
        assert_eq!(code, 5, "{text}");
        assert!(greatest_degc < 60.0, "{text}: {greatest_degc} °C");
    }
}

#[test]
fn a_frozen_thermometer_is_named_while_the_bath_goes_to_its_set_point() {
    let files = Files::demo()
        .without(EXPERIMENT, "fixture_check")
        .without(EXPERIMENT, "soc_reset")
        .edit(EXPERIMENT, "setpoint = \"25 °C\"", "setpoint = \"40 °C\"")
        .append(SCENARIO, "[faults]\nthermometer_freezes_s = 0.0");
    let (text, code, _) = ended(&files);
    assert!(text.contains("it is frozen"), "{text}");
    assert_eq!(code, 5, "{text}");
}

#[test]
fn sound_thermometers_with_and_without_noise_pass() {
    for meters in ["", "[meters]\nnoise_k = 0.0\noffset_k = 0.0"] {
        for seed in 1..=3 {
            let files = brief()
                .edit(EXPERIMENT, "seed = 1", &format!("seed = {seed}"))
                .append(SCENARIO, meters);
            let (text, code, _) = ended(&files);
            assert_eq!((text.as_str(), code), ("", 0), "{meters} {seed}");
        }
        let held = Files::demo()
            .without(EXPERIMENT, "fixture_check")
            .without(EXPERIMENT, "soc_reset")
            .edit(EXPERIMENT, "start = \"0.1 Hz\"", "start = \"10 Hz\"")
            .edit(EXPERIMENT, "points = 20", "points = 4")
            .edit(EXPERIMENT, "rc = [1, 2, 3, 4]", "rc = [1]")
            .edit(EXPERIMENT, "setpoint = \"25 °C\"", "setpoint = \"40 °C\"")
            .edit(EXPERIMENT, "within = \"0.2 K\"", "within = \"2 K\"")
            .append(SCENARIO, meters)
            .append(BENCH, "");
        let (text, code, _) = ended(&held);
        assert_eq!((text.as_str(), code), ("", 0), "{meters}");
    }
}
