//! The normal equations of one channel at one frequency, and their solution by Cholesky
//! factorisation.

use super::basis::{Square, dot};

/// Least ratio of a pivot of the factorisation to its diagonal element: below, the equations are
/// singular to working precision.
const SINGULAR: f64 = 1e-11;

/// Cholesky factor of the normal matrix of the fitted columns.
#[derive(Debug, Clone)]
pub(super) struct Normal {
    lower: Vec<Vec<f64>>,
}

impl Normal {
    /// Factorises the first `size` columns; `None` if the samples do not determine the parameters.
    pub(super) fn new(gram: &Square, size: usize) -> Option<Self> {
        let mut lower: Vec<Vec<f64>> = Vec::with_capacity(size);
        for row in 0..size {
            let mut line = vec![0.0; row + 1];
            for column in 0..row {
                let known = dot(&line[..column], &lower[column][..column]);
                line[column] = (gram.at(row, column) - known) / lower[column][column];
            }
            let own = gram.at(row, row);
            let left = own - dot(&line[..row], &line[..row]);
            // Not-a-number fails, too.
            if left > SINGULAR * own {
                line[row] = left.sqrt();
                lower.push(line);
            } else {
                return None;
            }
        }
        Some(Self { lower })
    }

    /// Returns the solution for a right-hand side; elements beyond the fitted columns are ignored.
    pub(super) fn solve(&self, rhs: &[f64]) -> Vec<f64> {
        let size = self.size();
        let mut x = rhs[..size].to_vec();
        for row in 0..size {
            let known = dot(&self.lower[row][..row], &x[..row]);
            x[row] = (x[row] - known) / self.lower[row][row];
        }
        for row in (0..size).rev() {
            let known: f64 = (row + 1..size).map(|k| self.lower[k][row] * x[k]).sum();
            x[row] = (x[row] - known) / self.lower[row][row];
        }
        x
    }

    /// Returns the number of parameters.
    pub(super) fn size(&self) -> usize {
        self.lower.len()
    }

    /// Block of the inverse for one tone: (re re, re im, im im).
    pub(super) fn phasor_inverse(&self, tone: usize) -> (f64, f64, f64) {
        let column = |index: usize| {
            let mut unit = vec![0.0; self.size()];
            unit[index] = 1.0;
            self.solve(&unit)
        };
        let (first, second) = (column(2 * tone), column(2 * tone + 1));
        (
            first[2 * tone],
            0.5 * (first[2 * tone + 1] + second[2 * tone]),
            second[2 * tone + 1],
        )
    }
}

/// Information of one channel on the phase that a change of the frequency adds at the ends of the
/// record (rad). Returns curvature and slope of the sum of squares, after the other parameters have
/// been fitted. `derivative` holds the coefficients of the model's derivative on all columns.
pub(super) fn frequency_step(
    gram: &Square,
    right: &[f64],
    normal: &Normal,
    beta: &[f64],
    derivative: &[f64],
) -> (f64, f64) {
    let along = gram.times(derivative);
    let explained = normal.solve(&along);
    let curvature = dot(derivative, &along) - dot(&explained, &along);
    (curvature, dot(derivative, right) - dot(beta, &along))
}
