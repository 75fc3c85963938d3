//! Least squares under x ≥ 0 by block principal pivoting (Portugal, Júdice and Vicente, Math. Comp.
//! 63 (1994) 625): the set of free unknowns is exchanged in blocks, and one by one when that goes
//! in circles.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

/// Rounds of exchanging blocks without progress.
const PATIENCE: u32 = 4;
const MOST_ROUNDS: usize = 400;

/// A minimiser, and which unknowns are free.
#[derive(Debug, Clone)]
pub(crate) struct Solution {
    pub(crate) x: DVector<f64>,
    /// Indices of the unknowns above zero.
    pub(crate) free: Vec<usize>,
    /// Factor of the matrix restricted to them.
    pub(crate) factor: Cholesky<f64, Dyn>,
}

/// Minimises ½xᵀKx − cᵀx under x ≥ 0, starting from a guess of the free unknowns; `None` if K is
/// too near to singular.
pub(crate) fn solve(k: &DMatrix<f64>, c: &DVector<f64>, guess: &[usize]) -> Option<Solution> {
    let n = c.len();
    let mut is_free = vec![false; n];
    guess.iter().for_each(|i| is_free[*i] = true);
    let (mut fewest, mut patience) = (n + 1, PATIENCE);
    for _ in 0..MOST_ROUNDS {
        let solution = restricted(k, c, &is_free)?;
        let gradient = k * &solution.x - c;
        let wrong: Vec<usize> = (0..n)
            .filter(|i| {
                let noise = 1e-10 * (c[*i].abs() + k[(*i, *i)] * solution.x[*i].abs());
                if is_free[*i] {
                    solution.x[*i] < 0.0
                } else {
                    gradient[*i] < -noise
                }
            })
            .collect();
        let Some(last) = wrong.last().copied() else {
            return Some(solution);
        };
        let exchanged = if wrong.len() < fewest {
            (fewest, patience) = (wrong.len(), PATIENCE);
            wrong
        } else if patience > 0 {
            patience -= 1;
            wrong
        } else {
            vec![last]
        };
        exchanged.into_iter().for_each(|i| is_free[i] = !is_free[i]);
    }
    None
}

fn restricted(k: &DMatrix<f64>, c: &DVector<f64>, is_free: &[bool]) -> Option<Solution> {
    let free: Vec<usize> = (0..c.len()).filter(|i| is_free[*i]).collect();
    let mut matrix = DMatrix::from_fn(free.len(), free.len(), |a, b| k[(free[a], free[b])]);
    (0..free.len()).for_each(|a| matrix[(a, a)] *= 1.0 + 1e-11);
    let factor = Cholesky::new(matrix)?;
    let solved = factor.solve(&DVector::from_fn(free.len(), |a, _| c[free[a]]));
    let mut x = DVector::zeros(c.len());
    free.iter().zip(solved.iter()).for_each(|(i, v)| x[*i] = *v);
    Some(Solution { x, free, factor })
}
