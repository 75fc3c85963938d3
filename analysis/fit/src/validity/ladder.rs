//! The ladder of the linear Kramers–Kronig test: R, L and C in series with RC elements of fixed
//! time constants and free resistances of either sign, fitted by weighted linear least squares
//! (Boukamp, J. Electrochem. Soc. 142 (1995) 1885).
//!
//! Solved by modified Gram–Schmidt, which gives the leverage of every point along with the
//! residual, on the machine's widest vectors but without fused operations, so that the digits are
//! everywhere the same. All memory is taken once; the orders that are tried share the columns that
//! they have in common. Knows no verdict.

use num_complex::Complex64;
use std::ops::{Range, RangeInclusive};

/// Series elements before the RC ladder: R, L, C.
pub(super) const SERIES: usize = 3;

/// Whitening of a point: turns its impedance into two numbers of variance one, a·Re and b·Re +
/// c·Im.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Whitening {
    pub(crate) a: f64,
    pub(crate) b: f64,
    pub(crate) c: f64,
}

impl Whitening {
    /// Leaves a point out.
    pub(super) const NONE: Self = Self {
        a: 0.0,
        b: 0.0,
        c: 0.0,
    };
}

/// A least-squares problem over one set of frequencies, and its last solution.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Ladder {
    points: usize,
    /// Length of a column: both parts of all points, one row per RC element that holds it near
    /// zero, filled up so that loops need no rest.
    rows: usize,
    /// Inverse of the size that a resistance is expected to have, 1/Ω.
    restraint_per_ohm: f64,
    omega: Vec<f64>,
    whiten: Vec<Whitening>,
    tau_range_s: RangeInclusive<f64>,
    /// Orthonormal columns, one after the other.
    q: Vec<f64>,
    /// Upper triangle, column after column, each of the full width.
    r: Vec<f64>,
    /// Squared length of each column before it was made orthogonal.
    sizes: Vec<f64>,
    projections: Vec<f64>,
    residual: Vec<f64>,
    /// Residual after the columns that all orders share.
    shared_residual: Vec<f64>,
    coefficients: Vec<f64>,
    columns: usize,
    width: usize,
}

impl Ladder {
    /// A ladder over angular frequencies in rad/s, with time constants between the two ends in s
    /// and room for `most` RC elements.
    pub(super) fn new(omega: Vec<f64>, tau_range_s: RangeInclusive<f64>, most: usize) -> Self {
        let points = omega.len();
        let most = most.max(2);
        let rows = (2 * points + most).next_multiple_of(LANES);
        let width = SERIES + most;
        Self {
            points,
            rows,
            restraint_per_ohm: 0.0,
            whiten: vec![Whitening::NONE; points],
            omega,
            tau_range_s,
            q: vec![0.0; rows * width],
            r: vec![0.0; width * width],
            sizes: vec![0.0; width],
            projections: vec![0.0; width],
            residual: vec![0.0; rows],
            shared_residual: vec![0.0; rows],
            coefficients: vec![0.0; width],
            columns: 0,
            width,
        }
    }

    /// Sets the data and their weights, and prepares what all orders share. Without the restraint a
    /// resistance has no limit: near the ends of the band pairs of huge opposite resistances would
    /// then describe responses that no passive system has.
    pub(super) fn load(
        &mut self,
        z_ohm: &[Complex64],
        whiten: &[Whitening],
        restraint_per_ohm: f64,
    ) {
        self.whiten.copy_from_slice(whiten);
        self.restraint_per_ohm = restraint_per_ohm;
        self.residual.fill(0.0);
        let (re, im) = self.residual.split_at_mut(self.points);
        for (k, (z, w)) in z_ohm.iter().zip(whiten).enumerate() {
            re[k] = w.a * z.re;
            im[k] = w.b * z.re + w.c * z.im;
        }
        pulp::Arch::new().dispatch(Shared(self));
    }

    /// Solves with `order` RC elements, at least two.
    pub(super) fn solve(&mut self, order: usize) {
        pulp::Arch::new().dispatch(Whole(self, order.min(self.width - SERIES)));
    }

    /// Makes the columns that all orders share orthonormal, and subtracts their part from the
    /// residual.
    #[inline(always)]
    fn prepare(&mut self) {
        self.write(0, |_| (1.0, 0.0));
        self.write(1, |omega| (0.0, omega));
        self.write(2, |omega| (0.0, -1.0 / omega));
        self.write_rc(3, *self.tau_range_s.start());
        self.write_rc(4, *self.tau_range_s.end());
        for k in 0..SHARED {
            self.finish(k);
            self.take_out(k, k + 1..SHARED);
        }
        self.shared_residual.copy_from_slice(&self.residual);
    }

