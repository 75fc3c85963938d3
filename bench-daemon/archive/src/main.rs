//! `eis-archive`: sends the ended runs of a data folder to a store, and fetches them. Works on run
//! folders only: no bench and no server waits for it.

mod command;
mod data_folder;
mod failure;
mod open;
mod print;
mod settings;
mod status;

use std::process::ExitCode;

use clap::Parser;

/// Sends ended runs to a store, and brings them back.
#[derive(Debug, Parser)]
#[command(
    name = "eis-archive",
    version,
    after_help = "Exit codes:
    0  done
    1  the store, or a file, failed an operation
    2  the arguments or a file are not as expected
   10  a run or an object is not as it should be"
)]
struct Arguments {
    #[command(subcommand)]
    action: command::Action,
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    match command::run(&arguments.action) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            print::print_remark(format_args!("{failure}"));
            ExitCode::from(failure.exit_code())
        }
    }
}
