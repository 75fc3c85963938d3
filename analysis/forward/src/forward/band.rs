//! The band that holds the voltage of a whole run.
//!
//! The errors of a prediction last: a model that is wrong by some percent of a resistance is so at every
//! instant. With n such errors, none of which changes in a run, the true voltage lies within √χ²ₙ
//! standard deviations at *all* instants together with the probability of χ²ₙ (Scheffé 1953). A band of
//! 1.96 standard deviations holds 95 % of the instants, and fewer whole runs.

use super::law::Demand;
use super::model::SimModel;
use super::trace::Trace;
use analysis_effects::contract::HeldOutError;
use analysis_model::map::{Instant, RUN_PROBABILITY, Unmeasured};
use analysis_numeric::stats::chi_factor;
use serde::Serialize;

/// What is wrong with a prediction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum RunError<'a> {
    /// The stated error of a map ([`CellMap::lasting_errors`](analysis_model::map::CellMap::lasting_errors)).
    Map,
    /// The parameters of a fit: their number, and the standard deviation of the voltage of a cell at each
    /// row, at the demand of the row, V.
    Parameters(usize, &'a [f64]),
    /// What a diagnosis has left unexplained in held-out runs.
    HeldOut(HeldOutError),
}

/// Band that holds the mean voltage of a cell over a whole run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RunBand {
    /// Probability that it holds a whole run.
    pub probability: f64,
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
    /// Returns the band of a run. Cells whose resistances scatter by `cell_share` of them, as a standard
    /// deviation, add that share of the overpotential. `None` if the model states no error, or if a row
    /// has none.
    pub fn new(
        model: &SimModel,
        trace: &Trace,
        demand: Demand,
        error: RunError<'_>,
        cell_share: f64,
    ) -> Option<Self> {
        let losses_v = lasting_losses_v(model, trace);
        let (terms, own_v, unmeasured_v): (usize, Vec<f64>, Vec<f64>) = match error {
            RunError::Map => {
                let at_row = |(k, loss_v): (usize, &f64)| {
                    let sigma_v = map_sigma_v(model, trace, k, *loss_v)?;
                    Some(sigma_v * growth(trace, demand, k))
                };
                let rows = losses_v.iter().enumerate().map(at_row);
                (
                    model.map()?.lasting_errors(),
                    rows.collect::<Option<_>>()?,
                    unmeasured_sigma_v(model, trace),
                )
            }
            RunError::Parameters(count, sigma_v) => {
                (count, sigma_v.to_vec(), vec![0.0; sigma_v.len()])
            }
            RunError::HeldOut(error) => {
                return Self::of_held_out(trace, demand, error, &losses_v, cell_share);
            }
        };
        if own_v.len() != trace.time_s.len() || own_v.is_empty() {
            return None;
        }
        let measured = model
            .map()
            .and_then(|map| map.voltage_error.as_ref()?.whole_runs);
        let sigmas = chi_factor(RUN_PROBABILITY, terms as f64);
        let measured = measured.unwrap_or(1.0);
        let rows = own_v.iter().zip(&losses_v).zip(&unmeasured_v).enumerate();
        let half_v: Vec<f64> = rows
            .map(|(k, ((own_v, loss_v), unmeasured_v))| {
                let others_v = unmeasured_v.hypot(cell_share * loss_v);
                sigmas * (measured * own_v).hypot(others_v * growth(trace, demand, k))
            })
            .collect();
        Self::of_half_widths(trace, half_v, RUN_PROBABILITY)
    }

    /// The band by the largest misses of held-out runs. The cells scatter beside it, by a share of the
    /// overpotentials, V.
    fn of_held_out(
        trace: &Trace,
        demand: Demand,
        error: HeldOutError,
        losses_v: &[f64],
        cell_share: f64,
    ) -> Option<Self> {
        let moved_v = HeldOutError::moved_v(&trace.cell_v);
        let of_cells = chi_factor(RUN_PROBABILITY, 1.0) * cell_share;
        let rows = moved_v.iter().zip(losses_v);
        let half_v = rows.enumerate().map(|(k, (moved_v, loss_v))| {
            (error.share * moved_v + of_cells * loss_v) * growth(trace, demand, k)
        });
        Self::of_half_widths(trace, half_v.collect(), error.probability())
    }

    /// A band of half widths, V, around a run; `None` without rows, or if a row has none.
    fn of_half_widths(trace: &Trace, half_v: Vec<f64>, probability: f64) -> Option<Self> {
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
            probability,
            mean_half_v: area_vs / all_s,
            most_half_v: half_v.iter().copied().fold(0.0, f64::max),
            lowest_v: edges(-1.0).fold(f64::INFINITY, f64::min),
            highest_v: edges(1.0).fold(f64::NEG_INFINITY, f64::max),
            half_v,
        };
        band.mean_half_v.is_finite().then_some(band)
    }
}

