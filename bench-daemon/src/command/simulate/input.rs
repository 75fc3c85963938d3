//! Arguments of `eis-bench simulate`, and what follows from them.

use crate::command::units;
use bench_plan::config::quantity::{Duration, Resistance, Temperature, Voltage};
use std::path::PathBuf;

use analysis::{
    forward::{Beyond, CellWindow, Method, OcvSource, Profile, SimModel, SimOptions, SimState},
    given::GivenModel,
};

use crate::command::{
    model_args::{ModelArgs, PackArgs, WindowArgs},
    profile_args::ProfileArgs,
};
use bench_core::safety::failure::Failure;
use bench_evaluate::files::AMBIENT_DEGC;

/// Most steps of explicit Euler: six hours of the thesis' 4-RC model, whose shortest time constant
/// of 0.83 ms makes steps of 0.21 ms.
const MOST_EULER_STEPS: f64 = 1e8;

/// Arguments of `simulate`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Margins are per cell (mean over the cells in series, interconnect left out) and positive inside \
the window; min_ccv_v and max_ccv_v are \
voltages at the terminals. `feasible` states whether all requested power was available; the \
margins show whether the window was kept.
Power and current count discharge as positive. Each row of a profile holds until the next; the \
last row only ends it.")]
pub struct SimulateArgs {
    /// Which model.
    #[command(flatten)]
    pub model: ModelArgs,
    /// The cell's OCV curve from `ocv --out` or a cell file, if the model has none or to replace it.
    #[arg(long, value_name = "JSON")]
    pub ocv: Option<PathBuf>,
    /// Two columns, time and power, current or load resistance, with or without header; several for
    /// a comparison of all.
    #[arg(long = "profile", required = true, value_name = "FILE")]
    pub profiles: Vec<PathBuf>,
    /// The pack.
    #[command(flatten)]
    pub pack: PackArgs,
    /// State of charge at the start, 0 to 1; needs a model with an OCV curve, or --ocv. This
    /// or --ocv-v is needed.
    #[arg(
        long,
        value_name = "X",
        conflicts_with = "ocv_v",
        allow_negative_numbers = true
    )]
    pub soc: Option<f64>,
    /// Open-circuit voltage of a cell at the start, V; constant if the model has no OCV curve.
    #[arg(long, value_name = "V", allow_hyphen_values = true, value_parser = units::of::<Voltage>)]
    pub ocv_v: Option<f64>,
    /// Temperature of the surroundings, and of the cells at the start, °C, for a model with a map.
    #[arg(
        long,
        default_value_t = AMBIENT_DEGC,
        value_name = "DEGC",
        allow_hyphen_values = true,
        value_parser = units::of::<Temperature>
    )]
    pub ambient_degc: f64,
    /// How the files are read.
    #[command(flatten)]
    pub read: ProfileArgs,
    /// `exact`: exponential steps with error control; `thesis`: its three steps, explicit Euler, by
    /// a quarter of the shortest time constant or by --step-s.
    #[arg(long, value_enum, default_value_t = Steps::Exact)]
    pub method: Steps,
    /// Treatment of power that cannot be had: `stop`, or `extrapolate` along the tangent from
    /// --p0-share of it (thesis 4.2.1), which ends at 0 V.
    #[arg(long, value_enum, default_value_t = Policy::Stop)]
    pub beyond: Policy,
    /// P₀, at which the tangent of --beyond extrapolate leaves the curve, as a share of the largest
    /// power, above 0 and below 1 [default: 0.95]
    #[arg(long, value_name = "X", allow_negative_numbers = true)]
    pub p0_share: Option<f64>,
    /// Longest distance of two rows of the trace, and step of `thesis`, s [default: a 2000th of the
    /// profile]
    #[arg(long, value_name = "S", allow_hyphen_values = true, value_parser = units::of::<Duration>)]
    pub step_s: Option<f64>,
    /// DC resistance of a cell for the simple-IR model, Ω [default: that of the model]
    #[arg(long, value_name = "OHM", allow_hyphen_values = true, value_parser = units::of::<Resistance>)]
    pub dcir_ohm: Option<f64>,
    /// Standard deviation of the resistance from cell to cell, as a share of it; widens the band around the
    /// voltage.
    #[arg(long, default_value_t = 0.0, value_name = "X", value_parser = spread)]
    pub sigma_r: f64,
    /// Limits of a cell.
    #[command(flatten)]
    pub window: WindowArgs,
    /// Folder for traces (Parquet) and plots. Without it nothing is written.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Write one table of results, .parquet or .csv: a row for each model and profile. --model may
    /// then be a table of `fit --rc N --table`, and --profile a folder. If the call is
    /// interrupted, the next call with the same arguments continues it.
    #[arg(long, value_name = "FILE")]
    pub table: Option<PathBuf>,
    /// Also write the largest factor on each profile that keeps every cell within its window: a
    /// search of some hundred simulations for each row.
    #[arg(long, requires = "table")]
    pub largest_factor: bool,
    /// Print JSON: one object for one profile, a list for several.
    #[arg(long)]
    pub json: bool,
}

