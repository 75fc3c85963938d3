//! `eis-bench simulate`: load profiles through a fitted model, as a cell or as a pack.

mod case;
mod figure;

use crate::{
    command::{
        model_args::ModelArgs,
        profile_args::{ProfileArgs, taken},
    },
    files,
    safety::failure::Failure,
    support::present::one_or_list,
    support::terminal::{remark, say},
};
use std::path::{Path, PathBuf};

use analysis::{
    dataset::write_trace_parquet,
    formats::read_profile,
    forward::{
        Beyond, CellWindow, ForwardError, Infeasible, Method, OcvSource, Profile, SimModel,
        SimOptions, SimState,
    },
    given::GivenModel,
    pack::Pack,
};

use case::{Case, Output};

/// Most steps of explicit Euler: six hours of the thesis' 4-RC model, whose shortest time constant
/// of 0.83 ms makes steps of 0.21 ms.
const MOST_EULER_STEPS: f64 = 1e8;

/// Arguments of `simulate`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Margins are per cell (mean over the cells in series, interconnect left out) and positive inside \
the window; min_ccv_v and max_ccv_v are \
voltages at the terminals. `feasible` says that all power asked for could be had; whether the \
window was kept, the margins say.
Power and current count discharge as positive. Each row of a profile holds until the next; the \
last row only ends it.")]
pub struct SimulateArgs {
    /// Which model.
    #[command(flatten)]
    pub model: ModelArgs,
    /// The cell's OCV curve, as `ocv --out` writes it, where the model holds none or another is
    /// wanted.
    #[arg(long, value_name = "JSON")]
    pub ocv: Option<PathBuf>,
    /// Two columns, time and power, current or load resistance, with or without header; several for
    /// a table over all.
    #[arg(long = "profile", required = true, value_name = "FILE")]
    pub profiles: Vec<PathBuf>,
    /// Cells in series.
    #[arg(long, default_value_t = 1, value_name = "N")]
    pub series: u32,
    /// Cells in parallel.
    #[arg(long, default_value_t = 1, value_name = "N")]
    pub parallel: u32,
    /// Resistance of busbars, wires and connectors over the whole pack, Ω.
    #[arg(
        long,
        default_value_t = 0.0,
        value_name = "OHM",
        allow_negative_numbers = true
    )]
    pub interconnect_ohm: f64,
    /// State of charge at the start, 0 to 1; needs a model with an OCV curve, or --ocv. This
    /// or --ocv-v is needed.
    #[arg(
        long,
        value_name = "X",
        conflicts_with = "ocv_v",
        allow_negative_numbers = true
    )]
    pub soc: Option<f64>,
    /// Open-circuit voltage of a cell at the start, V; without an OCV curve in the model it stays.
    #[arg(long, value_name = "V", allow_negative_numbers = true)]
    pub ocv_v: Option<f64>,
    /// How the files are read.
    #[command(flatten)]
    pub read: ProfileArgs,
    /// `exact`: exponential steps with error control; `thesis`: its three steps, explicit Euler, by
    /// a quarter of the shortest time constant or by --step-s.
    #[arg(long, value_enum, default_value_t = Steps::Exact)]
    pub method: Steps,
    /// Treatment of power that cannot be had: `stop`, or `extrapolate` along the tangent from 95 %
    /// of it (thesis 4.2.1), which ends at 0 V.
    #[arg(long, value_enum, default_value_t = Policy::Stop)]
    pub beyond: Policy,
    /// Longest distance of two rows of the trace, and step of `thesis`, s [default: a 2000th of the
    /// profile]
    #[arg(long, value_name = "S", allow_negative_numbers = true)]
    pub step_s: Option<f64>,
    /// DC resistance of a cell for the simple-IR model, Ω [default: that of the model]
    #[arg(long, value_name = "OHM", allow_negative_numbers = true)]
    pub dcir_ohm: Option<f64>,
    /// Lowest voltage of a cell, V.
    #[arg(long, default_value_t = CellWindow::THESIS.low_v, value_name = "V", allow_negative_numbers = true)]
    pub low_v: f64,
    /// Highest voltage of a cell, V.
    #[arg(long, default_value_t = CellWindow::THESIS.high_v, value_name = "V", allow_negative_numbers = true)]
    pub high_v: f64,
    /// Folder for traces (Parquet) and plots [default: the traces into the current directory, no
    /// plots]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Print JSON: one object for one profile, a list for several.
    #[arg(long)]
    pub json: bool,
}

