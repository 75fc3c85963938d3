//! Start values for a fit of RC branches.

use super::Drt;
use analysis_model::model::RcBranch;
use std::f64::consts::PI;

/// RC branches that stand for the distribution, by rising time constant: n of them, or as many as
/// there are nodes that carry something; none if all of it is within two standard deviations of
/// zero.
///
/// The nodes are merged to n groups so that each step costs the least squared spread of ln τ (Ward,
/// J. Am. Stat. Assoc. 58 (1963) 236). What the distribution holds in its Warburg element and
/// capacitance, which an ERM does not have, is spread over the slow end: A/√(jω) is the
/// distribution A·√τ/π, and a capacitance an RC whose time constant is three times the slowest of
/// the band.
pub fn start_values(drt: &Drt, n: usize) -> Vec<RcBranch> {
    let step = match drt.tau_s.as_slice() {
        [first, second, ..] => (second / first).ln(),
        _ => return Vec::new(),
    };
    // A node: resistance and logarithm of the time constant.
    let mut groups: Vec<(f64, f64)> = drt
        .tau_s
        .iter()
        .zip(&drt.gamma_ohm)
        .map(|(tau, gamma)| {
            (
                step * (gamma + drt.warburg_ohm_per_sqrt_s.value * tau.sqrt() / PI),
                tau.ln(),
            )
        })
        .collect();
    if drt.elastance_per_f.value > 0.0 {
        let tau = 3.0 * drt.band_tau_s.1;
        groups.push((tau * drt.elastance_per_f.value, tau.ln()));
        groups.sort_by(|a, b| a.1.total_cmp(&b.1));
    }
    groups.retain(|(r, _)| *r > 0.0 && r.is_finite());
    while groups.len() > n.max(1) {
        let cost = |k: &usize| {
            let [(r, at), (s, by)] = [groups[*k], groups[*k + 1]];
            r * s / (r + s) * (at - by).powi(2)
        };
        let Some(k) = (0..groups.len() - 1).min_by(|a, b| cost(a).total_cmp(&cost(b))) else {
            break;
        };
        let (s, by) = groups.remove(k + 1);
        let (r, at) = groups[k];
        groups[k] = (r + s, (r * at + s * by) / (r + s));
    }
    groups.truncate(n);
    // The uncertainty of the sum is the scale below which a single peak carries no information. A
    // tail stands out by its own size.
    let tail = drt.elastance_per_f.value > 2.0 * drt.elastance_per_f.sigma
        || drt.warburg_ohm_per_sqrt_s.value > 2.0 * drt.warburg_ohm_per_sqrt_s.sigma;
    if !tail && drt.polarisation_ohm.value <= 2.0 * drt.polarisation_ohm.sigma {
        return Vec::new();
    }
    groups
        .into_iter()
        .map(|(r_ohm, ln_tau)| RcBranch {
            r_ohm,
            c_f: ln_tau.exp() / r_ohm,
        })
        .collect()
}
