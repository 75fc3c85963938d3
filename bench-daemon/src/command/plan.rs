//! `eis-bench plan`: what would be done.

use crate::{cli::PlanArgs, command::Failure, config::load_experiment, procedure};

/// Prints the plan of an experiment.
///
/// # Errors
/// A mistake in the files; a plan that would leave the limits.
pub fn plan(args: &PlanArgs) -> Result<(), Failure> {
    let experiment = load_experiment(&args.experiment, args.bench.as_deref())?;
    let plan = procedure::plan(&experiment).check(&experiment.cell.limits)?;
    println!("{} on bench {} with {}", experiment.name, experiment.bench.name, experiment.cell.name);
    for stage in &plan.plan().stages {
        println!("\n{}", stage.purpose);
        for step in &stage.steps {
            println!("  {step}");
        }
    }
    let hours = |seconds: f64| format!("{:.0} h {:02.0} min", (seconds / 3600.0).floor(), (seconds % 3600.0) / 60.0);
    println!("\nabout {}, at most {} of bench time", hours(plan.plan().expected_s()), hours(plan.plan().longest_s()));
    Ok(())
}
