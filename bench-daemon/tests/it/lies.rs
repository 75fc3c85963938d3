//! Instruments that report wrong values: in every case no more current flows than the step
//! requests, the run ends soon, and the last message is correct.

use bench_evaluate::run::Session;
use fixtures::Witness;
use num_complex::Complex64;

use crate::support::{BENCH, CELL, EXPERIMENT, Files, SCENARIO, program, truth};

/// Result of a run, and the record of the cell.
pub(crate) struct Lived {
    pub(crate) ended: String,
    pub(crate) code: u8,
    pub(crate) witness: Witness,
    /// Current through the cell when all is over, A.
    pub(crate) left_a: f64,
    /// Bench times of the fault and of the last reading, s.
    pub(crate) happened_s: f64,
    pub(crate) over_s: f64,
    /// Corrected impedances and the true ones, Ω.
    pub(crate) points: Vec<(Complex64, Complex64)>,
}

/// Runs the experiment with one fault on one instrument from a bench time on.
pub(crate) fn live(files: &Files, (fault, role, from): (&str, &str, &str)) -> Lived {
    let faults = format!(
        "[simulation.faults]\nseed = 1\nper_message = 1.0\nmost = 1\nkinds = [\"{fault}\"]\n\
        role = \"{role}\"\nfrom = \"{from}\""
    );
    files.write(BENCH, &format!("{}\n{faults}\n", files.text(BENCH)));
    let experiment = files.load();
    let mut session = Session::new(&experiment.bench).unwrap();
    let outcome = session.run(&experiment, &files.path("run"));
    let world = session.simulation().unwrap().world();
    let points = outcome.as_ref().map_or_else(
        |_| Vec::new(),
        |finished| {
            let points = &finished.measured.spectrum.points;
            points
                .iter()
                .map(|point| point.z_ohm)
                .zip(truth(world, points))
                .collect()
        },
    );
    let (ended, code) = outcome.err().map_or_else(
        || ("finished".to_owned(), 0),
        |failure| (failure.to_string(), failure.exit_code()),
    );
    let world = world.lock().unwrap();
    let happened = session.simulation().unwrap().happened();
    let happened_s = happened
        .first()
        .unwrap_or_else(|| panic!("the fault did not happen: {ended}"))
        .time_s;
    let readings = std::fs::read_to_string(files.path("run/readings.csv")).unwrap_or_default();
    let over_s = readings
        .lines()
        .last()
        .and_then(|line| line.split(',').next()?.parse().ok())
        .unwrap_or(0.0);
    Lived {
        ended,
        code,
        witness: world.witness(),
        left_a: world.truth_current_a(),
        happened_s,
        over_s,
        points,
    }
}

#[test]
fn a_load_that_does_not_open_is_brought_to_zero_by_its_set_point() {
    let lived = live(
        &Files::brief(2).without("experiments/demo.toml", "fixture_check"),
        ("stuck_output", "load", "60 s"),
    );
    assert_eq!((lived.code, lived.left_a), (6, 0.0), "{}", lived.ended);
    let words = "LOOK AT THE BENCH: the load (siglent-sdl1000x) does not say that it is off; its \
    own meter shows 0.00 A since it was given its set-points \
                 at 0, it trips above ";
    assert!(
        lived.ended.starts_with(words) && lived.ended.contains(": UNPLUG THE LOAD FROM THE CELL"),
        "{}",
        lived.ended
    );
    assert_eq!(lived.witness.abuse, []);
}

#[test]
fn a_charger_that_does_not_go_off_is_brought_to_zero_by_its_current() {
    let files = Files::brief(2).without("experiments/demo.toml", "fixture_check");
    let lived = live(&files, ("stuck_output", "supply", "0 s"));
    assert_eq!((lived.code, lived.left_a), (6, 0.0), "{}", lived.ended);
    assert!(
        lived
            .ended
            .contains("the charger (siglent-spd3303x) does not say that it is off"),
        "{}",
        lived.ended
    );
    assert!(
        lived
            .ended
            .contains("since it was given its current at 0, it is limited to "),
        "{}",
        lived.ended
    );
    assert_eq!(lived.witness.abuse, []);
}

