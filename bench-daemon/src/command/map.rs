//! `eis-bench map`: resistances over state of charge and temperature, from logs and spectra of a cell.

mod next;
mod print;
mod read;

use std::path::{Path, PathBuf};

use crate::command::{printed::say_json, units};
use analysis::{
    formats::CurrentSign,
    given::{GivenModel, PlainModel},
    map::{Fitted, LogScore, MapFit, MapOptions, NextPlan, SpectrumScore, fit_map},
    ocv::OcvCurve,
    plot::{AxisSpec, Chart, Panel, Trace, TraceStyle},
};
use bench_core::{operator::progress::Waiting, safety::failure::Failure};
use bench_evaluate::files::{self, AMBIENT_DEGC};
use bench_plan::{config::quantity::Temperature, support::terminal::say};
use serde::Serialize;

const HELP: &str = "\
Fits V = U(z) + correction − R(z, T)·i − Σ vₖ with branches of fixed time constants whose \
resistances follow state of charge and temperature, to logs and spectra together: for given \
activation energies one bounded least-squares problem without starting values. Between and beyond \
temperatures, resistances follow Arrhenius' law. Fit data that cover the range of charge, at two or \
more temperatures; hold a log out to see the error on data that the fit has not seen. The error of a \
log is stated above a state of charge of 0.1, that of a spectrum also by a fit without it.

Examples:
  eis-bench map runs/map --out map
  eis-bench map drive_25C.parquet drive_10C.parquet --held-out us06_25C.parquet --ocv curve.json \
--soc-start 1 --out map";

/// Arguments of `map`.
#[derive(Debug, clap::Args)]
#[command(after_help = HELP)]
pub struct MapArgs {
    /// Data to fit: logs of time, current, voltage and temperature, of a cycler or of the bench; data
    /// sets of `dataset init`; run folders. Folders also have spectra.
    #[arg(value_name = "DATA", required = true)]
    pub data: Vec<PathBuf>,
    /// Data to predict only; may be given several times.
    #[arg(long, value_name = "DATA")]
    pub held_out: Vec<PathBuf>,
    /// Cell whose runs are used, in a folder with several.
    #[arg(long, value_name = "CELL")]
    pub specimen: Option<String>,
    /// The cell's OCV curve from `ocv --out` or a cell file [default: that of the data set or of the
    /// run's cell]
    #[arg(long, value_name = "JSON")]
    pub ocv: Option<PathBuf>,
    /// Temperature at which the OCV curve was measured, °C.
    #[arg(
        long,
        default_value_t = AMBIENT_DEGC,
        value_name = "DEGC",
        allow_hyphen_values = true,
        value_parser = units::of::<Temperature>
    )]
    pub ocv_temperature_degc: f64,
    /// State of charge at the first sample of every log file, 0 to 1 [default: from the OCV curve; the
    /// log must then begin at rest]
    #[arg(long, value_name = "X")]
    pub soc_start: Option<f64>,
    /// Temperature of the cell in logs that have no column for it, °C.
    #[arg(
        long,
        value_name = "DEGC",
        allow_hyphen_values = true,
        value_parser = units::of::<Temperature>
    )]
    pub temperature_degc: Option<f64>,
    /// Time constants of the branches, s, rising, separated by commas.
    #[arg(long, value_name = "LIST", value_delimiter = ',', default_values_t = MapOptions::default().time_constants_s)]
    pub time_constants_s: Vec<f64>,
    /// Direction of positive current in the files, `discharge` or `charge` [default: from the
    /// voltage and the file's columns]
    #[arg(long, value_name = "DIRECTION")]
    pub positive: Option<CurrentSign>,
    /// Name of the cell [default: that of the first file or folder]
    #[arg(long, value_name = "NAME")]
    pub name: Option<String>,
    /// Write `map.json` (a model for `simulate` and `sop`), `map_logs.csv`, `map_spectra.csv` and
    /// `map.svg`/`.png` into this folder.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// What to measure next.
    #[command(flatten)]
    pub next: next::NextArgs,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}

/// Result of the command: the fields of the fit, and the proposed measurements.
#[derive(Serialize)]
struct Printed<'a> {
    #[serde(flatten)]
    fit: &'a MapFit,
    #[serde(skip_serializing_if = "Option::is_none")]
    next: Option<NextPlan>,
}

