//! Seeded faults of every instrument of a bench during a short sweep. In every case the run
//! completes or ends with a named cause, the outputs are off, the cell was never harmed, and no
//! wrong impedance passes without a remark.
//!
//! `EIS_BENCH_BAD_DAYS=10000` runs this number of schedules instead of the share in continuous
//! integration, `EIS_BENCH_BAD_DAYS=5000..10000` those of these seeds.

use std::{collections::BTreeMap, path::Path};

use bench_evaluate::run::Session;
use bench_plan::config::Experiment;
use fixtures::witness::AbuseKind;
use instruments::mock::{Fault, Happened, Schedule};

use crate::support::{Files, truth};

/// Greatest duration of a short sweep including all repetitions and attempts to switch off, bench
/// s.
const BOUND_S: f64 = 3600.0;
/// Greatest error of a point, Ω/Ω: the bench's own uncertainty is a thousandth.
const OFF: f64 = 0.01;

/// Current that the meters may miss, A.
const NOTHING_A: f64 = 0.1;

/// Checks whether a fault prevents the verification of a bench.
fn lies_about_its_output(fault: Fault) -> bool {
    matches!(
        fault,
        Fault::StuckOutput | Fault::FrozenMeter | Fault::Lagging
    )
}

/// Result of one day.
struct Day {
    ended: &'static str,
    text: String,
    happened: Vec<Happened>,
    /// Violations, as text.
    wrong: Vec<String>,
}

fn day(experiment: &Experiment, folder: &Path, seed: u64) -> Day {
    let mut experiment = experiment.clone();
    let faults = Fault::ALL.into_iter().chain(Fault::LIES).collect();
    let schedule = Schedule {
        seed,
        per_message: 2e-3,
        most: 3,
        faults,
        ..Schedule::default()
    };
    if let Some(simulation) = &mut experiment.bench.simulation {
        simulation.faults = Some(schedule);
    }
    let run = folder.join(seed.to_string());
    let mut session = Session::new(&experiment.bench).unwrap();
    let outcome = session.run(&experiment, &run);
    let simulation = session.simulation().unwrap();
    let mut wrong = Vec::new();
    let (ended, text) = match &outcome {
        Ok(finished) => {
            let points = &finished.measured.spectrum.points;
            for (point, truth) in points.iter().zip(truth(simulation.world(), points)) {
                let off = (point.z_ohm / truth - 1.0).norm();
                if off > OFF
                    && !finished
                        .summary
                        .contains(&format!("{:.4} Hz", point.freq_hz))
                {
                    wrong.push(format!(
                        "{} Hz off by {off:.4} without a remark",
                        point.freq_hz
                    ));
                }
            }
            ("finished", String::new())
        }
        Err(failure) if failure.to_string().starts_with("LOOK AT THE BENCH: ") => {
            ("unsafe", failure.to_string())
        }
        Err(failure) => ("stopped", failure.to_string()),
    };
    if ended == "stopped" && text.len() < 20 {
        wrong.push(format!("no cause: {text:?}"));
    }
    let world = simulation.world().lock().unwrap();
    let left_a = world.truth_current_a();
    let lies = simulation
        .happened()
        .iter()
        .any(|happened| lies_about_its_output(happened.fault));
    // A current that another client drives before the run has begun is not due to the run, which
    // has changed nothing.
    let refused = text.starts_with("expected every output off at the beginning")
        && simulation
            .happened()
            .iter()
            .any(|happened| happened.fault == Fault::SecondClient);
    // An output that does not go off, or a meter that does not change, cannot be verified, but it
    // carries no current.
    if !refused && left_a.abs() > if lies { NOTHING_A } else { 0.0 } {
        wrong.push(format!("{left_a} A still flow"));
    }
    if ended == "unsafe" && !lies {
        wrong.push("not verified".to_owned());
    }
    wrong.extend(
        world
            .witness()
            .abuse
            .iter()
            .map(|abuse| format!("the cell: {abuse:?}")),
    );
    if session.now_s() > BOUND_S {
        wrong.push(format!("{} s", session.now_s()));
    }
    std::fs::remove_dir_all(&run).unwrap();
    Day {
        ended,
        text,
        happened: simulation.happened(),
        wrong,
    }
}

