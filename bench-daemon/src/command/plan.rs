//! `eis-bench plan`: prints the steps of an experiment without touching an instrument.

use crate::command::printed::say_json;
use std::path::PathBuf;

use instruments::{
    generator,
    instrument::{Unattended, by_key},
    load, supply, supply4q,
    units::{Amps, Seconds},
};

use bench_core::{
    safety::failure::Failure,
    watch::{Pace, unwatched},
};
use bench_plan::{
    config::{Bench, Experiment, Instrument, Jig, load_experiment},
    interlock::Limits,
    plan::{Flow, Leg, Plan, PointRow, Step, Through},
    procedure,
    support::terminal::{remark, say},
};

/// Arguments of `plan`.
#[derive(Debug, clap::Args)]
pub struct PlanArgs {
    /// The experiment file.
    pub experiment: PathBuf,
    /// A bench file instead of the one that the experiment names.
    #[arg(long, value_name = "FILE")]
    pub bench: Option<PathBuf>,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}

/// Plan that `--json` prints.
#[derive(Debug, serde::Serialize)]
struct PlanText {
    experiment: String,
    bench: String,
    cell: String,
    stages: Vec<StageText>,
    /// Points of a map.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    points: Vec<PointRow>,
    /// Bench time, s.
    expected_s: f64,
    longest_s: f64,
    /// Longest wait after `pause` and after `abort`, s; `None` if the plan has no wait.
    longest_pause_s: Option<f64>,
    longest_abort_s: Option<f64>,
    /// Remarks, as sentences.
    notes: Vec<String>,
}

/// A stage as text.
#[derive(Debug, serde::Serialize)]
struct StageText {
    purpose: String,
    steps: Vec<String>,
}

/// Describes how a current ends automatically if no further message arrives.
fn endings(experiment: &Experiment, plan: &Plan) -> Vec<String> {
    let (bench, limits) = (&experiment.bench, &experiment.cell.limits);
    let generator = bench
        .instruments
        .generator
        .as_ref()
        .and_then(|generator| by_key(generator::DIALECTS, &generator.model));
    let most = generator
        .filter(|_| bench.wiring.bursts)
        .and_then(|dialect| dialect.most_periods());
    let mut texts = Vec::new();
    match plan.plays_on_s(most) {
        Some(longest_s) if longest_s.is_finite() => {
            texts.push(format!(
                "without a further message the generator falls silent after about \
            {longest_s:.0}: it plays bursts"
            ));
        }
        Some(_) => {
            let biased = plan.stages.iter().any(|stage| stage.bias_a() != Amps(0.0));
            let why = match generator.map(|dialect| dialect.most_periods()) {
                _ if biased => {
                    "a burst ends a sinusoid, but not the direct current under it".to_owned()
                }
                Some(Some(_)) if !bench.wiring.bursts => "wiring.bursts is false".to_owned(),
                Some(Some(most)) => format!(
                    "a point has more than the {most} periods of a burst, or a trace goes step by \
                    step"
                ),
                _ => "its model has no bursts".to_owned(),
            };
            texts.push(format!(
                "without a further message the drive goes on ({why}): only the \
            daemon and the guardian end it"
            ));
        }
        None => {}
    }
    let moves = |of: fn(&Step) -> bool| plan.stages.iter().flat_map(|stage| &stage.steps).any(of);
    if moves(|step| matches!(step, Step::PowerUp { .. })) {
        texts.extend(one_way(bench));
    }
    if moves(|step| {
        matches!(
            step,
            Step::Discharge { .. }
                | Step::Leg(Leg {
                    flow: Flow::Discharge { .. } | Flow::DischargeTo { .. },
                    ..
                })
        ) || metered(step)
    }) {
        let load = bench
            .instruments
            .load
            .as_ref()
            .and_then(|load| Some((load, by_key(load::DIALECTS, &load.model)?)));
        texts.extend(load.map(|(load, dialect)| {
            unattended("load", load, dialect.capabilities().unattended, limits)
        }));
    }
    if moves(|step| {
        matches!(
            step,
            Step::Charge { .. }
                | Step::Leg(Leg {
                    flow: Flow::Charge { .. },
                    ..
                })
        ) || metered(step)
    }) {
        let supply = bench
            .instruments
            .supply
            .as_ref()
            .and_then(|supply| Some((supply, by_key(supply::DIALECTS, &supply.model)?)));
        texts.extend(supply.map(|(supply, dialect)| {
            unattended("charger", supply, dialect.capabilities().unattended, limits)
        }));
    }
    texts
}

