//! `eis-fleet`: an agent of a fleet of benches, and commands to a fleet.

fn main() -> std::process::ExitCode {
    bench_fleet::cli::main()
}
