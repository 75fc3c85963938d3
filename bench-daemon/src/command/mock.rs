//! `eis-bench mock`: the simulated instruments on real ports.

pub mod record;

use std::path::{Path, PathBuf};

use instruments::clock::{Clock, TimeMode};

use self::record::serve_record;
use crate::{
    config::{Source, load_bench},
    run::StopSignals,
    safety::failure::Failure,
    sim::{Served, SimError, Simulation},
    support::terminal::say,
};

/// Arguments of `mock`.
#[derive(Debug, clap::Args)]
pub struct MockArgs {
    /// The bench file; needs a section `[simulation]`.
    #[arg(required_unless_present = "replay")]
    pub bench: Option<PathBuf>,
    /// Serve a recorded conversation instead: `transcripts/ROLE.txt` of a run folder, or another
    /// transcript. It answers as then, and ends at the first message that is another.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["bench", "time", "write_bench", "seed"])]
    pub replay: Option<PathBuf>,
    /// With --replay: the model whose conversation it is, where neither the file's name nor a
    /// manifest tells it.
    #[arg(long, value_name = "KEY", requires = "replay")]
    pub model: Option<String>,
    /// With --replay: where to listen.
    #[arg(
        long,
        value_name = "HOST:PORT",
        default_value = "127.0.0.1:0",
        requires = "replay"
    )]
    pub listen: String,
    /// Print the addresses as one line of JSON.
    #[arg(long)]
    pub json: bool,
    /// Bench time: `real` or `scaled:FACTOR`; overrides the bench file. Clients must run at the
    /// same pace: --write-bench tells them.
    #[arg(long, value_name = "MODE")]
    pub time: Option<String>,
    /// Serve over another transport than the addresses name, on a free port of this machine:
    /// TRANSPORT for all instruments, ROLE=TRANSPORT for one; tcp, vxi11, vxi11-mapped, hislip,
    /// gpib or serial. `memory:` addresses are served over tcp without it.
    #[arg(long, value_name = "[ROLE=]TRANSPORT")]
    pub over: Vec<crate::sim::Over>,
    /// Seed of the simulated world.
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
    /// Write a copy of the bench file with the real addresses, for `run --bench`.
    #[arg(long, value_name = "FILE")]
    pub write_bench: Option<PathBuf>,
}

/// Serves the simulated instruments of a bench until it is stopped.
///
/// # Errors
/// A mistake in the files; a port that is taken.
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

/// The bench file with other addresses and the time of the mocks; everything else stays as it was
/// typed.
fn write_bench(
    path: &Path,
    source: &Source,
    served: &[Served],
    mode: TimeMode,
) -> Result<(), Failure> {
    let mut section = String::new();
    let mut text = String::new();
    let scenario_folder = source
        .path()
        .parent()
        .unwrap_or(Path::new("."))
        .canonicalize()?;
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
                text.push_str(&format!(
                    "scenario = {:?}\ntime = {:?}\n",
                    scenario_folder.join(value).canonicalize()?,
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
    // What was written must be read back as a bench: a file in another style (inline tables) would
    // keep its old addresses.
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
