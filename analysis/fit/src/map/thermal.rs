//! Heat capacity of the cell and its path to the surroundings, from the temperatures of the logs.

use super::log::Log;
use analysis_model::map::Thermal;
use nalgebra::{DMatrix, DVector};
use std::ops::Range;

/// Time constants that are tried, s: their ends and their number.
const TRIED_S: (f64, f64, usize) = (60.0, 6000.0, 40);
/// Least rise of the temperature within a log that shows the heat, K.
const LEAST_RISE_K: f64 = 1.0;
/// Largest share of the square of the temperatures that may remain.
const MOST_REMAINING: f64 = 0.5;

/// Fits T = T_s + (T₀ − T_s)·exp(−t/τ) + R·(heat through a filter of τ) to all logs, with T_s of
/// each part of a log and R in common; `None` if the temperatures do not follow the heat.
pub(super) fn fit(logs: &[&Log]) -> Option<Thermal> {
    let measured: Vec<&&Log> = logs.iter().filter(|log| log.temperature_measured).collect();
    let rise = |log: &Log| {
        let t = &log.samples.temperature_degc;
        t.iter().fold(f64::NEG_INFINITY, |a, b| a.max(*b))
            - t.iter().fold(f64::INFINITY, |a, b| a.min(*b))
    };
    if !measured.iter().any(|log| rise(log) >= LEAST_RISE_K) {
        return None;
    }
    let (first, last, count) = TRIED_S;
    let tried = (0..count).filter_map(|k| {
        let tau_s = first * (last / first).powf(k as f64 / (count - 1) as f64);
        let (left, resistance) = at(&measured, tau_s)?;
        Some((left, tau_s, resistance))
    });
    let (left, tau_s, resistance_k_per_w) = tried.min_by(|a, b| a.0.total_cmp(&b.0))?;
    // A time constant at an end of the range is one that the logs do not show.
    let shown = tau_s > 1.01 * first && tau_s < 0.99 * last;
    let fits = left < MOST_REMAINING && resistance_k_per_w > 0.0 && shown;
    fits.then(|| Thermal {
        capacity_j_per_k: tau_s / resistance_k_per_w,
        resistance_k_per_w,
    })
}

/// Share of the squares that remains with a time constant, and the thermal resistance, K/W.
fn at(logs: &[&&Log], tau_s: f64) -> Option<(f64, f64)> {
    let parts: Vec<(&Log, Range<usize>)> = logs
        .iter()
        .flat_map(|log| log.parts().map(move |part| (**log, part)))
        .collect();
    let n = parts.len() + 1;
    let (mut matrix, mut right) = (DMatrix::<f64>::zeros(n, n), DVector::<f64>::zeros(n));
    let (mut square, mut spread) = (0.0, 0.0);
    for (number, (log, part)) in parts.into_iter().enumerate() {
        let (time_s, degc) = (
            &log.samples.time_s,
            &log.samples.temperature_degc[part.clone()],
        );
        let (start, mean) = (degc[0], degc.iter().sum::<f64>() / degc.len() as f64);
        let (mut heated, mut left) = (0.0, 1.0);
        for k in part.clone() {
            if k > part.start {
                let decay = (-(time_s[k] - time_s[k - 1]) / tau_s).exp();
                heated = decay * heated + (1.0 - decay) * 0.5 * (log.heat_w(k - 1) + log.heat_w(k));
                left *= decay;
            }
            // Unknowns: R, and the surroundings of this part less its first temperature.
            let met = degc[k - part.start];
            let (y, a, b) = (met - start, heated, 1.0 - left);
            let place = number + 1;
            matrix[(0, 0)] += a * a;
            matrix[(0, place)] += a * b;
            matrix[(place, 0)] += a * b;
            matrix[(place, place)] += b * b;
            right[0] += a * y;
            right[place] += b * y;
            square += y * y;
            spread += (met - mean).powi(2);
        }
        // A part of one sample says nothing of its surroundings.
        matrix[(number + 1, number + 1)] += 1e-9;
    }
    let x = matrix.clone().cholesky()?.solve(&right);
    let left = square - 2.0 * right.dot(&x) + x.dot(&(&matrix * &x));
    Some((left / spread, x[0]))
}
