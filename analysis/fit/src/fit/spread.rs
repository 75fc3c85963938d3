//! Spread between cells and between repeats of one cell: in the impedance at every frequency, and
//! in the parameters of fits to single sweeps. Where single sweeps do not fix the parameters, a few
//! quantities are used that they do fix.

use super::cells::{CellSweeps, Components, FrequencySpread, components, frequency_spread};
use super::erm::fit_erm;
use super::options::{FitError, FitOptions};
use super::result::ErmFit;
use analysis_signal::spectrum::Spectrum;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Relative uncertainty of one sweep, stated or shown by repeats, above which the spread of a
/// parameter does not describe the cells.
const UNIDENTIFIED: f64 = 0.5;

/// One quantity over all cells and sweeps.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct QuantitySpread {
    /// R, R1, C1, … as in the thesis, `DC resistance`, or `|Z| at 1 Hz`.
    pub name: String,
    /// Ω or F.
    pub unit: String,
    /// Mean, and the two spreads.
    pub spread: Components,
    /// Median of the relative standard uncertainty of single fits; `None` for measured quantities.
    pub fitted_relative_sigma: Option<f64>,
    /// False if single sweeps do not determine it, so that its spread describes the fit and not the
    /// cells.
    pub identified: bool,
}

/// The spread of the parameters of one order.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ParameterSpread {
    /// Number of RC branches.
    pub rc: usize,
    /// One entry per parameter, and the DC resistance.
    pub quantities: Vec<QuantitySpread>,
    /// Warning on quantities that are not identified; none when all are.
    pub warning: Option<String>,
}

/// All that differs between and within cells.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CellSpread {
    /// Number of cells.
    pub cells: usize,
    /// Number of sweeps.
    pub sweeps: usize,
    /// The impedance, frequency by frequency.
    pub frequencies: Vec<FrequencySpread>,
    /// Quantities without a model: |Z| near whole decades and the real part at the lowest
    /// frequency.
    pub measured: Vec<QuantitySpread>,
    /// The parameters, by order.
    pub parameters: Vec<ParameterSpread>,
}

/// Separates between from within for the impedance and for the parameters of every requested order;
/// `options.rc` is ignored.
///
/// # Errors
/// [`FitError`] as for a fit of a single sweep.
pub fn cell_spread(
    cells: &[CellSweeps],
    orders: &[usize],
    options: &FitOptions,
) -> Result<CellSpread, FitError> {
    let frequencies = frequency_spread(cells);
    let parameters = orders
        .iter()
        .map(|rc| {
            parameter_spread(
                cells,
                &FitOptions {
                    rc: *rc,
                    ..*options
                },
            )
        })
        .collect::<Result<_, _>>()?;
    Ok(CellSpread {
        cells: cells.len(),
        sweeps: cells.iter().map(|c| c.sweeps.len()).sum(),
        measured: measured(cells, &frequencies),
        frequencies,
        parameters,
    })
}

fn parameter_spread(
    cells: &[CellSweeps],
    options: &FitOptions,
) -> Result<ParameterSpread, FitError> {
    let one = |s: &Spectrum| fit_erm(std::slice::from_ref(s), options);
    let fits: Vec<Vec<ErmFit>> = cells
        .par_iter()
        .map(|c| c.sweeps.iter().map(one).collect::<Result<_, _>>())
        .collect::<Result<_, FitError>>()?;
    let Some(names) = fits
        .iter()
        .flatten()
        .next()
        .map(|f| f.erm.parameter_names())
    else {
        return Err(FitError::NoPoints { spectra: 0 });
    };
    let dc = names.len();
    let quantities: Vec<QuantitySpread> = names
        .into_iter()
        .chain(["DC resistance".to_owned()])
        .enumerate()
        .filter_map(|(i, name)| quantity(&fits, i, dc, name))
        .collect();
    let loose: Vec<&str> = quantities
        .iter()
        .filter(|q| !q.identified)
        .map(|q| q.name.as_str())
        .collect();
    let warning = (!loose.is_empty()).then(|| {
        format!(
            "single sweeps do not fix {} of {} RC: their spread is of the fit, not of the cells; \
            compare |Z| and R instead",
            loose.join(", "),
            options.rc
        )
    });
    Ok(ParameterSpread {
        rc: options.rc,
        quantities,
        warning,
    })
}

