//! Points of a map that are chosen for loads: the list `points` of `[map]`, the experiment that
//! `map --next --write` makes, and the investigation that plays them until it ends for each reason.

use std::{fs, path::Path};

use bench_evaluate::investigate::{
    cell_map::loads::Demands,
    closed_loop::{Aims, Budget, End, MapInvestigation, Means, investigate_map},
};
use bench_plan::config::load_experiment;
use serde_json::Value;

use crate::{
    configuration::configs,
    support::{EXPERIMENT, Files, SCENARIO, json, program, project},
};

const SOC: &str = "soc = [\"90 %\", \"50 %\", \"20 %\"]\n";

/// The example on the demo's bench, with these charges or points.
fn example(points: &str) -> Files {
    let files = Files::demo();
    let text = |name: &str| fs::read_to_string(configs().join(name)).unwrap();
    let experiment = text("experiments/map.toml")
        .replace("benches/map.toml", "benches/demo.toml")
        .replace(SOC, points);
    files.write(EXPERIMENT, &experiment);
    files.write(SCENARIO, &text("scenarios/map.toml"));
    files
}

const POINTS: &str = "points = [
    { soc = \"60 %\", temperature = \"10 °C\", measure = [\"pulses\"] },
    { soc = \"30 %\", temperature = \"10 °C\" },
    { soc = \"90 %\", temperature = \"25 °C\", measure = [\"spectrum\"] },
]
";

#[test]
fn a_list_of_points_is_measured_in_its_order_with_what_each_names() {
    let files = example(POINTS);
    let experiment = files.experiment();
    let planned = program(&["plan".as_ref(), experiment.as_os_str(), "--json".as_ref()]);
    planned.expect_code(0);
    let plan: Value = serde_json::from_str(&planned.stdout).unwrap();
    let rows: Vec<String> = plan["points"]
        .as_array()
        .unwrap()
        .iter()
        .map(|row| {
            let what: Vec<&str> = row["measured"]
                .as_array()
                .unwrap()
                .iter()
                .map(|what| what.as_str().unwrap().split(' ').next().unwrap())
                .collect();
            format!("{} {} {}", row["soc"], row["temperature_c"], what.join("+"))
        })
        .collect();
    assert_eq!(
        rows,
        ["0.6 10.0 pulses", "0.3 10.0 sweep+pulses", "0.9 25.0 sweep"]
    );
    // A full charge at the beginning and at the second temperature.
    let charges = planned
        .stdout
        .matches("charge at 2.25 A, hold 4.195 V")
        .count();
    assert_eq!(charges, 2, "{}", planned.stdout);
}

#[test]
fn a_list_of_points_that_cannot_be_is_refused() {
    for (from, to, expected) in [
        (
            "\"30 %\"",
            "\"70 %\"",
            "map.points.2.soc: expected falling states of charge, because the cell is discharged from \
            point to point, found 70 % after 60 %",
        ),
        (
            "\"30 %\", temperature = \"10 °C\"",
            "\"30 %\", temperature = \"0 °C\"",
            "map.points.2.temperature: expected one of the temperatures of [map] (25, 10 °C), which have a \
            resistance_max, found 0 °C",
        ),
        (
            "\"90 %\", temperature = \"25 °C\"",
            "\"20 %\", temperature = \"25 °C\" }, { soc = \"10 %\", temperature = \"10 °C\"",
            "map.points.4.temperature: expected the points of 10 °C one after the other",
        ),
        (
            "measure = [\"pulses\"]",
            "measure = []",
            "map.points.1.measure: expected \"spectrum\", \"pulses\" or both, found none",
        ),
        (
            "temperatures = [",
            "soc = [\"50 %\"]\ntemperatures = [",
            "map.points: expected `soc` or `points`, found both",
        ),
    ] {
        let ended = example(POINTS).edit(EXPERIMENT, from, to).run("refused");
        let message = ended.expect_code(2).message();
        assert!(message.contains(expected), "{expected}\n{message}");
    }
    let neither = example("").run("refused");
    let message = neither.expect_code(2).message();
    assert!(
        message.contains("map: expected `soc`, measured at each temperature, or `points`"),
        "{message}"
    );
    let no_sweep = example(POINTS)
        .without(EXPERIMENT, "eis")
        .without(EXPERIMENT, "fixture_check")
        .run("refused");
    let message = no_sweep.expect_code(2).message();
    assert!(
        message.contains("map.points.3.measure: expected a section [eis]"),
        "{message}"
    );
}

/// Two points of pulses at one temperature: a start of a map within seconds.
pub(crate) fn start() -> Files {
    example("soc = [\"90 %\", \"20 %\"]\n")
        .without(EXPERIMENT, "fixture_check")
        .edit(EXPERIMENT, "[\"25 °C\", \"10 °C\"]", "[\"25 °C\"]")
        .edit(EXPERIMENT, "[\"30 mΩ\", \"45 mΩ\"]", "[\"30 mΩ\"]")
        .edit(EXPERIMENT, "points = 12", "points = 4")
        .edit(EXPERIMENT, "start = \"0.1 Hz\"", "start = \"10 Hz\"")
}

fn demands() -> Demands {
    Demands {
        under: vec![project("fixtures/data/profiles/walking.csv").into()],
        at_degc: Vec::new(),
        series: 16,
        parallel: 3,
    }
}

/// Plays the start, then what makes the error smaller.
fn investigation(files: &Files, name: &str, minutes: f64, aims: [f64; 2]) -> MapInvestigation {
    investigation_for(files, name, minutes, aims, demands())
}

fn investigation_for(
    files: &Files,
    name: &str,
    minutes: f64,
    aims: [f64; 2],
    demands: Demands,
) -> MapInvestigation {
    let experiment = files.load();
    let out = files.path(name);
    let [error_v, least_v_per_h] = aims;
    let means = Means {
        out: &out,
        ocv: experiment.cell.ocv.clone().unwrap(),
        budget: Budget {
            minutes,
            charge_ah: 100.0,
        },
    };
    let aims = Aims {
        demands,
        error_v,
        least_v_per_h,
    };
    investigate_map(&experiment, &means, &aims).unwrap()
}

#[test]
fn an_investigation_for_a_map_ends_for_each_reason() {
    let files = start();
    let spent = investigation(&files, "spent", 5.0, [1e-6, 0.0]);
    assert_eq!(spent.ended.end, Some(End::Budget));
    assert_eq!((spent.rounds.len(), spent.spent.minutes), (1, 0.0));
    let first_v = spent.ended.error_v;
    assert!(
        spent
            .ended
            .end_text
            .starts_with("the budget is spent: the next measurement takes ")
            && spent.ended.end_text.contains("left are 5 min"),
        "{}",
        spent.ended.end_text
    );
    let dear = investigation(&files, "dear", 1e4, [1e-6, 1.0]);
    assert_eq!(dear.ended.end, Some(End::GainBelowCost));
    let text = &dear.ended.end_text;
    assert!(
        text.starts_with("the next ") && text.ends_with(" mV, less than 1000 mV per hour"),
        "{text}"
    );
    // The same world and the same points: the same error.
    assert_eq!(dear.ended.error_v, first_v);
    let reached = investigation(&files, "reached", 1e4, [0.9 * first_v, 0.0]);
    assert_eq!(reached.ended.end, Some(End::ErrorReached));
    let [campaign, rounds @ ..] = &reached.rounds[..] else {
        panic!("{:?}", reached.rounds)
    };
    assert_eq!(campaign.measured.len(), 2, "{campaign:?}");
    assert_eq!(campaign.error_after_v, Some(first_v));
    let first = &rounds[0];
    assert_eq!(first.error_before_v, Some(first_v));
    let last = rounds.last().unwrap();
    assert_eq!(last.error_after_v, Some(reached.ended.error_v));
    assert!(reached.ended.error_v <= 0.9 * first_v, "{rounds:?}");
    // What was expected before the round is near what the refitted map states.
    let (expected_v, after_v) = (
        first.error_expected_v.unwrap(),
        first.error_after_v.unwrap(),
    );
    assert!(
        expected_v < first_v && (after_v / expected_v - 1.0).abs() < 0.5,
        "{first:?}"
    );
    assert_eq!(
        reached.spent.minutes,
        rounds.iter().filter_map(|round| round.minutes).sum::<f64>()
    );
    // No point is measured twice.
    let mut all: Vec<&String> = reached.rounds.iter().flat_map(|r| &r.measured).collect();
    all.sort();
    all.dedup();
    let count: usize = reached.rounds.iter().map(|r| r.measured.len()).sum();
    assert_eq!(all.len(), count, "{:?}", reached.rounds);
    let out = files.path("reached");
    let written = json(&out.join("investigation.json"));
    assert_eq!(written["end"], "error_reached");
    assert_eq!(
        written["rounds"].as_array().unwrap().len(),
        reached.rounds.len()
    );
    for name in [
        "map.json",
        "map_logs.csv",
        "investigation.md",
        "investigation.html",
    ] {
        assert!(out.join(name).is_file(), "{name}");
    }
    // From 20 % of 4.5 Ah to full, and from there to 50 %, and pulses.
    assert_eq!(first.measured, ["50 % at 25 °C: pulses"]);
    assert!(
        (5.8..6.2).contains(&reached.spent.charge_ah),
        "{:?}",
        reached.spent
    );
    let one_cell = Demands {
        series: 1,
        parallel: 1,
        ..demands()
    };
    let failed = investigation_for(&files, "failed", 1e4, [1e-6, 0.0], one_cell);
    assert_eq!(failed.ended.end, Some(End::Failed));
    let reason = failed.failure.as_ref().unwrap().to_string();
    assert!(
        reason.contains("expected a load that the pack can supply"),
        "{reason}"
    );
    assert_eq!(failed.ended.end_text, reason);
    let written = json(&files.path("failed/investigation.json"));
    assert_eq!(
        (&written["end"], &written["error_v"]),
        (&"failed".into(), &Value::Null)
    );
    assert!(files.path("failed/map.json").is_file());
    the_written_experiment_measures_the_chosen_places(&files, &files.path("spent/campaign"));
}

/// `map --next --write` on the run of the start.
fn the_written_experiment_measures_the_chosen_places(files: &Files, run: &Path) {
    let next = files.path("next.toml");
    let walking = project("fixtures/data/profiles/walking.csv");
    let words = [
        "--next",
        "3",
        "--under",
        &walking,
        "--series",
        "16",
        "--parallel",
        "3",
        "--json",
    ];
    let call = [
        "map",
        run.to_str().unwrap(),
        "--write",
        next.to_str().unwrap(),
    ];
    let (code, text, error) = program(&[&call[..], &words].concat()).parts();
    assert_eq!(code, 0, "{error}");
    let report: Value = serde_json::from_str(&text).unwrap();
    let written = load_experiment(&next, None).unwrap();
    let places = &written.map.as_ref().unwrap().places;
    let mut measured: Vec<String> = Vec::new();
    for place in places {
        assert_eq!(place.temperature_degc, 25.0, "{places:?}");
        let names = [(place.spectrum, "spectrum"), (place.pulses, "pulses")];
        let of = names.iter().filter(|(is_measured, _)| *is_measured);
        measured.extend(of.map(|(_, name)| format!("{} {name}", place.soc)));
    }
    let chosen = report["next"]["next"].as_array().unwrap();
    let mut expected: Vec<String> = chosen
        .iter()
        .map(|next| format!("{} {}", next["soc"], next["what"].as_str().unwrap()))
        .collect();
    measured.sort();
    expected.sort();
    assert_eq!(measured, expected);
    assert!(places.windows(2).all(|w| w[0].soc > w[1].soc), "{places:?}");
    // Bench, cell, sweep, pulses and limits are those of the run.
    let base = files.load();
    assert_eq!(written.name, "next");
    assert_eq!(written.cell.limits.max_v, base.cell.limits.max_v);
    assert_eq!(
        written
            .map
            .as_ref()
            .unwrap()
            .pulses
            .as_ref()
            .unwrap()
            .segments
            .len(),
        base.map
            .as_ref()
            .unwrap()
            .pulses
            .as_ref()
            .unwrap()
            .segments
            .len()
    );
    program(&["plan".as_ref(), next.as_os_str()]).expect_code(0);
    let (code, _, error) = program(&[&call[..], &words].concat()).parts();
    assert!(
        code == 2
            && error.contains("next.toml: expected the name of a new file, found one that exists"),
        "{error}"
    );
    let log = project("fixtures/data/cells/panasonic_18650pf_25C/pulses.bdf.csv");
    let ocv = project("fixtures/data/cells/panasonic_18650pf_25C/ocv.json");
    let call = [
        "map",
        &log,
        "--ocv",
        &ocv,
        "--write",
        next.to_str().unwrap(),
    ];
    let (code, _, error) = program(&[&call[..], &words].concat()).parts();
    assert!(
        code == 2 && error.contains("--write: expected --experiment with a file that has a [map]"),
        "{error}"
    );
    let other = configs().join("experiments/investigate.toml");
    let call = [
        "map",
        &log,
        "--ocv",
        &ocv,
        "--experiment",
        other.to_str().unwrap(),
    ];
    let (code, _, error) = program(&[&call[..], &words].concat()).parts();
    assert!(
        code == 2 && error.contains("expected a section [map], whose sweep, pulses and limits"),
        "{error}"
    );
}

#[test]
fn an_investigation_wants_loads_for_a_map_and_a_map_for_loads() {
    let files = start();
    let experiment = files.experiment();
    let call = ["investigate", experiment.to_str().unwrap(), "--yes"];
    let (code, _, error) = program(&call).parts();
    assert!(
        code == 2 && error.contains("expected --under with a load"),
        "{error}"
    );
    let other = configs().join("experiments/investigate.toml");
    let walking = project("fixtures/data/profiles/walking.csv");
    let call = [
        "investigate",
        other.to_str().unwrap(),
        "--under",
        &walking,
        "--yes",
    ];
    let (code, _, error) = program(&call).parts();
    assert!(
        code == 2 && error.contains("--under: expected an experiment with a [map], found "),
        "{error}"
    );
}
