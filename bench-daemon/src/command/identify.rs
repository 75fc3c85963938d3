//! `eis-bench identify`: who answers at the configured addresses.

use std::collections::BTreeMap;

use instruments::{
    clock::{Clock, TimeMode},
    transport::{Address, MemoryHub},
};

use crate::{
    bench::{Bench, Connections},
    cli::IdentifyArgs,
    command::Failure,
    config::load_bench,
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
        let mut bench = Bench::open(&config, &Connections { clock, hub, taps: BTreeMap::new() }).await?;
        let found = bench.identify().await?;
        if args.json {
            let text = serde_json::to_string_pretty(&found).map_err(|error| Failure::Analysis(error.to_string()))?;
            println!("{text}");
        } else {
            for instrument in &found {
                let verdict = if instrument.recognised { "ok" } else { "NOT THE CONFIGURED MODEL" };
                let (role, model, raw) = (instrument.role, &instrument.model, &instrument.identity.raw);
                println!("{role:<10} {model:<20} {address:<32} {raw}  [{verdict}]", address = instrument.address);
            }
        }
        bench.identify_strictly().await?;
        Ok(())
    })
}
