//! Command line: reads the arguments, calls the command, and returns its exit code.

use std::process::ExitCode;

use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};

use crate::command;
use bench_core::{operator::run_control::RunAction, safety::failure::Failure};
use bench_evaluate::support::telemetry::Telemetry;
use bench_plan::support::{
    logging::{self, Verbosity},
    terminal::{remark, say},
};

/// Commands by what they are for, in the order of the help.
const GROUPS: [(&str, &[&str]); 7] = [
    ("To begin with", &["demo", "config"]),
    (
        "A bench",
        &[
            "run", "resume", "pause", "go-on", "abort", "reorder", "answer", "plan", "devices",
            "identify", "doctor", "outputs", "safe", "clear", "mock",
        ],
    ),
    (
        "Spectra and records",
        &["fit", "kk", "ocv", "hppc", "map", "joint"],
    ),
    (
        "What a model lacks",
        &["dataset", "diagnose", "investigate", "effects"],
    ),
    ("A cell or a pack under load", &["simulate", "pack", "sop"]),
    (
        "Files",
        &["convert", "replay", "verify", "catalog", "campaign"],
    ),
    (
        "Server and shell",
        &["serve", "token", "completions", "man"],
    ),
];
/// Width of the names of commands, and of a line, in the help.
const NAMES: usize = 13;
const LINE: usize = 100;

/// Printed for a call without a command.
const DOORS: &str = "\
Runs a battery test bench and turns its measurements into a cell model with uncertainties.

  Try it, without hardware      eis-bench demo
  You have a bench              eis-bench config new DIR, then `identify`, `doctor` and `plan`
  You have a spectrum           eis-bench kk FILE, then `fit FILE --out DIR`
  You have data of a cycler     eis-bench dataset init FILE --out DIR, `map`, `hppc`, `ocv`
  You have a model of a cell    eis-bench simulate, `sop`, `pack`, `convert --to c`

  All commands                  eis-bench --help
  One command                   eis-bench COMMAND --help";

const EXAMPLES: &str = "\
Examples:
  The whole job on the built-in simulated bench, in seconds, from files that it writes:
    eis-bench demo
  The same from the files of the repository:
    eis-bench run configs/experiments/demo.toml
  Go on with a run that died, in its folder:
    eis-bench resume runs/thesis
  Print the steps of an experiment and their duration; changes nothing:
    eis-bench plan configs/experiments/thesis.toml
  Identify the instruments at the configured addresses; changes nothing:
    eis-bench identify configs/benches/thesis.toml
  Examine a bench before its first use, with the fake cell instead of the cell:
    eis-bench doctor configs/benches/thesis-network.toml --fixture fake_cell
  Read the state of its outputs; changes nothing:
    eis-bench outputs configs/benches/thesis.toml
  Switch a bench off, no matter who runs it; without a file all benches that run or ran here:
    eis-bench safe configs/benches/thesis.toml
    eis-bench safe
  Serve the simulated instruments on real ports, until Ctrl-C:
    eis-bench mock configs/benches/demo.toml --json
  Serve a page and an API for benches, with a queue:
    eis-bench serve configs/serve.toml
  Fit the extended Randles model to spectra of any supported format:
    eis-bench fit SPECTRUM.csv --rc all --out FOLDER
  Fit any equivalent circuit, without start values:
    eis-bench fit SPECTRUM.csv --circuit 'R0-p(R1,C1)-p(R2-Wo1,CPE1)'
  Test whether spectra are valid: Kramers–Kronig and more, with pictures:
    eis-bench kk SPECTRUM.csv --drt --out FOLDER
  Run a load profile through a pack of the fitted cells:
    eis-bench simulate --model FOLDER/model_4rc.json --profile POWER.csv --series 16 --parallel 3 \
