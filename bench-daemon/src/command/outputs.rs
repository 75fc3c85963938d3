//! `eis-bench outputs`: queries the state of a bench's outputs, and changes nothing.

use std::{collections::BTreeMap, path::PathBuf, time::Duration};

use clap::Args;
use instruments::{chiller::Chiller, clock::Clock, transport::MemoryHub};

use crate::command::printed::say_json;
use bench_core::{
    bench::outputs::{OutputReading, OutputsState},
    bench::{Bench, Connections, state_readback},
    safety::failure::Failure,
    safety::state::State,
};
use bench_plan::{
    config::{self, load_any_bench},
    support::terminal::say,
};

/// Longest time for the answers of all instruments.
const READ: Duration = Duration::from_secs(40);

/// Arguments of `outputs`.
#[derive(Debug, Args)]
pub struct OutputsArgs {
    /// The bench file, or an experiment on it.
    pub config: PathBuf,
    /// Print the last reading, and ask no instrument.
    #[arg(long)]
    pub known: bool,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}

/// Reads the outputs of a bench on which nothing runs, and prints their state with the time of the
/// reading. Refused while a run, a guardian or a switching off is at work.
///
/// # Errors
/// [`Failure::Unsafe`] if not every output was read as off; a bench that is in use.
pub fn outputs(args: &OutputsArgs) -> Result<(), Failure> {
    let bench = load_any_bench(&args.config)?;
    let Some(state) = State::of(&bench)? else {
        return tell(&OutputsState::simulated(), args.json);
    };
    if args.known {
        let known = if state.holder()?.is_some() {
            OutputsState::in_run()
        } else {
            state.outputs()
        };
        return tell(&known, args.json);
    }
    let _reader = state.lock_reader()?;
    let readings = Clock::runtime(bench.time())?.block_on(async {
        let clock = Clock::start(bench.time());
        let reading = read(&bench, &clock);
        clock.deadline(READ, reading).await.unwrap_or_else(|_| {
            Err(Failure::System(std::io::Error::other(format!(
                "expected the answers of all instruments within {READ:?}, they are not there"
            ))))
        })
    })?;
    state.keep_readings(&readings)?;
    let read = state.outputs();
    tell(&read, args.json)?;
    if read.is_off() {
        return Ok(());
    }
    Err(Failure::Unsafe {
        failures: read.words,
        cause: String::new(),
    })
}

async fn read(config: &config::Bench, clock: &Clock) -> Result<Vec<OutputReading>, Failure> {
    let connections = Connections {
        clock: clock.clone(),
        hub: MemoryHub::new(),
        taps: BTreeMap::new(),
    };
    let mut bench = Bench::unconnected(config, &connections)?;
    let mut found = state_readback::look_each(&mut bench).await;
    // A bath that closes its own loop continues between runs and does not count as an output.
    let has_relays = bench.instruments.chiller.as_ref();
    if has_relays.is_some_and(Chiller::is_regulated) {
        found.extend(state_readback::look_bath(&mut bench).await);
    }
    for error in found.iter().filter_map(|found| found.as_ref().err()) {
        tracing::warn!("{error}");
    }
    Ok(state_readback::readings(&bench, &found, "read"))
}

fn tell(state: &OutputsState, json: bool) -> Result<(), Failure> {
    if json {
        return say_json(state);
    }
    say!("{}", state.words);
    for reading in &state.outputs {
        let words = reading.in_words();
        say!("{:<10} {:<20} {words}", reading.role, reading.model);
    }
    Ok(())
}
