//! Identifies the instruments of a bench. Instruments on separate connections answer in parallel,
//! so that one that is silent does not delay the others.

use std::{collections::BTreeMap, time::Duration};

use futures_util::future::join_all;
use instruments::{
    clock::{Clock, TimeMode},
    transport::{Adapter, Address, MemoryHub},
};

use super::found::{IdentifiedInstrument, forcing, web};
use bench_core::{
    bench::outputs::{DRIVES, OutputReading},
    bench::survey::{AnyInstrument, InstrumentReport},
    bench::{Bench, BenchError, Connections, state_readback},
    operator::progress::Waiting,
    safety::failure::Failure,
    safety::state::State,
    sim::Simulation,
};
use bench_evaluate::doctor;
use bench_plan::config;

/// Longest time for all answers of one instrument.
const ANSWERS: Duration = Duration::from_secs(15);

/// What one instrument answered: its report, and the state of its output.
type Answered = (InstrumentReport, Option<OutputReading>);

/// Queries the instruments of a bench and stores the states of their outputs. It holds the lock of
/// a reader, so that a run, a stop or `safe` can end it at any time.
///
/// # Errors
/// A bench that is in use; a state that cannot be read or written.
pub(super) fn identify(config: &config::Bench) -> Result<Vec<IdentifiedInstrument>, Failure> {
    let in_process = config.in_process();
    let mode = if in_process {
        TimeMode::Virtual
    } else {
        config.time()
    };
    let state = State::of(config)?;
    Clock::runtime(mode)?.block_on(async {
        let clock = Clock::start(mode);
        doctor::free(config, &clock).await?;
        let _reader = state.as_ref().map(State::lock_reader).transpose()?;
        let hub = MemoryHub::new();
        let simulation = config.simulation.as_ref().filter(|_| in_process);
        let simulation = simulation
            .map(|section| Simulation::new(&section.scenario, 0))
            .transpose()?;
        if let Some(simulation) = &simulation {
            simulation.serve_in_process(config, &clock, &hub)?;
        }
        let connections = Connections {
            clock,
            hub,
            taps: BTreeMap::new(),
        };
        let all = ask_all(config, &connections).await;
        if let Some(state) = &state {
            let outputs: Vec<_> = all.iter().filter_map(|one| one.output.clone()).collect();
            state.keep_readings(&outputs)?;
        }
        Ok(all)
    })
}

/// Queries all instruments: those on one connection one after the other, the others in parallel.
/// Returns them in the order of the roles.
async fn ask_all(config: &config::Bench, connections: &Connections) -> Vec<IdentifiedInstrument> {
    let addressed = config.instruments.addressed();
    let mut lines: BTreeMap<String, Vec<usize>> = BTreeMap::new();
    for (place, (_, instrument)) in addressed.iter().enumerate() {
        let line = connection(&instrument.address);
        lines.entry(line).or_default().push(place);
    }
    let waiting = Waiting::shown();
    let count = waiting.counter(addressed.len() as u64, "instruments asked");
    let ask_line = async |places: Vec<usize>| {
        let mut found = Vec::new();
        for place in places {
            let (role, instrument) = addressed[place];
            found.push((place, ask(config, role, instrument, connections).await));
            count();
        }
        found
    };
    let asked = join_all(lines.into_values().map(ask_line)).await;
    waiting.end();
    let in_order: BTreeMap<usize, _> = asked.into_iter().flatten().collect();
    in_order.into_values().collect()
}

/// Returns the connection that an address needs for itself. Virtual time passes in one sequence,
/// so the instruments within a process share one.
fn connection(address: &Address) -> String {
    match address {
        Address::Tcp(socket) | Address::HiSlip { socket, .. } => socket.to_string(),
        Address::Gpib {
            adapter: Adapter::Tcp(socket),
            ..
        } => socket.to_string(),
        Address::Gpib {
            adapter: Adapter::Serial(port),
            ..
        }
        | Address::Serial(port) => port.path.clone(),
        Address::Vxi11 { host, .. } => host.clone(),
        Address::UsbTmc { path } => path.clone(),
        Address::Memory { .. } => String::new(),
    }
}

async fn ask(
    config: &config::Bench,
    role: &'static str,
    instrument: &config::Instrument,
    connections: &Connections,
) -> IdentifiedInstrument {
    let one = config::Bench {
        instruments: config.instruments.only(role),
        ..config.clone()
    };
    let clock = &connections.clock;
    let start_s = clock.machine_s();
    let answers = clock
        .deadline(ANSWERS, answers(role, &one, connections))
        .await;
    let answers = answers.unwrap_or_else(|_| {
        Err(format!(
            "expected all answers within {ANSWERS:?}, found fewer"
        ))
    });
    let answers = answers.and_then(|(report, output)| {
        if report.identity.is_web_server() {
            return Err(web(&report.identity));
        }
        Ok((report, output))
    });
    let took_s = clock.machine_s() - start_s;
    let (report, output, failure) = match answers {
        Ok((report, output)) => (Some(report), output, None),
        // The output may never have been asked; an earlier reading of it stays, with its age.
        Err(failure) => (None, None, Some(failure)),
    };
    let unknown = report.as_ref().filter(|report| !report.recognised);
    let could_be_forced = unknown.map_or_else(Vec::new, |report| {
        forcing(Some(role), &report.identity, &instrument.address)
    });
    IdentifiedInstrument {
        role: Some(role),
        model: Some(instrument.model.clone()),
        address: instrument.address.to_string(),
        report,
        output,
        failure,
        took_s,
        could_be_forced,
    }
}

/// Queries the only instrument of a bench. The error does not repeat its role and its model.
async fn answers(
    role: &str,
    one: &config::Bench,
    connections: &Connections,
) -> Result<Answered, String> {
    let short = |text: String| {
        let rest = text.strip_prefix(&format!("{role}: "));
        rest.map(str::to_owned).unwrap_or(text)
    };
    let reason = |error: BenchError| match error {
        BenchError::Link { source, .. } => short(source.to_string()),
        other => other.to_string(),
    };
    let bench = Bench::open(one, connections).await.map_err(reason)?;
    let mut same = bench.share(&connections.clock);
    let (_, mut any) = AnyInstrument::of(bench)
        .into_iter()
        .next()
        .ok_or("expected an instrument, found none")?;
    let report = any
        .describe()
        .await
        .map_err(|error| short(error.to_string()))?;
    // The answers of another model would be meaningless.
    if !report.recognised || !DRIVES.contains(&role) {
        return Ok((report, None));
    }
    let found = state_readback::look_each(&mut same).await;
    let output = state_readback::readings(&same, &found, "read").pop();
    Ok((report, output))
}