/// Step methods.
#[derive(Debug, Clone, Copy, clap::ValueEnum)]
pub enum Steps {
    /// Exponential steps with error control.
    Exact,
    /// Explicit Euler.
    Thesis,
}

/// Treatment of power that cannot be had.
#[derive(Debug, Clone, Copy, clap::ValueEnum)]
pub enum Policy {
    /// The simulation ends.
    Stop,
    /// The voltage goes on along its tangent.
    Extrapolate,
}

/// Runs the profiles, prints what comes of them, and writes traces and plots.
///
/// # Errors
/// A file or an argument that is not as expected; a folder that cannot be written.
pub fn simulate(args: &SimulateArgs) -> Result<(), Failure> {
    let (file, model) = model(args)?;
    let state = state(args, &model)?;
    let window = window(args)?;
    let mut outputs = Vec::new();
    let mut cases = Vec::new();
    for path in &args.profiles {
        let profile = read_profile(path, &args.read.options()).map_err(usage)?;
        check_euler(args, &model, &profile)?;
        let options = options(args, &profile, window);
        let case =
            Case::run(&file, &model, &state, profile, options, args.dcir_ohm).map_err(|error| {
                match error {
                    ForwardError::Unstable { .. } => Failure::Usage(format!("--step-s: {error}")),
                    other => usage(other),
                }
            })?;
        let trace = trace_path(args, &case.profile.name, &outputs);
        write_trace_parquet(&trace, &case.full.trace, window)
            .map_err(|error| Failure::Analysis(error.to_string()))?;
        outputs.push(case.output(&file, &model, trace));
        cases.push(case);
    }
    if let Some(folder) = &args.out {
        figure::write(folder, &cases, &model, window)?;
    }
    if args.json {
        print_json(&outputs)
    } else {
        print_text(&outputs, &model, &cases, args)
    }
}

fn usage(error: impl std::fmt::Display) -> Failure {
    Failure::Usage(error.to_string())
}

fn model(args: &SimulateArgs) -> Result<(GivenModel, SimModel), Failure> {
    let name = args.model.told();
    let file = args.model.read(args.ocv.as_deref())?;
    let ocv = match (&file.ocv, args.ocv_v) {
        (Some(curve), _) => OcvSource::Curve(curve.clone()),
        (None, Some(ocv_v)) => OcvSource::Constant(ocv_v),
        (None, None) if args.soc.is_none() => {
            return Err(Failure::Usage(
                "expected --soc or --ocv-v, found neither".to_owned(),
            ));
        }
        (None, None) => {
            return Err(Failure::Usage(format!(
                "--soc: expected a model with an OCV curve, {name} has none; give --ocv-v instead, \
                or a curve with --ocv"
            )));
        }
    };
    let pack = Pack::new(args.series, args.parallel, args.interconnect_ohm).map_err(usage)?;
    let model = files::sim_model(&file, ocv, pack)?;
    if let Some(folder) = &args.out {
        files::make_folder(folder)?;
    }
    Ok((file, model))
}

fn state(args: &SimulateArgs, model: &SimModel) -> Result<SimState, Failure> {
    match (args.soc, args.ocv_v) {
        (Some(soc), _) => model
            .rest(soc)
            .map_err(|error| Failure::Usage(format!("--soc: {error}"))),
        (None, Some(ocv_v)) => model
            .rest_at(ocv_v)
            .map_err(|error| Failure::Usage(format!("--ocv-v: {error}"))),
        (None, None) => Err(Failure::Usage(
            "expected --soc or --ocv-v, found neither".to_owned(),
        )),
    }
}

fn window(args: &SimulateArgs) -> Result<CellWindow, Failure> {
    let window = CellWindow {
        low_v: args.low_v,
        high_v: args.high_v,
    };
    if args.low_v < args.high_v {
        return Ok(window);
    }
    Err(Failure::Usage(format!(
        "--low-v, --high-v: expected a lower below a higher voltage, found {} and {} V",
        args.low_v, args.high_v
    )))
}

fn options(args: &SimulateArgs, profile: &Profile, window: CellWindow) -> SimOptions {
    let beyond = match args.beyond {
        Policy::Stop => Beyond::Stop,
        Policy::Extrapolate => Beyond::Extrapolate {
            fraction: Beyond::FRACTION,
        },
    };
    let method = match args.method {
        Steps::Exact => Method::Exact,
        Steps::Thesis => Method::Thesis,
    };
    let max_step_s = args.step_s.unwrap_or_else(|| profile.duration_s() / 2000.0);
    SimOptions {
        method,
        beyond,
        window,
        max_step_s,
        thesis_step_s: args.step_s,
        ..SimOptions::default()
    }
}