--ocv-v 3.72
  The same with a typed model, or with a fitted circuit:
    eis-bench simulate --erm \"6.43 mΩ; 1.51 mΩ, 0.553 F; 4.77 mΩ, 1.084 kF\" --profile POWER.csv \
--ocv-v 3.72
    eis-bench simulate --model FOLDER/circuit.json --profile POWER.csv --ocv-v 3.72
  Compute the open-circuit voltage from a slow discharge:
    eis-bench ocv DISCHARGE.csv --out FOLDER
  Compute pulse resistances and power over the state of charge:
    eis-bench hppc PULSES.csv --v-min 2.5 --v-max 4.2 --plot hppc.svg
  Fit the model to spectra and pulses together:
    eis-bench joint --spectra CELL*.csv --series PULSES.csv --ocv-from DISCHARGE.csv --out FOLDER
  Find what the model of a campaign lacks:
    eis-bench diagnose DATASET --model FOLDER/model.json --out FOLDER
  Run the whole loop on the simulated bench, with follow-up experiments:
    eis-bench investigate configs/experiments/investigate.toml --yes
  Analyse recorded captures again, and check that a run folder is unaltered:
    eis-bench replay runs/thesis
    eis-bench verify runs/thesis
  Catalogue all runs below a folder, and follow a cell over its runs:
    eis-bench catalog scan runs.sqlite runs
    eis-bench catalog ageing runs.sqlite --cell P45B-17 --out FOLDER
  A spectrum for ZView, a time series for the Battery Data Alliance's tools, a model for a \
controller:
    eis-bench convert SPECTRUM.csv --to zview --out FOLDER
    eis-bench convert SERIES.csv --to bdf-parquet --out FOLDER
    eis-bench convert model_4rc.json --to c --ocv ocv.json --out FOLDER
  Compute the power limits of a pack, and their duration:
    eis-bench pack size --series 16 --parallel 3 --ocv-v 3.6 --dcir-ohm 0.015
    eis-bench sop --model FOLDER/model_4rc.json --series 16 --parallel 3 --ocv-v 3.6

Exit codes:
  0  done
  1  an unexpected error
  2  the command line or a file is invalid; nothing was energised
  3  an instrument cannot be reached, answers wrongly or does not obey
  4  the fixture check or the doctor failed: do not trust measurements of this bench
  5  the interlock tripped, or a cell was in the jig instead of a control
  6  an output is not known to be off: LOOK AT THE BENCH, the message says what to unplug
  7  the bench is latched after a trip: inspect it, then run `eis-bench clear BENCH`
  8  another process runs the bench, or the guardian of an earlier run is still active on it
  9  the guardian cannot be started or was lost; the bench was brought into safe state
  10 a run folder was altered, or its numbers do not follow from its captures
  11 the run or its recomputation is finished, but the quality gate refused points: see the \
column `flags` of its spectra
  12 the diagnosis is finished, and its verdict is that the data are invalid
  130  stopped by Ctrl-C, Ctrl-Z, SIGTERM, `eis-bench abort` or the end of the terminal; the bench \
was brought into safe state";

