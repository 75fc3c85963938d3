//! Noise and code steps of the channels, from rests and constant currents of logs.

use analysis_signal::series::TimeSeries;
use serde::Serialize;

use super::{
    segment::{self, Course, inner, median},
    thresholds::{CODES_PART, FEWEST_STEPS, KEPT_VARIANCE, NEAR_CODES, OFF_CODE},
};

/// Errors of the channels as derived from logs; `None` if the logs do not show them.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Estimate {
    /// White noise of one voltage sample, V.
    pub voltage_noise_v: Option<f64>,
    /// Whether the codes hide the noise of the voltage; the stated value is then an upper bound.
    pub voltage_noise_hidden: bool,
    /// Step of the voltage channel's codes, V.
    pub voltage_resolution_v: Option<f64>,
    /// White noise of one current sample, A.
    pub current_noise_a: Option<f64>,
    /// Whether the codes hide the noise of the current; the stated value is then an upper bound.
    pub current_noise_hidden: bool,
    /// Step of the current channel's codes, A.
    pub current_resolution_a: Option<f64>,
}

/// Noise and codes of these logs: the voltage by rests, the current by constant currents.
pub fn estimate(logs: &[&TimeSeries]) -> Estimate {
    let (mut rest_v, mut constant_a) = (Vec::new(), Vec::new());
    for series in logs {
        for segment in segment::segments(series, None) {
            if segment.rest {
                bends(&series.voltage_v[segment.samples], &mut rest_v);
            } else if segment::course(series, &segment) == Course::Constant {
                bends(&series.current_a[inner(&segment)], &mut constant_a);
            }
        }
    }
    let steps = |of: fn(&TimeSeries) -> &[f64]| -> Vec<f64> {
        let all = logs.iter().flat_map(|series| of(series).windows(2));
        all.map(|pair| (pair[1] - pair[0]).abs()).collect()
    };
    let voltage_resolution_v = code(steps(|series| &series.voltage_v));
    let current_resolution_a = code(steps(|series| &series.current_a));
    let voltage = noise(&rest_v, voltage_resolution_v);
    let current = noise(&constant_a, current_resolution_a);
    Estimate {
        voltage_noise_v: voltage.map(|noise| noise.sigma),
        voltage_noise_hidden: voltage.is_some_and(|noise| noise.hidden),
        voltage_resolution_v,
        current_noise_a: current.map(|noise| noise.sigma),
        current_noise_hidden: current.is_some_and(|noise| noise.hidden),
        current_resolution_a,
    }
}

/// Enters the second differences of a record. A straight drift leaves them.
fn bends(values: &[f64], all: &mut Vec<f64>) {
    let each = values.windows(3).map(|w| w[0] - 2.0 * w[1] + w[2]);
    all.extend(each.filter(|bend| bend.is_finite()));
}

/// Noise of a channel.
#[derive(Clone, Copy)]
struct Noise {
    sigma: f64,
    /// Whether the codes hide it, so that `sigma` is the most that it can be.
    hidden: bool,
}

/// Returns the standard deviation of one sample from second differences. The largest tenth is
/// left out, because the first samples of a relaxation bend. The error of the codes is
/// subtracted.
fn noise(bends: &[f64], code: Option<f64>) -> Option<Noise> {
    if bends.len() < FEWEST_STEPS {
        return None;
    }
    let mut squares: Vec<f64> = bends.iter().map(|bend| bend * bend).collect();
    squares.sort_by(f64::total_cmp);
    squares.truncate(squares.len() - squares.len() / 10);
    #[expect(clippy::cast_precision_loss, reason = "numbers of samples")]
    let count = squares.len() as f64;
    // White noise of σ has second differences of √6 σ.
    let variance = squares.iter().sum::<f64>() / count / 6.0 / KEPT_VARIANCE;
    let of_codes = code.map_or(0.0, |code| code * code / 12.0);
    // Beyond the variance of the codes lies as much again: the noise dithers them.
    let hidden = variance < 2.0 * of_codes;
    let sigma = if hidden {
        of_codes.sqrt()
    } else {
        (variance - of_codes).sqrt()
    };
    Some(Noise { sigma, hidden }).filter(|noise| noise.sigma > 0.0)
}

/// Returns the code step of a channel from the differences of its samples, or `None` if they are
/// not multiples of one step.
fn code(mut steps: Vec<f64>) -> Option<f64> {
    steps.retain(|step| step.is_finite() && *step > 1e-9);
    steps.sort_by(f64::total_cmp);
    if steps.len() < FEWEST_STEPS {
        return None;
    }
    // The smallest one may be rounded down.
    let smallest = steps[steps.len() / 100];
    let first = median(
        steps
            .iter()
            .copied()
            .filter(|step| *step < 1.5 * smallest)
            .collect(),
    );
    let near: Vec<f64> = steps
        .into_iter()
        .filter(|step| *step < NEAR_CODES * first)
        .collect();
    let whole = |step: &&f64| {
        let codes = **step / first;
        codes > 0.5 && (codes - codes.round()).abs() < OFF_CODE
    };
    #[expect(clippy::cast_precision_loss, reason = "numbers of samples")]
    let part = near.iter().filter(whole).count() as f64 / near.len() as f64;
    (near.len() >= FEWEST_STEPS && part >= CODES_PART).then_some(first)
}
