//! `eis-bench`: arguments → exit code.

use std::process::ExitCode;

fn main() -> ExitCode {
    bench_daemon::cli::main()
}