/// Single faults of the wire: an answer that is late by 3 s, a reset, a connection that is dropped,
/// an answer that is lost or garbled.
const PASSING: [&str; 5] = ["too_late", "reset", "half_close", "lose_reply", "garble"];
const ROLES: [&str; 5] = ["supply4q", "generator", "scope", "load", "logger"];

/// `EIS_BENCH_PASSING=100` runs this number instead of the five in continuous integration.
#[test]
#[ignore = "drill"]
fn a_fault_of_the_wire_in_a_sweep_ends_in_a_finished_right_spectrum() {
    let count: usize = std::env::var("EIS_BENCH_PASSING").map_or(5, |count| count.parse().unwrap());
    let (mut resumed, mut worst, mut faults) = (0, 0.0_f64, std::collections::BTreeMap::new());
    for number in 0..count {
        let (fault, role) = (PASSING[number % 5], ROLES[(number + number / 5) % 5]);
        // Within the sweep of the cell, which lasts from 9 s to 25 s.
        let from = format!("{:.2} s", 9.0 + 15.0 * (number as f64 * 0.618_034).fract());
        let files = Files::short(3);
        let lived = live(&files, (fault, role, &from));
        assert_eq!(
            lived.code, 0,
            "{fault} of {role} from {from}: {}",
            lived.ended
        );
        assert_eq!(
            (lived.points.len(), lived.left_a, lived.witness.abuse.len()),
            (3, 0.0, 0),
            "{fault} of {role} from {from}"
        );
        worst = lived
            .points
            .iter()
            .map(|(met, truth)| (met / truth - 1.0).norm())
            .fold(worst, f64::max);
        assert!(
            worst < 0.01,
            "{fault} of {role} from {from}: {:?}",
            lived.points
        );
        resumed += usize::from(
            files
                .text("run/report.html")
                .contains("went on by itself (1 of 5 for faults that pass) after: "),
        );
        *faults.entry(fault).or_insert(0) += 1;
    }
    println!(
        "{count} faults of the wire {faults:?}: all finished, {resumed} went on by themselves, \
        worst point {:.3} % off",
        100.0 * worst
    );
    // Faults that the link corrects automatically are not reported; the others are.
    assert!(resumed >= count / 3, "{resumed}");
}

#[test]
fn a_thermometer_that_freezes_in_a_sweep_is_named_within_two_minutes() {
    let files = Files::short(40).edit(EXPERIMENT, "start = \"100 Hz\"", "start = \"0.1 Hz\"");
    let lived = live(&files, ("frozen_meter", "logger", "400 s"));
    let words = [
        "cell temperature: the last ",
        " readings of the logger are all ",
        "although its readings before went up and down by noise",
    ];
    assert!(
        words.iter().all(|word| lived.ended.contains(word)),
        "{}",
        lived.ended
    );
    assert_eq!((lived.code, lived.left_a), (3, 0.0), "{}", lived.ended);
    let took_s = lived.over_s - lived.happened_s;
    assert!(took_s < 120.0, "{took_s} s");
}

#[test]
fn a_bath_that_somebody_else_sets_to_70_degrees_is_named_at_the_next_readings() {
    let files = Files::demo().without(EXPERIMENT, "fixture_check");
    let lived = live(
        &files,
        ("second_client", "chiller", "900 s\"\nvariant = 0 #"),
    );
    let words = "chiller: its set-point is 70 °C, this run set 25 °C: another client, a hand at \
    its panel, or a protection?";
    assert!(lived.ended.contains(words), "{}", lived.ended);
    assert!(
        lived.code == 3 && lived.over_s - lived.happened_s < 15.0,
        "{} s",
        lived.over_s - lived.happened_s
    );
    // It is unknown where the temperature of this bath goes, so the bath is stopped.
    let notes = files.text("run/events.csv");
    assert!(
        notes.contains(
            "the bath was stopped, read back, for its set-point is 70 °C, this run set 25 °C"
        ),
        "{notes}"
    );
}

