//! `eis-bench safe`: switches a bench off at any time, even while another process runs it, and
//! verifies the result.

mod every;

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

use clap::Args;
use every::SafeOptions;
use instruments::{clock::Clock, transport::MemoryHub};
use nix::{
    sys::signal::{Signal, kill},
    unistd::Pid,
};

use bench_core::{
    bench::{Bench, Connections, SafeReport},
    safety::bench_lease::settle_verified,
    safety::failure::Failure,
    safety::guardian::last_cell_degc,
    safety::state::{Holder, Latched, State},
};
use bench_plan::{
    config::{self, load_any_bench},
    support::terminal::{remark, say},
};

/// Arguments of `safe`.
#[derive(Debug, Args)]
pub struct SafeArgs {
    /// The bench file, or an experiment on it. Left out: every bench that runs or ran on this
    /// machine, all at the same time.
    pub config: Option<PathBuf>,
    /// First kill the process that runs the bench (SIGKILL): most instruments accept only one
    /// client, and that process is it.
    #[arg(long)]
    pub kill: bool,
    /// Print the report as JSON, one line for each bench that is switched off.
    #[arg(long)]
    pub json: bool,
    /// Who switches off, for the record.
    #[arg(long, hide = true, default_value = "safe")]
    pub by: String,
}

/// Brings a bench, or every known bench, into safe state and prints the readback. A process that
/// runs the bench is first asked to end, so that it does not switch outputs on again.
///
/// # Errors
/// [`Failure::Unsafe`] if the state could not be verified.
pub fn safe(args: &SafeArgs) -> Result<(), Failure> {
    match &args.config {
        Some(config) => safe_one(config, args),
        None => every::safe_every(&SafeOptions {
            kill: args.kill,
            json: args.json,
            by: &args.by,
        }),
    }
}

fn safe_one(config: &Path, args: &SafeArgs) -> Result<(), Failure> {
    let bench = load_any_bench(config)?;
    if bench.in_process() {
        simulated(bench.name, args.json);
        return Ok(());
    }
    // A state folder that cannot be written must not prevent the shutdown.
    let state = State::of(&bench).unwrap_or_else(|error| {
        remark!("eis-bench: {error}");
        None
    });
    let state = state.as_ref();
    // Instruments take one client.
    let _no_reader = state.map(State::end_reader);
    match runner(state) {
        Runner::Nobody => {}
        Runner::Somebody(holder) => end(
            &holder,
            if args.kill {
                Signal::SIGKILL
            } else {
                Signal::SIGTERM
            },
        ),
        Runner::Unknown(why) => remark!("eis-bench: {UNKNOWN}, and it is not asked to end: {why}"),
    }
    Clock::runtime(bench.time())?.block_on(async {
        let clock = Clock::start(bench.time());
        // A process that ends on request switches off its outputs itself, and releases
        // instruments that accept one client.
        let gone = ended(state, &clock, ENDS_S.0).await;
        // The guardian of that process switches off after it, over the same connections.
        if gone {
            guarded(state, &clock).await;
        }
        // If another process holds the connections, an unknown state does not latch the bench:
        // that process has been asked to end, and has a guardian.
        let latch = state.filter(|_| gone);
        let states = States { state, latch };
        let off = switch_off(&bench, &clock, states, args)
            .await
            .inspect_err(|_| {
                if !gone {
                    remark!(
                        "eis-bench: instruments that take one client answer only after the process \
                that runs the bench has ended: --kill ends it"
                    );
                }
            })?;
        if gone {
            return Ok(state.map_or(Ok(()), settle_verified)?);
        }
        if ended(state, &clock, ENDS_S.1).await {
            guarded(state, &clock).await;
            remark!("the process that ran the bench has ended by now; once more:");
            let states = States {
                state,
                latch: state,
            };
            return switch_off(&bench, &clock, states, args).await.map(drop);
        }
        let failures = match runner(state) {
            Runner::Unknown(why) => format!(
                "everything was off, but {UNKNOWN}, and it may switch \
            on again: {why}"
            ),
            Runner::Nobody | Runner::Somebody(_) => {
                "everything was off, but the process that runs the bench does not end and may \
                switch on again: --kill ends it"
                    .to_owned()
            }
        };
        // The last line is for programs.
        tell(
            &SafeReport {
                verified: false,
                message: failures.clone(),
                ..off
            },
            args.json,
        );
        Err(Failure::Unsafe {
            failures,
            cause: String::new(),
        })
    })
}

/// Reports that a bench that exists only inside its process cannot be queried. Nothing has been
/// read back, so nothing is verified.
fn simulated(bench: String, json: bool) {
    let message = format!(
        "{bench} is simulated in the process that runs it: there is nothing to switch off and \
        nothing to read back"
    );
    if json {
        let report = SafeReport {
            bench,
            message,
            ..SafeReport::default()
        };
        say!(
            "{}",
            serde_json::to_string(&Simulated {
                report,
                simulated: true
            })
            .unwrap_or_default()
        );
    } else {
        say!("{message}");
    }
}