/// Explicit Euler steps by a quarter of the shortest time constant, which for a circuit's ladder
/// lies far below the profile's own times.
fn check_euler(args: &SimulateArgs, model: &SimModel, profile: &Profile) -> Result<(), Failure> {
    let shortest_s = model
        .erm
        .time_constants_s()
        .into_iter()
        .fold(f64::INFINITY, f64::min);
    let steps = 4.0 * profile.duration_s() / shortest_s;
    if !matches!(args.method, Steps::Thesis) || args.step_s.is_some() || steps <= MOST_EULER_STEPS {
        return Ok(());
    }
    Err(Failure::Usage(format!(
        "--method thesis: expected at most {MOST_EULER_STEPS:e} steps of a quarter of the shortest \
        time constant, met {steps:.1e}, for that is {shortest_s:.1e} s; \
         take --method exact"
    )))
}

/// Two profiles of one name from different folders must not share a trace.
fn trace_path(args: &SimulateArgs, name: &str, earlier: &[Output]) -> PathBuf {
    let folder = args.out.clone().unwrap_or_default();
    let path = |number: usize| match (args.profiles.len(), args.out.is_some(), number) {
        (1, true, _) => folder.join("trace.parquet"),
        (_, _, 0) => folder.join(format!("{name}.trace.parquet")),
        _ => folder.join(format!("{name}-{}.trace.parquet", number + 1)),
    };
    (0..)
        .map(path)
        .find(|path| earlier.iter().all(|other| other.trace != *path))
        .unwrap_or_else(|| Path::new("trace.parquet").to_owned())
}

fn print_json(outputs: &[Output]) -> Result<(), Failure> {
    let text = one_or_list(outputs).map_err(|error| Failure::Analysis(error.to_string()))?;
    say!("{text}");
    Ok(())
}

fn print_text(
    outputs: &[Output],
    model: &SimModel,
    cases: &[Case],
    args: &SimulateArgs,
) -> Result<(), Failure> {
    let (fast, slow) = (1e3 * model.erm.r_ohm, 1e3 * model.erm.dc_resistance_ohm());
    let rest = outputs
        .first()
        .zip(cases.first())
        .and_then(|(_, case)| case.full.trace.ocv_v.first().copied())
        .unwrap_or(f64::NAN);
    say!(
        "{}: {} RC, at the terminals R {fast:.2} mΩ, DC resistance {slow:.2} mΩ, OCV {rest:.2} V",
        model.pack.name(),
        model.erm.branches.len()
    );
    let dcir_mohm = 1e3 * outputs.first().map_or(f64::NAN, |o| o.simple_ir.dcir_ohm);
    let source = if args.dcir_ohm.is_some() {
        "as given"
    } else {
        "of the model"
    };
    say!(
        "cells within {} to {} V; simple IR is a DC resistance of {dcir_mohm:.2} mΩ per cell \
        alone, {source}",
        args.low_v,
        args.high_v
    );
    for case in cases {
        say!("{}", taken(&case.profile));
    }
    say!("");
    case::print_table(outputs);
    for output in outputs {
        if let Some(Infeasible {
            time_s,
            power_w,
            available_w,
            ..
        }) = &output.first_infeasible
        {
            remark!(
                "{}: at {time_s:.4} s {power_w:.1} W were asked for, {available_w:.1} W could be \
                had",
                output.profile
            );
        }
        if let Some(end) = &output.summary.tangent_end {
            remark!(
                "{}: the run ends at {:.4} s of its profile: see the note",
                output.profile,
                end.time_s
            );
        }
    }
    say!("");
    for output in outputs {
        say!("{}", case::sentence(output));
    }
    let mut told: Vec<&String> = Vec::new();
    for note in outputs.iter().flat_map(|output| &output.notes) {
        if !told.contains(&note) {
            say!("note: {note}");
            told.push(note);
        }
    }
    say!("");
    for output in outputs {
        say!("trace of {}: {}", output.profile, output.trace.display());
    }
    if let Some(folder) = &args.out {
        say!("plots in {}", folder.display());
    }
    Ok(())
}
