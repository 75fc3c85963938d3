//! Dense symmetric systems of a few unknowns, row-major: Cholesky, inverse, and the quadratic with
//! box bounds. No pivoting, no big matrices.

/// Replaces the lower triangle of the n×n matrix `a` by its Cholesky factor; false when `a` is not
/// positive definite.
pub fn cholesky(a: &mut [f64], n: usize) -> bool {
    for i in 0..n {
        for j in 0..=i {
            let dot: f64 = (0..j).map(|k| a[i * n + k] * a[j * n + k]).sum();
            let s = a[i * n + j] - dot;
            if i == j {
                // Rounding leaves a singular matrix with a tiny pivot of any sign.
                if !(s > 1e-14 * a[i * n + i].abs() && s.is_finite()) {
                    return false;
                }
                a[i * n + i] = s.sqrt();
            } else {
                a[i * n + j] = s / a[j * n + j];
            }
        }
    }
    true
}

/// Solves L·Lᵀ·x = b in place for a factor made by [`cholesky`].
pub fn cholesky_substitute(l: &[f64], n: usize, b: &mut [f64]) {
    for i in 0..n {
        let dot: f64 = (0..i).map(|k| l[i * n + k] * b[k]).sum();
        b[i] = (b[i] - dot) / l[i * n + i];
    }
    for i in (0..n).rev() {
        let dot: f64 = (i + 1..n).map(|k| l[k * n + i] * b[k]).sum();
        b[i] = (b[i] - dot) / l[i * n + i];
    }
}

/// a·b of square matrices, row-major.
pub fn product(a: &[f64], b: &[f64], n: usize) -> Vec<f64> {
    let mut product = vec![0.0; n * n];
    for (row, out) in a
        .chunks_exact(n.max(1))
        .zip(product.chunks_exact_mut(n.max(1)))
    {
        for (a, b) in row.iter().zip(b.chunks_exact(n.max(1))) {
            out.iter_mut().zip(b).for_each(|(o, b)| *o += a * b);
        }
    }
    product
}

/// Returns the inverse of a symmetric positive definite matrix, or `None` if it is not. It is
/// scaled by its diagonal first, so that units do not matter.
pub fn invert(a: &[f64], n: usize) -> Option<Vec<f64>> {
    let scale: Vec<f64> = (0..n).map(|i| a[i * n + i].sqrt()).collect();
    if scale.iter().any(|s| !(s.is_finite() && *s > 0.0)) {
        return None;
    }
    let mut l: Vec<f64> = (0..n * n)
        .map(|ij| a[ij] / (scale[ij / n] * scale[ij % n]))
        .collect();
    if !cholesky(&mut l, n) {
        return None;
    }
    let mut inverse = vec![0.0; n * n];
    let mut column = vec![0.0; n];
    for j in 0..n {
        column.fill(0.0);
        column[j] = 1.0;
        cholesky_substitute(&l, n, &mut column);
        for i in 0..n {
            inverse[i * n + j] = column[i] / (scale[i] * scale[j]);
        }
    }
    Some(inverse)
}

/// Largest number of unknowns of [`BoxQuadratic`].
pub const MAX_UNKNOWNS: usize = 9;

/// Minimises ½xᵀQx − cᵀx over lo ≤ x ≤ hi by an active set; everything is on the stack, because it
/// runs thousands of times in a fit.
#[derive(Debug, Clone)]
pub struct BoxQuadratic {
    /// Number of unknowns in use, at most [`MAX_UNKNOWNS`].
    pub n: usize,
    /// Q, both triangles filled.
    pub q: [[f64; MAX_UNKNOWNS]; MAX_UNKNOWNS],
    /// c.
    pub c: [f64; MAX_UNKNOWNS],
    /// Lower bounds.
    pub lo: [f64; MAX_UNKNOWNS],
    /// Upper bounds.
    pub hi: [f64; MAX_UNKNOWNS],
}

impl BoxQuadratic {
    /// Creates a problem of n unknowns, all zero.
    pub fn new(n: usize) -> Self {
        let zero = [0.0; MAX_UNKNOWNS];
        Self {
            n: n.min(MAX_UNKNOWNS),
            q: [zero; MAX_UNKNOWNS],
            c: zero,
            lo: zero,
            hi: zero,
        }
    }

    /// Returns the minimiser, feasible always, exact up to the ridge that keeps equal columns
    /// solvable.
    pub fn solve(&self) -> [f64; MAX_UNKNOWNS] {
        let n = self.n;
        let mut free = [true; MAX_UNKNOWNS];
        let mut x = self.solve_free(&free, &[0.0; MAX_UNKNOWNS]);
        for i in 0..n {
            let clamped = x[i].max(self.lo[i]).min(self.hi[i]);
            // The first guess of the active set: the bounds that the unbounded solution violates.
            free[i] = clamped == x[i];
            x[i] = clamped;
        }
        if free[..n].iter().all(|f| *f) {
            return x;
        }
        for _ in 0..4 * n {
            let target = self.solve_free(&free, &x);
            if let Some((i, step)) = self.blocking(&x, &target, &free) {
                for k in 0..n {
                    x[k] += step * (target[k] - x[k]);
                }
                x[i] = if target[i] > x[i] {
                    self.hi[i]
                } else {
                    self.lo[i]
                };
                free[i] = false;
                continue;
            }
            x = target;
            match self.most_wrong(&x, &free) {
                Some(i) => free[i] = true,
                None => break,
            }
        }
        x
    }