#[test]
#[ignore = "long drill"]
fn every_bad_day_ends_finished_or_with_a_cause_in_safe_state() {
    let wanted = std::env::var("EIS_BENCH_BAD_DAYS").unwrap_or_else(|_| "40".to_owned());
    let (first, end) = wanted.split_once("..").unwrap_or(("0", &wanted));
    let (first, end): (u64, u64) = (first.parse().unwrap(), end.parse().unwrap());
    let days = end - first;
    let files = Files::short(3);
    let experiment = files.load();
    let mut ends: BTreeMap<&str, usize> = BTreeMap::new();
    let mut faults: BTreeMap<String, usize> = BTreeMap::new();
    let mut wrong = Vec::new();
    for seed in first..end {
        let day = day(&experiment, &files.path("days"), seed);
        // A run that could not begin has no folder.
        let _ = std::fs::remove_dir_all(files.path("days").join(seed.to_string()));
        *ends.entry(day.ended).or_default() += 1;
        for happened in &day.happened {
            *faults.entry(format!("{:?}", happened.fault)).or_default() += 1;
        }
        let descriptions = || {
            day.happened.iter().map(|happened| {
                format!(
                    "{:?} of {}: {}",
                    happened.fault, happened.model, happened.message
                )
            })
        };
        if !day.wrong.is_empty() {
            wrong.push(format!(
                "seed {seed}, {}: {:?} {} after {:?}",
                day.ended,
                day.wrong,
                day.text,
                descriptions().collect::<Vec<_>>()
            ));
        }
    }
    println!(
        "bad days, seeds {first} to {}: {ends:?}; faults {faults:?}",
        end - 1
    );
    assert!(
        wrong.is_empty(),
        "{} of {days}:\n{}",
        wrong.len(),
        wrong.join("\n")
    );
    assert!(
        faults.values().sum::<usize>() > usize::try_from(days).unwrap() / 2,
        "{faults:?}"
    );
}

/// Readings that verify that the load is off: two, of voltage and current.
const VERIFYING: usize = 4;

/// Returns the messages to the load: a client that changes nothing is logged at every message.
fn messages_to_the_load(experiment: &Experiment, folder: &Path) -> Vec<Happened> {
    with_second_client(experiment, folder, usize::MAX, (usize::MAX, 0.0)).1
}

/// Runs with a second client at the load that does `variant` from a bench time on, up to a given
/// number of times.
fn with_second_client(
    experiment: &Experiment,
    folder: &Path,
    most: usize,
    (variant, from_s): (usize, f64),
) -> (Vec<AbuseKind>, Vec<Happened>) {
    let mut experiment = experiment.clone();
    let schedule = Schedule {
        per_message: 1.0,
        most,
        faults: vec![Fault::SecondClient],
        role: Some("load".to_owned()),
        from_s,
        variant: Some(variant),
        ..Schedule::default()
    };
    if let Some(simulation) = &mut experiment.bench.simulation {
        simulation.faults = Some(schedule);
    }
    let mut session = Session::new(&experiment.bench).unwrap();
    // Another test checks how it ends: a load that is on at the wrong moment may stop the run.
    let _ = session.run(&experiment, folder);
    std::fs::remove_dir_all(folder).unwrap();
    let simulation = session.simulation().unwrap();
    let abuse = simulation
        .world()
        .lock()
        .unwrap()
        .witness()
        .abuse
        .iter()
        .map(|abuse| abuse.kind)
        .collect();
    (abuse, simulation.happened())
}

#[test]
#[ignore = "long drill"]
fn a_load_switched_on_by_another_client_is_off_again_before_anything_is_mounted() {
    let files = Files::short(2);
    let experiment = files.load();
    let all = messages_to_the_load(&experiment, &files.path("all"));
    let verified = all
        .iter()
        .enumerate()
        .filter(|(_, happened)| happened.message == ":INP?")
        .map(|(at, _)| at);
    let readings: Vec<f64> = verified
        .flat_map(|at| all.iter().skip(at + 1).take(VERIFYING))
        .map(|happened| happened.time_s)
        .collect();
    let abuse =
        |from_s: &f64| with_second_client(&experiment, &files.path("run"), 1, (1, *from_s)).0;
    let live: Vec<_> = readings
        .iter()
        .filter(|from_s| abuse(from_s).contains(&AbuseKind::LiveMount))
        .collect();
    assert!(readings.len() >= 3 * VERIFYING, "{readings:?}");
    assert!(live.is_empty(), "{live:?}");
}
