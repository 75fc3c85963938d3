//! Whether a resistance comes and goes while a run lasts, as a loose contact does.
//!
//! No law says when it does, so no structure can be fitted; what it makes is a covariance of the rows that goes with the current,
//!
//! ```text
//! K = i·j·exp(−|Δt|/τ) between two rows of a record under currents i and j, 1 for the real part of a point of a sweep
//! ```
//!
//! per Ω². The score of its variance at zero, U = ½·(rᵀC⁻¹KC⁻¹r − tr C⁻¹K), is the most powerful question for a little of it (Cox and Hinkley, Theoretical
//! Statistics 1974, 4.8). For a sweep the imaginary part counts as −1, so that noise of both parts, which is what repeats would take it for, says nothing. Under
//! noise alone 2U is a sum of squares with variance 2·tr(C⁻¹K)² and third cumulant 8·tr(C⁻¹K)³, and about a scaled χ² of
//! (tr(C⁻¹K)²)³/(tr(C⁻¹K)³)² degrees of freedom. For the third one imaginary parts count as real ones do: what is left and right of the middle does not make the
//! tails less heavy.

use super::block::{Block, Kind};
use super::data::Role;
use super::problem::{Fit, Problem};
use super::whitening::dot;

/// Times within which it is taken to come or go, s.
pub(super) const TAUS_S: [f64; 3] = [1.0, 5.0, 25.0];
/// Part of the largest current of a record below which a row says nothing of a resistance.
const FLOWS: f64 = 0.05;

/// χ² and degrees of freedom of the score, for each of [`TAUS_S`]; 0 of 0 where no row tells.
pub(super) fn intermittent(problem: &Problem, fit: &Fit) -> [(f64, f64); TAUS_S.len()] {
    let mut sums = [[0.0; 3]; TAUS_S.len()];
    let mut first = 0;
    for k in problem.of_role(Role::Train) {
        let block = &problem.blocks[k];
        let rows = first..first + block.rows();
        first = rows.end;
        if !block.at.is_cell {
            continue;
        }
        let mut solved = fit.residuals[rows].to_vec();
        problem.whiteners[k].apply_transposed(&mut solved);
        let inverse = problem.whiteners[k].inverse();
        for (sums, tau_s) in sums.iter_mut().zip(TAUS_S) {
            let of = Kernel::new(block, tau_s).terms(&solved, &inverse);
            sums.iter_mut().zip(of).for_each(|(sum, term)| *sum += term);
        }
    }
    sums.map(|[score, square, cube]| {
        if square <= 0.0 || cube <= 0.0 {
            return (0.0, 0.0);
        }
        let dof = square.powi(3) / (cube * cube);
        (dof + score / (2.0 * square).sqrt() * (2.0 * dof).sqrt(), dof)
    })
}

/// What a resistance that comes and goes does to some rows of a block.
struct Kernel {
    rows: Vec<usize>,
    /// Row-major, over those rows.
    k: Vec<f64>,
    /// Signs of the rows.
    signs: Vec<f64>,
}

impl Kernel {
    fn new(block: &Block, tau_s: f64) -> Self {
        match &block.kind {
            Kind::Eis { points, .. } => {
                let n = 2 * points.len();
                let mut k = vec![0.0; n * n];
                (0..n).for_each(|i| k[i * n + i] = 1.0);
                Self { rows: (0..n).collect(), k, signs: (0..n).map(|i| if i.is_multiple_of(2) { 1.0 } else { -1.0 }).collect() }
            }
            Kind::Time(time) => {
                let greatest_a = time.bins.iter().fold(0.0f64, |m, b| m.max(b.current_a.abs()));
                let rows: Vec<usize> = (0..time.bins.len()).filter(|row| time.bins[*row].current_a.abs() > FLOWS * greatest_a).collect();
                // Of what comes and goes within a row its mean has less.
                let size = |row: usize| {
                    let bin = &time.bins[row];
                    bin.current_a * of_mean((time.time_s[bin.to - 1] - time.time_s[bin.from]) / tau_s).sqrt()
                };
                let between = |a: usize, b: usize| size(a) * size(b) * (-(time.bins[a].time_s - time.bins[b].time_s).abs() / tau_s).exp();
                let k = rows.iter().flat_map(|a| rows.iter().map(|b| between(*a, *b)).collect::<Vec<f64>>()).collect();
                Self { signs: vec![1.0; rows.len()], rows, k }
            }
        }
    }

    /// xᵀKx − tr C⁻¹K, tr (C⁻¹K)² and tr (C⁻¹K)³, the last without signs, with x = C⁻¹r.
    fn terms(&self, solved: &[f64], inverse: &[f64]) -> [f64; 3] {
        let (n, all) = (self.rows.len(), solved.len());
        let x: Vec<f64> = self.rows.iter().map(|row| solved[*row]).collect();
        let rows = || self.k.chunks_exact(n.max(1)).zip(&self.signs);
        let quadratic: f64 = rows().zip(&x).map(|((k, sign), x_i)| sign * x_i * dot(k, &x)).sum();
        let weights: Vec<f64> = self.rows.iter().flat_map(|i| self.rows.iter().map(move |j| inverse[i * all + j])).collect();
        let once = product(&weights, &self.k, n);
        let twice = product(&once, &once, n);
        let trace: f64 = (0..n).map(|i| self.signs[i] * once[i * n + i]).sum();
        let cube = (0..n * n).map(|ij| twice[ij] * once[(ij % n) * n + ij / n]).sum();
        let square = (0..n).map(|i| twice[i * n + i]).sum();
        [quadratic - trace, square, cube]
    }
}

/// Variance of the mean over a time of so many τ of what forgets itself within τ, as a part of its variance.
fn of_mean(x: f64) -> f64 {
    if x < 1e-3 { 1.0 } else { 2.0 * (x - 1.0 + (-x).exp()) / (x * x) }
}

/// a·b of square matrices, row-major.
fn product(a: &[f64], b: &[f64], n: usize) -> Vec<f64> {
    let mut product = vec![0.0; n * n];
    for (row, out) in a.chunks_exact(n.max(1)).zip(product.chunks_exact_mut(n.max(1))) {
        for (a, b) in row.iter().zip(b.chunks_exact(n.max(1))) {
            if *a != 0.0 {
                out.iter_mut().zip(b).for_each(|(o, b)| *o += a * b);
            }
        }
    }
    product
}
