//! Start of an addition at the linear test's own step, the base moved with it.
//!
//! The test of an effect lets the base give way. A fit that starts with the base where it was can
//! lose that way: a resistance that must grow a thousandfold for it moves by a factor in one step,
//! while the effect moves at once, and the steps are refused.

use super::problem::Fit;
use super::search::Search;
use super::structure::Member;
use super::whitening::dot;
use analysis_numeric::linalg::{cholesky, cholesky_substitute};

/// Least part of a resistance that a linear step leaves.
const LEAST_LEFT: f64 = 0.1;
/// Longest move of a logarithm of a time constant.
const LONGEST_LN: f64 = 1.0;

impl Search<'_> {
    /// Returns the fit of an effect from its start and the base that the linear model puts beside
    /// it, or `None` if the data do not determine that base.
    pub(super) fn fit_from_step(&mut self, from: &Fit, member: &Member) -> Option<Fit> {
        let structure = from.structure.with(member.clone());
        let axes = structure.axes(&self.problem.base.erm);
        let mut x = from.x.clone();
        x.extend(member.encode());
        let here = self
            .problem
            .prediction(structure.at(&x), &mut self.workspace);
        let target = self.problem.target();
        let residuals: Vec<f64> = target.iter().zip(&here.white).map(|(t, p)| t - p).collect();
        let moves = solved(&from.columns, &residuals)?;
        for (k, step) in moves
            .iter()
            .enumerate()
            .take(1 + 2 * self.problem.branches())
        {
            // The prediction is linear in a resistance, and its logarithm moves with it.
            x[k] += if k > 0 && k % 2 == 0 {
                step.clamp(-LONGEST_LN, LONGEST_LN)
            } else {
                (1.0 + step).max(LEAST_LEFT).ln()
            };
        }
        x.iter_mut()
            .zip(&axes)
            .for_each(|(x, axis)| *x = x.clamp(axis.lower, axis.upper));
        let x_is_finite = x.iter().all(|x| x.is_finite());
        x_is_finite.then(|| {
            self.problem
                .fit_from(&structure, x, axes, &mut self.workspace)
        })
    }
}

/// Returns the moves whose change of the prediction is nearest to the residuals.
fn solved(columns: &[Vec<f64>], residuals: &[f64]) -> Option<Vec<f64>> {
    let n = columns.len();
    let mut normal: Vec<f64> = (0..n * n)
        .map(|ij| dot(&columns[ij / n], &columns[ij % n]))
        .collect();
    (0..n).for_each(|i| normal[i * n + i] *= 1.0 + 1e-9);
    let mut moves: Vec<f64> = columns.iter().map(|c| dot(c, residuals)).collect();
    cholesky(&mut normal, n).then(|| {
        cholesky_substitute(&normal, n, &mut moves);
        moves
    })
}
