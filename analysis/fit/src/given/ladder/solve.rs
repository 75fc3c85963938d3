//! Resistances of a ladder over given time constants: least squares of the relative error, none
//! negative. Then the time constants move too.

use super::polish::polish;
use super::rows::{DC_WEIGHT, Met, NOTHING, Rows, pole};
use crate::drt::nonnegative;
use crate::given::error::MOST_BRANCHES;
use analysis_model::model::RcBranch;
use nalgebra::{DMatrix, DVector};
use num_complex::Complex64;
use std::ops::RangeInclusive;

/// Branches per decade that are tried, until the error is small enough.
const DENSITIES: [f64; 10] = [0.5, 0.75, 1.0, 1.25, 1.5, 1.75, 2.0, 2.5, 3.0, 4.0];
/// Points per decade for the fit, and for the error: finer, and between them.
const FITTED_PER_DECADE: f64 = 16.0;
const CHECKED_PER_DECADE: f64 = 50.0;
/// Factor by which time constants reach beyond the reciprocals of the band's ends.
const REACH_FAST: f64 = 3.0;
const REACH_SLOW: f64 = 10.0;
/// Impedance and band that a ladder is to follow.
pub(super) struct Problem<'a> {
    /// Impedance to be followed, by angular frequency.
    pub(super) rest: &'a dyn Fn(f64) -> Complex64,
    /// Impedance in series with it that is already an ERM.
    pub(super) beside: &'a dyn Fn(f64) -> Complex64,
    /// Ends of the band, rad/s.
    pub(super) omega: RangeInclusive<f64>,
    /// Whether it ends as a capacitance.
    pub(super) stores: bool,
    /// DC resistance of the rest, Ω, if it has one.
    pub(super) dc_ohm: Option<f64>,
}

/// Returns the shortest ladder that is good enough, otherwise the best of all; `None` if no system
/// could be solved.
pub(super) fn best_ladder(problem: &Problem) -> Option<Met> {
    let mut best: Option<Met> = None;
    for density in DENSITIES {
        let Some(met) = problem
            .ladder(density)
            .filter(|met| met.branches.len() <= MOST_BRANCHES)
        else {
            continue;
        };
        if best.as_ref().is_none_or(|best| met.worst < best.worst) {
            best = Some(met);
        }
        if best.as_ref().is_some_and(|best| best.worst < TARGET) {
            break;
        }
    }
    best
}

