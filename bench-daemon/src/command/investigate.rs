//! `eis-bench investigate`: measures, diagnoses, and runs the experiments that the diagnosis
//! recommends, within a budget; with a `[map]`, fits a map and measures the points that make it
//! predict given loads better.

use crate::command::{load_args::LoadArgs, map::print_fit, printed::say_json, units};
use bench_plan::config::quantity::Charge;
use std::{io::BufRead, path::PathBuf};

use analysis::diagnosis::report;

use bench_core::{operator::Operator, safety::failure::Failure};
use bench_evaluate::{
    files,
    investigate::closed_loop::{
        Aims, Budget, End, Investigation, MapInvestigation, Means, investigate as play,
        investigate_map, not_played_text,
    },
};
use bench_plan::{
    config::{Experiment, load_experiment},
    support::{
        quoted::quoted,
        terminal::{remark, say},
    },
};

const HELP: &str = "\
An experiment with a [map] is played first; then a map is fitted, the points that take most off the \
predicted error of the loads per minute are measured on the same bench, and so on. It stops when the \
error is below --error-mv, when the next measurement takes off less than --least-mv-per-hour, or when \
the budget does not pay for it.

Examples:
  eis-bench investigate configs/experiments/investigate.toml
  eis-bench investigate configs/experiments/map.toml --under fixtures/data/profiles/walking.csv \
--series 16 --parallel 3 --budget-minutes 600 --budget-ah 60";

/// Arguments of `investigate`.
#[derive(Debug, clap::Args)]
#[command(after_help = HELP)]
pub struct InvestigateArgs {
    /// The experiment file of the first campaign.
    pub experiment: PathBuf,
    /// A bench file instead of the one that the experiment names.
    #[arg(long, value_name = "FILE")]
    pub bench: Option<PathBuf>,
    /// Folder of the investigation [default: runs/NAME-investigation]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// A seed instead of the experiment's, for the simulation and the fits' searches.
    #[arg(long)]
    pub seed: Option<u64>,
    /// Time on the bench for experiments after the campaign, min.
    #[arg(long, default_value_t = 240.0, value_name = "MIN")]
    pub budget_minutes: f64,
    /// Charge that these experiments may move in either direction, Ah.
    #[arg(long, default_value_t = 20.0, value_name = "AH", value_parser = units::of::<Charge>)]
    pub budget_ah: f64,
    /// Loads of an experiment with a `[map]`.
    #[command(flatten)]
    pub loads: LoadArgs,
    /// Predicted error of the voltage under the loads at which the map is good enough, one standard
    /// deviation, mV.
    #[arg(long, default_value_t = 5.0, value_name = "MV", requires = "under")]
    pub error_mv: f64,
    /// Fall of this error for an hour on the bench below which no further point is measured, mV.
    #[arg(long, default_value_t = 0.2, value_name = "MV", requires = "under")]
    pub least_mv_per_hour: f64,
    /// Confirm the budget without being asked.
    #[arg(long)]
    pub yes: bool,
    /// The OCV curve, from `ocv --out` (`ocv.json`) or a cell file (.toml) [default: that of the
    /// cell's file]
    #[arg(long, value_name = "JSON")]
    pub ocv: Option<PathBuf>,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}

/// Runs the investigation and prints how it ends.
///
/// # Errors
/// Before anything is energised: a file or an argument that is not as expected, or a budget
/// without confirmation. Later: whatever ends a run. At the end: data that cannot be diagnosed,
/// and points that the quality gate has refused.
pub fn investigate(args: &InvestigateArgs) -> Result<(), Failure> {
    let mut experiment = load_experiment(&args.experiment, args.bench.as_deref())?;
    experiment.seed = args.seed.unwrap_or(experiment.seed);
    let given = args.ocv.as_deref().map(files::read_curve).transpose()?;
    let ocv = given
        .or_else(|| experiment.cell.ocv.clone())
        .ok_or_else(|| {
            Failure::Usage(
            "expected an OCV curve: a section [ocv] in the cell's file, or --ocv with a file of \
            `ocv --out`; found neither".to_owned(),
        )
        })?;
    let aims = aims(args, &experiment)?;
    let budget = budget(args)?;
    let out = args.out.clone().unwrap_or_else(|| {
        PathBuf::from("runs").join(format!("{}-investigation", experiment.name))
    });
    let means = Means {
        out: &out,
        ocv,
        budget,
    };
    match aims {
        Some(aims) => end_of_map(args, investigate_map(&experiment, &means, &aims)?, &means),
        None => end(args, play(&experiment, &means)?, &means),
    }
}

