//! Arguments for the slope of the open-circuit voltage at the charge of a spectrum, for the
//! commands that fit.

use crate::command::units;
use bench_plan::config::quantity::Voltage;
use std::path::PathBuf;

use analysis::{
    fit::{ChargeStorage, Objective, Slope},
    ocv::{REST_SIGMA_V, SLOPE_SHARE},
};

use bench_core::safety::failure::Failure;
use bench_evaluate::{files, support::present::significant};

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
    /// prior, `none` leaves it in the impedances, a number is V/C [default: fit with --objective
    /// complex, otherwise none]
    #[arg(long, value_name = "fit|none|V/C", conflicts_with = "ocv")]
    pub ocv_slope: Option<String>,
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
    format!(
        "without charge storage: slope of the open-circuit voltage {}{sigma} µV/C (given {} ± {}); \
        apparent DC resistance with it left in {} mΩ",
        micro(storage.v_per_coulomb),
        micro(storage.given.v_per_coulomb),
        micro(storage.given.sigma_v_per_coulomb),
        significant(1.0e3 * storage.apparent_dc_resistance_ohm, 5)
    )
}
