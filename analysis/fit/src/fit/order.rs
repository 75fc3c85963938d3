//! Number of RC branches that the data support: the corrected Akaike criterion (Hurvich and
//! Tsai, 1989), the F-test between nested orders, the whiteness of the residuals, and the
//! prediction of a cell from the others.
//!
//! Cells differ from each other by more than one cell from sweep to sweep, so that pooled residuals
//! say more of the cells than of the model. Every cell is therefore fitted on its own, its repeats
//! averaged and their scatter taken as the noise, and the cells' sums are judged. A branch that is
//! not there leaves its time constant free, which textbook F-tests do not foresee: their levels are
//! approximate here.

use super::cells::{CellSweeps, cell_means};
use super::erm::fit_erm;
use super::options::{Bounds, FitError, FitOptions, Objective, check_spectra};
use super::outliers::standing_out;
use super::problem::Problem;
use super::result::ErmFit;
use super::verdict::{OrderRow, for_other_cells, judge};
use super::whiteness::{Lag1, lag1};
use super::zero::is_r_zero;
use analysis_numeric::{
    Covariance2,
    stats::{FDistribution, normal_tail},
};
use analysis_signal::spectrum::Spectrum;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Highest order that is tried if the data choose it.
pub const MOST_AUTO: usize = 6;

/// Residuals relative to |Z| that are rounding.
const ROUNDING: f64 = 1e-8;

/// Options of the choice of an order.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OrderOptions {
    /// Highest number of RC branches.
    pub most: usize,
    /// Limits of the parameters.
    pub bounds: Bounds,
    /// Seed of the searches.
    pub seed: u64,
}

/// The orders tried, and the conclusion.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct OrderSelection {
    /// One row per order, rising.
    pub rows: Vec<OrderRow>,
    /// The order to use.
    pub recommended: usize,
    /// Orders that the data cannot distinguish from the best one; if there is more than one, the
    /// order is undecided.
    pub plausible: Vec<usize>,
    /// Why, in sentences.
    pub reasons: Vec<String>,
    /// Number of cells.
    pub cells: usize,
    /// Number of sweeps.
    pub sweeps: usize,
    /// The smallest order that predicts a left-out cell as well as any other; `None` below three
    /// cells.
    pub for_other_cells: Option<usize>,
    /// Error of predicting a cell from the mean of the others without any model: no order can do
    /// better than about this.
    pub left_out_floor: Option<f64>,
}

impl OrderSelection {
    /// True when one order stands out.
    pub fn is_clear(&self) -> bool {
        self.plausible.len() == 1
    }
}

/// Tries all orders up to the highest that the data allow.
///
/// # Errors
/// [`FitError`] as for a fit.
pub fn select_order(
    cells: &[CellSweeps],
    options: &OrderOptions,
) -> Result<OrderSelection, FitError> {
    let all: Vec<Spectrum> = cells.iter().flat_map(|c| c.sweeps.clone()).collect();
    check_spectra(&all)?;
    let means = cell_means(cells);
    let repeated = cells.iter().any(|c| c.sweeps.len() > 1);
    let groups = means.iter().map(|m| {
        Problem::new(std::slice::from_ref(m), Objective::Complex)
            .groups
            .len()
    });
    let fewest = groups.min().unwrap_or(0);
    // As many points as parameters, and one that may be left out.
    let fits_into = |rc: &usize| fewest >= 2 * rc + 2;
    let orders: Vec<usize> = (0..=options.most)
        .filter(|rc| *rc == 0 || fits_into(rc))
        .collect();
    let freedom_within: usize = cells
        .iter()
        .map(|c| c.sweeps.len().saturating_sub(1))
        .sum::<usize>()
        * 2
        * fewest;
    let judge_order = |rc: &usize| -> Result<(OrderRow, Vec<f64>), FitError> {
        let row = row(&means, options, *rc, repeated.then_some(freedom_within))?;
        Ok((row, left_out(&means, options, *rc)?))
    };
    let judged: Vec<(OrderRow, Vec<f64>)> = orders
        .par_iter()
        .map(judge_order)
        .collect::<Result<_, _>>()?;
    let (mut rows, squares): (Vec<OrderRow>, Vec<Vec<f64>>) = judged.into_iter().unzip();
    compare(&mut rows, &squares);
    let (recommended, plausible, reasons) = judge(&rows);
    Ok(OrderSelection {
        for_other_cells: for_other_cells(&rows).map(|r| r.rc),
        rows,
        recommended,
        plausible,
        reasons,
        cells: cells.len(),
        sweeps: all.len(),
        left_out_floor: left_out_floor(&means),
    })
}