/// The i-th parameter over all fits; the one after the last is the DC resistance.
fn quantity(fits: &[Vec<ErmFit>], i: usize, dc: usize, name: String) -> Option<QuantitySpread> {
    let value = |f: &ErmFit| {
        if i == dc {
            f.erm.dc_resistance_ohm()
        } else {
            f.erm.log_parameters()[i].exp()
        }
    };
    let relative = |f: &ErmFit| match &f.log_covariance {
        _ if i == dc => f
            .sigma
            .dc_resistance_ohm
            .map_or(f64::INFINITY, |s| s / value(f)),
        Some(c) => c[i][i].max(0.0).sqrt(),
        None => f64::INFINITY,
    };
    let mut sigmas: Vec<f64> = fits.iter().flatten().map(relative).collect();
    sigmas.sort_by(f64::total_cmp);
    let median = sigmas[sigmas.len() / 2];
    let unit = if i != dc && i > 0 && i.is_multiple_of(2) {
        "F"
    } else {
        "Ω"
    };
    let spread = components(
        &fits
            .iter()
            .map(|g| g.iter().map(value).collect())
            .collect::<Vec<_>>(),
    )?;
    // The uncertainty that a single fit states may be too small where its minimum is flat. The
    // repeats are therefore checked as well.
    let repeats = spread
        .within
        .is_none_or(|within| within <= UNIDENTIFIED * spread.mean);
    Some(QuantitySpread {
        name,
        unit: unit.to_owned(),
        spread,
        fitted_relative_sigma: median.is_finite().then_some(median),
        identified: median <= UNIDENTIFIED && repeats,
    })
}

/// |Z| at the measured frequencies nearest to whole decades, and Re Z at the lowest.
fn measured(cells: &[CellSweeps], frequencies: &[FrequencySpread]) -> Vec<QuantitySpread> {
    let (Some(first), Some(last)) = (frequencies.first(), frequencies.last()) else {
        return Vec::new();
    };
    let decades = (first.freq_hz.log10().round() as i32)..=(last.freq_hz.log10().floor() as i32);
    let off = |f: f64, decade: i32| (f.log10() - f64::from(decade)).abs();
    let nearest = |d: i32| {
        frequencies
            .iter()
            .map(|f| f.freq_hz)
            .min_by(|a, b| off(*a, d).total_cmp(&off(*b, d)))
    };
    let of = |name: String,
              freq_hz: f64,
              part: fn(num_complex::Complex64) -> f64|
     -> Option<QuantitySpread> {
        let at = |s: &Spectrum| {
            s.points
                .iter()
                .find(|p| (p.freq_hz - freq_hz).abs() <= 1e-9 * freq_hz)
                .map(|p| part(p.z_ohm))
        };
        let values: Vec<Vec<f64>> = cells
            .iter()
            .map(|c| c.sweeps.iter().filter_map(at).collect())
            .collect();
        Some(QuantitySpread {
            name,
            unit: "Ω".to_owned(),
            spread: components(&values)?,
            fitted_relative_sigma: None,
            identified: true,
        })
    };
    let magnitudes = decades
        .filter_map(nearest)
        .map(|f| (format!("|Z| at {:.3} Hz", f), f));
    let mut all: Vec<QuantitySpread> = magnitudes
        .filter_map(|(name, f)| of(name, f, |z| z.norm()))
        .collect();
    all.extend(of(
        format!("Re Z at {:.3} Hz", first.freq_hz),
        first.freq_hz,
        |z| z.re,
    ));
    all
}