#[test]
fn two_voltmeters_of_a_cell_that_differ_are_both_named() {
    // The load has frozen, and shows no noise; the charger sees its own terminals rise.
    let files = Files::brief(2)
        .without(EXPERIMENT, "fixture_check")
        .edit(
            CELL,
            "frozen_charge = \"1 %\"",
            "frozen_charge = \"1000 %\"",
        )
        .append(SCENARIO, "[meters]\nnoise_v = 0.0");
    let lived = live(&files, ("frozen_meter", "load", "700 s"));
    assert!(
        lived.ended.contains("cell voltage: charger's terminals ")
            && lived.ended.contains(" V, voltmeter 3."),
        "{}",
        lived.ended
    );
    assert_eq!(
        (lived.code, lived.left_a, lived.witness.abuse.len()),
        (3, 0.0, 0),
        "{}",
        lived.ended
    );
}

#[test]
fn a_direct_current_that_comes_up_in_a_fast_sweep_ends_it_soon() {
    let files = Files::short(60).without(EXPERIMENT, "fixture_check");
    let lived = live(&files, ("offset_drift", "supply4q", "10 s"));
    assert!(
        lived
            .ended
            .starts_with("interlock: change of the mean of the cell current "),
        "{}",
        lived.ended
    );
    assert_eq!((lived.code, lived.left_a), (5, 0.0), "{}", lived.ended);
    // A fiftieth of an ampere a second: 0.1 A are there after 5 s, and 0.2 A, from which on the
    // current is beyond the step, after 10 s.
    assert!(
        lived.over_s - lived.happened_s < 10.0,
        "{} s",
        lived.over_s - lived.happened_s
    );
}

/// Another client switches on an instrument that the step does not use: its current does not pass
/// the step's own instrument, and is still detected.
#[test]
fn a_load_that_sinks_beside_a_charge_and_a_charger_that_feeds_beside_a_sweep_are_seen() {
    let reset = Files::brief(2).without(EXPERIMENT, "fixture_check");
    let sweep = Files::short(60).without(EXPERIMENT, "fixture_check");
    for (files, role, from_s, words) in [
        (&reset, "load", 700, "interlock: current of the load "),
        (&reset, "supply", 60, "interlock: current of the charger "),
        (&sweep, "supply", 20, "interlock: current of the charger "),
    ] {
        let bench = files.text(BENCH);
        let lived = live(
            files,
            (
                "second_client",
                role,
                &format!("{from_s} s\"\nvariant = 1 #"),
            ),
        );
        files.write(BENCH, &bench);
        std::fs::remove_dir_all(files.path("run")).unwrap();
        assert!(
            lived.ended.starts_with(words),
            "{role} from {from_s} s: {}",
            lived.ended
        );
        assert_eq!(
            (lived.code, lived.left_a, lived.witness.abuse.len()),
            (5, 0.0, 0),
            "{role}: {}",
            lived.ended
        );
        assert!(
            lived.over_s - lived.happened_s < 3.0,
            "{role} from {from_s} s: {} s",
            lived.over_s - lived.happened_s
        );
    }
}

#[test]
fn the_plan_says_of_each_model_what_ends_without_a_message_and_what_has_no_second_way_to_zero() {
    let plan = |files: &Files| {
        program(&["plan".as_ref(), files.experiment().as_os_str()])
            .expect_code(0)
            .stdout
            .clone()
    };
    let text = plan(&Files::brief(2));
    assert!(
        text.contains(
            "without a further message the load (siglent-sdl1000x) stops by itself \
    at 2.5 V or above"
        ),
        "{text}"
    );
    assert!(
        text.contains(
            "without a further message the charger (siglent-spd3303x) holds 4.2 V or \
    less, and its current falls"
        ),
        "{text}"
    );
    assert!(!text.contains("no second way to zero"), "{text}");
    let files = Files::brief(2)
        .edit(BENCH, "\"siglent-sdl1000x\"", "\"rigol-dl3000\"")
        .edit(BENCH, "\"kepco-bop-mg\"", "\"kepco-bop-linear\"");
    let text = plan(&files);
    let known = "without a further message nothing that is known ends the current of the load \
    (rigol-dl3000): only the daemon and the guardian do";
    assert!(
        text.contains(known) && !text.contains("the load (rigol-dl3000) stops"),
        "{text}"
    );
    assert!(
        text.contains(
            "the bipolar supply (kepco-bop-linear) has no second way to zero: it \
    follows its analog input."
        ),
        "{text}"
    );
}