/// Evidence of one order by itself.
fn row(
    means: &[Spectrum],
    options: &OrderOptions,
    rc: usize,
    freedom_within: Option<usize>,
) -> Result<OrderRow, FitError> {
    let options = FitOptions {
        rc,
        objective: Objective::Complex,
        bounds: options.bounds,
        seed: options.seed,
    };
    let fits: Vec<ErmFit> = means
        .iter()
        .map(|m| fit_erm(std::slice::from_ref(m), &options))
        .collect::<Result<_, _>>()?;
    let chi2: f64 = fits.iter().map(|f| f.objective).sum();
    let numbers: usize = fits.iter().map(|f| 2 * f.points).sum();
    let parameters = fits.len() * options.parameter_count();
    let problems: Vec<Problem> = means
        .iter()
        .map(|m| Problem::new(std::slice::from_ref(m), Objective::Complex))
        .collect();
    let lags: Vec<Lag1> = problems
        .iter()
        .zip(&fits)
        .filter_map(|(p, f)| lag1(p, f))
        .collect();
    let count = lags.len() as f64;
    let freedom = numbers.saturating_sub(parameters) as f64;
    let absolute = fits.iter().all(|f| f.reduced_chi2.is_some());
    // Of exact data every order that is high enough leaves rounding, in which none is better.
    let chi2 = if absolute {
        chi2
    } else {
        chi2.max(ROUNDING.powi(2) * numbers as f64)
    };
    Ok(OrderRow {
        rc,
        chi2,
        numbers,
        parameters,
        aicc: aicc(chi2, numbers as f64, parameters as f64 + 1.0),
        f_test_p: None,
        lag1: (count > 0.0).then(|| lags.iter().map(|l| l.correlation).sum::<f64>() / count),
        whiteness_p: (count > 0.0)
            .then(|| normal_tail(lags.iter().map(|l| l.z).sum::<f64>() / count.sqrt())),
        lack_of_fit_p: freedom_within.filter(|_| absolute).map(|within| {
            FDistribution {
                above: freedom,
                below: within as f64,
            }
            .tail(chi2 / freedom)
        }),
        left_out_cell: None,
        left_out_change: None,
        held_by_bounds: held_by_bounds(&fits, &problems),
        reduced_chi2: (absolute && freedom > 0.0).then_some(chi2 / freedom),
        stands_out: problems
            .iter()
            .zip(&fits)
            .any(|(p, f)| !standing_out(p, &f.erm).is_empty()),
        unidentified: unidentified(&fits, &problems),
    })
}

fn aicc(chi2: f64, numbers: f64, parameters: f64) -> f64 {
    let left = numbers - parameters - 1.0;
    let correction = if left > 0.0 {
        2.0 * parameters * (parameters + 1.0) / left
    } else {
        f64::INFINITY
    };
    numbers * (chi2 / numbers).max(f64::MIN_POSITIVE).ln() + 2.0 * parameters + correction
}

/// Names of the parameters that a bound holds in at least half of the fits.
fn held_by_bounds(fits: &[ErmFit], problems: &[Problem]) -> Vec<String> {
    let Some(first) = fits.first() else {
        return Vec::new();
    };
    let held: Vec<Vec<String>> = fits
        .iter()
        .zip(problems)
        .map(|(fit, problem)| super::warnings::held_by_bounds(fit, problem))
        .collect();
    let names = first.erm.parameter_names().into_iter();
    names
        .filter(|name| 2 * held.iter().filter(|held| held.contains(name)).count() >= fits.len())
        .collect()
}