    #[inline(always)]
    fn solve_whole(&mut self, order: usize) {
        self.residual.copy_from_slice(&self.shared_residual);
        self.columns = SERIES + order;
        let (first, last) = (*self.tau_range_s.start(), *self.tau_range_s.end());
        let step = (last / first).powf(1.0 / (order as f64 - 1.0));
        let mut tau_s = first;
        for column in SHARED..self.columns {
            tau_s *= step;
            self.write_rc(column, tau_s);
        }
        for k in 0..self.columns {
            if k >= SHARED {
                self.finish(k);
            }
            self.take_out(k, SHARED.max(k + 1)..self.columns);
        }
    }

    #[inline(always)]
    fn write_rc(&mut self, column: usize, tau_s: f64) {
        self.write(column, |omega| {
            let x = omega * tau_s;
            let re = 1.0 / (1.0 + x * x);
            (re, -x * re)
        });
    }

    /// Writes an element's column, weighted, with its row that holds it near zero.
    #[inline(always)]
    fn write(&mut self, index: usize, element: impl Fn(f64) -> (f64, f64)) {
        let column = &mut self.q[index * self.rows..(index + 1) * self.rows];
        let (upper, lower) = column.split_at_mut(self.points);
        for (((omega, w), upper), lower) in self
            .omega
            .iter()
            .zip(&self.whiten)
            .zip(upper)
            .zip(&mut *lower)
        {
            let (re, im) = element(*omega);
            *upper = w.a * re;
            *lower = w.b * re + w.c * im;
        }
        lower[self.points..].fill(0.0);
        if index >= SERIES {
            lower[self.points + index - SERIES] = self.restraint_per_ohm;
        }
        self.sizes[index] = dot(column, column);
    }

    /// Normalises a column that is orthogonal to those before, and subtracts its part from the
    /// residual.
    #[inline(always)]
    fn finish(&mut self, index: usize) {
        let column = &mut self.q[index * self.rows..(index + 1) * self.rows];
        let left = dot(column, column);
        // A column that the columns before can make already adds nothing but rounding.
        let norm = if left > DEPENDENT * self.sizes[index] {
            left.sqrt()
        } else {
            f64::INFINITY
        };
        let inverse = 1.0 / norm;
        column.iter_mut().for_each(|v| *v *= inverse);
        self.r[index * self.width + index] = norm;
        let projection = dot(column, &self.residual);
        subtract(&mut self.residual, projection, column);
        self.projections[index] = projection;
    }

    /// Subtracts a finished column's part from those of a range after it. They do not depend on
    /// each other, so that the loop can be vectorised.
    #[inline(always)]
    fn take_out(&mut self, index: usize, range: Range<usize>) {
        // Further rows are zero: those that hold later elements near zero.
        let length = (2 * self.points + (index + 1).saturating_sub(SERIES))
            .next_multiple_of(LANES)
            .min(self.rows);
        let (before, after) = self.q.split_at_mut(range.start * self.rows);
        let finished = &before[index * self.rows..][..length];
        for (column, j) in after.chunks_exact_mut(self.rows).zip(range) {
            let column = &mut column[..length];
            let projection = dot(finished, column);
            subtract(column, projection, finished);
            self.r[j * self.width + index] = projection;
        }
    }

    /// Weighted sum of the points' squared residuals.
    pub(super) fn chi2(&self) -> f64 {
        self.residual[..2 * self.points].iter().map(|r| r * r).sum()
    }

    /// The resistances' balance 1 − Σ|R<0|/ΣR>0 of Schönleber, Klotz and Ivers-Tiffée (2014): near
    /// 1 below, near 0 beyond the right order.
    pub(super) fn mu(&mut self) -> f64 {
        self.back_substitute();
        let (mut negative, mut positive) = (0.0, 0.0);
        for r in &self.coefficients[SERIES..self.columns] {
            if *r < 0.0 {
                negative -= r;
            } else {
                positive += r;
            }
        }
        if positive > 0.0 {
            1.0 - negative / positive
        } else {
            0.0
        }
    }

    fn back_substitute(&mut self) {
        let n = self.columns;
        self.coefficients[..n].copy_from_slice(&self.projections[..n]);
        for j in (0..n).rev() {
            let norm = self.r[j * self.width + j];
            let x = if norm.is_finite() {
                self.coefficients[j] / norm
            } else {
                0.0
            };
            self.coefficients[j] = x;
            for k in 0..j {
                self.coefficients[k] -= x * self.r[j * self.width + k];
            }
        }
    }

    /// Whitened residual of a point.
    pub(super) fn residual(&self, point: usize) -> (f64, f64) {
        (self.residual[point], self.residual[self.points + point])
    }

