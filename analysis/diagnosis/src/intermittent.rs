//! Intermittent contact: tests for a resistance that appears under current for some seconds and
//! disappears again, as a loose contact does.
//!
//! Its times follow no law, so no structure can be fitted. It makes a covariance of the rows of a
//! record that is proportional to the current,
//!
//! ```text
//! K = i·j·exp(−|Δt|/τ) between two rows under currents i and j, ±1 for real and imaginary part of a point of a sweep
//! ```
//!
//! per Ω². The score of its variance at zero, U = ½·(rᵀC⁻¹KC⁻¹r − tr C⁻¹K), is the most powerful
//! test for a small amount of it (Cox and Hinkley, Theoretical Statistics 1974, 4.8). Under noise
//! alone 2U is a sum of squares with variance 2·tr(C⁻¹K)² and third cumulant 8·tr(C⁻¹K)³, and about
//! a scaled χ² of (tr(C⁻¹K)²)³/(tr(C⁻¹K)³)² degrees of freedom. The minus makes it blind to equal
//! noise of both parts, which is how repeats would see it. A real part that is noisier than the
//! imaginary one may still come from the gain of a channel. Spectra therefore count only where the
//! records show something by themselves.

use super::block::Kind;
use super::guards::beyond_formula;
use super::inconsistency::Inconsistency;
use super::problem::{Fit, Problem};
use super::time_block::TimeBlock;
use super::whitening::dot;
use crate::thresholds::{CONTACT_FLOWS_PART, CONTACT_RECORDS_Z, CONTACT_TAUS_S};
use analysis_fit::validity::tail::{chi2_tail, holm};
use analysis_numeric::linalg::product;

/// Tests for an intermittent contact, with probabilities corrected for the number of tested time
/// constants; `gained` is the λ of the named effects.
pub(super) fn intermittent_contact(
    problem: &Problem,
    fit: &Fit,
    gained: f64,
) -> Vec<Inconsistency> {
    let asked: Vec<(f64, (f64, f64))> = CONTACT_TAUS_S
        .into_iter()
        .zip(scores(problem, fit))
        .filter(|(_, (_, dof))| *dof > 0.0)
        .collect();
    let p_values = asked
        .iter()
        .map(|(_, (chi2, dof))| chi2_tail(dof + beyond_formula(chi2 - dof, gained), *dof));
    let corrected = holm(&p_values.collect::<Vec<f64>>());
    let found = |((tau_s, (chi2, dof)), p_value): (&(f64, (f64, f64)), f64)| {
        let message = format!(
            "what is left under current comes and goes within about {tau_s} s, as with a loose \
            contact"
        );
        Inconsistency {
            message,
            chi2: *chi2,
            dof: dof.round() as usize,
            p_value,
            is_contact: true,
        }
    };
    asked.iter().zip(corrected).map(found).collect()
}

/// Returns χ² and degrees of freedom of the score, for each of [`CONTACT_TAUS_S`]; 0 of 0 if no row
/// contributes.
fn scores(problem: &Problem, fit: &Fit) -> [(f64, f64); CONTACT_TAUS_S.len()] {
    let mut sums = [[Terms::default(); 2]; CONTACT_TAUS_S.len()];
    for (k, block, residual) in problem
        .whitened_residuals(fit)
        .filter(|(_, block, _)| block.at.is_cell)
    {
        let mut solved = residual.to_vec();
        problem.whiteners[k].apply_transposed(&mut solved);
        let inverse = problem.whiteners[k].inverse();
        match &block.kind {
            Kind::Time(time) => {
                sums.iter_mut()
                    .zip(CONTACT_TAUS_S)
                    .for_each(|([records, _], tau_s)| {
                        records.add(Kernel::new(time, tau_s).terms(&solved, &inverse));
                    });
            }
            Kind::Eis { .. } => {
                let of = Terms::of_parts(&solved, &inverse);
                sums.iter_mut().for_each(|[_, spectra]| spectra.add(of));
            }
        }
    }
    sums.map(|[records, spectra]| {
        let (chi2, dof) = records.chi2();
        if chi2 - dof < CONTACT_RECORDS_Z * (2.0 * dof).sqrt() {
            return (chi2, dof);
        }
        let mut both = records;
        both.add(spectra);
        both.chi2()
    })
}

