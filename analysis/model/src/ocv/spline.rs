//! A smooth rising curve through many noisy points. It is a cubic B-spline with a penalty on the
//! third differences of its coefficients (P-spline, Eilers and Marx, 1996). The weight of the
//! penalty comes from generalised cross-validation (Craven and Wahba, 1978). The coefficients are
//! made to rise: falling neighbours are pulled together until none falls (asymmetric penalty,
//! Bollaerts et al., 2006).
//!
//! Uniform knots on 0…1; all matrices are banded, so that thirty thousand points cost milliseconds.

/// Half width of the band: a cubic spline overlaps three neighbours, and the penalty reaches no
/// further.
const BAND: usize = 3;
/// Weight that pulls falling coefficients together, relative to the mean weight of the data.
const PULL: f64 = 1e6;

/// A smoothed curve at its knots.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Smoothed {
    /// Knots.
    pub(super) x: Vec<f64>,
    /// Values at the knots; between them the curve is the cubic of values and slopes, exactly.
    pub(super) value: Vec<f64>,
    /// Slopes at the knots, zero or more.
    pub(super) slope: Vec<f64>,
    /// Root mean square of the residuals over the degrees of freedom left.
    pub(super) noise: f64,
    /// Trace of the smoother: how many free parameters the penalty leaves.
    pub(super) effective_parameters: f64,
    /// Standard uncertainty of the values at the knots by that noise, root mean square over the
    /// knots.
    pub(super) sigma: f64,
}

/// Smooths points with x in 0…1 on `intervals` intervals; none for too few points.
pub(super) fn smooth(points: &[(f64, f64)], intervals: usize) -> Option<Smoothed> {
    if points.len() < 2 * (BAND + 1) || intervals < 1 {
        return None;
    }
    let normal = Normal::new(points, intervals);
    let candidates = (-32..=32).map(|k| 10f64.powf(0.25 * f64::from(k)) * normal.mean_weight());
    let best = candidates
        .filter_map(|lambda| normal.score(lambda))
        .min_by(|a, b| a.gcv.total_cmp(&b.gcv))?;
    let mut c = normal.rising(best.lambda)?;
    for k in 1..c.len() {
        // The error that the pull leaves is below a nanovolt, but the curve must not fall at all.
        c[k] = c[k].max(c[k - 1]);
    }
    let h = 1.0 / intervals as f64;
    let freedom = (points.len() as f64 - best.parameters).max(1.0);
    let noise = (normal.residual(&c) / freedom).sqrt();
    Some(Smoothed {
        x: (0..=intervals).map(|k| k as f64 * h).collect(),
        value: c
            .windows(3)
            .map(|w| (w[0] + 4.0 * w[1] + w[2]) / 6.0)
            .collect(),
        slope: c.windows(3).map(|w| (w[2] - w[0]) / (2.0 * h)).collect(),
        noise,
        effective_parameters: best.parameters,
        // The trace is the sum of the leverages of all points; its mean is the mean relative
        // variance of the fitted values.
        sigma: noise * (best.parameters / points.len() as f64).sqrt(),
    })
}

/// A symmetric band matrix, lower half: `rows[i][d]` is the entry (i, i − d).
type Bands = Vec<[f64; BAND + 1]>;

struct Normal {
    gram: Bands,
    right: Vec<f64>,
    square: f64,
    count: usize,
}

struct Score {
    lambda: f64,
    gcv: f64,
    parameters: f64,
}

impl Normal {
    fn new(points: &[(f64, f64)], intervals: usize) -> Self {
        let n = intervals + BAND;
        let mut normal = Self {
            gram: vec![[0.0; BAND + 1]; n],
            right: vec![0.0; n],
            square: 0.0,
            count: points.len(),
        };
        for (x, y) in points {
            let (first, basis) = basis(*x, intervals);
            for (a, wa) in basis.iter().enumerate() {
                normal.right[first + a] += wa * y;
                for (b, wb) in basis[..=a].iter().enumerate() {
                    normal.gram[first + a][a - b] += wa * wb;
                }
            }
            normal.square += y * y;
        }
        normal
    }

    fn mean_weight(&self) -> f64 {
        self.gram.iter().map(|r| r[0]).sum::<f64>() / self.gram.len() as f64
    }

    /// Gram matrix plus λ·DᵀD of the third differences.
    fn penalised(&self, lambda: f64) -> Bands {
        const D: [f64; 4] = [-1.0, 3.0, -3.0, 1.0];
        let mut a = self.gram.clone();
        for start in 0..a.len() - BAND {
            for (i, di) in D.iter().enumerate() {
                for (j, dj) in D[..=i].iter().enumerate() {
                    a[start + i][i - j] += lambda * di * dj;
                }
            }
        }
        // Knots without points on both sides of a gap keep solvable.
        let floor = 1e-12 * self.mean_weight();
        a.iter_mut().for_each(|row| row[0] += floor);
        a
    }

    fn score(&self, lambda: f64) -> Option<Score> {
        let l = factor(self.penalised(lambda))?;
        let c = solve(&l, self.right.clone());
        let n = self.gram.len();
        let mut parameters = 0.0;
        for k in 0..n {
            let column: Vec<f64> = (0..n).map(|i| self.gram_entry(i, k)).collect();
            parameters += solve(&l, column)[k];
        }
        let freedom = self.count as f64 - parameters;
        if freedom <= 0.0 {
            return None;
        }
        Some(Score {
            lambda,
            gcv: self.residual(&c) / (freedom * freedom),
            parameters,
        })
    }

    fn gram_entry(&self, i: usize, j: usize) -> f64 {
        let (low, high) = (i.min(j), i.max(j));
        if high - low > BAND {
            0.0
        } else {
            self.gram[high][high - low]
        }
    }

