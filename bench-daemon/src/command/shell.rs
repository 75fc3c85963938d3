//! `eis-bench completions` and `eis-bench man`: generates shell completions and manual pages of
//! the commands.

use std::{io, path::PathBuf};

use clap::{Args, Command};
use clap_complete::{Shell, generate};

use bench_core::safety::failure::Failure;
use bench_evaluate::files;
use bench_plan::support::terminal::say;

/// Arguments of `completions`.
#[derive(Debug, Args)]
pub struct CompletionsArgs {
    /// The shell.
    pub shell: Shell,
}

/// Arguments of `man`.
#[derive(Debug, Args)]
pub struct ManArgs {
    /// The folder to write into: one page for each command.
    #[arg(value_name = "DIR")]
    pub folder: PathBuf,
}

/// Prints the completions of a shell.
pub fn completions(args: &CompletionsArgs, mut command: Command) {
    generate(args.shell, &mut command, "eis-bench", &mut io::stdout());
}

/// Writes the manual pages.
///
/// # Errors
/// A folder that cannot be written.
pub fn man(args: &ManArgs, command: Command) -> Result<(), Failure> {
    files::make_folder(&args.folder)?;
    clap_mangen::generate_to(command, &args.folder)
        .map_err(|error| Failure::Usage(format!("{}: {error}", args.folder.display())))?;
    say!("written to {}", args.folder.display());
    Ok(())
}
