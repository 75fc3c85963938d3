//! Arguments of `eis-bench map`.

use std::path::PathBuf;

use super::next::NextArgs;
use crate::command::units;
use analysis::{formats::CurrentSign, map::MapOptions};
use bench_evaluate::files::AMBIENT_DEGC;
use bench_plan::config::quantity::Temperature;

const HELP: &str = "\
Fits V = U(z) + correction − R(z, T)·i − Σ vₖ with branches of fixed time constants whose \
resistances follow state of charge and temperature, to logs and spectra together: for given \
activation energies one bounded least-squares problem without starting values. Between and beyond \
temperatures, resistances follow Arrhenius' law. Fit data that cover the range of charge, at two or \
more temperatures; hold a log out to see the error on data that the fit has not seen. The error of a \
log is stated above a state of charge of 0.1, that of a spectrum also by a fit without it.

Examples:
  eis-bench map runs/map --out map
  eis-bench map runs/map --next 4 --under walking.csv --series 16 --parallel 3 --write next.toml
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
    pub next: NextArgs,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}