/// Standard deviation by the stated error of a map at a row, V, for an overpotential of a cell.
fn map_sigma_v(model: &SimModel, trace: &Trace, k: usize, loss_v: f64) -> Option<f64> {
    let map = model.map()?;
    let at = map.place(trace.soc[k], *trace.temperature_degc.get(k)?);
    let slope_v = model.curve_v(trace.soc[k]).1 / f64::from(model.pack.series);
    map.sigma_v(&at, slope_v, loss_v)
}

/// Standard deviation of the voltage of a cell at each row by what the data of a map show least, V.
fn unmeasured_sigma_v(model: &SimModel, trace: &Trace) -> Vec<f64> {
    let rows = trace.time_s.len();
    let Some(map) = model.map().filter(|_| trace.temperature_degc.len() == rows) else {
        return vec![0.0; rows];
    };
    let (series, parallel) = (f64::from(model.pack.series), f64::from(model.pack.parallel));
    let mut unmeasured = Unmeasured::new(map);
    let of_row = |k: usize| {
        // A run that begins with voltages of its branches has had their current.
        let step_s = match k {
            0 => f64::INFINITY,
            _ => trace.time_s[k] - trace.time_s[k - 1],
        };
        let at = Instant {
            soc: trace.soc[k],
            temperature_degc: trace.temperature_degc[k],
            current_a: trace.current_a[k] / parallel,
        };
        let branch_v = trace.v_rc_v.iter().map(|v| v[k] / series);
        unmeasured.advance(step_s, at, branch_v)
    };
    (0..rows).map(of_row).collect()
}

