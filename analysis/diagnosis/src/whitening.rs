//! Covariances of a block's rows, and the triangular matrix that whitens them.

use analysis_numeric::linalg::cholesky;

/// L⁻¹ of a covariance C = L·Lᵀ, by columns.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Whitener {
    n: usize,
    /// Column j holds rows j… of L⁻¹, one after the other.
    columns: Vec<f64>,
}

impl Whitener {
    /// Of a symmetric positive definite covariance, row-major; none for any other matrix.
    pub(super) fn new(mut covariance: Vec<f64>, n: usize) -> Option<Self> {
        if !cholesky(&mut covariance, n) {
            return None;
        }
        let l = covariance;
        let mut columns = Vec::with_capacity(n * (n + 1) / 2);
        let mut column = vec![0.0; n];
        for j in 0..n {
            column[j] = 1.0 / l[j * n + j];
            for i in j + 1..n {
                let dot: f64 = dot(&l[i * n + j..i * n + i], &column[j..i]);
                column[i] = -dot / l[i * n + i];
            }
            columns.extend_from_slice(&column[j..]);
        }
        Some(Self { n, columns })
    }

    /// Appends L⁻¹·v to `out`.
    pub(super) fn apply(&self, v: &[f64], out: &mut Vec<f64>) {
        let first = out.len();
        out.resize(first + self.n, 0.0);
        let target = &mut out[first..];
        let mut at = 0;
        for (j, x) in v.iter().enumerate().take(self.n) {
            let column = &self.columns[at..at + self.n - j];
            target[j..]
                .iter_mut()
                .zip(column)
                .for_each(|(t, c)| *t += c * x);
            at += self.n - j;
        }
    }

    /// L⁻¹·M·L⁻ᵀ for a symmetric matrix of which the lower triangle is given, row-major, whole;
    /// empty for an empty one.
    pub(super) fn whitened(&self, lower: &[f64]) -> Vec<f64> {
        if lower.is_empty() {
            return Vec::new();
        }
        let n = self.n;
        let half: Vec<Vec<f64>> = (0..n)
            .map(|i| {
                let row = (0..n).map(|j| lower[i.max(j) * n + i.min(j)]);
                let mut out = Vec::with_capacity(n);
                self.apply(&row.collect::<Vec<f64>>(), &mut out);
                out
            })
            .collect();
        let mut whole = Vec::with_capacity(n * n);
        for j in 0..n {
            let column: Vec<f64> = half.iter().map(|row| row[j]).collect();
            self.apply(&column, &mut whole);
        }
        whole
    }

    /// Replaces w by L⁻ᵀ·w, so that both together give C⁻¹·v.
    pub(super) fn apply_transposed(&self, w: &mut [f64]) {
        let mut at = 0;
        for j in 0..self.n {
            let column = &self.columns[at..at + self.n - j];
            w[j] = dot(column, &w[j..]);
            at += self.n - j;
        }
    }

    /// vᵀ·C·v: the variance of the sum of the rows with these weights, |Lᵀ·v|².
    pub(super) fn variance(&self, v: &[f64]) -> f64 {
        let mut y = v.to_vec();
        let mut at = self.columns.len();
        for j in (0..self.n).rev() {
            at -= self.n - j;
            let column = &self.columns[at..at + self.n - j];
            y[j] = (v[j] - dot(&column[1..], &y[j + 1..])) / column[0];
        }
        dot(&y, &y)
    }

    /// C⁻¹·v.
    pub(super) fn solve(&self, v: &[f64]) -> Vec<f64> {
        let mut w = Vec::with_capacity(self.n);
        self.apply(v, &mut w);
        self.apply_transposed(&mut w);
        w
    }

    /// Σᵢ gᵢ(C⁻¹)ᵢᵢ.
    pub(super) fn trace_with_diagonal(&self, g: &[f64]) -> f64 {
        let mut at = 0;
        let mut sum = 0.0;
        for (j, g) in g.iter().enumerate().take(self.n) {
            let column = &self.columns[at..at + self.n - j];
            // (C⁻¹)ⱼⱼ = Σᵢ (L⁻¹)ᵢⱼ².
            sum += g * dot(column, column);
            at += self.n - j;
        }
        sum
    }

    /// C⁻¹ as a full matrix, row-major.
    pub(super) fn inverse(&self) -> Vec<f64> {
        let n = self.n;
        let starts: Vec<usize> = (0..n)
            .scan(0, |at, j| Some(std::mem::replace(at, *at + n - j)))
            .collect();
        let mut inverse = vec![0.0; n * n];
        for i in 0..n {
            let a = &self.columns[starts[i]..starts[i] + n - i];
            for j in 0..=i {
                let b = &self.columns[starts[j] + i - j..starts[j] + n - j];
                let value = dot(a, b);
                inverse[i * n + j] = value;
                inverse[j * n + i] = value;
            }
        }
        inverse
    }
}

/// Scalar product in four independent sums, which a compiler can keep in one register.
pub(super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut sums = [0.0; 4];
    let (a4, b4) = (a.chunks_exact(4), b.chunks_exact(4));
    let rest: f64 = a4
        .remainder()
        .iter()
        .zip(b4.remainder())
        .map(|(x, y)| x * y)
        .sum();
    for (x, y) in a4.zip(b4) {
        for k in 0..4 {
            sums[k] += x[k] * y[k];
        }
    }
    rest + (sums[0] + sums[1]) + (sums[2] + sums[3])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whitens_inverts_and_traces() {
        let n = 9;
        let c: Vec<f64> = (0..n * n)
            .map(|ij| {
                let (i, j) = ((ij / n) as f64, (ij % n) as f64);
                (-(i - j).abs() / 3.0).exp() + if i == j { 0.3 + 0.1 * i } else { 0.0 }
            })
            .collect();
        let w = Whitener::new(c.clone(), n).unwrap();
        let v: Vec<f64> = (0..n).map(|k| (k as f64).sin()).collect();
        let x = w.solve(&v);
        for i in 0..n {
            let back: f64 = (0..n).map(|j| c[i * n + j] * x[j]).sum();
            assert!((back - v[i]).abs() < 1e-12);
        }
        let vcv: f64 = (0..n * n).map(|ij| v[ij / n] * c[ij] * v[ij % n]).sum();
        assert!((w.variance(&v) / vcv - 1.0).abs() < 1e-12);
        let inverse = w.inverse();
        let trace: f64 = (0..n).map(|i| (i as f64) * inverse[i * n + i]).sum();
        let g: Vec<f64> = (0..n).map(|i| i as f64).collect();
        assert!((trace - w.trace_with_diagonal(&g)).abs() < 1e-12);
        assert!((0..n).all(
            |i| ((0..n).map(|j| inverse[i * n + j] * v[j]).sum::<f64>() - x[i]).abs() < 1e-12
        ));
        let lower: Vec<f64> = (0..n * n)
            .map(|ij| if ij / n >= ij % n { c[ij] } else { f64::NAN })
            .collect();
        for (ij, k) in w.whitened(&lower).into_iter().enumerate() {
            let identity = f64::from(ij / n == ij % n);
            assert!((k - identity).abs() < 1e-12, "{ij}: {k}");
        }
        assert!(Whitener::new(vec![1.0, 2.0, 2.0, 1.0], 2).is_none());
    }
}
