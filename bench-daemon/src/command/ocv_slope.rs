//! Arguments for the slope of the open-circuit voltage at the charge of a spectrum, for the
//! commands that fit.

use crate::command::units;
use bench_plan::config::quantity::Voltage;
use std::{
    collections::BTreeSet,
    path::{Path, PathBuf},
};

use analysis::{
    fit::{ChargeStorage, Objective, Slope},
    ocv::{REST_SIGMA_V, SLOPE_SHARE},
    spectrum::OcvSlope,
};

use bench_core::safety::failure::Failure;
use bench_evaluate::{
    files,
    run::{SlopeAtRest, slope_of_spectrum},
    support::present::significant,
};
use bench_plan::support::terminal::remark;

/// Arguments that define the slope.
#[derive(Debug, clap::Args)]
pub struct SlopeArgs {
    /// The OCV curve, as `eis-bench ocv --out` writes it (`ocv.json`); with --at-v.
    #[arg(long, value_name = "JSON", requires = "at_v")]
    pub ocv: Option<PathBuf>,
    /// Open-circuit voltage at which the spectra were measured, V.
    #[arg(long, value_name = "V", requires = "ocv", value_parser = units::of::<Voltage>)]
    pub at_v: Option<f64>,
    /// Slope dU/dQ of the open-circuit voltage if no curve is known: `fit` estimates it with a weak
    /// prior, `none` leaves it in the impedances, a number is V/C [default: of a spectrum in a run
    /// folder the slope of its cell at the voltage at rest before the sweep; of another one fit
    /// with --objective complex, otherwise none]
    #[arg(long, value_name = "fit|none|V/C", conflicts_with = "ocv")]
    pub ocv_slope: Option<String>,
    /// The slope of one file, V/C, and its standard deviation, as the server knows it for the copy
    /// of a spectrum.
    #[arg(long, value_name = "FILE=V/C,SIGMA", hide = true, value_parser = slope_of_file)]
    pub slope_of: Vec<SlopeOfFile>,
}

/// Slope of the spectra of one file.
#[derive(Debug, Clone)]
pub struct SlopeOfFile {
    file: PathBuf,
    slope: OcvSlope,
}

fn slope_of_file(text: &str) -> Result<SlopeOfFile, String> {
    let parsed = || {
        let (file, slope) = text.rsplit_once('=')?;
        let (v_per_coulomb, sigma) = slope.split_once(',')?;
        let number = |text: &str| text.parse::<f64>().ok().filter(|number| number.is_finite());
        Some(SlopeOfFile {
            file: file.into(),
            slope: OcvSlope {
                v_per_coulomb: number(v_per_coulomb)?,
                sigma_v_per_coulomb: number(sigma)?,
            },
        })
    };
    parsed().ok_or_else(|| format!("expected FILE=V/C,SIGMA, found {text:?}"))
}

/// The slopes of files that arguments or run folders state; each run is named once.
#[derive(Debug, Default)]
pub struct KnownSlopes {
    reported: BTreeSet<PathBuf>,
}

impl KnownSlopes {
    /// Returns the slope of a file, unless the arguments request another treatment.
    pub fn of(&mut self, args: &SlopeArgs, file: &Path) -> Option<OcvSlope> {
        if args.ocv.is_some() || args.ocv_slope.is_some() {
            return None;
        }
        let of_file = args.slope_of.iter().find(|one| one.file == file);
        if let Some(one) = of_file {
            return Some(one.slope);
        }
        let found = slope_of_spectrum(file)?;
        let SlopeAtRest { rest_v, slope } = found.at;
        if self.reported.insert(found.run.clone()) {
            remark!(
                "{}: slope of the open-circuit voltage {} ± {} µV/C, from [ocv] of its cell at \
                {rest_v:.4} V",
                found.run.display(),
                significant(1.0e6 * slope.v_per_coulomb, 3),
                significant(1.0e6 * slope.sigma_v_per_coulomb, 2)
            );
        }
        Some(slope)
    }
}

/// Returns the slope that the arguments request.
///
/// # Errors
/// A curve that cannot be read or does not reach the voltage; an invalid slope; a fit of the
/// slope with an objective that does not support it.
pub fn asked(args: &SlopeArgs, objective: Objective) -> Result<Slope, Failure> {
    if let (Some(path), Some(at_v)) = (&args.ocv, args.at_v) {
        let curve = files::read_curve(path)?;
        let slope = curve.charge_slope(at_v, REST_SIGMA_V, SLOPE_SHARE);
        let (low, high) = (
            curve.ocv_v.first().copied().unwrap_or(f64::NAN),
            curve.ocv_v.last().copied().unwrap_or(f64::NAN),
        );
        let refused = || {
            Failure::Usage(format!(
                "--at-v: expected a voltage of the curve, {low:.3} to {high:.3} V, found {at_v} V"
            ))
        };
        return slope.map(Slope::Known).ok_or_else(refused);
    }
    Slope::asked(args.ocv_slope.as_deref(), objective)
        .map_err(|error| Failure::Usage(format!("--ocv-slope{error}")))
}

/// Returns the slope that the arguments request for a circuit fit. The elements of the circuit
/// define what stores charge, so that by default nothing is subtracted.
///
/// # Errors
/// As [`asked`]; a request to fit the slope.
pub fn for_circuit(args: &SlopeArgs, objective: Objective) -> Result<Slope, Failure> {
    match args.ocv_slope.as_deref() {
        None if args.ocv.is_none() => Ok(Slope::Left),
        Some("fit") => Err(Failure::Usage(
            "--ocv-slope fit: expected a slope in V/C or --ocv with --circuit; a capacitor in \
            series is a slope that is fitted"
                .to_owned(),
        )),
        _ => asked(args, objective),
    }
}

/// Describes the charge storage that a fit found.
pub fn in_words(storage: &ChargeStorage) -> String {
    let micro = |v: f64| significant(1.0e6 * v, 3);
    let sigma = storage
        .sigma_v_per_coulomb
        .map_or_else(String::new, |sigma| format!(" ± {}", micro(sigma)));
    let given = format!(
        "{} ± {}",
        micro(storage.given.v_per_coulomb),
        micro(storage.given.sigma_v_per_coulomb)
    );
    let source = if storage.given.is_prior() {
        format!("no slope was given: prior {given}; give --ocv or --ocv-slope")
    } else {
        format!("given {given}")
    };
    format!(
        "without charge storage: slope of the open-circuit voltage {}{sigma} µV/C ({source}); \
        apparent DC resistance with it left in {} mΩ",
        micro(storage.v_per_coulomb),
        significant(1.0e3 * storage.apparent_dc_resistance_ohm, 5)
    )
}