/// Returns the aims of an experiment with a map.
fn aims(args: &InvestigateArgs, experiment: &Experiment) -> Result<Option<Aims>, Failure> {
    let demands = args.loads.demands();
    let reason = match (experiment.map.is_some(), demands.under.is_empty()) {
        (false, true) => return Ok(None),
        (true, true) => {
            "expected --under with a load: the points of a [map] are chosen for it, found none"
                .to_owned()
        }
        (false, false) => format!(
            "--under: expected an experiment with a [map], found {} without",
            args.experiment.display()
        ),
        (true, false) => {
            let numbers = [
                ("--error-mv", args.error_mv),
                ("--least-mv-per-hour", args.least_mv_per_hour),
            ];
            let wrong = numbers
                .iter()
                .find(|(_, mv)| !(mv.is_finite() && *mv >= 0.0));
            let Some((name, mv)) = wrong else {
                return Ok(Some(Aims {
                    demands,
                    error_v: 1e-3 * args.error_mv,
                    least_v_per_h: 1e-3 * args.least_mv_per_hour,
                }));
            };
            format!("{name}: expected 0 mV or more, found {mv}")
        }
    };
    Err(Failure::Usage(reason))
}

/// Prints how an investigation for a map ended.
fn end_of_map(
    args: &InvestigateArgs,
    mut investigation: MapInvestigation,
    means: &Means<'_>,
) -> Result<(), Failure> {
    if args.json {
        say_json(&investigation)?;
    } else {
        for round in &investigation.rounds {
            say!("{}", round.line());
        }
        say!("{}", investigation.spent_text());
        if let Some(fit) = &investigation.fit {
            print_fit(fit);
        }
        say!("stop: {}", investigation.ended.end_text);
        say!("written to {}", means.out.display());
        print_continuation(args, &investigation, means);
    }
    match (
        investigation.failure.take(),
        investigation.ended.refused_points,
    ) {
        (Some(failure), _) => Err(failure),
        (None, 0) => Ok(()),
        (None, count) => Err(Failure::Refused { count }),
    }
}

/// Prints the commands that go on from the runs of an investigation for a map, unless the aim is reached.
fn print_continuation(args: &InvestigateArgs, investigation: &MapInvestigation, means: &Means<'_>) {
    if investigation.ended.end == Some(End::ErrorReached) {
        return;
    }
    if let Some(folder) = investigation.unfinished(means.out) {
        say!(
            "complete the last run: eis-bench resume {}",
            quoted(&folder)
        );
    }
    let runs = investigation.rounds.iter();
    let runs: Vec<String> = runs
        .map(|round| quoted(&means.out.join(&round.folder)))
        .collect();
    if !runs.is_empty() {
        say!(
            "choose further points: eis-bench map {} --next 4 {} --write {}",
            runs.join(" "),
            args.loads.words(),
            quoted(&means.out.join("next.toml"))
        );
    }
}

/// Prints how an investigation ended.
fn end(
    args: &InvestigateArgs,
    mut investigation: Investigation,
    means: &Means<'_>,
) -> Result<(), Failure> {
    if args.json {
        say_json(&investigation)?;
    } else {
        print(&investigation);
        say!("written to {}", means.out.display());
    }
    if let Some(failure) = investigation.failure.take() {
        return Err(failure);
    }
    match (investigation.end, investigation.refused_points) {
        (End::Invalid, _) => Err(Failure::Invalid(investigation.diagnosis.summary)),
        (_, 0) => Ok(()),
        (_, count) => Err(Failure::Refused { count }),
    }
}

/// Returns the budget after one confirmation.
fn budget(args: &InvestigateArgs) -> Result<Budget, Failure> {
    let budget = Budget {
        minutes: args.budget_minutes,
        charge_ah: args.budget_ah,
    };
    let budget = budget.checked().map_err(Failure::Usage)?;
    if args.yes {
        return Ok(budget);
    }
    if Operator::detect() != Operator::Terminal {
        return Err(Failure::Usage(
            "expected a confirmation of the budget: give --yes, because standard input is not a \
            terminal"
                .to_owned(),
        ));
    }
    remark!(
        "After the campaign, experiments may take {} min and move {} Ah. Type `yes`:",
        budget.minutes,
        budget.charge_ah
    );
    let mut line = String::new();
    std::io::stdin().lock().read_line(&mut line)?;
    if line.trim() == "yes" {
        Ok(budget)
    } else {
        Err(Failure::Usage(format!(
            "expected `yes`, found {:?}: nothing was started",
            line.trim()
        )))
    }
}

fn print(investigation: &Investigation) {
    for step in &investigation.steps {
        if let Some(bought) = &step.bought {
            say!(
                "{}: {}, {:.0} min",
                step.folder,
                bought.experiment.description,
                bought.minutes
            );
        }
        say!("{}: {}", step.folder, step.verdict.label());
    }
    say!("{}", report::text(&investigation.diagnosis));
    say!("the investigation ended: {}", investigation.end_text);
    if !investigation.not_played.is_empty() {
        say!("{}", not_played_text(&investigation.not_played));
    }
}
