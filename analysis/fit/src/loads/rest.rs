//! The rest before a load: its voltage, and whether that stands still.

use analysis_signal::series::TimeSeries;
use serde::Serialize;

use super::{
    segment::{Segment, median},
    thresholds::{FEWEST_OF_SLOPE, REST_VOLTAGE_S, REST_WINDOW_S, STEEPEST_V_PER_S},
};

/// Rest before a load.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Rest {
    /// Its duration, s.
    pub duration_s: f64,
    /// Voltage at its end, V.
    pub voltage_v: f64,
    /// Residual slope of the voltage at its end, V/s.
    pub slope_v_per_s: f64,
    /// Standard uncertainty of the slope, V/s.
    pub slope_sigma_v_per_s: f64,
}

impl Rest {
    /// Residual slope in mV per minute, rounded so that nothing has no sign.
    pub fn slope_mv_per_min(&self) -> f64 {
        (6e6 * self.slope_v_per_s).round() / 1e2 + 0.0
    }
}

/// Why a rest does not serve as the start of a run.
pub(crate) fn unfit(rest: &Rest, shortest_s: f64) -> Option<String> {
    if rest.duration_s < shortest_s {
        return Some(format!(
            "the rest before it is logged for {:.1} s, less than {:.1} s",
            rest.duration_s, shortest_s
        ));
    }
    let sure = rest.slope_v_per_s.abs() - 2.0 * rest.slope_sigma_v_per_s;
    if sure > STEEPEST_V_PER_S {
        return Some(format!(
            "the voltage before it still moves by {:.2} mV per minute",
            rest.slope_mv_per_min()
        ));
    }
    None
}

/// A rest that a load ends at this time.
pub(crate) fn rest_of(series: &TimeSeries, rest: &Segment, load_s: f64) -> Rest {
    let time_s = &series.time_s[rest.samples.clone()];
    let voltage_v = &series.voltage_v[rest.samples.clone()];
    let duration_s = load_s - time_s[0];
    let late = |window_s: f64| time_s.partition_point(|t| *t < load_s - window_s);
    // A slow log has less than a few samples in the window.
    let begin = late(REST_WINDOW_S).min(time_s.len().saturating_sub(FEWEST_OF_SLOPE));
    let end = begin.max(late(REST_VOLTAGE_S)).min(time_s.len() - 1);
    let (slope, sigma) = slope(&time_s[begin..], &voltage_v[begin..]);
    Rest {
        duration_s,
        voltage_v: median(voltage_v[end..].to_vec()),
        slope_v_per_s: slope,
        slope_sigma_v_per_s: sigma,
    }
}

/// Returns the slope of a straight line and its standard uncertainty; both are 0 if there are too
/// few samples.
fn slope(time_s: &[f64], voltage_v: &[f64]) -> (f64, f64) {
    let (t0, v0) = (mean(time_s), mean(voltage_v));
    let sum = |of: &dyn Fn(f64, f64) -> f64| -> f64 {
        let pairs = time_s.iter().zip(voltage_v);
        pairs
            .map(|(t, v)| of(t - t0, v - v0))
            .filter(|x| x.is_finite())
            .sum()
    };
    let spread = sum(&|t, _| t * t);
    if time_s.len() < 3 || spread <= 0.0 {
        return (0.0, 0.0);
    }
    let slope = sum(&|t, v| t * v) / spread;
    let rest = sum(&|t, v| (v - slope * t).powi(2));
    #[expect(clippy::cast_precision_loss, reason = "numbers of samples")]
    let freedom = (time_s.len() - 2) as f64;
    (slope, (rest / freedom / spread).sqrt())
}

/// Mean of the finite values; 0 if there are none.
pub(crate) fn mean(values: &[f64]) -> f64 {
    let finite: Vec<f64> = values.iter().copied().filter(|v| v.is_finite()).collect();
    #[expect(clippy::cast_precision_loss, reason = "numbers of samples")]
    let count = finite.len().max(1) as f64;
    finite.iter().sum::<f64>() / count
}
