//! Polish of a ladder to full precision: resistances and time constants together, by the same least
//! squares.

use super::rows::{DC_WEIGHT, Met, NOTHING, Rows, pole};
use analysis_model::model::RcBranch;
use analysis_numeric::{LocalOptions, Smooth, minimise};
use num_complex::Complex64;

/// Iterations at most; the error is judged whether or not they end at the bottom.
const ITERATIONS: usize = 60;
/// Relative decrease of the sum of squares per step below which the search has converged.
const TOLERANCE: f64 = 1e-6;
/// Bounds of all resistances, as factors of the largest |Z|.
const MOST: f64 = 1e6;

/// Squares of the relative errors by the logarithms of: the series resistance, the inverse
/// capacitance, and each branch's resistance and time constant.
struct Squares<'a> {
    rows: &'a Rows,
    stores: bool,
}

/// The same ladder at the bottom of its basin.
pub(super) fn polish(rows: &Rows, met: &Met) -> Met {
    let largest = rows.scale_ohm.iter().copied().fold(0.0, f64::max);
    let least = NOTHING * largest;
    let stores = met.elastance_per_f > 0.0;
    let mut x = vec![met.r_ohm.max(least).ln()];
    let resistance = (least.ln(), (MOST * largest).ln());
    let mut bounds = vec![resistance];
    if stores {
        let at = met.elastance_per_f.ln();
        x.push(at);
        bounds.push((at - MOST.ln(), at + MOST.ln()));
    }
    for branch in &met.branches {
        x.extend([branch.r_ohm.max(least).ln(), branch.time_constant_s().ln()]);
        bounds.extend([resistance, (rows.tau_s.start().ln(), rows.tau_s.end().ln())]);
    }
    let options = LocalOptions {
        iterations: ITERATIONS,
        tolerance: TOLERANCE,
        ..LocalOptions::default()
    };
    let x = minimise(&Squares { rows, stores }, &x, &bounds, &options).x;
    let (head, pairs) = x.split_at(1 + usize::from(stores));
    let branch = |pair: &[f64]| {
        let (r_ohm, tau_s) = (pair[0].exp(), pair[1].exp());
        RcBranch {
            r_ohm,
            c_f: tau_s / r_ohm,
        }
    };
    Met {
        r_ohm: head[0].exp(),
        elastance_per_f: if stores { head[1].exp() } else { 0.0 },
        branches: pairs
            .chunks_exact(2)
            .map(branch)
            .filter(|b| b.r_ohm > 2.0 * least)
            .collect(),
        worst: met.worst,
        worst_omega: met.worst_omega,
    }
}

impl Squares<'_> {
    /// Calls `f` with every complex residual and, where asked for, its derivatives.
    fn each(&self, x: &[f64], slopes: bool, mut f: impl FnMut(Complex64, &[Complex64])) {
        let first = 1 + usize::from(self.stores);
        let exp: Vec<f64> = x.iter().map(|x| x.exp()).collect();
        let mut row = vec![Complex64::ZERO; x.len()];
        for ((omega, z), scale) in self
            .rows
            .omega
            .iter()
            .zip(&self.rows.z_ohm)
            .zip(&self.rows.scale_ohm)
        {
            row[0] = Complex64::from(exp[0] / scale);
            let mut sum = row[0];
            if self.stores {
                row[1] = pole(*omega, exp[1]) / scale;
                sum += row[1];
            }
            for k in (first..x.len()).step_by(2) {
                let u = Complex64::new(1.0, omega * exp[k + 1]).inv();
                row[k] = u * (exp[k] / scale);
                sum += row[k];
                if slopes {
                    row[k + 1] = row[k] * (u - 1.0);
                }
            }
            f(sum - z / scale, &row);
        }
        let Some((rest_ohm, all_ohm)) = self.rows.dc_ohm else {
            return;
        };
        row.fill(Complex64::ZERO);
        (0..1)
            .chain((first..x.len()).step_by(2))
            .for_each(|k| row[k] = Complex64::from(DC_WEIGHT * exp[k] / all_ohm));
        f(
            row.iter().sum::<Complex64>() - DC_WEIGHT * rest_ohm / all_ohm,
            &row,
        );
    }
}

impl Smooth for Squares<'_> {
    fn value(&self, x: &[f64]) -> f64 {
        let mut sum = 0.0;
        self.each(x, false, |residual, _| sum += 0.5 * residual.norm_sqr());
        sum
    }

    /// The Hessian is Gauss's and Newton's: residuals are small, and damping does the rest.
    fn expand(&self, x: &[f64], gradient: &mut [f64], hessian: &mut [f64]) -> f64 {
        let (n, mut sum) = (x.len(), 0.0);
        gradient.fill(0.0);
        hessian.fill(0.0);
        self.each(x, true, |residual, row| {
            sum += 0.5 * residual.norm_sqr();
            for i in 0..n {
                gradient[i] += row[i].re * residual.re + row[i].im * residual.im;
                for j in 0..=i {
                    hessian[i * n + j] += row[i].re * row[j].re + row[i].im * row[j].im;
                }
            }
        });
        for i in 0..n {
            (0..i).for_each(|j| hessian[j * n + i] = hessian[i * n + j]);
        }
        sum
    }
}
