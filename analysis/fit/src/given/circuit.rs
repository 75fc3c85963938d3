//! A fitted circuit, as `fit --circuit` writes it (`circuit.json`), as a model that is simulated.

use super::GivenModel;
use super::error::GivenError;
use super::ladder::{Bands, Followed, follow};
use super::plain::PlainModel;
use analysis_model::model::Circuit;
use serde::Deserialize;
use serde_json::Value;

/// Fields that are read of a [`crate::fit::CircuitFit`].
#[derive(Debug, Deserialize)]
struct Entry {
    circuit: String,
    values: Vec<f64>,
    #[serde(default)]
    covariance: Vec<Vec<Option<f64>>>,
    #[serde(default)]
    band_hz: Option<(f64, f64)>,
    #[serde(default)]
    warnings: Vec<String>,
}

/// Reads the one circuit of a file and follows it.
pub(super) fn read(value: Value, asked_hz: Option<(f64, f64)>) -> Result<GivenModel, GivenError> {
    let entry: Entry = serde_json::from_value(one(value)?).map_err(GivenError::CircuitFile)?;
    let circuit: Circuit = entry.circuit.parse()?;
    let bands = Bands {
        data_hz: entry.band_hz,
        asked_hz,
    };
    let Followed {
        erm,
        ladder,
        log_jacobian,
    } = follow(&circuit, &entry.values, bands)?;
    let log_covariance =
        log_jacobian.and_then(|jacobian| propagated(&jacobian, &entry.values, &entry.covariance));
    let plain = PlainModel::new(&ladder.circuit, erm);
    Ok(PlainModel {
        ladder: Some(ladder),
        warnings: entry.warnings,
        log_covariance,
        ..plain
    }
    .into())
}

/// The fit itself, or the only one of a list.
fn one(mut value: Value) -> Result<Value, GivenError> {
    let Some(fits) = value.get_mut("fits") else {
        return Ok(value);
    };
    let mut fits: Vec<Value> =
        serde_json::from_value(fits.take()).map_err(GivenError::CircuitFile)?;
    if fits
        .first()
        .is_some_and(|fit| fit.get("circuit").is_none() && fit.get("rc").is_some())
    {
        return Err(GivenError::RandlesFits);
    }
    match (fits.pop(), fits.len()) {
        (Some(fit), 0) => Ok(fit),
        (None, _) => Err(GivenError::Fits { met: 0 }),
        (Some(_), before) => Err(GivenError::Fits { met: before + 1 }),
    }
}

/// Returns J·Σ·Jᵀ with the covariance of the logarithms of the circuit's parameters; `None` if it
/// is unknown for one that the ERM depends on.
fn propagated(
    jacobian: &[Vec<f64>],
    values: &[f64],
    covariance: &[Vec<Option<f64>>],
) -> Option<Vec<Vec<f64>>> {
    let log = |i: usize, j: usize| {
        covariance
            .get(i)?
            .get(j)
            .copied()
            .flatten()
            .map(|c| c / (values[i] * values[j]))
    };
    let entry = |a: &[f64], b: &[f64]| {
        let mut sum = 0.0;
        for (i, a) in a.iter().enumerate().filter(|(_, a)| **a != 0.0) {
            for (j, b) in b.iter().enumerate().filter(|(_, b)| **b != 0.0) {
                sum += a * b * log(i, j)?;
            }
        }
        Some(sum)
    };
    jacobian
        .iter()
        .map(|a| jacobian.iter().map(|b| entry(a, b)).collect())
        .collect()
}