/// 2U, tr (C⁻¹K)² and tr (C⁻¹K)³.
#[derive(Debug, Clone, Copy, Default)]
struct Terms {
    score: f64,
    square: f64,
    cube: f64,
}

impl Terms {
    fn add(&mut self, other: Self) {
        self.score += other.score;
        self.square += other.square;
        self.cube += other.cube;
    }

    /// Uses the real and imaginary parts of a spectrum, which have signs on the diagonal of K and
    /// nothing else. Its third cumulant is computed without them: parts on either side of the
    /// middle do not make the tails of the whole lighter.
    fn of_parts(solved: &[f64], inverse: &[f64]) -> Self {
        let n = solved.len();
        let sign = |i: usize| if i.is_multiple_of(2) { 1.0 } else { -1.0 };
        let square: f64 = (0..n * n)
            .map(|ij| sign(ij / n) * sign(ij % n) * inverse[ij] * inverse[ij])
            .sum();
        let score: f64 = (0..n)
            .map(|i| sign(i) * (solved[i] * solved[i] - inverse[i * n + i]))
            .sum();
        let cube = (0..n).map(|i| inverse[i * n + i].powi(3)).sum();
        Self {
            score,
            square,
            cube,
        }
    }

    fn chi2(&self) -> (f64, f64) {
        if self.square <= 0.0 || self.cube <= 0.0 {
            return (0.0, 0.0);
        }
        let dof = self.square.powi(3) / (self.cube * self.cube);
        (
            dof + self.score / (2.0 * self.square).sqrt() * (2.0 * dof).sqrt(),
            dof,
        )
    }
}

/// Covariance of an intermittent contact resistance in some rows of a record, per Ω².
struct Kernel {
    rows: Vec<usize>,
    /// Row-major, over those rows.
    k: Vec<f64>,
}

impl Kernel {
    fn new(time: &TimeBlock, tau_s: f64) -> Self {
        let greatest_a = time
            .bins
            .iter()
            .fold(0.0f64, |m, b| m.max(b.current_a.abs()));
        let rows: Vec<usize> = (0..time.bins.len())
            .filter(|row| time.bins[*row].current_a.abs() > CONTACT_FLOWS_PART * greatest_a)
            .collect();
        // The mean of a row averages out an intermittent resistance that changes within the row.
        let size = |row: usize| {
            let bin = &time.bins[row];
            bin.current_a
                * of_mean((time.time_s[bin.to - 1] - time.time_s[bin.from]) / tau_s).sqrt()
        };
        let between = |a: usize, b: usize| {
            size(a) * size(b) * (-(time.bins[a].time_s - time.bins[b].time_s).abs() / tau_s).exp()
        };
        let k = rows
            .iter()
            .flat_map(|a| rows.iter().map(|b| between(*a, *b)).collect::<Vec<f64>>())
            .collect();
        Self { rows, k }
    }

    /// With x = C⁻¹r.
    fn terms(&self, solved: &[f64], inverse: &[f64]) -> Terms {
        let (n, all) = (self.rows.len(), solved.len());
        let x: Vec<f64> = self.rows.iter().map(|row| solved[*row]).collect();
        let quadratic: f64 = self
            .k
            .chunks_exact(n.max(1))
            .zip(&x)
            .map(|(k, x_i)| x_i * dot(k, &x))
            .sum();
        let weights: Vec<f64> = self
            .rows
            .iter()
            .flat_map(|i| self.rows.iter().map(move |j| inverse[i * all + j]))
            .collect();
        let once = product(&weights, &self.k, n);
        let twice = product(&once, &once, n);
        let trace = |of: &[f64]| (0..n).map(|i| of[i * n + i]).sum::<f64>();
        let cube = (0..n * n)
            .map(|ij| twice[ij] * once[(ij % n) * n + ij / n])
            .sum();
        Terms {
            score: quadratic - trace(&once),
            square: trace(&twice),
            cube,
        }
    }
}

/// Returns the variance of the mean over a time of `x` correlation times τ, as a part of the
/// variance of a value.
fn of_mean(x: f64) -> f64 {
    if x < 1e-3 {
        1.0
    } else {
        2.0 * (x - 1.0 + (-x).exp()) / (x * x)
    }
}
