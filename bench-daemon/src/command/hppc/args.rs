//! Arguments of `hppc`.

use std::path::PathBuf;

use analysis::formats::CurrentSign;
use clap::Args;

use crate::command::units;
use bench_core::safety::failure::Failure;
use bench_plan::config::{
    Cell, Source,
    quantity::{Charge, Duration, Voltage},
    resolve_cell,
};

/// Arguments of `hppc`.
#[derive(Debug, Args)]
pub struct HppcArgs {
    /// Logs of a cycler with pulses, or run folders. The format is detected from the content.
    #[arg(required = true, value_name = "FILE|FOLDER")]
    pub files: Vec<PathBuf>,
    /// Times after the start of a pulse, such as "0.1,1,10" or "100 ms,2 s".
    #[arg(long, value_name = "TIMES", value_delimiter = ',', value_parser = units::of::<Duration>,
          default_value = "0.1,1,2,5,10")]
    pub at: Vec<f64>,
    /// Lowest voltage of the cell for its discharge power, V.
    #[arg(long, value_name = "V", value_parser = units::of::<Voltage>, conflicts_with = "no_power")]
    pub v_min: Option<f64>,
    /// Highest voltage of the cell for its charge power, V.
    #[arg(long, value_name = "V", value_parser = units::of::<Voltage>, conflicts_with = "no_power")]
    pub v_max: Option<f64>,
    /// File of the cell, as an experiment names it: it gives voltage limits and capacity.
    #[arg(long, value_name = "FILE")]
    pub cell: Option<PathBuf>,
    /// Leave the power out, so that no voltage limits are needed.
    #[arg(long)]
    pub no_power: bool,
    /// Capacity for counting charge, Ah [default: that of the OCV curve, the cell, or the log's head]
    #[arg(long, value_name = "AH", value_parser = units::of::<Charge>)]
    pub capacity_ah: Option<f64>,
    /// State of charge at the first row of each log, 0 to 1 [default: as the log's column says]
    #[arg(long, value_name = "SOC")]
    pub soc_start: Option<f64>,
    /// OCV curve from `ocv --out` or a cell file: it gives the state of charge at the first rest.
    #[arg(long, value_name = "JSON")]
    pub ocv: Option<PathBuf>,
    /// Shortest logged rest before a pulse.
    #[arg(long, value_name = "TIME", default_value = "10 s", value_parser = units::of::<Duration>)]
    pub rest: f64,
    /// Relative standard uncertainty of the current's gain, such as 0.001. A log does not show it.
    #[arg(long, value_name = "PART", default_value_t = 0.0)]
    pub current_gain: f64,
    /// The logs have a row where each pulse begins. Otherwise it may begin up to its first row under
    /// current, and that is part of the uncertainty.
    #[arg(long)]
    pub start_logged: bool,
    /// Direction that the logs count positive, `discharge` or `charge` [default: from the voltage and
    /// the file's columns]
    #[arg(long, value_name = "DIRECTION")]
    pub positive: Option<CurrentSign>,
    /// Write all resistances as a table, one row for each pulse and time: CSV, or Parquet by its name.
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Draw resistance over state of charge into this `.svg` or `.png`.
    #[arg(long, value_name = "FILE")]
    pub plot: Option<PathBuf>,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}

impl HppcArgs {
    /// Checks numbers that cannot be, and reads the file of the cell.
    pub(super) fn read_cell(&self) -> Result<Option<Cell>, Failure> {
        let fail = |option: &str, expected: &str, met: f64| {
            Err(Failure::Usage(format!(
                "--{option}: expected {expected}, found {met}"
            )))
        };
        if let Some(ah) = self.capacity_ah.filter(|ah| !(*ah > 0.0 && ah.is_finite())) {
            return fail("capacity-ah", "a capacity above 0 Ah", ah);
        }
        if let Some(soc) = self.soc_start.filter(|soc| !(0.0..=1.0).contains(soc)) {
            return fail("soc-start", "a state of charge from 0 to 1", soc);
        }
        let cell = self.cell.as_deref().map(|path| {
            let source = Source::read(path)?;
            resolve_cell(&source)
        });
        Ok(cell.transpose()?)
    }
}