/// Describes what the watch sees of the bench, how fast it acts, and what it cannot see.
fn watched(experiment: &Experiment) -> Vec<String> {
    let pace = Pace::of(experiment);
    let mut lines = vec![pace.describe(&experiment.bench.instruments)];
    lines.extend(unwatched(&experiment.bench));
    lines
}

/// Describes the pulses of a map that are left out.
fn left_out(experiment: &Experiment) -> Vec<String> {
    procedure::left_out_pulses(experiment)
        .into_iter()
        .map(|(point, reason)| format!("point {point}: {reason}"))
        .collect()
}

/// Describes the waits that the plan does not bound: those for a person who changes what is in
/// the jig.
fn persons(experiment: &Experiment, plan: &Plan) -> Option<String> {
    if !matches!(experiment.bench.instruments.jig, Some(Jig::Person)) {
        return None;
    }
    let mut asked: Vec<String> = Vec::new();
    for step in plan
        .stages
        .iter()
        .flat_map(|stage| &stage.steps)
        .filter(|step| matches!(step, Step::Mount(_)))
    {
        let text = step.to_string().trim().to_owned();
        if !asked.contains(&text) {
            asked.push(text);
        }
    }
    (!asked.is_empty()).then(|| {
        format!(
            "beside that a person changes the fixture ({}): each change lasts until the person \
            confirms it, in safe state; `eis-bench abort` ends that wait",
            asked.join(", ")
        )
    })
}

/// Returns whether a trace uses the load and the charger.
fn metered(step: &Step) -> bool {
    matches!(step, Step::Trace(trace) if trace.through == Through::LoadAndSupply)
}

/// Describes the function that ends the current of a load or charger if messages stop.
fn unattended(role: &str, instrument: &Instrument, how: Unattended, limits: &Limits) -> String {
    let model = &instrument.model;
    match how {
        Unattended::StopsBelow => format!(
            "without a further message the {role} ({model}) stops by itself at {} V or above",
            limits.min_v.0
        ),
        Unattended::HoldsVoltage => {
            format!(
                "without a further message the {role} ({model}) holds {} V or less, and its \
                current falls",
                limits.max_v.0
            )
        }
        Unattended::NothingKnown => {
            format!(
                "without a further message nothing that is known ends the current of the {role} \
                ({model}): only the daemon and the guardian do"
            )
        }
    }
}

/// Describes a bipolar supply without a second path to zero.
fn one_way(bench: &Bench) -> Option<String> {
    if bench.wiring.analog.is_some() {
        return Some(
            "the bipolar supply (analog) is not switched by the program: \"down\" means that the \
            generator commands zero. Where the generator cannot be reached, only the supply's own \
            switch, or the one in series with the cell, ends its current"
                .to_owned(),
        );
    }
    let supply = bench.instruments.supply4q.as_ref()?;
    let none = by_key(supply4q::DIALECTS, &supply.model)?.zero().is_empty();
    none.then(|| {
        format!(
            "the bipolar supply ({}) has no second way to zero: it follows its analog input. Where \
            it does not go off and the generator cannot be \
             reached, only the switch in series with the cell ends its current",
            supply.model
        )
    })
}

