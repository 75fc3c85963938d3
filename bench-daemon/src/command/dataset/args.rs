//! Arguments of `dataset`.

use crate::command::units;
use bench_plan::config::quantity::{Charge, Frequency, Temperature};
use std::{path::PathBuf, str::FromStr};

use analysis::formats::CurrentSign;
use clap::{Args, Subcommand};

use bench_evaluate::investigate::proposal::Place;
use bench_plan::config::quantity::{Duration, Quantity};

/// Arguments of `dataset`.
#[derive(Debug, Args)]
pub struct DatasetArgs {
    #[command(subcommand)]
    pub(super) act: Act,
}

#[derive(Debug, Subcommand)]
pub(super) enum Act {
    /// Propose a data set for `diagnose` from spectra and logs: runs, repeats, split, noise.
    Init(Box<InitArgs>),
    /// Check whether `diagnose` accepts a data set, and name the first key that is missing or wrong.
    Check(CheckArgs),
}

/// Arguments of `dataset check`.
#[derive(Debug, Args)]
pub(super) struct CheckArgs {
    /// Folder with a `dataset.toml`, the file itself, or a run folder.
    #[arg(value_name = "DATA")]
    pub data: PathBuf,
}

/// Arguments of `dataset init`.
#[derive(Debug, Args)]
pub(super) struct InitArgs {
    /// Spectra and logs of a cycler, recognised by their content. The files stay in place.
    #[arg(required = true, value_name = "FILE")]
    pub files: Vec<PathBuf>,
    /// Folder of the new `dataset.toml`. A file that is there is never written over, unless it lacks
    /// something and is unchanged.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Name of the cell.
    #[arg(long, default_value = "cell", value_name = "NAME")]
    pub cell: String,
    /// Capacity for counting charge, Ah [default: that of the OCV curve, else of the log's head]
    #[arg(long, value_name = "AH", value_parser = units::of::<Charge>)]
    pub capacity_ah: Option<f64>,
    /// State of charge at the first row of each log, 0 to 1 [default: as the log's column says]
    #[arg(long, value_name = "SOC")]
    pub soc_start: Option<f64>,
    /// Use loads and spectra at this state of charge only, 0 to 1. A load whose state is not known is
    /// left out.
    #[arg(long, value_name = "SOC")]
    pub soc: Option<f64>,
    /// Distance from --soc up to which a load or a spectrum is used.
    #[arg(long, value_name = "SOC", default_value_t = 0.05, requires = "soc")]
    pub near: f64,
    /// OCV curve from `ocv --out` or a cell file: it gives states of charge, and the data set names it.
    #[arg(long, value_name = "JSON")]
    pub ocv: Option<PathBuf>,
    /// Temperature of all logs and spectra, °C [default: as logged, else as the log's head says]
    #[arg(
        long = "temperature-c",
        value_name = "C",
        allow_hyphen_values = true,
        value_parser = units::of::<Temperature>
    )]
    pub temperature_degc: Option<f64>,
    /// Circumstances of one spectrum or log, such as "eis_07:ocv_v=3.66,temperature_c=26.8" or
    /// "log_2:soc=1". Keys: `soc`, `ocv_v` (spectra only), `temperature_c`.
    #[arg(long, value_name = "NAME:KEY=VALUE")]
    pub at: Vec<Stated>,
    /// Lowest frequency of spectra that is used, Hz: the band in which `fit` fitted the model.
    #[arg(long, value_name = "HZ", value_parser = units::of::<Frequency>)]
    pub from_hz: Option<f64>,
    /// Highest frequency of spectra that is used, Hz [default: where they become inductive]
    #[arg(long, value_name = "HZ", value_parser = units::of::<Frequency>)]
    pub to_hz: Option<f64>,
    /// Shortest logged rest before a load, such as "10 s" or "30 min".
    #[arg(long, value_name = "TIME", default_value = "10 s", value_parser = duration)]
    pub rest: f64,
    /// Slowest sampling of a pulse or a drive cycle.
    #[arg(long, value_name = "TIME", default_value = "1 s", value_parser = duration)]
    pub sampling: f64,
    /// Direction that the logs count positive, `discharge` or `charge` [default: from the voltage and
    /// the file's columns]
    #[arg(long, value_name = "DIRECTION")]
    pub positive: Option<CurrentSign>,
    /// Print what would be written, and write nothing.
    #[arg(long)]
    pub dry_run: bool,
    /// Print the findings as JSON.
    #[arg(long)]
    pub json: bool,
}

fn duration(text: &str) -> Result<f64, String> {
    Quantity::<Duration>::parse(text).map(|duration| duration.si)
}

/// Conditions of a file or spectrum from the command line.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Stated {
    /// Name of the log or spectrum.
    pub(super) name: String,
    /// Its conditions.
    pub(super) place: Place,
}

impl FromStr for Stated {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let expected =
            || format!("expected NAME:KEY=VALUE with keys soc, ocv_v, temperature_c, met {text:?}");
        let (name, values) = text.rsplit_once(':').ok_or_else(expected)?;
        let mut place = Place::default();
        for pair in values.split(',') {
            let (key, value) = pair.split_once('=').ok_or_else(expected)?;
            let value: f64 = value.trim().parse().map_err(|_| expected())?;
            let (target, fits) = match key.trim() {
                "soc" => (&mut place.soc, (0.0..=1.0).contains(&value)),
                "ocv_v" => (&mut place.ocv_v, value > 0.0 && value.is_finite()),
                "temperature_c" => (&mut place.temperature_degc, value.is_finite()),
                _ => return Err(expected()),
            };
            if !fits {
                return Err(format!("expected a value that {key} can have, met {value}"));
            }
            *target = Some(value);
        }
        if place.soc.is_some() && place.ocv_v.is_some() {
            return Err(format!(
                "expected either soc or ocv_v, met both in {text:?}"
            ));
        }
        Ok(Self {
            name: name.to_owned(),
            place,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn circumstances_are_read_and_others_refused() {
        let stated: Stated = "a.mpt#loop:1:ocv_v=3.66,temperature_c=-5".parse().unwrap();
        assert_eq!(stated.name, "a.mpt#loop:1");
        assert_eq!(
            stated.place,
            Place {
                soc: None,
                ocv_v: Some(3.66),
                temperature_degc: Some(-5.0)
            }
        );
        for text in [
            "a",
            "a:soc",
            "a:soc=2",
            "a:soc=x",
            "a:r=1",
            "a:soc=0.5,ocv_v=3.6",
        ] {
            assert!(text.parse::<Stated>().is_err(), "{text}");
        }
    }
}
