//! The band that holds the voltage of a whole run.
//!
//! The errors of a prediction last: a model that is wrong by some percent of a resistance is so at every
//! instant. With n such errors, none of which changes in a run, the true voltage lies within √χ²ₙ
//! standard deviations at *all* instants together with the probability of χ²ₙ (Scheffé 1953). A band of
//! 1.96 standard deviations holds 95 % of the instants, and fewer whole runs.

use super::law::Demand;
use super::trace::Trace;
use analysis_numeric::stats::chi2_tail;
use serde::Serialize;

/// Probability with which a band holds the whole run.
pub const RUN_PROBABILITY: f64 = 0.95;

/// What is wrong with a prediction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum RunError<'a> {
    /// The stated error of a map, in [`Trace::cell_sigma_v`]: one at rest, and one of the resistance.
    Map,
    /// The parameters of a fit: their number, and the standard deviation of the voltage of a cell at each
    /// row, at the demand of the row, V.
    Parameters(usize, &'a [f64]),
}

/// Band that holds the mean voltage of a cell over a whole run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RunBand {
    /// Half width at each row of the trace, V.
    #[serde(skip)]
    pub half_v: Vec<f64>,
    /// Mean of the half width over time, V.
    pub mean_half_v: f64,
    /// Largest half width, V.
    pub most_half_v: f64,
    /// Lowest voltage of its lower edge, V.
    pub lowest_v: f64,
    /// Highest voltage of its upper edge, V.
    pub highest_v: f64,
}

impl RunBand {
    /// Returns the band of a run of cells in series. Cells whose resistances scatter by `cell_share` of
    /// them, as a standard deviation, add that share of the overpotential. `None` if the trace states no
    /// error, or if its rows have none.
    pub fn new(
        trace: &Trace,
        demand: Demand,
        series: u32,
        error: RunError<'_>,
        cell_share: f64,
    ) -> Option<Self> {
        let (terms, sigma_v) = match error {
            RunError::Map => (2, trace.cell_sigma_v.as_slice()),
            RunError::Parameters(count, sigma_v) => (count, sigma_v),
        };
        if sigma_v.len() != trace.time_s.len() || sigma_v.is_empty() {
            return None;
        }
        let sigmas = factor(terms);
        let at_row = |(k, sigma_v): (usize, &f64)| {
            let grows = growth(trace, demand, k);
            let loss_v = trace.ocv_v[k] / f64::from(series) - trace.cell_v[k];
            let own = match error {
                RunError::Map => sigma_v * grows,
                RunError::Parameters(..) => *sigma_v,
            };
            sigmas * own.hypot(cell_share * loss_v * grows)
        };
        let half_v: Vec<f64> = sigma_v.iter().enumerate().map(at_row).collect();
        let (mut area_vs, mut all_s) = (0.0, 0.0);
        for (times, halves) in trace.time_s.windows(2).zip(half_v.windows(2)) {
            let step_s = times[1] - times[0];
            area_vs += 0.5 * step_s * (halves[0] + halves[1]);
            all_s += step_s;
        }
        let edges = |sign: f64| {
            let rows = trace.cell_v.iter().zip(&half_v);
            rows.map(move |(cell_v, half_v)| cell_v + sign * half_v)
        };
        let band = Self {
            mean_half_v: area_vs / all_s,
            most_half_v: half_v.iter().copied().fold(0.0, f64::max),
            lowest_v: edges(-1.0).fold(f64::INFINITY, f64::min),
            highest_v: edges(1.0).fold(f64::NEG_INFINITY, f64::max),
            half_v,
        };
        band.mean_half_v.is_finite().then_some(band)
    }
}

/// How much a change of the source moves the voltage at the demand of a row: under a power, a lower
/// voltage takes more current, and sinks further; beyond the largest power it has no end.
fn growth(trace: &Trace, demand: Demand, k: usize) -> f64 {
    let (ccv_v, ocv_v) = (trace.ccv_v[k], trace.ocv_v[k]);
    match demand {
        Demand::Power => ccv_v / (2.0 * ccv_v - ocv_v).max(0.0),
        Demand::Current | Demand::Resistance => 1.0,
    }
}

/// Returns √χ²ₙ of [`RUN_PROBABILITY`].
fn factor(terms: usize) -> f64 {
    let (mut low, mut high) = (0.0, 1e3);
    while high - low > 1e-9 {
        let middle = 0.5 * (low + high);
        if chi2_tail(middle * middle, terms as f64) > 1.0 - RUN_PROBABILITY {
            low = middle;
        } else {
            high = middle;
        }
    }
    0.5 * (low + high)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn trace() -> Trace {
        Trace {
            time_s: vec![0.0, 1.0, 3.0],
            ccv_v: vec![7.4, 6.0, 6.4],
            cell_v: vec![3.7, 3.0, 3.2],
            ocv_v: vec![7.4, 7.4, 7.4],
            cell_sigma_v: vec![0.001, 0.004, 0.003],
            ..Trace::default()
        }
    }

    #[test]
    fn the_factor_is_that_of_the_tables_of_chi_squared() {
        for (terms, chi2) in [(1, 3.841_459), (2, 5.991_465), (9, 16.918_978)] {
            assert!((factor(terms) - f64::sqrt(chi2)).abs() < 1e-6, "{terms}");
        }
    }

    #[test]
    fn under_a_current_the_band_is_a_multiple_of_sigma() {
        let band = RunBand::new(&trace(), Demand::Current, 2, RunError::Map, 0.0).unwrap();
        let sigmas = 5.991_465_f64.sqrt();
        for (half_v, sigma_v) in band.half_v.iter().zip([0.001, 0.004, 0.003]) {
            assert!((half_v - sigmas * sigma_v).abs() < 1e-8);
        }
        assert!((band.most_half_v - sigmas * 0.004).abs() < 1e-8);
        assert!((band.mean_half_v - sigmas * (0.0025 + 0.0035 * 2.0) / 3.0).abs() < 1e-8);
        assert!((band.lowest_v - (3.0 - sigmas * 0.004)).abs() < 1e-8);
        assert!((band.highest_v - (3.7 + sigmas * 0.001)).abs() < 1e-8);
    }

    #[test]
    fn under_a_power_the_band_is_wider_and_infinite_at_the_largest_power() {
        let held = RunBand::new(&trace(), Demand::Current, 2, RunError::Map, 0.0).unwrap();
        let power = RunBand::new(&trace(), Demand::Power, 2, RunError::Map, 0.0).unwrap();
        assert!((power.half_v[0] - held.half_v[0]).abs() < 1e-12);
        // 6 V of 7.4 V: 6 / (12 − 7.4).
        assert!((power.half_v[1] / held.half_v[1] - 6.0 / 4.6).abs() < 1e-9);
        // The largest power takes half of the voltage.
        let mut deep = trace();
        deep.ccv_v[1] = 3.7;
        assert_eq!(
            RunBand::new(&deep, Demand::Power, 2, RunError::Map, 0.0),
            None
        );
    }

    #[test]
    fn scattering_cells_add_a_share_of_the_overpotential() {
        let sigma_v = [0.0; 3];
        let error = RunError::Parameters(1, &sigma_v);
        let band = RunBand::new(&trace(), Demand::Current, 2, error, 0.02).unwrap();
        let expected_v = 3.841_459_f64.sqrt() * 0.02 * (3.7 - 3.0);
        assert!((band.half_v[1] - expected_v).abs() < 1e-8);
        let short = RunError::Parameters(1, &sigma_v[..2]);
        assert_eq!(
            RunBand::new(&trace(), Demand::Current, 2, short, 0.02),
            None
        );
    }
}
