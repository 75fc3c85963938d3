//! `eis-bench safe`: switches a bench off at any time, whoever runs it, and proves it.

use std::{collections::BTreeMap, path::PathBuf};

use clap::Args;
use instruments::{clock::Clock, transport::MemoryHub};
use nix::{
    sys::signal::{Signal, kill},
    unistd::Pid,
};

use crate::{
    bench::{Bench, BenchError, Connections},
    command::Failure,
    config::{self, load_any_bench},
    state::{Holder, Latched, State},
    terminal::{remark, say},
};

/// Arguments of `safe`.
#[derive(Debug, Args)]
pub struct SafeArgs {
    /// The bench file, or an experiment on it.
    pub config: PathBuf,
    /// First end the process that runs the bench (SIGKILL): most instruments take one client only, and that is it.
    #[arg(long)]
    pub kill: bool,
}

/// Brings a bench into safe state and prints what was read back.
///
/// # Errors
/// [`Failure::Unsafe`] when it could not be verified.
pub fn safe(args: &SafeArgs) -> Result<(), Failure> {
    let bench = load_any_bench(&args.config)?;
    if bench.in_process() {
        say!("{} is simulated in the process that runs it: there is nothing to switch off", bench.name);
        return Ok(());
    }
    // A state folder that cannot be written must not keep anybody from switching off.
    let state = State::of(&bench).unwrap_or_else(|error| {
        remark!("eis-bench: {error}");
        None
    });
    let holder = state.as_ref().and_then(|state| state.holder().ok().flatten());
    if let Some(holder) = &holder {
        end(holder, args.kill);
    }
    let clock_mode = bench.time();
    Clock::runtime(clock_mode)?.block_on(switch_off(&bench, Clock::start(clock_mode), state.as_ref())).inspect_err(|_| {
        if holder.is_some() && !args.kill {
            remark!(
                "eis-bench: instruments that take one client only answer after the process that runs the bench has ended: --kill ends it"
            );
        }
    })
}

fn end(Holder { pid, run }: &Holder, wanted: bool) {
    remark!("process {pid} runs this bench for {}", run.display());
    // Not 0 and not 1: those are whole groups.
    if wanted && *pid > 1 {
        match kill(Pid::from_raw(*pid), Signal::SIGKILL) {
            Ok(()) => remark!("process {pid} was killed; its guardian switches off too"),
            Err(error) => remark!("process {pid} cannot be killed: {error}"),
        }
    }
}

async fn switch_off(config: &config::Bench, clock: Clock, state: Option<&State>) -> Result<(), Failure> {
    let connections = Connections { clock, hub: MemoryHub::new(), taps: BTreeMap::new() };
    let mut bench = Bench::unconnected(config, &connections)?;
    let failures = bench.safe_state().await.err().unwrap_or_default();
    for (role, read) in bench.read_back().await {
        let off = !failures.iter().any(|failure| is_of(failure, role));
        let model = bench.model(role);
        match (read, off) {
            (Ok((volts, amps)), true) => say!("{role:<10} {model:<20} off, read back; {volts:.4} V, {amps:.4} A"),
            (Ok((volts, amps)), false) => say!("{role:<10} {model:<20} NOT VERIFIED; {volts:.4} V, {amps:.4} A"),
            (Err(error), _) => say!("{role:<10} {model:<20} NOT VERIFIED; {error}"),
        }
    }
    if bench.generator.is_some() {
        let off = !failures.iter().any(|failure| is_of(failure, "generator"));
        say!("{:<10} {:<20} {}", "generator", bench.model("generator"), if off { "off, read back" } else { "NOT VERIFIED" });
    }
    if failures.is_empty() {
        return Ok(());
    }
    let failures = failures.iter().map(ToString::to_string).collect::<Vec<_>>().join("; ");
    let failure = Failure::Unsafe { failures, cause: String::new() };
    if let Some(Err(error)) = state.map(|state| state.latch(&Latched::new("safe", &failure.to_string()))) {
        remark!("eis-bench: {error}");
    }
    Err(failure)
}

fn is_of(failure: &BenchError, of: &str) -> bool {
    match failure {
        BenchError::Link { role, .. }
        | BenchError::Identity { role, .. }
        | BenchError::Flowing { role, .. }
        | BenchError::Missing { role }
        | BenchError::Dialect { role, .. } => *role == of,
    }
}
