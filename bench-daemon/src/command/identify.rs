//! `eis-bench identify`: who answers at the configured addresses.

use std::collections::BTreeMap;

use instruments::{
    clock::{Clock, TimeMode},
    transport::{Address, MemoryHub},
};

use crate::terminal::say;
use crate::{
    bench::{Bench, BenchError, Connections, Identified},
    cli::IdentifyArgs,
    command::Failure,
    config::{self, load_bench},
    sim::Simulation,
};

/// Asks every instrument who it is and prints the answers. Changes nothing on any of them.
///
/// # Errors
/// A mistake in the bench file; an instrument that does not answer, or is not the configured model.
pub fn identify(args: &IdentifyArgs) -> Result<(), Failure> {
    let (config, _) = load_bench(&args.bench)?;
    let in_process = config.instruments.addressed().iter().any(|(_, instrument)| matches!(instrument.address, Address::Memory { .. }));
    let mode = if in_process { TimeMode::Virtual } else { TimeMode::Real };
    Clock::runtime(mode)?.block_on(async {
        let clock = Clock::start(mode);
        let hub = MemoryHub::new();
        let simulation =
            config.simulation.as_ref().filter(|_| in_process).map(|section| Simulation::new(&section.scenario, 0)).transpose()?;
        if let Some(simulation) = &simulation {
            simulation.serve_in_process(&config, &clock, &hub)?;
        }
        let mut found = Vec::new();
        let mut failures = Vec::new();
        for (role, instrument) in config.instruments.addressed() {
            let one = config::Bench { instruments: config.instruments.only(role), ..config.clone() };
            let connections = Connections { clock: clock.clone(), hub: hub.clone(), taps: BTreeMap::new() };
            match ask(&one, &connections).await {
                Ok(identified) => {
                    if !args.json {
                        identified.iter().for_each(print_line);
                    }
                    found.extend(identified);
                }
                // One that is silent must not hide the others.
                Err(error) => {
                    if !args.json {
                        say!("{role:<10} {model:<20} {address:<32} {error}", model = instrument.model, address = instrument.address);
                    }
                    failures.push(error);
                }
            }
        }
        if args.json {
            let text = serde_json::to_string_pretty(&found).map_err(|error| Failure::Analysis(error.to_string()))?;
            say!("{text}");
        }
        if let Some(error) = failures.into_iter().next() {
            return Err(error.into());
        }
        found.iter().try_for_each(Identified::expected)?;
        Ok(())
    })
}

async fn ask(config: &config::Bench, connections: &Connections) -> Result<Vec<Identified>, BenchError> {
    Bench::open(config, connections).await?.identify().await
}

fn print_line(instrument: &Identified) {
    let verdict = if instrument.recognised { "ok" } else { "NOT THE CONFIGURED MODEL" };
    let (role, model, raw) = (instrument.role, &instrument.model, &instrument.identity.raw);
    say!("{role:<10} {model:<20} {address:<32} {raw}  [{verdict}]", address = instrument.address);
}