/// Fits the map, prints what it is worth, and writes it into a folder if requested.
///
/// # Errors
/// A file or an argument that is not as expected; a folder that cannot be written.
pub fn map(args: &MapArgs) -> Result<(), Failure> {
    if let Some(soc) = args.soc_start.filter(|soc| !(0.0..=1.0).contains(soc)) {
        let reason = format!("--soc-start: expected a fraction from 0 to 1, found {soc}");
        return Err(Failure::Usage(reason));
    }
    let curve = read::curve(args)?;
    let waiting = Waiting::on("reading the data".to_owned());
    let data = read::data(args, &curve)?;
    let profiles = next::read(&args.next)?;
    let options = MapOptions {
        time_constants_s: args.time_constants_s.clone(),
        ocv_temperature_degc: args.ocv_temperature_degc,
        ..MapOptions::default()
    };
    waiting.say(format!(
        "fitting a map to {} logs and {} spectra",
        data.logs.len(),
        data.spectra.len()
    ));
    let fit =
        fit_map(&data, &curve, &options).map_err(|error| Failure::Usage(error.to_string()))?;
    waiting.end();
    let stem = args.data[0].file_stem().unwrap_or_default();
    let name = args
        .name
        .clone()
        .unwrap_or_else(|| stem.to_string_lossy().into_owned());
    if let Some(folder) = &args.out {
        write(folder, &name, &curve, &fit)?;
    }
    let fitted = Fitted {
        data: &data,
        ocv: &curve,
        options: &options,
        fit: &fit,
    };
    if !args.json {
        print::print(&fit);
    }
    let next = next::plan(&args.next, &profiles, fitted)?;
    if args.json {
        return say_json(&Printed { fit: &fit, next });
    }
    if let Some(plan) = &next {
        next::print(plan);
    }
    if let Some(folder) = &args.out {
        say!("written to {}", folder.display());
    }
    Ok(())
}

/// The map as a model file: the map itself, and its model at half charge for tasks that know one
/// point only.
fn model(name: &str, curve: &OcvCurve, fit: &MapFit) -> GivenModel {
    let map = &fit.map;
    let nearest =
        |a: &&f64, b: &&f64| f64::abs(**a - AMBIENT_DEGC).total_cmp(&f64::abs(**b - AMBIENT_DEGC));
    let degc = map
        .temperature_degc
        .iter()
        .min_by(nearest)
        .copied()
        .unwrap_or(AMBIENT_DEGC);
    PlainModel {
        ocv: Some(curve.clone()),
        map: Some(map.clone()),
        warnings: fit.notes.clone(),
        ..PlainModel::new(name, map.model_at(0.5, degc))
    }
    .into()
}

fn write(folder: &Path, name: &str, curve: &OcvCurve, fit: &MapFit) -> Result<(), Failure> {
    files::make_folder(folder)?;
    let json = model(name, curve, fit).to_json();
    let json = json.map_err(|error| Failure::Analysis(error.to_string()))?;
    files::write_text(folder, "map.json", &json)?;
    if !fit.logs.is_empty() {
        files::write_text(folder, "map_logs.csv", &table_of_logs(&fit.logs))?;
    }
    if !fit.spectra.is_empty() {
        files::write_text(folder, "map_spectra.csv", &table_of_spectra(&fit.spectra))?;
    }
    files::write_chart(folder, "map", &picture(name, fit))
}

/// A number of a table; a log below the states of charge that count has no error.
fn number(value: Option<f64>, factor: f64) -> String {
    let known = value.filter(|value| value.is_finite());
    known.map_or_else(String::new, |value| format!("{:.3}", factor * value))
}

fn table_of_logs(logs: &[LogScore]) -> String {
    let mut table = "log,role,temperature_degc,rms_mv,bias_mv,worst_soc,worst_mv\n".to_owned();
    for score in logs {
        let (soc, worst_v) = (score.worst.map(|w| w.0), score.worst.map(|w| w.1));
        table.push_str(&format!(
            "{},{},{:.2},{},{},{},{}\n",
            score.name.replace(',', ";"),
            print::role(score.role),
            score.temperature_degc,
            number(Some(score.rms_v), 1e3),
            number(Some(score.bias_v), 1e3),
            number(soc, 1.0),
            number(worst_v, 1e3)
        ));
    }
    table
}

fn table_of_spectra(spectra: &[SpectrumScore]) -> String {
    let mut table =
        "spectrum,role,soc,temperature_degc,error_percent,left_out_percent\n".to_owned();
    for score in spectra {
        table.push_str(&format!(
            "{},{},{:.4},{:.2},{},{}\n",
            score.name.replace(',', ";"),
            print::role(score.role),
            score.soc,
            score.temperature_degc,
            number(Some(score.rms_part), 100.0),
            number(score.left_out_part, 100.0)
        ));
    }
    table
}

/// The series resistance and the whole resistance over state of charge, a line per temperature.
fn picture(name: &str, fit: &MapFit) -> Chart {
    let map = &fit.map;
    let (mut series, mut whole) = (Vec::new(), Vec::new());
    for (j, degc) in map.temperature_degc.iter().enumerate() {
        let label = format!("{degc:.1} °C");
        let knots = map.soc.iter().enumerate();
        let points = knots.map(|(k, z)| (*z, 1e3 * map.series.r_ohm[j][k]));
        series.push(Trace::new(&label, j, TraceStyle::Line, points.collect()));
        let total = |z: f64| 1e3 * map.model_at(z, *degc).dc_resistance_ohm();
        let points = map.soc.iter().map(|z| (*z, total(*z)));
        whole.push(Trace::new("", j, TraceStyle::Line, points.collect()));
    }
    let soc = || AxisSpec::linear("State of charge").between(0.0, 1.0);
    let panel = |title: &str, traces| Panel::new(soc(), AxisSpec::linear(title), traces);
    Chart::new(
        name,
        "resistance over state of charge and temperature",
        vec![
            panel("series resistance / mΩ", series),
            panel("with all branches / mΩ", whole),
        ],
    )
}
