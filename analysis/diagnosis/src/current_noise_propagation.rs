//! Propagation of white noise of the logged current to rows after its own sample. The noise charges
//! the branches, where it decays. It also accumulates in the state of charge, where it does not
//! decay.
//!
//! With n the noise of a sample, held until the next one after Δt, component p follows vₚ ← aₚ·vₚ +
//! gₚ·n: aₚ = e^(−Δt/τₚ) and gₚ = Rₚ·(1 − aₚ) for a branch, aₚ = 1 and gₚ = Δt for the charge,
//! whose voltage is its product with the curve's slope per charge. Rows are means over samples of
//! R·n + Σ uₚ·vₚ. The covariances of the components with each other, S ← a·S·aᵀ + σ²·g·gᵀ, and of
//! every row with them are carried from sample to sample. A current that is linear between samples
//! is approximated as held, and branches of effects are left out.

use super::time_block::{Bin, TimeBlock};
use super::whitening::dot;
use analysis_effects::contract::Base;

/// Returns the covariance of the rows of a record from current noise of this variance (A²), V²,
/// row-major, without the direct drop of each sample over the series resistance. The record starts
/// at `soc`.
pub(super) fn covariance(time: &TimeBlock, soc: f64, base: &Base, variance_a2: f64) -> Vec<f64> {
    let capacity_coulomb = 3600.0 * base.ocv.capacity_ah;
    let per_coulomb = |bin: &Bin| {
        base.ocv
            .slope_v(soc - bin.charge_coulomb / capacity_coulomb)
            / capacity_coulomb
    };
    // The charge is the last component.
    let branches = &base.erm.branches;
    let (n, count) = (time.bins.len(), branches.len() + 1);
    let mut covariance = vec![0.0; n * n];
    let mut state = vec![0.0; count * count];
    // For each earlier row, with all components.
    let mut with: Vec<Vec<f64>> = Vec::with_capacity(n);
    let mut volts = vec![1.0; count];
    let mut row = 0;
    for k in 0..time.time_s.len() {
        row += usize::from(time.bins.get(row).is_some_and(|bin| bin.to <= k));
        let bin = time.bins.get(row).filter(|bin| bin.from <= k);
        let share = bin.map_or(0.0, |bin| 1.0 / (bin.to - bin.from) as f64);
        if let Some(bin) = bin {
            if bin.from == k {
                with.push(vec![0.0; count]);
            }
            volts[count - 1] = per_coulomb(bin);
            let sample: Vec<f64> = (0..count)
                .map(|p| dot(&state[p * count..(p + 1) * count], &volts))
                .collect();
            for (met, with) in with.iter().enumerate().take(row) {
                let v = share * dot(with, &volts);
                covariance[met * n + row] += v;
                covariance[row * n + met] += v;
            }
            covariance[row * n + row] +=
                share * (2.0 * dot(&with[row], &volts) + share * dot(&sample, &volts));
            with[row]
                .iter_mut()
                .zip(&sample)
                .for_each(|(w, s)| *w += share * s);
        }
        let Some(next_s) = time.time_s.get(k + 1) else {
            break;
        };
        let step_s = next_s - time.time_s[k];
        let stays: Vec<f64> = branches
            .iter()
            .map(|b| (-step_s / b.time_constant_s()).exp())
            .chain([1.0])
            .collect();
        let gains: Vec<f64> = branches
            .iter()
            .zip(&stays)
            .map(|(b, a)| b.r_ohm * (1.0 - a))
            .chain([step_s])
            .collect();
        for (pq, s) in state.iter_mut().enumerate() {
            let (p, q) = (pq / count, pq % count);
            *s = stays[p] * stays[q] * *s + variance_a2 * gains[p] * gains[q];
        }
        for with in &mut with {
            with.iter_mut().zip(&stays).for_each(|(w, a)| *w *= a);
        }
        if bin.is_some() {
            let drop = share * base.erm.r_ohm * variance_a2;
            with[row]
                .iter_mut()
                .zip(&gains)
                .for_each(|(w, g)| *w += drop * g);
        }
    }
    covariance
}
