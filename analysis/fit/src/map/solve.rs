//! Bounded least squares: resistances are zero or more, corrections of the OCV are free.

use super::options::MapFitError;
use crate::drt::nonnegative;
use analysis_model::map::CellMap;
use nalgebra::{DMatrix, DVector};
use std::sync::Arc;

/// Shift of free unknowns, in which a bound at zero never acts, in their own unit.
const SHIFT: f64 = 10.0;

/// Unit of the inductance, H: nothing but its size in the equations depends on it.
pub(super) const INDUCTANCE_H: f64 = 1e-7;

/// How resistances follow temperature and current.
#[derive(Debug, Clone)]
pub(super) struct Kinetics {
    /// Activation energy of the series resistance, J/mol.
    pub(super) series: f64,
    /// That of the branches, J/mol.
    pub(super) branches: f64,
    /// The map around which the equations of charge transfer are made: its voltage and resistances give the
    /// exchange current at each place. `None` if the data show no fall under current.
    pub(super) around: Option<Arc<CellMap>>,
}

/// Start and prior of the activation energies, J/mol: ionic conduction, and charge transfer with
/// diffusion (Arrhenius slopes of lithium-ion cells; Waldmann et al., J. Power Sources 262 (2014)
/// 129, and the sources there).
pub(super) const START: Kinetics = Kinetics {
    series: 15e3,
    branches: 35e3,
    around: None,
};

/// Normal equations of weighted rows and priors.
#[derive(Clone)]
pub(super) struct Normal {
    pub(super) matrix: DMatrix<f64>,
    pub(super) right: DVector<f64>,
    /// Weighted sum of squares of the data.
    pub(super) square: f64,
}

/// A minimiser.
#[derive(Debug, Clone)]
pub(super) struct Solved {
    /// Unknowns.
    pub(super) x: DVector<f64>,
    /// Sum of squares of data and priors.
    pub(super) cost: f64,
    /// Variance of each unknown.
    pub(super) variance: Vec<f64>,
    /// Unknowns that are not at their bound.
    above_zero: Vec<usize>,
}

/// Rows of equations, without the columns in which all are zero: data at one state touch few of the
/// unknowns.
pub(super) struct Rows {
    /// The other columns, rising.
    pub(super) columns: Vec<usize>,
    /// The rows in these columns.
    pub(super) of_columns: DMatrix<f64>,
}

impl Rows {
    pub(super) fn of(rows: &DMatrix<f64>) -> Self {
        let is_touched = |k: &usize| rows.column(*k).iter().any(|x| *x != 0.0);
        let columns: Vec<usize> = (0..rows.ncols()).filter(is_touched).collect();
        let of_columns = rows.select_columns(&columns);
        Self {
            columns,
            of_columns,
        }
    }

    /// Adds the product of the transposed rows and the rows to a matrix of all unknowns.
    pub(super) fn add_square_to(&self, matrix: &mut DMatrix<f64>) {
        let square = self.of_columns.tr_mul(&self.of_columns);
        for (j, column) in self.columns.iter().enumerate() {
            for (i, row) in self.columns.iter().enumerate() {
                matrix[(*row, *column)] += square[(i, j)];
            }
        }
    }

    /// Returns X·M·Xᵀ of the rows X and a matrix of all unknowns.
    pub(super) fn around(&self, matrix: &DMatrix<f64>) -> DMatrix<f64> {
        let part = matrix
            .select_columns(&self.columns)
            .select_rows(&self.columns);
        &self.of_columns * part * self.of_columns.transpose()
    }

    /// Returns M·Xᵀ of the rows X and a matrix of all unknowns.
    pub(super) fn after(&self, matrix: &DMatrix<f64>) -> DMatrix<f64> {
        matrix.select_columns(&self.columns) * self.of_columns.transpose()
    }
}

impl Normal {
    pub(super) fn new(count: usize) -> Self {
        Self {
            matrix: DMatrix::zeros(count, count),
            right: DVector::zeros(count),
            square: 0.0,
        }
    }

    /// Adds rows, one per row of `a`.
    pub(super) fn add(&mut self, a: &DMatrix<f64>, y: &DVector<f64>) {
        let rows = Rows::of(a);
        rows.add_square_to(&mut self.matrix);
        for (place, column) in rows.columns.iter().enumerate() {
            self.right[*column] += rows.of_columns.column(place).dot(y);
        }
        self.square += y.norm_squared();
    }

    /// Returns the covariance of the unknowns; `None` if the rows and priors leave one open.
    pub(super) fn covariance(&self) -> Option<DMatrix<f64>> {
        let n = self.right.len();
        let unit = DVector::from_fn(n, |k, _| self.matrix[(k, k)].max(1e-300).sqrt().recip());
        let scaled = DMatrix::from_fn(n, n, |i, j| self.matrix[(i, j)] * unit[i] * unit[j]);
        let inverse = nalgebra::Cholesky::new(scaled)?.inverse();
        Some(DMatrix::from_fn(n, n, |i, j| {
            inverse[(i, j)] * unit[i] * unit[j]
        }))
    }

    /// Removes the rows that have been added to another set of equations.
    pub(super) fn remove(&mut self, other: &Self) {
        self.matrix -= &other.matrix;
        self.right -= &other.right;
        self.square -= other.square;
    }

    /// Adds the prior that a weighted sum of unknowns is zero.
    pub(super) fn expect_zero(&mut self, terms: &[(usize, f64)]) {
        for (i, a) in terms {
            for (j, b) in terms {
                self.matrix[(*i, *j)] += a * b;
            }
        }
    }

    /// Minimises; unknowns from `free` on have no bound. `guess` is a solution of nearly the same
    /// equations.
    pub(super) fn solve(&self, free: usize, guess: Option<&Solved>) -> Result<Solved, MapFitError> {
        let singular = || MapFitError::Singular("too few different states in the logs");
        let n = self.right.len();
        let unit = DVector::from_fn(n, |k, _| self.matrix[(k, k)].max(1e-300).sqrt().recip());
        let scaled = DMatrix::from_fn(n, n, |i, j| self.matrix[(i, j)] * unit[i] * unit[j]);
        let shift = DVector::from_fn(n, |k, _| if k < free { 0.0 } else { SHIFT / unit[k] });
        let right = self.right.component_mul(&unit) + &scaled * &shift;
        let guess: Vec<usize> =
            guess.map_or_else(|| (0..n).collect(), |solved| solved.above_zero.clone());
        let solution = nonnegative::solve(&scaled, &right, &guess).ok_or_else(singular)?;
        let x = (&solution.x - &shift).component_mul(&unit);
        let inverse = solution.factor.inverse();
        // At its bound an unknown is as uncertain as with all others held.
        let mut variance: Vec<f64> = unit.iter().map(|u| u * u).collect();
        for (place, k) in solution.free.iter().enumerate() {
            variance[*k] = inverse[(place, place)] * unit[*k] * unit[*k];
        }
        let cost = self.square - 2.0 * self.right.dot(&x) + x.dot(&(&self.matrix * &x));
        Ok(Solved {
            x,
            cost,
            variance,
            above_zero: solution.free,
        })
    }
}
