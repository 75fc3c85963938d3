//! `eis-bench guardian`: the process that a run starts beside itself; see [`bench_core::safety::guardian`].

use std::path::PathBuf;

use clap::Args;
use instruments::{
    clock::Clock,
    units::{Celsius, Volts},
};

use bench_core::{
    safety::failure::Failure,
    safety::guardian::{self, Charge, Keeper},
};
use bench_evaluate::run::StopSignals;
use bench_plan::{
    config::load_bench,
    support::{hash, terminal::say},
};

/// Arguments of `guardian`.
#[derive(Debug, Args)]
pub struct GuardianArgs {
    /// The bench file.
    pub bench: PathBuf,
    /// The run folder that it watches.
    #[arg(long)]
    pub run: PathBuf,
    /// Least voltage of the cell, V.
    #[arg(long)]
    pub least_v: f64,
    /// Greatest voltage of the cell, V.
    #[arg(long)]
    pub greatest_v: f64,
    /// Least temperature of the cell, °C.
    #[arg(
        long = "least-c",
        value_name = "LEAST_C",
        requires = "greatest_degc",
        allow_hyphen_values = true
    )]
    pub least_degc: Option<f64>,
    /// Greatest temperature of the cell, °C.
    #[arg(
        long = "greatest-c",
        value_name = "GREATEST_C",
        requires = "least_degc",
        allow_hyphen_values = true
    )]
    pub greatest_degc: Option<f64>,
    /// SHA-256 of the bench file as the daemon has read it.
    #[arg(long)]
    pub sha256: String,
}

/// Watches the process that started it and switches the bench off when that ends without a goodbye.
///
/// # Errors
/// Any failure to watch, or to verify safe state.
pub fn guardian(args: &GuardianArgs) -> Result<(), Failure> {
    let (bench, source) = load_bench(&args.bench)?;
    let found = hash::sha256(source.text());
    if found != args.sha256 {
        say!(
            "refused {}: expected the bench file that the run began with, found another text: put \
            it back (the run folder has a copy in config/)",
            args.bench.display()
        );
        return Err(Failure::Usage("the bench file has changed".to_owned()));
    }
    Ok(Clock::runtime(bench.time())?.block_on(async {
        // The end of the terminal and a request to stop are for the daemon; the guardian ends after
        // it.
        let _deaf = StopSignals::install().map_err(guardian::GuardianError::Start)?;
        let cell_degc = args.least_degc.zip(args.greatest_degc);
        let charge = Charge {
            bench: &bench,
            run: &args.run,
            window_v: (Volts(args.least_v), Volts(args.greatest_v)),
            cell_degc: cell_degc.map(|(least, greatest)| (Celsius(least), Celsius(greatest))),
            sha256: found,
        };
        guardian::watch(&charge, &Clock::start(bench.time()))
            .await
            .inspect_err(|error| {
                if error.may_pass() {
                    say!("{}", Keeper::MAY_PASS);
                }
            })
    })?)
}
