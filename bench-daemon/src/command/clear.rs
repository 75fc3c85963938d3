//! `eis-bench clear`: a person has looked at a latched bench and lets it run again.

use std::{
    io::{BufRead, IsTerminal},
    path::PathBuf,
};

use clap::Args;

use bench_core::{safety::failure::Failure, safety::state::State};
use bench_plan::{
    config::load_any_bench,
    support::terminal::{remark, say},
};

/// Arguments of `clear`.
#[derive(Debug, Args)]
pub struct ClearArgs {
    /// The bench file, or an experiment on it.
    pub config: PathBuf,
    /// Confirm without being asked that the bench and the cell were inspected.
    #[arg(long)]
    pub yes: bool,
    /// Result of the inspection and actions taken; stored with the trip.
    #[arg(long, value_name = "TEXT")]
    pub found: Option<String>,
}

/// Shows why a bench is latched and clears the latch after a confirmation.
///
/// # Errors
/// A state that cannot be read or written; no confirmation.
pub fn clear(args: &ClearArgs) -> Result<(), Failure> {
    let bench = load_any_bench(&args.config)?;
    let Some(state) = State::of(&bench)? else {
        say!(
            "{} is simulated in the process that runs it: nothing of it can be latched",
            bench.name
        );
        return Ok(());
    };
    let Some(trip) = state.latched()? else {
        say!("{} is not latched", bench.name);
        return Ok(());
    };
    say!("{} is latched by the {}: {trip}", bench.name, trip.by);
    if !(args.yes || confirmed()) {
        return Err(Failure::Usage(
            "nothing was cleared: expected --yes, or `clear` typed on a terminal".to_owned(),
        ));
    }
    state.clear(&trip, None, args.found.as_deref())?;
    say!(
        "cleared; the next run may use the bench. {} remembers it",
        state.path("trips.jsonl").display()
    );
    Ok(())
}

fn confirmed() -> bool {
    if !std::io::stdin().is_terminal() {
        return false;
    }
    remark!("Have you looked at the bench and the cell, and is the cause gone? Type `clear`:");
    let mut line = String::new();
    std::io::stdin().lock().read_line(&mut line).is_ok() && line.trim() == "clear"
}