/// Overpotential of a cell at each row without signs, V: that of the series resistance, and of each
/// branch the largest so far, which fades with its time constant. After a current has changed its sign
/// the parts cancel in the voltage, but their errors do not.
fn lasting_losses_v(model: &SimModel, trace: &Trace) -> Vec<f64> {
    let series = f64::from(model.pack.series);
    let time_constants_s: Vec<f64> = match model.map() {
        Some(map) => map.branches.iter().map(|branch| branch.tau_s).collect(),
        None => model.erm.branches.iter().map(|b| b.r_ohm * b.c_f).collect(),
    };
    let mut lasting_v = vec![0.0_f64; time_constants_s.len().min(trace.v_rc_v.len())];
    let rows = (0..trace.time_s.len()).map(|k| {
        let step_s = trace.time_s[k] - trace.time_s[k.saturating_sub(1)];
        let whole_v = trace.ocv_v[k] / series - trace.cell_v[k];
        let mut of_branches_v = 0.0;
        for (branch, lasting_v) in lasting_v.iter_mut().enumerate() {
            let now_v = trace.v_rc_v[branch][k] / series;
            let faded_v = *lasting_v * (-step_s / time_constants_s[branch]).exp();
            *lasting_v = faded_v.max(now_v.abs());
            of_branches_v += now_v;
        }
        (whole_v - of_branches_v).abs() + lasting_v.iter().sum::<f64>()
    });
    rows.collect()
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::forward::OcvSource;
    use analysis_model::model::{Erm, RcBranch};
    use analysis_model::pack::Pack;

    /// Two cells in series, of a branch of 2 s.
    fn model() -> SimModel {
        let cell = Erm {
            r_ohm: 0.1,
            branches: vec![RcBranch {
                r_ohm: 0.02,
                c_f: 100.0,
            }],
        };
        SimModel::pack(
            &cell,
            OcvSource::Constant(3.7),
            Pack::new(2, 1, 0.0).unwrap(),
        )
        .unwrap()
    }

    /// A discharge, and a rest at which the branch holds 0.2 V of each cell.
    fn trace() -> Trace {
        Trace {
            time_s: vec![0.0, 1.0, 3.0],
            ccv_v: vec![7.4, 6.0, 7.0],
            cell_v: vec![3.7, 3.0, 3.5],
            ocv_v: vec![7.4, 7.4, 7.4],
            v_rc_v: vec![vec![0.0, 0.4, 0.4]],
            ..Trace::default()
        }
    }

    #[test]
    fn the_factor_is_that_of_the_tables_of_chi_squared() {
        for (terms, chi2) in [(1, 3.841_459), (2, 5.991_465), (9, 16.918_978)] {
            let sigmas = chi_factor(RUN_PROBABILITY, terms as f64);
            assert!((sigmas - f64::sqrt(chi2)).abs() < 1e-6, "{terms}");
        }
    }

    #[test]
    fn the_band_is_a_multiple_of_sigma_over_the_run() {
        let sigma_v = [0.001, 0.004, 0.003];
        let error = RunError::Parameters(2, &sigma_v);
        let band = RunBand::new(&model(), &trace(), Demand::Power, error, 0.0).unwrap();
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
    fn under_a_power_a_share_grows_and_is_infinite_at_the_largest_power() {
        let share = |trace: &Trace, demand| {
            let sigma_v = [0.0; 3];
            let error = RunError::Parameters(1, &sigma_v);
            RunBand::new(&model(), trace, demand, error, 0.02)
        };
        let held = share(&trace(), Demand::Current).unwrap();
        let power = share(&trace(), Demand::Power).unwrap();
        // Of 0.7 V, whose parts have one sign.
        let expected_v = 3.841_459_f64.sqrt() * 0.02 * 0.7;
        assert!((held.half_v[1] - expected_v).abs() < 1e-8);
        // 6 V of 7.4 V: 6 / (12 − 7.4).
        assert!((power.half_v[1] / held.half_v[1] - 6.0 / 4.6).abs() < 1e-9);
        // The largest power takes half of the voltage.
        let mut deep = trace();
        deep.ccv_v[1] = 3.7;
        assert_eq!(share(&deep, Demand::Power), None);
    }

    #[test]
    fn what_held_out_runs_show_grows_with_the_movement_of_the_voltage() {
        let error = HeldOutError {
            runs: 4,
            share: 0.05,
        };
        let band = |demand, cell_share| {
            let error = RunError::HeldOut(error);
            RunBand::new(&model(), &trace(), demand, error, cell_share).unwrap()
        };
        let held = band(Demand::Current, 0.0);
        assert_eq!(held.probability, 0.8);
        // 20 mV at the start; the largest movement of 0.7 V stays.
        for (half_v, expected) in held.half_v.iter().zip([0.02, 0.72, 0.72]) {
            assert!((half_v - 0.05 * expected).abs() < 1e-12);
        }
        let power = band(Demand::Power, 0.0);
        assert!((power.half_v[1] / held.half_v[1] - 6.0 / 4.6).abs() < 1e-9);
        let cells = band(Demand::Current, 0.02).half_v[1] - held.half_v[1];
        assert!((cells - 3.841_459_f64.sqrt() * 0.02 * 0.7).abs() < 1e-8);
    }

    #[test]
    fn parts_that_cancel_in_the_voltage_count_in_the_band() {
        let mut crossed = trace();
        // A charge of 0.2 V over the series resistance cancels the branch.
        crossed.cell_v[2] = 3.7;
        crossed.ccv_v[2] = 7.4;
        let losses_v = lasting_losses_v(&model(), &crossed);
        assert!((losses_v[2] - 0.4).abs() < 1e-12, "{losses_v:?}");
        // A branch that a charge has emptied fades with its time constant: 0.2 V after 2 of 2 s.
        crossed.v_rc_v[0][2] = 0.0;
        let losses_v = lasting_losses_v(&model(), &crossed);
        assert!(
            (losses_v[2] - 0.2 * f64::exp(-1.0)).abs() < 1e-12,
            "{losses_v:?}"
        );
    }

    #[test]
    fn rows_without_an_error_have_no_band() {
        let error = RunError::Parameters(1, &[0.0; 2]);
        assert_eq!(
            RunBand::new(&model(), &trace(), Demand::Current, error, 0.02),
            None
        );
        assert_eq!(
            RunBand::new(&model(), &trace(), Demand::Current, RunError::Map, 0.0),
            None
        );
    }
}