    /// Σ(y − fit)², from the sums alone.
    fn residual(&self, c: &[f64]) -> f64 {
        let mut sum = self.square;
        for (i, ci) in c.iter().enumerate() {
            sum -= 2.0 * ci * self.right[i];
            for d in 0..=BAND.min(i) {
                sum += if d == 0 { 1.0 } else { 2.0 } * self.gram[i][d] * ci * c[i - d];
            }
        }
        sum.max(0.0)
    }

    /// Returns coefficients that rise, except for the part that the penalty leaves.
    fn rising(&self, lambda: f64) -> Option<Vec<f64>> {
        const MOST_ROUNDS: usize = 60;
        let base = self.penalised(lambda);
        let mut falling: Vec<bool> = vec![false; base.len()];
        let mut c = solve(&factor(base.clone())?, self.right.clone());
        for _ in 0..MOST_ROUNDS {
            let now: Vec<bool> = (0..c.len())
                .map(|k| k > 0 && (c[k] < c[k - 1] || (falling[k] && c[k] <= c[k - 1])))
                .collect();
            if now == falling {
                break;
            }
            falling = now;
            let mut a = base.clone();
            let pull = PULL * self.mean_weight();
            for k in (1..c.len()).filter(|k| falling[*k]) {
                a[k][0] += pull;
                a[k - 1][0] += pull;
                a[k][1] -= pull;
            }
            c = solve(&factor(a)?, self.right.clone());
        }
        Some(c)
    }
}

/// Returns the index of the first of the four splines over x, and their values.
fn basis(x: f64, intervals: usize) -> (usize, [f64; 4]) {
    let place = x.clamp(0.0, 1.0) * intervals as f64;
    let first = (place as usize).min(intervals - 1);
    let t = place - first as f64;
    let u = 1.0 - t;
    let (t2, t3) = (t * t, t * t * t);
    (
        first,
        [
            u * u * u / 6.0,
            (3.0 * t3 - 6.0 * t2 + 4.0) / 6.0,
            (-3.0 * t3 + 3.0 * t2 + 3.0 * t + 1.0) / 6.0,
            t3 / 6.0,
        ],
    )
}

/// Cholesky factor of a band matrix.
fn factor(mut a: Bands) -> Option<Bands> {
    for i in 0..a.len() {
        for d in (0..=BAND.min(i)).rev() {
            let j = i - d;
            let mut s = a[i][d];
            for k in i.saturating_sub(BAND)..j {
                if j - k <= BAND {
                    s -= a[i][i - k] * a[j][j - k];
                }
            }
            a[i][d] = if d > 0 {
                s / a[j][0]
            } else if s > 0.0 {
                s.sqrt()
            } else {
                return None;
            };
        }
    }
    Some(a)
}

fn solve(l: &Bands, mut b: Vec<f64>) -> Vec<f64> {
    let n = l.len();
    for i in 0..n {
        let dot: f64 = (1..=BAND.min(i)).map(|d| l[i][d] * b[i - d]).sum();
        b[i] = (b[i] - dot) / l[i][0];
    }
    for i in (0..n).rev() {
        let dot: f64 = (1..=BAND.min(n - 1 - i))
            .map(|d| l[i + d][d] * b[i + d])
            .sum();
        b[i] = (b[i] - dot) / l[i][0];
    }
    b
}

#[cfg(test)]
mod tests {
    use super::*;
    use analysis_numeric::Rng;

    #[test]
    fn smooths_to_below_the_noise_and_says_how_large_it_is() {
        let truth = |x: f64| {
            3.0 + 1.1 * x + 0.03 * (9.0 * x).sin() + 0.2 * (-(x / 0.03)).exp().mul_add(-1.0, 1.0)
        };
        let mut rng = Rng::new(11);
        let points: Vec<(f64, f64)> = (0..8000)
            .map(|k| f64::from(k) / 7999.0)
            .map(|x| (x, truth(x) + 4e-4 * rng.normal()))
            .collect();
        let s = smooth(&points, 200).unwrap();
        assert!((s.noise / 4e-4 - 1.0).abs() < 0.05, "{}", s.noise);
        let worst =
            s.x.iter()
                .zip(&s.value)
                .map(|(x, v)| (v - truth(*x)).abs())
                .fold(0.0, f64::max);
        assert!(worst < 4e-4, "{worst}: worse than one sample");
        let rms =
            (s.x.iter()
                .zip(&s.value)
                .map(|(x, v)| (v - truth(*x)).powi(2))
                .sum::<f64>()
                / s.x.len() as f64)
                .sqrt();
        assert!(
            rms < 2.0 * s.sigma && rms > 0.3 * s.sigma,
            "{rms} against the stated {}",
            s.sigma
        );
    }

    #[test]
    fn noise_on_a_plateau_does_not_make_it_fall() {
        let truth = |x: f64| {
            if (0.3..0.7).contains(&x) {
                3.3
            } else {
                3.3 + 0.5 * (x - x.clamp(0.3, 0.7))
            }
        };
        let mut rng = Rng::new(5);
        let points: Vec<(f64, f64)> = (0..3000)
            .map(|k| f64::from(k) / 2999.0)
            .map(|x| (x, truth(x) + 2e-3 * rng.normal()))
            .collect();
        let s = smooth(&points, 100).unwrap();
        assert!(s.value.windows(2).all(|w| w[1] >= w[0]) && s.slope.iter().all(|m| *m >= 0.0));
        let worst =
            s.x.iter()
                .zip(&s.value)
                .map(|(x, v)| (v - truth(*x)).abs())
                .fold(0.0, f64::max);
        assert!(worst < 2e-3, "{worst}");
    }
}
