//! A polynomial through an OCV curve, with its error and the positions at which it falls, which no
//! OCV does.

use super::OcvCurve;
use analysis_numeric::linalg;
use serde::{Deserialize, Serialize};

/// Highest order; beyond it the powers of SOC lose too many significant digits.
pub const MAX_ORDER: usize = 15;
/// Points the curve is read at.
const GRID: usize = 2001;

/// OCV as a polynomial in SOC.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct OcvPolynomial {
    /// Order.
    pub order: usize,
    /// Coefficients of SOC⁰, SOC¹, …, V.
    pub coefficients_v: Vec<f64>,
    /// Root mean square of polynomial less curve over SOC, V.
    pub rms_v: f64,
    /// Largest difference, V.
    pub max_v: f64,
    /// SOC of the maximum.
    pub max_at_soc: f64,
    /// Ranges of SOC in which the polynomial falls; empty when it rises everywhere.
    pub falling_soc: Vec<(f64, f64)>,
}

impl OcvPolynomial {
    /// Returns the polynomial of least squares through a curve, or `None` for an order beyond
    /// 1…[`MAX_ORDER`].
    pub fn through(curve: &OcvCurve, order: usize) -> Option<Self> {
        if !(1..=MAX_ORDER).contains(&order) {
            return None;
        }
        let n = order + 1;
        let (mut gram, mut right) = (vec![0.0; n * n], vec![0.0; n]);
        for z in grid() {
            let t = chebyshev(2.0 * z - 1.0, n);
            let y = curve.voltage_v(z);
            for i in 0..n {
                right[i] += t[i] * y;
                for j in 0..n {
                    gram[i * n + j] += t[i] * t[j];
                }
            }
        }
        if !linalg::cholesky(&mut gram, n) {
            return None;
        }
        linalg::cholesky_substitute(&gram, n, &mut right);
        let mut polynomial = Self {
            order,
            coefficients_v: powers(&right),
            rms_v: 0.0,
            max_v: 0.0,
            max_at_soc: 0.0,
            falling_soc: Vec::new(),
        };
        polynomial.judge(curve);
        Some(polynomial)
    }

    /// OCV at a state of charge, V.
    pub fn voltage_v(&self, soc: f64) -> f64 {
        self.coefficients_v
            .iter()
            .rev()
            .fold(0.0, |v, c| v * soc + c)
    }

    /// dOCV/dSOC at a state of charge, V.
    pub fn slope_v(&self, soc: f64) -> f64 {
        self.coefficients_v
            .iter()
            .enumerate()
            .skip(1)
            .rev()
            .fold(0.0, |v, (k, c)| v * soc + k as f64 * c)
    }

    /// Returns the sentence on its monotony.
    pub fn statement(&self) -> String {
        let at = |(a, b): &(f64, f64)| format!("{a:.3}–{b:.3}");
        if self.falling_soc.is_empty() {
            return format!(
                "the polynomial of order {} rises everywhere between SOC 0 and 1",
                self.order
            );
        }
        let ranges: Vec<String> = self.falling_soc.iter().map(at).collect();
        format!(
            "the polynomial of order {} falls at SOC {}: it has no inverse there and a battery \
            would charge itself",
            self.order,
            ranges.join(", ")
        )
    }

    fn judge(&mut self, curve: &OcvCurve) {
        let mut square = 0.0;
        let mut since = None;
        for z in grid() {
            let error = self.voltage_v(z) - curve.voltage_v(z);
            square += error * error;
            if error.abs() > self.max_v {
                (self.max_v, self.max_at_soc) = (error.abs(), z);
            }
            match (self.slope_v(z) < 0.0, since) {
                (true, None) => since = Some(z),
                (false, Some(start)) => {
                    self.falling_soc.push((start, z));
                    since = None;
                }
                _ => {}
            }
        }
        self.falling_soc.extend(since.map(|start| (start, 1.0)));
        self.rms_v = (square / GRID as f64).sqrt();
    }
}

fn grid() -> impl Iterator<Item = f64> {
    (0..GRID).map(|k| k as f64 / (GRID - 1) as f64)
}

/// T₀(u)…Tₙ₋₁(u).
fn chebyshev(u: f64, n: usize) -> Vec<f64> {
    let mut t = vec![1.0, u];
    while t.len() < n {
        t.push(2.0 * u * t[t.len() - 1] - t[t.len() - 2]);
    }
    t
}

/// Coefficients of the powers of z of Σ cₖTₖ(2z − 1).
fn powers(c: &[f64]) -> Vec<f64> {
    let n = c.len();
    let mut older = vec![0.0; n];
    let mut newer = vec![0.0; n];
    older[0] = 1.0;
    newer[0] = -1.0;
    newer[1] = 2.0;
    let mut sum: Vec<f64> = (0..n).map(|i| c[0] * older[i] + c[1] * newer[i]).collect();
    for ck in &c[2..] {
        let shifted = |i: usize| if i == 0 { 0.0 } else { newer[i - 1] };
        let next: Vec<f64> = (0..n)
            .map(|i| 4.0 * shifted(i) - 2.0 * newer[i] - older[i])
            .collect();
        sum.iter_mut().zip(&next).for_each(|(s, t)| *s += ck * t);
        older = std::mem::replace(&mut newer, next);
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_curve_that_is_a_cubic_comes_back_with_its_coefficients() {
        let truth = |z: f64| 3.0 + 0.9 * z - 0.5 * z * z + 0.4 * z * z * z;
        let soc: Vec<f64> = (0..=400).map(|k| f64::from(k) / 400.0).collect();
        let curve =
            OcvCurve::monotone(4.0, soc.clone(), soc.iter().map(|z| truth(*z)).collect()).unwrap();
        let p = OcvPolynomial::through(&curve, 5).unwrap();
        for (met, expected) in p.coefficients_v.iter().zip([3.0, 0.9, -0.5, 0.4, 0.0, 0.0]) {
            assert!((met - expected).abs() < 2e-4, "{:?}", p.coefficients_v);
        }
        assert!(p.max_v < 1e-5 && p.falling_soc.is_empty());
        assert_eq!(
            p.statement(),
            "the polynomial of order 5 rises everywhere between SOC 0 and 1"
        );
        assert!(
            OcvPolynomial::through(&curve, 0).is_none()
                && OcvPolynomial::through(&curve, 16).is_none()
        );
    }

    #[test]
    fn says_where_it_falls() {
        // A step: any polynomial of moderate order rings beside it.
        let curve = OcvCurve::monotone(4.0, vec![0.0, 0.48, 0.52, 1.0], vec![3.0, 3.01, 3.99, 4.0])
            .unwrap();
        let p = OcvPolynomial::through(&curve, 9).unwrap();
        assert!(!p.falling_soc.is_empty());
        for k in 0..=1000 {
            let z = f64::from(k) / 1000.0;
            let falls = p.voltage_v(z + 1e-5) < p.voltage_v(z - 1e-5);
            let stated = p.falling_soc.iter().any(|(a, b)| (*a..=*b).contains(&z));
            let near_edge = p
                .falling_soc
                .iter()
                .any(|(a, b)| (z - a).abs() < 1.1e-3 || (z - b).abs() < 1.1e-3);
            assert!(
                falls == stated || near_edge,
                "SOC {z}: falls {falls}, said {stated}"
            );
        }
        assert!(p.statement().contains("falls at SOC"));
    }
}