    /// The points' own blocks (h₁₁, h₁₂, h₂₂) of the hat matrix: how much of a point's noise the
    /// ladder follows.
    pub(super) fn leverage(&self, into: &mut Vec<(f64, f64, f64)>) {
        into.clear();
        into.resize(self.points, (0.0, 0.0, 0.0));
        for column in self.q.chunks_exact(self.rows).take(self.columns) {
            let (upper, lower) = column.split_at(self.points);
            for ((h, u), l) in into.iter_mut().zip(upper).zip(lower) {
                h.0 += u * u;
                h.1 += u * l;
                h.2 += l * l;
            }
        }
    }

    /// Impedance of a column's element, of unit size, at angular frequency `omega`.
    fn element(&self, column: usize, order: usize, omega: f64) -> Complex64 {
        let (first, last) = (*self.tau_range_s.start(), *self.tau_range_s.end());
        let step = (last / first).powf(1.0 / (order as f64 - 1.0));
        let tau_s = match column {
            0 => return Complex64::new(1.0, 0.0),
            1 => return Complex64::new(0.0, omega),
            2 => return Complex64::new(0.0, -1.0 / omega),
            3 => first,
            4 => last,
            inner => first * step.powf((inner - SERIES - 1) as f64),
        };
        Complex64::new(1.0, omega * tau_s).inv()
    }

    /// Variance that a linear function of the whitened residuals has, given its weights for the
    /// first and the second row of every point.
    pub(super) fn variance(&self, weights: &[f64]) -> f64 {
        let own: f64 = weights.iter().map(|w| w * w).sum();
        let shares = self
            .q
            .chunks_exact(self.rows)
            .take(self.columns)
            .map(|q| q.iter().zip(weights).map(|(q, w)| q * w).sum::<f64>());
        (own - shares.map(|s| s * s).sum::<f64>()).max(0.0)
    }

    /// The weight of every point.
    pub(super) fn whitening(&self) -> &[Whitening] {
        &self.whiten
    }

    /// The fitted impedance of every point, whether it was left out or not, Ω.
    pub(super) fn impedance(&mut self, order: usize) -> Vec<Complex64> {
        self.back_substitute();
        let at = |omega: &f64| {
            (0..self.columns)
                .map(|k| self.coefficients[k] * self.element(k, order, *omega))
                .sum()
        };
        self.omega.iter().map(at).collect()
    }

    /// Covariance (11, 12, 22) that the noise of the fitted points gives to the prediction of a
    /// point, in units of a whitening of that point.
    pub(super) fn prediction(&self, point: usize, order: usize, w: Whitening) -> (f64, f64, f64) {
        let mut solved: Vec<(f64, f64)> = Vec::with_capacity(self.columns);
        let mut covariance = (0.0, 0.0, 0.0);
        for j in 0..self.columns {
            let z = self.element(j, order, self.omega[point]);
            let mut x = (w.a * z.re, w.b * z.re + w.c * z.im);
            let column = &self.r[j * self.width..];
            for (k, u) in solved.iter().enumerate() {
                x = (x.0 - column[k] * u.0, x.1 - column[k] * u.1);
            }
            let norm = column[j];
            let u = if norm.is_finite() {
                (x.0 / norm, x.1 / norm)
            } else {
                (0.0, 0.0)
            };
            covariance = (
                covariance.0 + u.0 * u.0,
                covariance.1 + u.0 * u.1,
                covariance.2 + u.1 * u.1,
            );
            solved.push(u);
        }
        covariance
    }
}

/// [`Ladder::prepare`] as something to dispatch. A closure would not be inlined into the function
/// that has the machine's vectors.
struct Shared<'l>(&'l mut Ladder);

impl pulp::WithSimd for Shared<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        self.0.prepare();
    }
}

/// [`Ladder::solve_whole`] with its order.
struct Whole<'l>(&'l mut Ladder, usize);

impl pulp::WithSimd for Whole<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        self.0.solve_whole(self.1);
    }
}

/// Columns that all orders share: the series elements and the outermost RC elements.
const SHARED: usize = SERIES + 2;
const LANES: usize = 8;
/// Squared share of a column that must be its own.
const DEPENDENT: f64 = 1e-18;

#[inline(always)]
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut sums = [0.0; LANES];
    for (a, b) in a
        .as_chunks::<LANES>()
        .0
        .iter()
        .zip(b.as_chunks::<LANES>().0)
    {
        for k in 0..LANES {
            sums[k] += a[k] * b[k];
        }
    }
    ((sums[0] + sums[4]) + (sums[1] + sums[5])) + ((sums[2] + sums[6]) + (sums[3] + sums[7]))
}

#[inline(always)]
fn subtract(from: &mut [f64], factor: f64, what: &[f64]) {
    for (from, what) in from.iter_mut().zip(what) {
        *from -= factor * what;
    }
}