/// Describes a plan.
fn describe_plan(experiment: &Experiment, plan: &Plan) -> PlanText {
    let stage = |stage: &bench_plan::plan::Stage| StageText {
        purpose: stage.purpose.to_string(),
        steps: stage
            .steps
            .iter()
            .map(|step| step.to_string().trim().to_owned())
            .collect(),
    };
    let [pause, abort] = plan
        .waits()
        .map(|wait| wait.map(|(_, _, longest_s)| longest_s));
    let wide = experiment.cell.wide.iter().map(ToString::to_string);
    PlanText {
        experiment: experiment.name.clone(),
        bench: experiment.bench.name.clone(),
        cell: experiment.cell.name.clone(),
        stages: plan.stages.iter().map(stage).collect(),
        points: plan.points(&experiment.cell.limits),
        expected_s: plan.expected_s().0,
        longest_s: plan.longest_s().0,
        longest_pause_s: pause.map(Seconds::value),
        longest_abort_s: abort.map(Seconds::value),
        notes: wide
            .chain(left_out(experiment))
            .chain(watched(experiment))
            .chain(endings(experiment, plan))
            .chain(persons(experiment, plan))
            .collect(),
    }
}

/// Prints the points of a map.
fn points(experiment: &Experiment, plan: &Plan) {
    let rows = plan.points(&experiment.cell.limits);
    if rows.is_empty() {
        return;
    }
    say!("\npoints of the map");
    rows.iter().for_each(|row| say!("  {}", row.line()));
    let (into_coulomb, out_coulomb) = rows.iter().fold((0.0, 0.0), |sum, row| {
        let (into, out) = row.charge_coulomb;
        (sum.0 + into.value(), sum.1 + out.value())
    });
    say!(
        "  {} points; {:.2} Ah out, {:.2} Ah in",
        rows.len(),
        out_coulomb / 3600.0,
        into_coulomb / 3600.0
    );
    left_out(experiment)
        .iter()
        .for_each(|text| remark!("note: {text}"));
}

/// Prints the plan of an experiment.
///
/// # Errors
/// A mistake in the files; a plan that would leave the limits.
pub fn plan(args: &PlanArgs) -> Result<(), Failure> {
    let experiment = load_experiment(&args.experiment, args.bench.as_deref())?;
    let plan = procedure::plan(&experiment).check(&experiment.cell.limits)?;
    Pace::of(&experiment)
        .check(&experiment)
        .map_err(Failure::Usage)?;
    if args.json {
        return say_json(&describe_plan(&experiment, plan.plan()));
    }
    say!(
        "{} on bench {} with {}",
        experiment.name,
        experiment.bench.name,
        experiment.cell.name
    );
    for stage in &plan.plan().stages {
        say!("\n{}", stage.purpose);
        for step in &stage.steps {
            say!("  {step}");
        }
    }
    points(&experiment, plan.plan());
    experiment
        .cell
        .wide
        .iter()
        .for_each(|text| remark!("note: {text}"));
    let hours = |seconds: f64| {
        format!(
            "{:.0} h {:02.0} min",
            (seconds / 3600.0).floor(),
            (seconds % 3600.0) / 60.0
        )
    };
    say!(
        "\nabout {}, at most {} of bench time",
        hours(plan.plan().expected_s().0),
        hours(plan.plan().longest_s().0)
    );
    let [pause, end] = plan.plan().waits();
    let wait_text = |wait: Option<(&Step, Seconds, Seconds)>| {
        let text = |(step, about_s, longest_s): (&Step, Seconds, Seconds)| {
            format!(
                "about {about_s:.0}, at most {longest_s:.0} ({})",
                step.to_string().trim()
            )
        };
        wait.map_or_else(|| "none".to_owned(), text)
    };
    watched(&experiment)
        .iter()
        .chain(&endings(&experiment, plan.plan()))
        .for_each(|text| say!("{text}"));
    persons(&experiment, plan.plan())
        .iter()
        .for_each(|text| say!("{text}"));
    say!(
        "longest wait after `eis-bench pause`: {}; after `eis-bench abort`: {}",
        wait_text(pause),
        wait_text(end)
    );
    Ok(())
}
