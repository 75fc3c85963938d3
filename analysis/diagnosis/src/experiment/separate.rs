//! λ of a pair: the residual χ² after one structure is refitted to the prediction of another, on
//! the training runs and planned ones, without noise.
//!
//! On the training runs the refit is linear around its fit, so that only planned runs are
//! simulated; on those it is Gauss–Newton.

use crate::{
    block::Workspace,
    problem::{Fit, Problem, step},
    whitening::dot,
};

/// Damping of a step, as a part of the diagonal.
const DAMPING: f64 = 1e-7;

/// A fit with its predictions for planned runs.
#[derive(Debug)]
pub(super) struct View<'a> {
    fit: &'a Fit,
    predicted: Vec<f64>,
    columns: Vec<Vec<f64>>,
}

impl<'a> View<'a> {
    /// Creates a view; without planned runs it has no rows.
    pub(super) fn new(fit: &'a Fit, planned: Option<&Problem>, workspace: &mut Workspace) -> Self {
        let alone = || Self {
            fit,
            predicted: Vec::new(),
            columns: Vec::new(),
        };
        planned.map_or_else(alone, |p| Self::at(fit, &fit.x, p, workspace))
    }

    fn at(fit: &'a Fit, x: &[f64], planned: &Problem, workspace: &mut Workspace) -> Self {
        let at = fit.structure.at(x);
        let predicted = planned.prediction(at, workspace);
        let columns = planned.columns(at, &fit.axes, &predicted, workspace);
        Self {
            fit,
            predicted: predicted.white,
            columns,
        }
    }
}

/// Returns λ of a truth against another structure, which is refitted. One step gives the result of
/// a linear refit; further steps simulate again.
pub(super) fn separation_chi2(
    truth: &View<'_>,
    other: &View<'_>,
    planned: Option<&Problem>,
    steps: usize,
    workspace: &mut Workspace,
) -> f64 {
    let (view, other) = (other, other.fit);
    // Residuals are measured less predicted, so the measured values cancel.
    let mut known: Vec<f64> = other
        .residuals
        .iter()
        .zip(&truth.fit.residuals)
        .map(|(o, t)| o - t)
        .collect();
    let away = |v: &View<'_>| {
        truth
            .predicted
            .iter()
            .zip(&v.predicted)
            .map(|(t, p)| t - p)
            .collect::<Vec<f64>>()
    };
    let joined = |v: &View<'_>| {
        other
            .columns
            .iter()
            .enumerate()
            .map(|(k, c)| joint(c, v.columns.get(k).map_or(&[], Vec::as_slice)))
            .collect::<Vec<_>>()
    };
    let (mut x, mut residuals) = (other.x.clone(), joint(&known, &away(view)));
    let mut columns = joined(view);
    let mut chi2 = dot(&residuals, &residuals);
    for n in 0..steps {
        let Some((moves, promise)) = step(&columns, &residuals, &other.axes, &x, DAMPING) else {
            break;
        };
        let Some(planned) = planned.filter(|_| steps > 1) else {
            return (chi2 - promise).max(0.0);
        };
        let trial: Vec<f64> = x
            .iter()
            .zip(&moves)
            .zip(&other.axes)
            .map(|((x, s), a)| (x + s).clamp(a.lower, a.upper))
            .collect();
        let moved = View::at(other, &trial, planned, workspace);
        let mut residual = known.clone();
        trial
            .iter()
            .zip(&x)
            .zip(&other.columns)
            .for_each(|((t, x), c)| {
                residual
                    .iter_mut()
                    .zip(c)
                    .for_each(|(l, c)| *l -= (t - x) * c);
            });
        let whole = joint(&residual, &away(&moved));
        let value = dot(&whole, &whole);
        if value >= chi2 {
            break;
        }
        (x, known, residuals, chi2) = (trial, residual, whole, value);
        if n + 1 < steps {
            columns = joined(&moved);
        }
    }
    chi2
}

fn joint(a: &[f64], b: &[f64]) -> Vec<f64> {
    a.iter().chain(b).copied().collect()
}
