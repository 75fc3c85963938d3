//! The open-circuit voltage over the state of charge on the simulated bench, against its truth.

use analysis::{dataset::read_legs_csv, ocv::OcvCurve};
use bench_daemon::command::run::run_experiment;
use bench_evaluate::run::Finished;
use bench_plan::config::{Experiment, load_experiment};

use instruments::units::Ohms;

use crate::support::{EXPERIMENT, Files, Ports, json, poll, program};

fn experiment() -> Experiment {
    load_experiment(
        &crate::configuration::configs().join("experiments/ocv.toml"),
        None,
    )
    .unwrap()
}

/// Returns the curve of a run and its greatest distance from the truth over 5 % to 95 %, V.
fn worst_v(finished: &Finished, folder: &std::path::Path) -> (OcvCurve, f64) {
    let curve: OcvCurve = serde_json::from_value(json(&folder.join("ocv.json"))).unwrap();
    let world = finished
        .simulation
        .as_ref()
        .unwrap()
        .world()
        .lock()
        .unwrap();
    let off = |k: i32| {
        let soc = f64::from(k) / 100.0;
        // The inverse of the true curve gives the same values without access to the true curve
        // itself.
        let found_v = curve.voltage_v(soc);
        (world.truth_soc_at(found_v) - soc).abs() * curve.slope_v(soc)
    };
    let worst = (5..=95).map(off).fold(0.0, f64::max);
    (curve, worst)
}

#[test]
#[ignore = "long drill"]
fn the_curve_is_the_truth_within_two_millivolts_and_the_interruptions_tell_the_resistance() {
    let folder = tempfile::tempdir().unwrap();
    let run = folder.path().join("run");
    let finished = run_experiment(&experiment(), &run).unwrap();
    let (curve, worst) = worst_v(&finished, &run);
    assert!(worst < 2.0e-3, "off by {worst} V: {}", finished.summary);
    assert!(
        (curve.capacity_ah / 4.5 - 1.0).abs() < 2.0e-3,
        "{}",
        curve.capacity_ah
    );
    // The cell's 13.8 mΩ and the wire that the load's terminals see, within the spread of the wire.
    let found = json(&run.join("ocv_found.json"));
    let dcir_ohm = found["extraction"]["dcir_ohm"].as_f64().unwrap();
    assert!((0.0250..0.0265).contains(&dcir_ohm), "{dcir_ohm}");
    assert_eq!(
        (
            found["interruptions"].as_array().unwrap().len(),
            found["monotone"].as_bool()
        ),
        (10, Some(true))
    );
    let report = std::fs::read_to_string(run.join("report.html")).unwrap();
    assert!(report.contains("<svg") && report.contains("Interruptions of the discharge"));
    assert!(run.join("plots/ocv.svg").exists() && !run.join("ocv.svg").exists());
    // This cell has no hidden hysteresis: none is found beyond the uncertainty of the curve.
    let half_v = found["extraction"]["charge"]["median_v"].as_f64().unwrap();
    assert!(half_v.abs() < 2.0e-3, "{half_v}");
    let down = read_legs_csv(&run.join("ocv_discharge.bdf.csv")).unwrap();
    let drawn_coulomb = -down.last().unwrap().charge_coulomb;
    assert!(
        (drawn_coulomb / 16_200.0 - 1.0).abs() < 5.0e-3,
        "{drawn_coulomb} C"
    );
    let witness = finished
        .simulation
        .as_ref()
        .unwrap()
        .world()
        .lock()
        .unwrap()
        .witness();
    assert_eq!(witness.abuse_count, 0, "{witness:?}");
}

#[test]
#[ignore = "long drill"]
fn the_data_sheets_resistance_leaves_what_it_misses() {
    let mut experiment = experiment();
    let ocv = experiment.ocv_soc.as_mut().unwrap();
    (ocv.dcir_ohm, ocv.interruptions, ocv.both_directions) = (Some(Ohms(0.015)), 0, false);
    let folder = tempfile::tempdir().unwrap();
    let run = folder.path().join("run");
    let finished = run_experiment(&experiment, &run).unwrap();
    let (_, worst) = worst_v(&finished, &run);
    // 26 mΩ less 15 mΩ at 1 A.
    assert!((0.008..0.016).contains(&worst), "off by {worst} V");
    assert!(
        finished
            .summary
            .contains("OCV: compensated by 15.00 mΩ; 1 interruptions show"),
        "{}",
        finished.summary
    );
    assert!(
        finished
            .summary
            .contains("note: OCV: ocv_soc.dcir is 15.00 mΩ, and 1 interruptions show "),
        "{}",
        finished.summary
    );
}

#[test]
fn an_abort_within_a_leg_of_hours_is_handled_within_seconds() {
    let files = Files::demo();
    let text = files.text(EXPERIMENT);
    let ocv = std::fs::read_to_string(crate::configuration::configs().join("experiments/ocv.toml"))
        .unwrap();
    let head = text
        .lines()
        .take_while(|line| !line.starts_with('['))
        .collect::<Vec<_>>()
        .join("\n");
    let section = &ocv[ocv.find("[ocv_soc]").unwrap()..];
    files.write(EXPERIMENT, &format!("{head}\n{section}"));
    let ports = Ports::serve(&files, 20.0, 1);
    let run = files.path("aborted");
    let mut child = crate::kill::start(&files, &run, &[]);
    poll("a leg", || {
        assert!(child.0.try_wait().unwrap().is_none());
        std::fs::read_to_string(run.join("events.csv"))
            .ok()
            .filter(|events| events.contains("into ocv_"))
            .map(|_| ())
    });
    program(&["abort".as_ref(), run.as_os_str()]).expect_code(0);
    let (code, text) = crate::kill::end(child);
    assert_eq!(code, Some(130), "{text}");
    ports.assert_outputs_off();
    assert_eq!(ports.world.lock().unwrap().witness().abuse, []);
}
