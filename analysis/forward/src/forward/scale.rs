//! Largest factor of a profile's demand with which a cell or a pack stays within the voltage
//! window.

use super::batch::{BatchCell, BatchOptions, BatchOutcome, MAX_BATCH_RC, simulate_batch};
use super::error::ForwardError;
use super::law::Beyond;
use super::limits::CellWindow;
use super::model::{SimModel, SimState};
use super::options::SimOptions;
use super::profile::Profile;
use super::simulate::simulate;
use rayon::prelude::*;
use serde::Serialize;

/// Factors tried at once.
const TRIED: usize = 16;
/// Factors below this are taken to be unlimited.
const LARGEST: f64 = 1e6;

/// Options of the search for the factor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScaleOptions {
    /// Limits of a cell.
    pub window: CellWindow,
    /// Longest step, s.
    pub max_step_s: f64,
    /// Relative accuracy of the factor.
    pub accuracy: f64,
}

impl ScaleOptions {
    /// Uses steps of 0.1 ms, or 200 000 of them if that is less work; the factor to 10⁻⁶.
    pub fn for_profile(profile: &Profile) -> Self {
        Self {
            window: CellWindow::THESIS,
            max_step_s: (profile.duration_s() / 2e5).max(1e-4),
            accuracy: 1e-6,
        }
    }
}

/// Limit that ends the growth of a factor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ScaleBound {
    /// A cell's voltage falls to the lower limit.
    LowerVoltage,
    /// A cell's voltage rises to the upper limit.
    UpperVoltage,
    /// No more power is available at any voltage.
    Power,
    /// Nothing up to a factor of a million.
    Nothing,
}

/// The largest factor and what bounds it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ScaleLimit {
    /// Largest factor of the demand; 0 if the cell is already outside the window at rest.
    pub factor: f64,
    /// Limit that bounds it.
    pub bound: ScaleBound,
}

/// Returns the largest factor of a power or current profile that keeps every cell within the
/// window, all power to be had.
///
/// A model that no batch takes (additions, many branches) is simulated factor by factor.
///
/// Assumes that if a factor breaks a limit, every larger one does.
///
/// # Errors
/// As [`simulate_batch`] and [`simulate`].
pub fn largest_scale(
    model: &SimModel,
    state: &SimState,
    profile: &Profile,
    options: &ScaleOptions,
) -> Result<ScaleLimit, ForwardError> {
    let batch = BatchOptions {
        beyond: Beyond::Stop,
        max_step_s: options.max_step_s,
    };
    let too_many = model.mapped.is_none() && model.erm.branches.len() > MAX_BATCH_RC;
    let one_by_one = model.laws.is_some() || too_many;
    let judge = |factors: &[f64]| -> Result<Vec<Option<ScaleBound>>, ForwardError> {
        if one_by_one {
            return factors
                .par_iter()
                .map(|factor| alone(model, state, &profile.scaled(*factor), options))
                .collect();
        }
        let cells: Vec<BatchCell<'_>> = factors
            .iter()
            .map(|&scale| BatchCell {
                model,
                state,
                scale,
            })
            .collect();
        Ok(simulate_batch(&cells, profile, &batch)?
            .iter()
            .map(|outcome| broken(outcome, options.window))
            .collect())
    };
    let coarse: Vec<f64> = (0..TRIED)
        .map(|k| LARGEST * 10f64.powf(0.8 * (k as f64 - (TRIED - 1) as f64)))
        .collect();
    let (mut kept, mut lost) = (0.0, (LARGEST, ScaleBound::Nothing));
    let mut tried = coarse;
    loop {
        let verdicts = judge(&tried)?;
        match verdicts.iter().position(Option::is_some) {
            Some(first) => {
                lost = (tried[first], verdicts[first].unwrap_or(ScaleBound::Nothing));
                kept = if first > 0 { tried[first - 1] } else { kept };
            }
            None => kept = tried.last().copied().unwrap_or(kept),
        }
        if lost.1 == ScaleBound::Nothing
            || lost.0 - kept <= options.accuracy * lost.0
            || lost.0 < 1e-9
        {
            let factor = if lost.0 < 1e-9 { 0.0 } else { kept };
            return Ok(ScaleLimit {
                factor,
                bound: lost.1,
            });
        }
        tried = (1..=TRIED)
            .map(|k| kept + (lost.0 - kept) * k as f64 / (TRIED + 1) as f64)
            .collect();
    }
}

fn broken(outcome: &BatchOutcome, window: CellWindow) -> Option<ScaleBound> {
    if window.margin_high_v(outcome.max_cell_v) < 0.0 {
        return Some(ScaleBound::UpperVoltage);
    }
    if outcome.infeasible_s.is_some() || outcome.collapsed {
        return Some(ScaleBound::Power);
    }
    (window.margin_low_v(outcome.min_cell_v) < 0.0).then_some(ScaleBound::LowerVoltage)
}

/// Returns the first limit that breaks in one separate simulation.
fn alone(
    model: &SimModel,
    state: &SimState,
    profile: &Profile,
    options: &ScaleOptions,
) -> Result<Option<ScaleBound>, ForwardError> {
    let simulated = SimOptions {
        beyond: Beyond::Stop,
        window: options.window,
        ..SimOptions::default()
    };
    let summary = match simulate(model, state, profile, &simulated) {
        Ok(simulation) => simulation.summary,
        // Demands far beyond the model's meaning do not settle; no limit lies there.
        Err(
            ForwardError::Collapsed { .. }
            | ForwardError::Unresolved { .. }
            | ForwardError::MapUnresolved { .. },
        ) => {
            return Ok(Some(ScaleBound::Power));
        }
        Err(error) => return Err(error),
    };
    if summary.margin_high_v < 0.0 {
        return Ok(Some(ScaleBound::UpperVoltage));
    }
    if !summary.feasible {
        return Ok(Some(ScaleBound::Power));
    }
    Ok((summary.margin_low_v < 0.0).then_some(ScaleBound::LowerVoltage))
}
