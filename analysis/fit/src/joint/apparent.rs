//! The resistance that a pulse shows a time after its edge.

use super::noise::NoiseModel;
use super::pulse::Pulse;
use analysis_signal::series::TimeSeries;

/// Apparent resistance of a pulse a time after its edge.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Apparent {
    /// Time after [`Pulse::start_s`], s.
    pub time_s: f64,
    /// Voltage lost since the edge over the step of current, Ω. The fall of the OCV is in it.
    pub resistance_ohm: f64,
    /// Standard uncertainty by the noise of the voltages, Ω.
    pub sigma_ohm: f64,
}

/// Duration of steady current from which the voltage at the edge is extrapolated, s.
const BASELINE_S: f64 = 20.0;

/// Apparent resistance after a time: the straight line through the last 20 s before the edge,
/// extrapolated to the edge, less the mean of the samples within ±(50 ms + a tenth of the time).
/// `None` without samples there.
pub fn apparent(
    series: &TimeSeries,
    pulse: &Pulse,
    time_s: f64,
    noise: &NoiseModel,
) -> Option<Apparent> {
    let (start, half) = (pulse.start_s(), 0.05 + 0.1 * time_s);
    let near: Vec<usize> = pulse
        .during
        .clone()
        .filter(|k| (series.time_s[*k] - start - time_s).abs() <= half)
        .collect();
    let base: Vec<usize> = pulse
        .before
        .clone()
        .rev()
        .take_while(|k| start - series.time_s[*k] <= BASELINE_S)
        .collect();
    if near.is_empty() || base.len() < 3 {
        return None;
    }
    let n = near.len() as f64;
    let mean = |f: &dyn Fn(usize) -> f64| near.iter().map(|k| f(*k)).sum::<f64>() / n;
    let (voltage, step) = (
        mean(&|k| series.voltage_v[k]),
        mean(&|k| series.current_a[k]) - pulse.current_a[0],
    );
    let at_edge = line_at(series, &base, start);
    // A straight line at the end of its support is four times as uncertain (in variance) as its
    // mean.
    let variance = noise.variance_v2(near.len()) + 4.0 * noise.variance_v2(base.len());
    Some(Apparent {
        time_s,
        resistance_ohm: (at_edge - voltage) / step,
        sigma_ohm: variance.sqrt() / step.abs(),
    })
}

/// The straight line through samples, at a time, V.
fn line_at(series: &TimeSeries, samples: &[usize], at_s: f64) -> f64 {
    let n = samples.len() as f64;
    let t = |k: &usize| series.time_s[*k] - at_s;
    let (mt, mv) = (
        samples.iter().map(t).sum::<f64>() / n,
        samples.iter().map(|k| series.voltage_v[*k]).sum::<f64>() / n,
    );
    let stt: f64 = samples.iter().map(|k| (t(k) - mt).powi(2)).sum();
    let stv: f64 = samples
        .iter()
        .map(|k| (t(k) - mt) * (series.voltage_v[*k] - mv))
        .sum();
    mv - stv / stt.max(f64::MIN_POSITIVE) * mt
}
