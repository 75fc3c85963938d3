//! `eis-bench mock`: the simulated instruments on real ports.

mod args;
pub mod record;

use std::path::Path;

use instruments::clock::{Clock, TimeMode};

use self::record::serve_record;
pub use args::MockArgs;
use bench_core::{
    safety::failure::Failure,
    sim::{Served, SimError, Simulation},
};
use bench_evaluate::run::StopSignals;
use bench_plan::{
    config::{Source, load_bench},
    support::terminal::say,
};

/// Serves the simulated instruments of a bench until it is stopped.
///
/// # Errors
/// A mistake in the files; a port that is in use.
pub fn mock(args: &MockArgs) -> Result<(), Failure> {
    let path = match (&args.replay, &args.bench) {
        (Some(transcript), _) => return serve_record(transcript, args),
        (None, Some(path)) => path,
        (None, None) => {
            return Err(Failure::Usage(
                "expected a bench file, or --replay FILE".to_owned(),
            ));
        }
    };
    let (bench, source) = load_bench(path)?;
    let section = bench
        .simulation
        .as_ref()
        .ok_or_else(|| SimError::Real { path: path.clone() })?;
    let roles: Vec<&str> = bench
        .instruments
        .addressed()
        .iter()
        .map(|(role, _)| *role)
        .collect();
    if let Some(role) = args
        .over
        .iter()
        .filter_map(|over| over.role.as_deref())
        .find(|role| !roles.contains(role))
    {
        return Err(Failure::Usage(format!(
            "--over: expected a role of this bench ({}), found `{role}`",
            roles.join(", ")
        )));
    }
    if let Some(written) = &args.write_bench
        && written
            .canonicalize()
            .is_ok_and(|written| path.canonicalize().is_ok_and(|read| read == written))
    {
        let text = format!(
            "--write-bench {}: expected another file than the bench file itself, which would be \
            lost",
            written.display()
        );
        return Err(Failure::Usage(text));
    }
    let mode = match &args.time {
        Some(text) => text
            .parse::<TimeMode>()
            .map_err(|error| Failure::Usage(format!("--time: {error}")))?,
        // In virtual time nothing waits for a client on a real port.
        None if section.time == TimeMode::Virtual => TimeMode::Real,
        None => section.time,
    };
    if mode == TimeMode::Virtual {
        return Err(Failure::Usage(
            "--time: expected `real` or `scaled:FACTOR`: real ports cannot answer in virtual time"
                .to_owned(),
        ));
    }
    Clock::runtime(mode)?.block_on(async {
        let mut stop = StopSignals::install()?;
        let clock = Clock::start(mode);
        let simulation = Simulation::new(&section.scenario, args.seed)?
            .with_faults(section.faults.clone())
            .with_quirks(section.quirks.clone());
        let served = simulation.serve_on_ports(&bench, &args.over, &clock).await?;
        if let Some(path) = &args.write_bench {
            write_bench(path, &source, &served, mode)?;
        }
        if args.json {
            let addresses: serde_json::Map<String, serde_json::Value> =
                served.iter().map(|mock| (mock.role.to_owned(), mock.address.clone().into())).collect();
            say!("{}", serde_json::json!({ "bench": bench.name, "time": mode.to_string(), "addresses": addresses }));
        } else {
            say!("bench {} in {mode} time; Ctrl-C ends it", bench.name);
            for mock in &served {
                say!("  {:<10} {:<20} {}", mock.role, mock.model, mock.address);
            }
        }
        stop.requested().await;
        Ok(())
    })
}

/// Writes the bench file with other addresses and the time of the mocks; everything else stays as
/// typed.
fn write_bench(
    path: &Path,
    source: &Source,
    served: &[Served],
    mode: TimeMode,
) -> Result<(), Failure> {
    let mut section = String::new();
    let mut text = String::new();
    let named = |path: &Path, error: std::io::Error| {
        Failure::Usage(format!("--write-bench: {}: {error}", path.display()))
    };
    // A file in the working folder has an empty parent.
    let parent = source.path().parent().unwrap_or(Path::new(""));
    let folder = Path::new(".").join(parent);
    let scenario_folder = folder
        .canonicalize()
        .map_err(|error| named(&folder, error))?;
    for line in source.text().lines() {
        let trimmed = line.trim();
        if trimmed.starts_with('[') {
            section = trimmed.trim_matches(['[', ']']).to_owned();
        }
        let key = trimmed.split('=').next().unwrap_or("").trim();
        let address = served
            .iter()
            .find(|mock| section == format!("instruments.{}", mock.role))
            .filter(|_| key == "address");
        match (address, section.as_str(), key) {
            (Some(mock), _, _) => text.push_str(&format!("address = {:?}\n", mock.address)),
            (None, "simulation", "time") => {}
            (None, "simulation", "scenario") => {
                let value = trimmed
                    .split_once('=')
                    .map_or("", |(_, value)| value)
                    .trim()
                    .trim_matches('"');
                let scenario = scenario_folder.join(value);
                let scenario = scenario
                    .canonicalize()
                    .map_err(|error| named(&scenario, error))?;
                text.push_str(&format!(
                    "scenario = {scenario:?}\ntime = {:?}\n",
                    mode.to_string()
                ));
            }
            _ => {
                text.push_str(line);
                text.push('\n');
            }
        }
    }
    std::fs::write(path, text)
        .map_err(|error| Failure::Usage(format!("--write-bench {}: {error}", path.display())))?;
    // The written file must parse as a bench with these addresses: a file in another style
    // (inline tables) would keep its old addresses.
    let (bench, _) = load_bench(path)?;
    let addressed = bench.instruments.addressed();
    let missed = served.iter().find(|mock| {
        !addressed
            .iter()
            .any(|(role, found)| *role == mock.role && found.address.to_string() == mock.address)
    });
    match missed {
        None => Ok(()),
        Some(mock) => Err(Failure::Usage(format!(
            "--write-bench: expected `address = \"…\"` on a line of its own under [instruments.{}] \
            in {}",
            mock.role,
            source.path().display()
        ))),
    }
}
