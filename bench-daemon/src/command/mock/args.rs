//! Arguments of `mock`.

use std::path::PathBuf;

/// Arguments of `mock`.
#[derive(Debug, clap::Args)]
pub struct MockArgs {
    /// The bench file; needs a section `[simulation]`.
    #[arg(required_unless_present = "replay")]
    pub bench: Option<PathBuf>,
    /// Serve a recorded conversation instead: `transcripts/ROLE.txt` of a run folder, or another
    /// transcript. It repeats the recorded answers, and ends at the first message that differs.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["bench", "time", "write_bench", "seed"])]
    pub replay: Option<PathBuf>,
    /// With --replay: the instrument model of the conversation, if neither the file's name nor a
    /// manifest states it.
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
    /// same rate, which --write-bench writes into their bench file.
    #[arg(long, value_name = "MODE")]
    pub time: Option<String>,
    /// Serve over another transport than the addresses name, on a free port of this machine:
    /// TRANSPORT for all instruments, ROLE=TRANSPORT for one; tcp, vxi11, vxi11-mapped, hislip,
    /// gpib or serial. `memory:` addresses are served over tcp without it.
    #[arg(long, value_name = "[ROLE=]TRANSPORT")]
    pub over: Vec<bench_core::sim::Over>,
    /// Seed of the simulated world.
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
    /// Write a copy of the bench file with the real addresses, for `run --bench`.
    #[arg(long, value_name = "FILE")]
    pub write_bench: Option<PathBuf>,
}