    /// Solution over the free unknowns with the others held at `at`.
    fn solve_free(
        &self,
        free: &[bool; MAX_UNKNOWNS],
        at: &[f64; MAX_UNKNOWNS],
    ) -> [f64; MAX_UNKNOWNS] {
        let n = self.n;
        let mut index = [0; MAX_UNKNOWNS];
        let mut m = 0;
        for (i, _) in free.iter().enumerate().take(n).filter(|(_, f)| **f) {
            index[m] = i;
            m += 1;
        }
        let mut a = [0.0; MAX_UNKNOWNS * MAX_UNKNOWNS];
        let mut b = [0.0; MAX_UNKNOWNS];
        for (row, &i) in index[..m].iter().enumerate() {
            let held: f64 = (0..n)
                .filter(|k| !free[*k])
                .map(|k| self.q[i][k] * at[k])
                .sum();
            b[row] = self.c[i] - held;
            for (column, &j) in index[..m].iter().enumerate() {
                a[row * m + column] = self.q[i][j];
            }
            a[row * m + row] *= 1.0 + 1e-11;
        }
        let mut x = *at;
        if cholesky(&mut a[..m * m], m) {
            cholesky_substitute(&a[..m * m], m, &mut b);
            for (row, &i) in index[..m].iter().enumerate() {
                x[i] = b[row];
            }
        }
        x
    }

    /// Returns the first bound met on the way from a feasible x to the target, with the fraction of
    /// the way.
    fn blocking(
        &self,
        x: &[f64; MAX_UNKNOWNS],
        target: &[f64; MAX_UNKNOWNS],
        free: &[bool; MAX_UNKNOWNS],
    ) -> Option<(usize, f64)> {
        let mut first = None;
        let mut shortest = 1.0;
        for i in (0..self.n).filter(|i| free[*i]) {
            let bound = if target[i] > self.hi[i] {
                self.hi[i]
            } else if target[i] < self.lo[i] {
                self.lo[i]
            } else {
                continue;
            };
            let step = ((bound - x[i]) / (target[i] - x[i])).clamp(0.0, 1.0);
            if first.is_none() || step < shortest {
                first = Some((i, step));
                shortest = step;
            }
        }
        first
    }

    /// Returns the bound unknown with the largest gradient away from its bound.
    fn most_wrong(&self, x: &[f64; MAX_UNKNOWNS], free: &[bool; MAX_UNKNOWNS]) -> Option<usize> {
        let mut worst = None;
        let mut largest = 0.0;
        for i in (0..self.n).filter(|i| !free[*i]) {
            let gradient: f64 = (0..self.n).map(|k| self.q[i][k] * x[k]).sum::<f64>() - self.c[i];
            let inward = if x[i] <= self.lo[i] {
                -gradient
            } else {
                gradient
            };
            let noise = 1e-9 * (self.c[i].abs() + self.q[i][i] * x[i].abs());
            if self.lo[i] < self.hi[i] && inward > noise && inward > largest {
                largest = inward;
                worst = Some(i);
            }
        }
        worst
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn inverse_times_matrix_is_one() {
        let a = [4.0, 2.0, 0.6, 2.0, 5.0, 1.0, 0.6, 1.0, 3.0];
        let b = invert(&a, 3).unwrap();
        for i in 0..3 {
            for j in 0..3 {
                let s: f64 = (0..3).map(|k| a[i * 3 + k] * b[k * 3 + j]).sum();
                assert!((s - f64::from(i == j)).abs() < 1e-12);
            }
        }
        assert!(invert(&[1.0, 1.0, 1.0, 1.0], 2).is_none(), "singular");
        assert!(invert(&[-1.0], 1).is_none());
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(300))]

        #[test]
        fn box_quadratic_meets_the_optimality_conditions(
            rows in prop::collection::vec(prop::array::uniform5(-1.0..1.0f64), 7),
            c in prop::array::uniform5(-2.0..2.0f64),
        ) {
            let mut problem = BoxQuadratic::new(5);
            for i in 0..5 {
                for j in 0..5 {
                    problem.q[i][j] =
                        rows.iter().map(|r| r[i] * r[j]).sum::<f64>() + f64::from(i == j) * 1e-3;
                }
                problem.c[i] = c[i];
                problem.hi[i] = 0.5;
            }
            let x = problem.solve();
            for i in 0..5 {
                let gradient: f64 = (0..5).map(|k| problem.q[i][k] * x[k]).sum::<f64>() - c[i];
                prop_assert!((0.0..=0.5).contains(&x[i]));
                prop_assert!(
                    gradient < 1e-5 || x[i] == 0.0,
                    "x{} = {} wants down: {}",
                    i,
                    x[i],
                    gradient
                );
                prop_assert!(
                    gradient > -1e-5 || x[i] == 0.5,
                    "x{} = {} wants up: {}",
                    i,
                    x[i],
                    gradient
                );
            }
        }
    }
}