/// The report of a bench that has no outputs outside the process that runs it.
#[derive(serde::Serialize)]
struct Simulated {
    #[serde(flatten)]
    report: SafeReport,
    simulated: bool,
}

/// Prints a report as a line of JSON, if requested.
fn tell(report: &SafeReport, json: bool) {
    if json {
        say!("{}", serde_json::to_string(report).unwrap_or_default());
    }
}

const UNKNOWN: &str = "whether a process runs the bench is not known";

/// The process that runs the bench.
#[derive(Debug)]
enum Runner {
    Nobody,
    Somebody(Holder),
    /// Its state, or that of an instrument, cannot be read.
    Unknown(String),
}

fn runner(state: Option<&State>) -> Runner {
    match state.map(State::holder) {
        Some(Ok(None)) => Runner::Nobody,
        Some(Ok(Some(holder))) => Runner::Somebody(holder),
        Some(Err(error)) => Runner::Unknown(error.to_string()),
        None => Runner::Unknown("the state of the bench cannot be opened".to_owned()),
    }
}

/// How long the process that runs the bench may take to end before the bench is switched off beside
/// it, and after that, s.
const ENDS_S: (f64, f64) = (5.0, 15.0);
const LOOK_S: f64 = 0.1;
/// A guardian is done within this time, s, or tries without success.
const GUARDED_S: f64 = 10.0;

/// Waits until no process runs the bench, for at most `at_most_s`. Returns whether that is so; if
/// it is unknown, returns `false`.
async fn ended(state: Option<&State>, clock: &Clock, at_most_s: f64) -> bool {
    let start_s = clock.machine_s();
    loop {
        match runner(state) {
            Runner::Nobody => return true,
            // Waiting does not open it.
            Runner::Unknown(_) => return false,
            Runner::Somebody(_) if clock.machine_s() - start_s > at_most_s => return false,
            Runner::Somebody(_) => clock.sleep_s(LOOK_S).await,
        }
    }
}

/// Waits until no guardian is active, up to a time limit.
async fn guarded(state: Option<&State>, clock: &Clock) {
    let (Some(state), start_s) = (state, clock.machine_s()) else {
        return;
    };
    while matches!(state.lock_guardian(), Ok(None)) && clock.machine_s() - start_s < GUARDED_S {
        clock.sleep_s(LOOK_S).await;
    }
}

/// Ends the process that runs the bench. A number that another process has got by now is left
/// alone.
fn end(holder: &Holder, how: Signal) {
    let Holder { pid, run, .. } = holder;
    remark!("process {pid} runs this bench for {}", run.display());
    if !holder.lives() {
        remark!("process {pid} is not the one that took the bench: it is left alone");
        return;
    }
    match (kill(Pid::from_raw(*pid), how), how) {
        (Ok(()), Signal::SIGKILL) => {
            remark!("process {pid} was killed; its guardian switches off too");
        }
        (Ok(()), _) => remark!("process {pid} was asked to end its run and to switch off"),
        (Err(error), _) => remark!("process {pid} cannot be ended: {error}"),
    }
}

/// The state of a bench, by its use during the shutdown.
#[derive(Clone, Copy)]
struct States<'a> {
    /// Contains the limits of the cell.
    state: Option<&'a State>,
    /// Is latched where something is not verified.
    latch: Option<&'a State>,
}

/// Switches off and prints the readback, a line for each instrument, or the report as JSON.
async fn switch_off(
    config: &config::Bench,
    clock: &Clock,
    states: States<'_>,
    args: &SafeArgs,
) -> Result<SafeReport, Failure> {
    let connections = Connections {
        clock: clock.clone(),
        hub: MemoryHub::new(),
        taps: BTreeMap::new(),
    };
    let mut bench = Bench::unconnected(config, &connections)?;
    // A bath that closes its own loop moves no charge: nothing waits for it but the report.
    let mut beside = Bench::unconnected(config, &connections)?;
    let (report, bath) = tokio::join!(
        bench.safe_state(),
        beside.bath(states.state.and_then(last_cell_degc))
    );
    let report = report.with_bath(bath);
    tell(&report, args.json);
    if !args.json {
        say!("{}: {}", report.bench, report.read);
        report
            .outputs
            .iter()
            .for_each(|output| say!("{}", output.line()));
        report.bath.iter().for_each(|bath| say!("{bath}"));
    }
    if let Some(Err(error)) = states
        .state
        .map(|state| state.keep_readings(&report.readings(&args.by)))
    {
        remark!("eis-bench: what was read back is not kept: {error}");
    }
    let Err(unproven) = report.clone().proven() else {
        return Ok(report);
    };
    let failure = Failure::from(unproven);
    if let Some(Err(error)) = states
        .latch
        .map(|state| state.latch(&Latched::new("safe", &failure.to_string())))
    {
        remark!("eis-bench: {error}");
    }
    Err(failure)
}