/// Names of the parameters that at least half of the fits do not fix; a series resistance of zero
/// is fixed.
fn unidentified(fits: &[ErmFit], problems: &[Problem]) -> Vec<String> {
    let Some(first) = fits.first() else {
        return Vec::new();
    };
    let loose = |(fit, problem): (&ErmFit, &Problem), i: usize| {
        let relative = match i {
            0 if is_r_zero(&fit.erm, &fit.bounds, problem) => return false,
            0 => fit.sigma.r_ohm.map(|s| s / fit.erm.r_ohm),
            _ => {
                let (b, s) = (
                    fit.erm.branches[(i - 1) / 2],
                    fit.sigma.branches[(i - 1) / 2],
                );
                if i % 2 == 1 {
                    s.r_ohm.map(|s| s / b.r_ohm)
                } else {
                    s.c_f.map(|s| s / b.c_f)
                }
            }
        };
        relative.is_none_or(|r| r > 0.5)
    };
    let names = first.erm.parameter_names().into_iter().enumerate();
    names
        .filter(|(i, _)| {
            let loose = fits.iter().zip(problems).filter(|of| loose(*of, *i));
            2 * loose.count() >= fits.len()
        })
        .map(|(_, name)| name)
        .collect()
}

/// Adds the comparison of each order with the one below.
fn compare(rows: &mut [OrderRow], squares: &[Vec<f64>]) {
    for k in 0..rows.len() {
        let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
        rows[k].left_out_cell = (!squares[k].is_empty()).then(|| mean(&squares[k]).sqrt());
        if k == 0 {
            continue;
        }
        let (below, here) = (rows[k - 1].chi2, rows[k].chi2);
        let more = (rows[k].parameters - rows[k - 1].parameters) as f64;
        let freedom = (rows[k].numbers - rows[k].parameters) as f64;
        let distribution = FDistribution {
            above: more,
            below: freedom,
        };
        let ratio = (below - here).max(0.0) / more / (here / freedom);
        rows[k].f_test_p = Some(distribution.tail(ratio)).filter(|p| p.is_finite());
        let changes: Vec<f64> = squares[k]
            .iter()
            .zip(&squares[k - 1])
            .map(|(a, b)| a - b)
            .collect();
        if changes.len() > 1 {
            let (m, n) = (mean(&changes), changes.len() as f64);
            let variance = changes.iter().map(|c| (c - m).powi(2)).sum::<f64>() / (n - 1.0);
            rows[k].left_out_change = Some((m, (variance / n).sqrt()));
        }
    }
}

/// Mean of |ΔZ/Z|² of every cell under the model of the others; empty below three cells.
fn left_out(means: &[Spectrum], options: &OrderOptions, rc: usize) -> Result<Vec<f64>, FitError> {
    if means.len() < 3 {
        return Ok(Vec::new());
    }
    let options = FitOptions {
        rc,
        objective: Objective::Complex,
        bounds: options.bounds,
        seed: options.seed,
    };
    let one = |left: usize| {
        let mut others: Vec<Spectrum> = means
            .iter()
            .enumerate()
            .filter(|(k, _)| *k != left)
            .map(|(_, m)| m.clone())
            .collect();
        // Every cell counts alike, and every frequency by its magnitude: the noise is not what
        // makes cells differ.
        others
            .iter_mut()
            .flat_map(|m| &mut m.points)
            .for_each(|p| p.covariance = Covariance2::UNKNOWN);
        let fit = fit_erm(&others, &options)?;
        let points = &means[left].points;
        Ok(points
            .iter()
            .map(|p| ((fit.erm.impedance(p.freq_hz) - p.z_ohm) / p.z_ohm).norm_sqr())
            .sum::<f64>()
            / points.len() as f64)
    };
    (0..means.len()).map(one).collect()
}

fn left_out_floor(means: &[Spectrum]) -> Option<f64> {
    let points = means.first()?.points.len();
    if means.len() < 3 || means.iter().any(|m| m.points.len() != points) {
        return None;
    }
    let others = (means.len() - 1) as f64;
    let mut sum = 0.0;
    for k in 0..points {
        let total: num_complex::Complex64 = means.iter().map(|m| m.points[k].z_ohm).sum();
        sum += means
            .iter()
            .map(|m| m.points[k].z_ohm)
            .map(|z| (((total - z) / others - z) / z).norm_sqr())
            .sum::<f64>();
    }
    Some((sum / (points * means.len()) as f64).sqrt())
}