/// Runs a battery test bench and turns its measurements into a cell model with uncertainties.
#[derive(Debug, Parser)]
#[command(name = "eis-bench", version, after_help = EXAMPLES, max_term_width = 120)]
struct Cli {
    #[command(subcommand)]
    command: Option<Command>,
    /// Show every step (-v) or everything (-vv) on standard error.
    #[arg(short, long, action = clap::ArgAction::Count, global = true)]
    verbose: u8,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Run the whole job on the built-in simulated bench, from files that it writes.
    Demo(command::demo::DemoArgs),
    /// Write example files, print the schemas of files, and check files.
    Config(command::config::ConfigArgs),
    /// Run an experiment: fixture check, SOC reset, sweep, fits, report.
    Run(command::run::RunArgs),
    /// Continue an interrupted or stopped run in its folder, at the next unfinished point.
    Resume(command::resume::ResumeArgs),
    /// Pause a run of another terminal at its next point, without any current.
    Pause(command::run_control::FolderArgs),
    /// Continue a paused run.
    GoOn(command::run_control::FolderArgs),
    /// End a run in safe state at its next point.
    Abort(command::run_control::FolderArgs),
    /// Move the named runs of a campaign to the front of its order.
    Reorder(command::run_control::ReorderArgs),
    /// Show the question of a run that waits for a person, or confirm that the fixture is changed.
    Answer(command::answer::AnswerArgs),
    /// Print the steps of an experiment and their duration. Changes nothing.
    Plan(command::plan::PlanArgs),
    /// Serve the simulated instruments of a bench on real ports until stopped.
    Mock(command::mock::MockArgs),
    /// List the instruments on USB and on serial ports of this machine by their addresses. Sends
    /// nothing.
    Devices(command::devices::DevicesArgs),
    /// Identify instruments, and print their abilities and programmed settings. Changes nothing on
    /// any of them.
    Identify(command::identify::IdentifyArgs),
    /// Examine a bench before its first use: instruments, probes, drive, limits, safe state,
    /// guardian; writes a signed report.
    Doctor(command::doctor::DoctorArgs),
    /// Read the state of the outputs of a bench. Changes nothing.
    Outputs(command::outputs::OutputsArgs),
    /// Switch a bench off, no matter who runs it, and print the read-back.
    Safe(command::safe::SafeArgs),
    /// Show why a bench is latched, and clear the latch after a person has inspected it.
    Clear(command::clear::ClearArgs),
    /// Read the spectra of a file on standard input, with bounds of memory and time.
    #[command(hide = true)]
    ReadSpectra(bench_serve::imported::ReadSpectraArgs),
    /// Watch the process that started it. A run starts its own guardian.
    #[command(hide = true)]
    Guardian(command::guardian::GuardianArgs),
    /// Fit the extended Randles model, or any equivalent circuit, to spectra.
    Fit(command::fit::FitArgs),
    /// Size a pack of cells, or run a profile through packs of cells that differ.
    Pack(command::pack::PackArgs),
    /// Test spectra: Kramers–Kronig, Z-HIT, linearity, stationarity; distribution of relaxation
    /// times.
    Kk(command::kk::KkArgs),
    /// Open-circuit voltage over state of charge from a slow discharge.
    Ocv(command::ocv::OcvArgs),
    /// Fit resistances over state of charge and temperature to logs of a cell.
    Map(command::map::MapArgs),
    /// Pulse resistances and power over state of charge from logs of a cycler.
    Hppc(command::hppc::HppcArgs),
    /// Run load profiles through a fitted model, as a cell or as a pack.
    Simulate(command::simulate::SimulateArgs),
    /// Fit the model to spectra and pulses together; print the error of the spectra alone on the
    /// pulses.
    Joint(command::joint::JointArgs),
    /// Make a data set for `diagnose` from spectra and logs of a cycler.
    Dataset(command::dataset::DatasetArgs),
    /// Find where a model and a data set disagree, which effect is missing, and whether adding it
    /// closes the gap.
    Diagnose(command::diagnose::DiagnoseArgs),
    /// Run a campaign, diagnose it, run the experiments that the diagnosis recommends within a
    /// budget, and diagnose again.
    Investigate(command::investigate::InvestigateArgs),
    /// Print the catalogue of effects that a model may lack.
    Effects(command::effects::EffectsArgs),
    /// State of power: the most power that can be held, over duration and state of charge.
    Sop(command::sop::SopArgs),
    /// Convert spectra, time series and models to and from the formats of other programs.
    Convert(command::convert::ConvertArgs),
    /// Process recorded captures with the present pipeline and report what changes.
    Replay(command::replay::ReplayArgs),
    /// Compare a run folder with its hashes, and recompute every number from its captures.
    Verify(command::verify::VerifyArgs),
    /// Build a catalogue of run folders and search it across runs and benches.
    Catalog(command::catalog::CatalogArgs),
    /// Plan measurements of many cells on several benches, and evaluate the results.
    Campaign(command::campaign::CampaignArgs),
    /// Serve benches over HTTP, with a queue, a page and an API, until stopped.
    Serve(command::serve::ServeArgs),
    /// Manage the tokens of a server's API.
    Token(command::token::TokenArgs),
    /// Print completions for bash, zsh, fish, elvish or PowerShell.
    Completions(command::shell::CompletionsArgs),
    /// Write manual pages.
    Man(command::shell::ManArgs),
}

/// The command line, its commands in groups.
fn grouped() -> clap::Command {
    let command = Cli::command();
    let mut text = String::from("Commands:\n");
    for (title, names) in GROUPS {
        text.push_str(&format!(
            "{} {title}:\n",
            if title == GROUPS[0].0 { "" } else { "\n" }
        ));
        for name in names {
            let about = command
                .find_subcommand(name)
                .and_then(clap::Command::get_about);
            let about = about.map_or_else(String::new, ToString::to_string);
            let mut line = format!("  {name:<NAMES$}");
            for word in about.split_whitespace() {
                if line.chars().count() + 1 + word.chars().count() > LINE {
                    text.push_str(line.trim_end());
                    text.push('\n');
                    line = format!("  {:<NAMES$}", "");
                }
                line.push_str(word);
                line.push(' ');
            }
            text.push_str(line.trim_end());
            text.push('\n');
        }
    }
    command.help_template(format!(
        "{{about-with-newline}}\n{{usage-heading}} {{usage}}\n\n{text}\nOptions:\n{{options}}{{after-help}}"
    ))
}

