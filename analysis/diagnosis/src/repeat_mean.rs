//! Repeat-mean residual: tests whether all repeats of a kind of run have a residual in common.
//! Their mean contains all of it, and less noise by the root of their number.
//!
//! With rₖ the whitened residuals of m repeats, s = Σ rₖ has the covariance m·I if only noise
//! remains. Errors that may be equal in repeats (codes of the current, the position of an edge
//! between two samples) have the whitened covariance K in each; if the repeats share them, that of
//! s is m·(I + (m − 1)·K). sᵀ times its inverse times s is then χ² of one run's rows.

use super::guards::beyond_formula;
use super::inconsistency::Inconsistency;
use super::problem::{Fit, Problem};
use super::whitening::dot;
use analysis_fit::validity::tail::{chi2_tail, holm};
use analysis_numeric::linalg::{cholesky, cholesky_substitute};
use std::collections::BTreeMap;

/// Repeats: their blocks, and the sum of their whitened residuals.
#[derive(Default)]
struct Repeats {
    blocks: Vec<usize>,
    sum: Vec<f64>,
}

/// Tests each group of repeats, and all of them together, with probabilities corrected for their
/// number; `gained` is the λ of the named effects.
pub(super) fn repeat_mean_residual(
    problem: &Problem,
    fit: &Fit,
    gained: f64,
) -> Vec<Inconsistency> {
    let mut groups: BTreeMap<(&str, usize), Repeats> = BTreeMap::new();
    for (k, block, residual) in problem.whitened_residuals(fit) {
        let repeats = groups.entry((&block.group, block.rows())).or_default();
        repeats.blocks.push(k);
        repeats.sum.resize(block.rows(), 0.0);
        repeats
            .sum
            .iter_mut()
            .zip(residual)
            .for_each(|(sum, r)| *sum += r);
    }
    let mut asked: Vec<(String, f64, usize)> = Vec::new();
    for ((group, rows), Repeats { blocks, sum }) in groups
        .into_iter()
        .filter(|(_, repeats)| repeats.blocks.len() > 1)
    {
        let repeats = blocks.len() as f64;
        let known = &problem.repeating[blocks[0]];
        let mut covariance: Vec<f64> = known.iter().map(|k| (repeats - 1.0) * k).collect();
        let mut solved = sum.clone();
        if !covariance.is_empty() {
            (0..rows).for_each(|i| covariance[i * rows + i] += 1.0);
            if cholesky(&mut covariance, rows) {
                cholesky_substitute(&covariance, rows, &mut solved);
            }
        }
        asked.push((group.to_owned(), dot(&sum, &solved) / repeats, rows));
    }
    if asked.len() > 1 {
        let (chi2, rows) = asked
            .iter()
            .fold((0.0, 0), |(chi2, rows), of| (chi2 + of.1, rows + of.2));
        asked.push(("every kind".to_owned(), chi2, rows));
    }
    asked.retain(|(_, _, dof)| *dof > 0);
    let p_values = asked.iter().map(|(_, chi2, dof)| {
        chi2_tail(
            *dof as f64 + beyond_formula(chi2 - *dof as f64, gained),
            *dof as f64,
        )
    });
    let corrected = holm(&p_values.collect::<Vec<f64>>());
    let found = |((group, chi2, dof), p_value): (&(String, f64, usize), f64)| Inconsistency {
        message: format!("all repeats of {group} have more in common than the model"),
        chi2: *chi2,
        dof: *dof,
        p_value,
        is_contact: false,
    };
    asked.iter().zip(corrected).map(found).collect()
}