/// Parses a standard deviation as a share.
fn spread(text: &str) -> Result<f64, String> {
    let share = text
        .trim()
        .parse()
        .ok()
        .filter(|share| (0.0..1.0).contains(share));
    share.ok_or_else(|| "expected a share from 0 to below 1, such as 0.01".to_owned())
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

/// An error of the analysis as one of the call.
pub(super) fn usage(error: impl std::fmt::Display) -> Failure {
    Failure::Usage(error.to_string())
}

/// The open-circuit voltage of a model that messages call `name`.
pub(super) fn source_of_ocv(
    args: &SimulateArgs,
    file: &GivenModel,
    name: &str,
) -> Result<OcvSource, Failure> {
    match (&file.ocv, args.ocv_v) {
        (Some(curve), _) => Ok(OcvSource::Curve(curve.clone())),
        (None, Some(ocv_v)) => Ok(OcvSource::Constant(ocv_v)),
        (None, None) if args.soc.is_none() => Err(Failure::Usage(
            "expected --soc or --ocv-v, found neither".to_owned(),
        )),
        (None, None) => Err(Failure::Usage(format!(
            "--soc: expected a model with an OCV curve, {name} has none; give --ocv-v instead, or \
            a curve with --ocv"
        ))),
    }
}

/// Returns the initial state of the cell at rest.
pub(super) fn state(args: &SimulateArgs, model: &SimModel) -> Result<SimState, Failure> {
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

/// Limits of a cell.
pub(super) fn window(args: &SimulateArgs) -> Result<CellWindow, Failure> {
    let window = args.window.window();
    if window.low_v < window.high_v {
        return Ok(window);
    }
    Err(Failure::Usage(format!(
        "--v-min, --v-max: expected a lower below a higher voltage, found {} and {} V",
        window.low_v, window.high_v
    )))
}

/// Treatment of power that cannot be had, from --beyond and --p0-share.
pub(super) fn beyond(args: &SimulateArgs) -> Result<Beyond, Failure> {
    let beyond = match (args.beyond, args.p0_share) {
        (Policy::Stop, None) => Beyond::Stop,
        (Policy::Stop, Some(_)) => {
            let expected = "--p0-share: expected with --beyond extrapolate, met --beyond stop";
            return Err(Failure::Usage(expected.to_owned()));
        }
        (Policy::Extrapolate, share) => Beyond::Extrapolate {
            fraction: share.unwrap_or(Beyond::FRACTION),
        },
    };
    match (beyond.is_valid(), args.p0_share) {
        (false, Some(met)) => Err(Failure::Usage(format!(
            "--p0-share: expected a number above 0 and below 1, met {met}"
        ))),
        _ => Ok(beyond),
    }
}

/// Options of a simulation of a profile.
pub(super) fn options(
    args: &SimulateArgs,
    profile: &Profile,
    window: CellWindow,
) -> Result<SimOptions, Failure> {
    let beyond = beyond(args)?;
    let method = match args.method {
        Steps::Exact => Method::Exact,
        Steps::Thesis => Method::Thesis,
    };
    let max_step_s = args.step_s.unwrap_or_else(|| profile.duration_s() / 2000.0);
    Ok(SimOptions {
        method,
        beyond,
        window,
        max_step_s,
        thesis_step_s: args.step_s,
        ..SimOptions::default()
    })
}

/// Explicit Euler steps by a quarter of the shortest time constant, which for a circuit's ladder
/// lies far below the profile's own times.
pub(super) fn check_euler(
    args: &SimulateArgs,
    model: &SimModel,
    profile: &Profile,
) -> Result<(), Failure> {
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