impl Problem<'_> {
    fn ladder(&self, density: f64) -> Option<Met> {
        let rows = self.rows(0.0);
        let tau_s = spaced(&rows.tau_s, density);
        let plain = self.solve(&rows, &tau_s)?;
        if !self.stores {
            return Some(self.judged(polish(&rows, &plain)));
        }
        // The capacitance's part of |Z| must not hide the error of the rest.
        let rows = self.rows(plain.elastance_per_f);
        Some(self.judged(polish(&rows, &self.solve(&rows, &tau_s)?)))
    }

    /// |Z| without the capacitance.
    fn scale(&self, omega: f64, elastance_per_f: f64) -> f64 {
        ((self.rest)(omega) + (self.beside)(omega) - pole(omega, elastance_per_f)).norm()
    }

    fn rows(&self, elastance_per_f: f64) -> Rows {
        let omega = spaced(&self.omega, FITTED_PER_DECADE);
        Rows {
            z_ohm: omega.iter().map(|omega| (self.rest)(*omega)).collect(),
            scale_ohm: omega
                .iter()
                .map(|omega| self.scale(*omega, elastance_per_f))
                .collect(),
            dc_ohm: self.dc_ohm.map(|rest| (rest, rest + (self.beside)(0.0).re)),
            tau_s: 1.0 / (REACH_FAST * self.omega.end())..=REACH_SLOW / self.omega.start(),
            omega,
        }
    }

    /// Resistances over time constants that are held.
    fn solve(&self, rows: &Rows, tau_s: &[f64]) -> Option<Met> {
        // Unknowns: the resistances of the branches, that in series, and the capacitance's
        // reactance at the lower end.
        let (series, store) = (tau_s.len(), tau_s.len() + 1);
        let (unknowns, last) = (
            tau_s.len() + 1 + usize::from(self.stores),
            2 * rows.omega.len(),
        );
        let mut matrix = DMatrix::zeros(last + 1, unknowns);
        let mut data = DVector::zeros(last + 1);
        for (k, ((omega, z), scale)) in rows
            .omega
            .iter()
            .zip(&rows.z_ohm)
            .zip(&rows.scale_ohm)
            .enumerate()
        {
            let mut put = |j: usize, z: Complex64| {
                (matrix[(2 * k, j)], matrix[(2 * k + 1, j)]) = (z.re / scale, z.im / scale);
            };
            tau_s
                .iter()
                .enumerate()
                .for_each(|(j, tau_s)| put(j, Complex64::new(1.0, omega * tau_s).inv()));
            put(series, Complex64::ONE);
            if self.stores {
                put(store, pole(*omega, *self.omega.start()));
            }
            (data[2 * k], data[2 * k + 1]) = (z.re / scale, z.im / scale);
        }
        if let Some((rest_ohm, all_ohm)) = rows.dc_ohm {
            (0..=series).for_each(|j| matrix[(last, j)] = DC_WEIGHT / all_ohm);
            data[last] = DC_WEIGHT * rest_ohm / all_ohm;
        }
        let guess: Vec<usize> = (0..unknowns).collect();
        let x = nonnegative::solve(
            &(matrix.transpose() * &matrix),
            &(matrix.transpose() * &data),
            &guess,
        )?
        .x;
        let least_ohm = NOTHING * rows.scale_ohm.iter().copied().fold(0.0, f64::max);
        let branches = tau_s
            .iter()
            .zip(x.iter())
            .filter(|(_, r_ohm)| **r_ohm > least_ohm);
        Some(Met {
            r_ohm: x[series].max(0.0),
            branches: branches
                .map(|(tau_s, r_ohm)| RcBranch {
                    r_ohm: *r_ohm,
                    c_f: tau_s / r_ohm,
                })
                .collect(),
            elastance_per_f: if self.stores {
                x[store].max(0.0) * self.omega.start()
            } else {
                0.0
            },
            worst: f64::INFINITY,
            worst_omega: *self.omega.start(),
        })
    }

    /// The same with its worst error, on a grid that was not fitted.
    fn judged(&self, mut met: Met) -> Met {
        let error = |omega: f64| {
            let branches = met
                .branches
                .iter()
                .map(|b| b.r_ohm / Complex64::new(1.0, omega * b.time_constant_s()))
                .sum::<Complex64>();
            let z = met.r_ohm + branches + pole(omega, met.elastance_per_f);
            ((self.rest)(omega) - z).norm() / self.scale(omega, met.elastance_per_f)
        };
        let all = spaced(&self.omega, CHECKED_PER_DECADE)
            .into_iter()
            .map(|omega| (error(omega), omega));
        // Not a number is the worst of all.
        let worst = all
            .max_by(|a, b| a.0.total_cmp(&b.0))
            .unwrap_or((f64::INFINITY, *self.omega.start()));
        (met.worst, met.worst_omega) = (
            if worst.0.is_finite() {
                worst.0
            } else {
                f64::INFINITY
            },
            worst.1,
        );
        met
    }
}

/// Returns values with equal ratios from end to end, at least this number per decade.
fn spaced(range: &RangeInclusive<f64>, per_decade: f64) -> Vec<f64> {
    let (low, high) = (range.start(), range.end());
    let steps = (per_decade * (high / low).log10()).ceil().max(1.0) as usize;
    (0..=steps)
        .map(|k| low * (high / low).powf(k as f64 / steps as f64))
        .collect()
}

/// Relative error that ends the search: a third of the 0.3 % by which the thesis' sweeps of one
/// cell repeat.
pub const TARGET: f64 = 1e-3;
