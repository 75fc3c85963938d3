//! Error of a map on a log.

use super::design::Log;
use analysis_model::map::{BranchStep, CellMap, Outside};
use analysis_signal::series::Role;
use serde::Serialize;

/// Lowest SOC that counts for the error of a log: below it the OCV is steep, and an error of charge
/// of 1 % is some ten millivolts.
const LEAST_SOC: f64 = 0.1;
/// Width of the bands of SOC in which the error is stated.
const BAND: f64 = 0.1;
/// Rows of a band at least.
const LEAST_ROWS: usize = 20;

/// Error of the predicted voltage on one log, under its own current and temperature.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LogScore {
    /// Name of the log.
    pub name: String,
    /// Whether it was fitted.
    pub role: Role,
    /// Mean temperature, °C.
    pub temperature_degc: f64,
    /// Root of the mean squared error above SOC 0.1, V; NaN if the log lies below.
    pub rms_v: f64,
    /// Mean error (measured less predicted) above SOC 0.1, V.
    pub bias_v: f64,
    /// Band of 0.1 SOC with the largest error: its lower end and its error, V.
    pub worst: Option<(f64, f64)>,
    /// Farthest distance from the measured range.
    pub outside: Outside,
}

impl LogScore {
    pub(super) fn new(map: &CellMap, log: &Log, residuals: &[f64]) -> Self {
        let rms =
            |rows: &[f64]| (rows.iter().map(|e| e * e).sum::<f64>() / rows.len() as f64).sqrt();
        let chosen = |low: f64, high: f64| -> Vec<f64> {
            let rows = log.soc.iter().zip(residuals);
            rows.filter(|(z, _)| **z > low && **z <= high)
                .map(|(_, e)| *e)
                .collect()
        };
        let counted = chosen(LEAST_SOC, f64::INFINITY);
        let bands = (1..10).map(|k| {
            let low = BAND * f64::from(k);
            (low, chosen(low, low + BAND))
        });
        let worst = bands
            .filter(|(_, rows)| rows.len() >= LEAST_ROWS)
            .map(|(low, rows)| (low, rms(&rows)))
            .max_by(|a, b| a.1.total_cmp(&b.1));
        let places = log.soc.iter().zip(&log.temperature_degc);
        let outside = places
            .map(|(soc, degc)| map.place(*soc, *degc).outside)
            .fold(Outside::default(), Outside::farther);
        Self {
            name: log.name.clone(),
            role: log.role,
            temperature_degc: log.mean_degc(),
            rms_v: rms(&counted),
            bias_v: counted.iter().sum::<f64>() / counted.len() as f64,
            worst,
            outside,
        }
    }
}

/// Measured less predicted voltage, V, at each sample.
pub(super) fn residuals(map: &CellMap, log: &Log) -> Vec<f64> {
    let mut v = vec![0.0; map.branches.len()];
    let mut before = vec![0.0; map.branches.len()];
    let mut residuals = Vec::with_capacity(log.len());
    for k in 0..log.len() {
        let (soc, degc, i) = (log.soc[k], log.temperature_degc[k], log.current_a[k]);
        let at = map.place(soc, degc);
        for ((v, before), branch) in v.iter_mut().zip(&mut before).zip(&map.branches) {
            let driven = map.resistance_ohm(&branch.resistance, &at) * i;
            if k > 0 {
                let step = BranchStep::new(log.time_s[k] - log.time_s[k - 1], branch.tau_s);
                *v = step.end_v(*v, *before, driven);
            }
            *before = driven;
        }
        let ocv_v = log.ocv_v[k] + map.ocv_correction_v(&at, degc);
        let series_v = map.resistance_ohm(&map.series, &at) * i;
        residuals.push(log.voltage_v[k] - (ocv_v - series_v - v.iter().sum::<f64>()));
    }
    residuals
}

/// Time over which residuals are correlated, s: twice the integral of their autocorrelation up to
/// its first zero, the mean over the logs.
pub(super) fn correlation_s(fitted: &[(&Log, &Vec<f64>)]) -> f64 {
    let times = fitted.iter().map(|(log, residuals)| {
        let n = residuals.len();
        let mean = residuals.iter().sum::<f64>() / n as f64;
        let step_s = (log.time_s[n - 1] - log.time_s[0]) / (n - 1) as f64;
        let product = |lag: usize| {
            let pairs = residuals.iter().zip(&residuals[lag..]);
            pairs.map(|(a, b)| (a - mean) * (b - mean)).sum::<f64>()
        };
        let whole = product(0);
        if whole <= 0.0 {
            return step_s;
        }
        // Lags grow, so that slow residuals are seen as well as fast ones.
        let (mut lag, mut last, mut integral_s) = (0_usize, 1.0, 0.0);
        while lag < n / 2 {
            let next = (lag + 1).max(lag * 5 / 4);
            let share = product(next.min(n - 1)) / whole;
            let width_s = (next - lag) as f64 * step_s;
            integral_s += 0.5 * width_s * (last + share.max(0.0));
            if share <= 0.0 {
                break;
            }
            (lag, last) = (next, share);
        }
        2.0 * integral_s
    });
    times.sum::<f64>() / fitted.len() as f64
}

/// Factor on the standard deviations of the fit, whose weights assume an error and a correlation.
pub(super) fn sigma_scale(fitted: &[(&Log, &Vec<f64>)], correlation_s: f64) -> f64 {
    let all = fitted.iter().flat_map(|(_, r)| r.iter());
    let (count, square) = all.fold((0.0, 0.0), |(n, s), e| (n + 1.0, s + e * e));
    let rms: f64 = f64::sqrt(square / count);
    let assumed = super::design::ERROR_V;
    (rms / assumed).max(1e-3) * (correlation_s / super::design::CORRELATION_S).sqrt()
}
