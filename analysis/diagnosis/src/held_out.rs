//! Judges an addition by the held-out runs, in which nothing was fitted.
//!
//! Three tests: whether the whitened χ² of a run grows, whether the root mean square of a record
//! grows in volts, and whether the predictions of the addition are found in all held-out runs.

use super::block::Kind;
use super::data::Role;
use super::problem::Fit;
use super::search::Search;
use super::whitening::dot;
use crate::thresholds::{FORMULA_SHARE, HELD_OUT_PART, HELD_OUT_RMS_Z, HELD_OUT_SUM, HELD_OUT_Z};

/// A held-out record that an addition predicts worse.
#[derive(Debug, Clone, PartialEq)]
struct Worse {
    before_mv: f64,
    after_mv: f64,
    /// Distance from what noise can do, σ.
    z: f64,
}

/// How much of a predicted change held-out runs show.
struct FoundChange {
    /// Part of the predicted change, 1 if all of it is there.
    times: f64,
    /// Its standard deviation.
    sigma: f64,
    /// Distance from 1, beyond the error of a formula, in standard deviations.
    z: f64,
}

impl Search<'_> {
    /// Returns the change of the held-out χ², or an error if one run becomes worse.
    pub(super) fn held_out(&mut self, before: &Fit, after: &Fit) -> Result<f64, String> {
        let mut change = 0.0;
        for k in self.problem.of_role(Role::HeldOut) {
            let old = self.problem.block_chi2(before.at(), k, &mut self.workspace);
            let new = self.problem.block_chi2(after.at(), k, &mut self.workspace);
            let is_worse = new > old * (1.0 + HELD_OUT_PART) + HELD_OUT_SUM || new.is_nan();
            if self.guards.held_out && is_worse {
                return Err(format!(
                    "held-out run {} becomes worse: χ² from {old:.0} to {new:.0}",
                    self.problem.blocks[k].name
                ));
            }
            change += new - old;
        }
        if self.guards.held_out {
            self.no_record_worse(before, after)?;
        }
        if let Some(found) = self.found_change(before, after)
            && self.guards.held_out
            && found.z > HELD_OUT_Z
        {
            return Err(format!(
                "held-out runs show {:.2} ± {:.2} times the change that it predicts for them",
                found.times, found.sigma
            ));
        }
        Ok(change)
    }

    /// Returns an error if a held-out record is missed by more millivolts than before, beyond its
    /// noise.
    ///
    /// A whitened χ² can fall while the root mean square grows: it weights most the parts with the
    /// least noise.
    pub(super) fn no_record_worse(&mut self, before: &Fit, after: &Fit) -> Result<(), String> {
        self.compare_records(before, after, |worse| worse.z > HELD_OUT_RMS_Z)
    }

    /// Returns the same error for a model that is to predict: an assumed noise excuses no more than
    /// a formula's error.
    pub(super) fn no_prediction_worse(&mut self, before: &Fit, after: &Fit) -> Result<(), String> {
        let is_assumed = !self.measured;
        self.compare_records(before, after, |worse| {
            let is_larger = worse.after_mv > (1.0 + FORMULA_SHARE) * worse.before_mv;
            worse.z > HELD_OUT_RMS_Z || (is_assumed && is_larger)
        })
    }

    fn compare_records(
        &mut self,
        before: &Fit,
        after: &Fit,
        counts: impl Fn(&Worse) -> bool,
    ) -> Result<(), String> {
        for k in self.problem.of_role(Role::HeldOut) {
            let chi2 = self.problem.block_chi2(after.at(), k, &mut self.workspace);
            if chi2.is_nan() {
                return Err(format!(
                    "held-out run {} becomes worse: its prediction is not a number",
                    self.problem.blocks[k].name
                ));
            }
            if let Some(Worse {
                before_mv,
                after_mv,
                z,
            }) = self.worse(before, after, k).filter(&counts)
            {
                return Err(format!(
                    "held-out run {} becomes worse: {before_mv:.2} mV to {after_mv:.2} mV, {z:.1} \
                    standard deviations beyond its noise",
                    self.problem.blocks[k].name
                ));
            }
        }
        Ok(())
    }

    /// Returns how the prediction of a record is worse, or `None` if it is not.
    ///
    /// With Δ the residual and d the change of the prediction, the sum of squares grows by −2·dᵀΔ −
    /// dᵀd. Were the new prediction true, dᵀΔ would be noise of variance dᵀC·d.
    fn worse(&mut self, before: &Fit, after: &Fit, block: usize) -> Option<Worse> {
        let Kind::Time(time) = &self.problem.blocks[block].kind else {
            return None;
        };
        let at_edges = &self.problem.at_edges[block];
        let all_at_edges = at_edges.iter().all(|at| *at);
        let weights: Vec<f64> = time
            .bins
            .iter()
            .zip(at_edges)
            .map(|(bin, at_edge)| {
                if *at_edge && !all_at_edges {
                    0.0
                } else {
                    (bin.to - bin.from) as f64
                }
            })
            .collect();
        let sum: f64 = weights.iter().sum();
        let [old, new] = [before, after].map(|fit| {
            self.problem
                .predict(fit.at(), block, 1, &mut self.workspace)
        });
        let measured = &self.problem.blocks[block].measured;
        let free_level = time.level_sigma_v > 0.0;
        let about = |mut rows: Vec<f64>| {
            if free_level {
                let level = dot(&rows, &weights) / sum;
                rows.iter_mut().for_each(|row| *row -= level);
            }
            rows
        };
        let minus = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a - b).collect();
        let left = [&old, &new].map(|predicted| about(minus(measured, predicted)));
        let [before_v2, after_v2] = [&left[0], &left[1]].map(|rows| {
            let squares: f64 = rows.iter().zip(&weights).map(|(r, w)| w * r * r).sum();
            squares / sum
        });
        if after_v2 <= before_v2 {
            return None;
        }
        let change: Vec<f64> = about(minus(&new, &old))
            .iter()
            .zip(&weights)
            .map(|(change, weight)| change * weight)
            .collect();
        let along = dot(&left[1], &change);
        let sigma = self.problem.whiteners[block].variance(&change).sqrt();
        let z = along.abs() / sigma.max(f64::MIN_POSITIVE);
        Some(Worse {
            before_mv: 1e3 * before_v2.sqrt(),
            after_mv: 1e3 * after_v2.sqrt(),
            z,
        })
    }

    /// Returns how much of the change that the addition makes to the prediction of the held-out runs
    /// is found there, or `None` if it changes nothing.
    ///
    /// With u the direction of the change and r the residual after it, u·r is left of noise and
    /// parameters if the addition is true: its variance is 1 + uᵀJΣJᵀu.
    fn found_change(&mut self, before: &Fit, after: &Fit) -> Option<FoundChange> {
        let problem = self.problem;
        let old = problem.whitened_of(Role::HeldOut, before.at(), &mut self.workspace);
        let new = problem.whitened_of(Role::HeldOut, after.at(), &mut self.workspace);
        let mut u: Vec<f64> = new.iter().zip(&old).map(|(n, o)| n - o).collect();
        let size = dot(&u, &u).sqrt();
        let n = after.x.len();
        let covariance = after.covariance().filter(|_| size > 1e-6)?;
        u.iter_mut().for_each(|u| *u /= size);
        let (residual, columns) = problem.held_out(after, &mut self.workspace);
        let along: Vec<f64> = columns.iter().map(|c| dot(&u, c)).collect();
        let spread: f64 = (0..n * n)
            .map(|ij| along[ij / n] * along[ij % n] * covariance[ij])
            .sum();
        let sigma = (1.0 + spread.max(0.0)).sqrt();
        let along = dot(&u, &residual);
        Some(FoundChange {
            times: 1.0 + along / size,
            sigma: sigma / size,
            z: (along.abs() - FORMULA_SHARE * size).max(0.0) / sigma,
        })
    }
}
