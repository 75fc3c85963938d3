//! The peaks of a distribution.

use nalgebra::DMatrix;
use serde::Serialize;
use std::ops::RangeInclusive;

/// Minimum share of the whole for a peak, and its minimum number of standard deviations.
const LEAST_SHARE: f64 = 5e-3;
const LEAST_SIGMAS: f64 = 2.0;

/// A peak of γ, from minimum to minimum.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Peak {
    /// Time constant of its centre, s.
    pub tau_s: f64,
    /// Its area, Ω.
    pub r_ohm: f64,
    /// Standard deviation of the area by the noise, Ω.
    pub sigma_ohm: f64,
    /// Root mean square width, decades.
    pub width_decades: f64,
    /// Its centre lies in the measured band; else it is a guess.
    pub in_band: bool,
}

/// Peaks of the resistances `x` (Ω per node, with covariance) over the grid, by rising time
/// constant.
pub(super) fn peaks(
    tau_s: &[f64],
    x: &[f64],
    covariance: &DMatrix<f64>,
    band: RangeInclusive<f64>,
) -> Vec<Peak> {
    let least = LEAST_SHARE * x.iter().sum::<f64>();
    let peak = |(from, to): (usize, usize)| {
        let r_ohm: f64 = x[from..to].iter().sum();
        let moment = |f: &dyn Fn(f64) -> f64| {
            (from..to).map(|k| x[k] * f(tau_s[k].ln())).sum::<f64>() / r_ohm
        };
        let centre = moment(&|l| l);
        let variance: f64 = (from..to)
            .filter(|k| x[*k] > 0.0)
            .flat_map(|i| {
                (from..to)
                    .filter(|k| x[*k] > 0.0)
                    .map(move |j| covariance[(i, j)])
            })
            .sum();
        let tau = centre.exp();
        Peak {
            tau_s: tau,
            r_ohm,
            sigma_ohm: variance.max(0.0).sqrt(),
            width_decades: moment(&|l| (l - centre).powi(2)).sqrt() / std::f64::consts::LN_10,
            in_band: band.contains(&tau),
        }
    };
    let carries = |(from, to): &(usize, usize)| x[*from..*to].iter().sum::<f64>() > least;
    segments(x)
        .into_iter()
        .filter(carries)
        .map(peak)
        .filter(|p| p.r_ohm > LEAST_SIGMAS * p.sigma_ohm)
        .collect()
}

/// Ranges between minima.
fn segments(x: &[f64]) -> Vec<(usize, usize)> {
    let mut segments = Vec::new();
    let mut from = 0;
    for k in 1..x.len() {
        let falls_before = x[k] <= x[k - 1];
        let rises_after = x.get(k + 1).is_some_and(|next| *next > x[k]);
        if falls_before && rises_after {
            segments.push((from, k));
            from = k;
        }
    }
    segments.push((from, x.len()));
    segments
}
