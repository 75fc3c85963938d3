//! `eis-bench investigate`: measures, diagnoses, and runs the experiments that the diagnosis
//! recommends, within a budget.

use crate::command::printed::say_json;
use crate::command::units;
use bench_plan::config::quantity::Charge;
use std::{io::BufRead, path::PathBuf};

use analysis::diagnosis::report;

use bench_core::{operator::Operator, safety::failure::Failure};
use bench_evaluate::{
    files,
    investigate::closed_loop::{
        Budget, End, Investigation, Means, investigate as play, not_played_text,
    },
};
use bench_plan::{
    config::load_experiment,
    support::terminal::{remark, say},
};

/// Arguments of `investigate`.
#[derive(Debug, clap::Args)]
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
    let budget = budget(args)?;
    let out = args.out.clone().unwrap_or_else(|| {
        PathBuf::from("runs").join(format!("{}-investigation", experiment.name))
    });
    let mut investigation = play(
        &experiment,
        &Means {
            out: &out,
            ocv,
            budget,
        },
    )?;
    if args.json {
        say_json(&investigation)?;
    } else {
        print(&investigation);
        say!("written to {}", out.display());
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
