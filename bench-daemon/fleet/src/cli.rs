//! Command line: reads the arguments, calls the command, and returns its exit code.

use std::{
    io::{self, IsTerminal},
    path::PathBuf,
    process::ExitCode,
};

use clap::{CommandFactory, Parser, Subcommand};
use clap_complete::{Shell, generate};
use tracing::level_filters::LevelFilter;

use crate::{
    agent,
    command::{self, Act, ConnectArgs},
    failure::Failure,
    terminal::say,
};

const EXAMPLES: &str = "\
Examples:
  An agent beside the server of a bench, until stopped:
    eis-fleet agent fleet.toml
  The benches of its fleet, and 20 runs for whichever of them is free:
    eis-fleet --config fleet.toml status
    eis-fleet --config fleet.toml submit configs/experiments/demo.toml --count 20
  The same from a machine without an agent:
    eis-fleet --fleet lab --server tls://nats.lab.example:4222 --credentials FILE status
  Stop one bench, or all:
    eis-fleet --config fleet.toml stop north/b1
    eis-fleet --config fleet.toml stop --all

Exit codes, with the same meaning as those of eis-bench:
  0  done
  1  a server does not answer, or something unexpected
  2  the command line or a file is not as expected, or the request is refused
  6  an output is not known to be off: LOOK AT THE BENCH";

/// Connects the server of a bench to a fleet; shows a fleet, gives it jobs, holds and stops its
/// benches.
#[derive(Debug, Parser)]
#[command(name = "eis-fleet", version, after_help = EXAMPLES, max_term_width = 120)]
struct Cli {
    #[command(flatten)]
    connect: ConnectArgs,
    #[command(subcommand)]
    command: Command,
    /// Print JSON.
    #[arg(long, global = true)]
    json: bool,
    /// Show every step (-v) or everything (-vv) on standard error.
    #[arg(short, long, action = clap::ArgAction::Count, global = true)]
    verbose: u8,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Work beside a server of benches until stopped: take jobs for its benches, follow holds and
    /// stops, serve the page and the API of the fleet.
    Agent {
        /// The file of the agent.
        #[arg(value_name = "FILE")]
        config: PathBuf,
    },
    #[command(flatten)]
    Act(Act),
    /// Print completions for bash, zsh, fish, elvish or PowerShell.
    Completions {
        /// The shell.
        shell: Shell,
    },
    /// Write manual pages.
    Man {
        /// The folder to write into: one page for each command.
        #[arg(value_name = "DIR")]
        folder: PathBuf,
    },
}

/// Runs the command line of this process.
pub fn main() -> ExitCode {
    let cli = Cli::parse();
    let level = match cli.verbose {
        0 => LevelFilter::WARN,
        1 => LevelFilter::INFO,
        _ => LevelFilter::DEBUG,
    };
    tracing_subscriber::fmt()
        .with_writer(io::stderr)
        .with_ansi(io::stderr().is_terminal())
        .with_max_level(level)
        .with_target(false)
        .init();
    let result = match &cli.command {
        Command::Agent { config } => agent::run(config),
        Command::Act(act) => command::run(&cli.connect, act, cli.json),
        Command::Completions { shell } => {
            generate(*shell, &mut Cli::command(), "eis-fleet", &mut io::stdout());
            Ok(())
        }
        Command::Man { folder } => write_manual(folder),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            // A closed standard error does not change the result.
            let _ = io::Write::write_fmt(&mut io::stderr(), format_args!("eis-fleet: {failure}\n"));
            ExitCode::from(failure.exit_code())
        }
    }
}

fn write_manual(folder: &std::path::Path) -> Result<(), Failure> {
    let wrong = |error: io::Error| Failure::Usage(format!("{}: {error}", folder.display()));
    std::fs::create_dir_all(folder).map_err(wrong)?;
    clap_mangen::generate_to(Cli::command(), folder).map_err(wrong)?;
    say!("written to {}", folder.display());
    Ok(())
}
