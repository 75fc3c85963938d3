//! Arguments for the slope of the open-circuit voltage at the charge of a spectrum, for the
//! commands that fit.

use std::path::PathBuf;

use analysis::{
    fit::{ChargeStorage, Objective},
    ocv::{REST_SIGMA_V, SLOPE_SHARE},
    spectrum::{OcvSlope, Spectrum},
};

use crate::{files, safety::failure::Failure, support::present::significant};

/// Arguments that tell the slope.
#[derive(Debug, clap::Args)]
pub struct SlopeArgs {
    /// The OCV curve, as `eis-bench ocv --out` writes it (`ocv.json`); with --at-v.
    #[arg(long, value_name = "JSON", requires = "at_v")]
    pub ocv: Option<PathBuf>,
    /// Open-circuit voltage at which the spectra were measured, V.
    #[arg(long, value_name = "V", requires = "ocv")]
    pub at_v: Option<f64>,
    /// Slope dU/dQ of the open-circuit voltage where no curve is known: `fit` finds it with a weak
    /// prior, `none` leaves it in the impedances, a number is V/C [default: fit with --objective
    /// complex, else none]
    #[arg(long, value_name = "fit|none|V/C", conflicts_with = "ocv")]
    pub ocv_slope: Option<String>,
}

/// Treatment of the slope of the open-circuit voltage.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Slope {
    /// It stays in the impedances.
    Left,
    /// It is taken out as known.
    Known(OcvSlope),
    /// It is fitted with a prior for each spectrum.
    Fitted,
}

impl Slope {
    /// Slope that the arguments ask for.
    ///
    /// # Errors
    /// A curve that cannot be read or does not reach the voltage; a slope that is none; a fit of
    /// the slope with an objective that has no room for it.
    pub fn asked(args: &SlopeArgs, objective: Objective) -> Result<Self, Failure> {
        if let (Some(path), Some(at_v)) = (&args.ocv, args.at_v) {
            let curve = files::read_curve(path)?;
            let slope = curve.charge_slope(at_v, REST_SIGMA_V, SLOPE_SHARE);
            let (low, high) = (
                curve.ocv_v.first().copied().unwrap_or(f64::NAN),
                curve.ocv_v.last().copied().unwrap_or(f64::NAN),
            );
            let refused = || {
                Failure::Usage(format!(
                    "--at-v: expected a voltage of the curve, {low:.3} to {high:.3} V, found \
                    {at_v} V"
                ))
            };
            return slope.map(Self::Known).ok_or_else(refused);
        }
        let complex = objective == Objective::Complex;
        match args.ocv_slope.as_deref() {
            None if complex => Ok(Self::Fitted),
            None | Some("none") => Ok(Self::Left),
            Some("fit") if complex => Ok(Self::Fitted),
            Some("fit") => Err(Failure::Usage(format!(
                "--ocv-slope fit: expected --objective complex, found {objective}"
            ))),
            Some(text) => {
                let number = text
                    .trim()
                    .trim_end_matches("V/C")
                    .trim()
                    .parse::<f64>()
                    .ok()
                    .filter(|v| v.is_finite() && *v >= 0.0);
                let v_per_c = number.ok_or_else(|| {
                    Failure::Usage(format!(
                        "--ocv-slope: expected `fit`, `none` or a slope in V/C, found {text:?}"
                    ))
                })?;
                Ok(Self::Known(OcvSlope {
                    v_per_c,
                    sigma_v_per_c: SLOPE_SHARE * v_per_c,
                }))
            }
        }
    }

    /// Slope that the arguments ask for where a circuit is fitted. The elements of the circuit say
    /// what stores charge, so that nothing is taken out by default.
    ///
    /// # Errors
    /// As [`Slope::asked`]; a slope that is to be fitted.
    pub fn for_circuit(args: &SlopeArgs, objective: Objective) -> Result<Self, Failure> {
        match args.ocv_slope.as_deref() {
            None if args.ocv.is_none() => Ok(Self::Left),
            Some("fit") => Err(Failure::Usage(
                "--ocv-slope fit: expected a slope in V/C or --ocv with --circuit; a capacitor in \
                series is a slope that is fitted"
                    .to_owned(),
            )),
            _ => Self::asked(args, objective),
        }
    }

    /// A spectrum as it is to be fitted.
    pub fn less(&self, spectrum: &Spectrum) -> Spectrum {
        match self {
            Self::Left => spectrum.clone(),
            Self::Known(slope) => spectrum.less_charge_storage(*slope),
            Self::Fitted => OcvSlope::prior(spectrum).map_or_else(
                || spectrum.clone(),
                |slope| spectrum.less_charge_storage(slope),
            ),
        }
    }
}

/// Charge storage that a fit found, in words.
pub fn in_words(storage: &ChargeStorage) -> String {
    let micro = |v: f64| significant(1.0e6 * v, 3);
    let sigma = storage
        .sigma_v_per_c
        .map_or_else(String::new, |sigma| format!(" ± {}", micro(sigma)));
    format!(
        "without charge storage: slope of the open-circuit voltage {}{sigma} µV/C (given {} ± {}); \
        apparent DC resistance with it left in {} mΩ",
        micro(storage.v_per_c),
        micro(storage.given.v_per_c),
        micro(storage.given.sigma_v_per_c),
        significant(1.0e3 * storage.apparent_dc_resistance_ohm, 5)
    )
}