/// Runs the command line of this process.
pub fn main() -> ExitCode {
    let matches = grouped().get_matches();
    let cli = Cli::from_arg_matches(&matches).unwrap_or_else(|error| error.exit());
    let Some(command) = cli.command else {
        say!("{DOORS}");
        return ExitCode::SUCCESS;
    };
    let verbosity = match cli.verbose {
        0 if matches!(command, Command::Identify(_)) => Verbosity::Quiet,
        0 => Verbosity::Normal,
        1 => Verbosity::Verbose,
        _ => Verbosity::Debug,
    };
    // What a server sends is said in its file.
    let telemetry = match command {
        Command::Run(_) | Command::Resume(_) => {
            Telemetry::from_environment(&std::process::id().to_string())
        }
        _ => Telemetry::default(),
    };
    logging::start(verbosity, telemetry.layer());
    let result = match command {
        Command::Run(args) => command::run::run(&args),
        Command::Resume(args) => command::resume::resume(&args),
        Command::Pause(args) => command::run_control::send_action(&args, RunAction::Pause),
        Command::GoOn(args) => command::run_control::send_action(&args, RunAction::GoOn),
        Command::Abort(args) => command::run_control::send_action(&args, RunAction::Abort),
        Command::Reorder(args) => command::run_control::reorder(&args),
        Command::Answer(args) => command::answer::answer(&args),
        Command::ReadSpectra(args) => bench_serve::imported::command(&args),
        Command::Plan(args) => command::plan::plan(&args),
        Command::Mock(args) => command::mock::mock(&args),
        Command::Devices(args) => command::devices::devices(&args),
        Command::Identify(args) => command::identify::identify(&args),
        Command::Doctor(args) => command::doctor::doctor(&args),
        Command::Outputs(args) => command::outputs::outputs(&args),
        Command::Safe(args) => command::safe::safe(&args),
        Command::Clear(args) => command::clear::clear(&args),
        Command::Guardian(args) => command::guardian::guardian(&args),
        Command::Fit(args) => command::fit::fit(&args),
        Command::Pack(args) => command::pack::pack(&args),
        Command::Kk(args) => command::kk::kk(&args),
        Command::Ocv(args) => command::ocv::ocv(&args),
        Command::Map(args) => command::map::map(&args),
        Command::Hppc(args) => command::hppc::hppc(&args),
        Command::Simulate(args) => command::simulate::simulate(&args),
        Command::Joint(args) => command::joint::joint(&args),
        Command::Dataset(args) => command::dataset::dataset(&args),
        Command::Diagnose(args) => command::diagnose::diagnose(&args),
        Command::Investigate(args) => command::investigate::investigate(&args),
        Command::Effects(args) => command::effects::effects(&args),
        Command::Sop(args) => command::sop::sop(&args),
        Command::Convert(args) => command::convert::convert(&args),
        Command::Replay(args) => command::replay::replay(&args),
        Command::Verify(args) => command::verify::verify(&args),
        Command::Catalog(args) => command::catalog::catalog(&args),
        Command::Campaign(args) => command::campaign::campaign(&args),
        Command::Serve(args) => command::serve::serve(&args),
        Command::Token(args) => command::token::token(&args),
        Command::Demo(args) => command::demo::demo(&args),
        Command::Config(args) => command::config::config(&args),
        Command::Completions(args) => {
            command::shell::completions(&args, Cli::command());
            Ok(())
        }
        Command::Man(args) => command::shell::man(&args, Cli::command()),
    };
    telemetry.end();
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            remark!("eis-bench: {failure}");
            ExitCode::from(Failure::exit_code(&failure))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_command_stands_in_one_group() {
        let command = Cli::command();
        let visible = command.get_subcommands().filter(|one| !one.is_hide_set());
        let mut visible: Vec<&str> = visible.map(clap::Command::get_name).collect();
        let mut named: Vec<&str> = GROUPS
            .iter()
            .flat_map(|(_, names)| names.iter().copied())
            .collect();
        visible.sort_unstable();
        named.sort_unstable();
        assert_eq!(visible, named);
    }

    #[test]
    fn the_command_line_is_sound_and_its_help_teaches() {
        Cli::command().debug_assert();
        let help = grouped().render_long_help().to_string();
        for text in [
            "run",
            "plan",
            "mock",
            "identify",
            "doctor",
            "safe",
            "clear",
            "fit",
            "kk",
            "ocv",
            "hppc",
            "joint",
            "dataset",
            "diagnose",
            "investigate",
            "effects",
            "simulate",
            "serve",
            "pack",
            "convert",
            "replay",
            "verify",
            "catalog",
            "sop",
            "Examples:",
            "Exit codes:",
        ] {
            assert!(help.contains(text), "{help}");
        }
    }
}
