//! `eis-bench plan`: what would be done.

use crate::terminal::{remark, say};
use crate::{cli::PlanArgs, command::Failure, config::load_experiment, procedure};

/// Prints the plan of an experiment.
///
/// # Errors
/// A mistake in the files; a plan that would leave the limits.
pub fn plan(args: &PlanArgs) -> Result<(), Failure> {
    let experiment = load_experiment(&args.experiment, args.bench.as_deref())?;
    let plan = procedure::plan(&experiment).check(&experiment.cell.limits)?;
    say!("{} on bench {} with {}", experiment.name, experiment.bench.name, experiment.cell.name);
    for stage in &plan.plan().stages {
        say!("\n{}", stage.purpose);
        for step in &stage.steps {
            say!("  {step}");
        }
    }
    experiment.cell.wide.iter().for_each(|text| remark!("note: {text}"));
    let hours = |seconds: f64| format!("{:.0} h {:02.0} min", (seconds / 3600.0).floor(), (seconds % 3600.0) / 60.0);
    say!("\nabout {}, at most {} of bench time", hours(plan.plan().expected_s()), hours(plan.plan().longest_s()));
    let [pause, end] = plan.plan().waits();
    let told = |wait: Option<(&crate::plan::Step, f64)>| {
        wait.map_or_else(|| "none".to_owned(), |(step, s)| format!("{s:.0} s ({})", step.to_string().trim()))
    };
    say!("longest wait after `eis-bench pause`: {}; after `eis-bench abort`: {}", told(pause), told(end));
    Ok(())
}
