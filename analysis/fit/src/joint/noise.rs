//! The noise of a recorded voltage, measured on its own steady stretches.
//!
//! Samples of a cycler are not independent: some alternate from sample to sample (which averages
//! away faster than 1/n), all wander (which does not average away at all). So no law is assumed:
//! the variance of the mean of n samples is measured as the scatter of such means about a straight
//! line in windows of steady current, as an Allan variance is. Beyond the largest n measured it
//! stays: more samples promise nothing.

use super::pulse::Pulse;
use analysis_signal::series::TimeSeries;

/// Samples of a window.
const WINDOW: usize = 128;
/// Lengths of the means.
const LENGTHS: [usize; 6] = [1, 2, 4, 8, 16, 32];

/// Variance of means of samples.
#[derive(Debug, Clone, PartialEq)]
pub struct NoiseModel {
    /// Variance of the mean of [`LENGTHS`] samples, V².
    variance_v2: [f64; LENGTHS.len()],
    /// Windows it was measured on.
    pub windows: usize,
}

impl NoiseModel {
    /// Measures the noise before the pulses, in windows of 128 samples; `None` if the record has no
    /// such window.
    pub fn measure(series: &TimeSeries, pulses: &[Pulse]) -> Option<Self> {
        let mut sums = [0.0; LENGTHS.len()];
        let mut windows = 0;
        for pulse in pulses {
            // The end of the stretch is farthest from the last edge.
            let mut end = pulse.before.end;
            for _ in 0..8 {
                // No more than the second half, where the last pulse has died away.
                if end < WINDOW + (pulse.before.start + pulse.before.end) / 2 {
                    break;
                }
                let scatter = scatter(series, end - WINDOW);
                sums.iter_mut().zip(scatter).for_each(|(s, v)| *s += v);
                windows += 1;
                end -= WINDOW;
            }
        }
        if windows == 0 {
            return None;
        }
        let mut variance_v2 = sums.map(|s| s / windows as f64);
        // A record of equal values would otherwise count as exact.
        let floor = (1e-9f64).powi(2);
        for k in 0..variance_v2.len() {
            variance_v2[k] = variance_v2[k].max(floor);
            if k > 0 {
                variance_v2[k] = variance_v2[k].min(variance_v2[k - 1]);
            }
        }
        Some(Self {
            variance_v2,
            windows,
        })
    }

    /// Variance of the mean of n neighbouring samples, V².
    pub fn variance_v2(&self, n: usize) -> f64 {
        let last = LENGTHS.len() - 1;
        let k = LENGTHS.iter().rposition(|l| *l <= n.max(1)).unwrap_or(0);
        if k == last {
            return self.variance_v2[last];
        }
        let share = (n as f64 / LENGTHS[k] as f64).ln() / 2f64.ln();
        (self.variance_v2[k].ln() * (1.0 - share) + self.variance_v2[k + 1].ln() * share).exp()
    }

    /// Standard deviation of one sample, V.
    pub fn sample_v(&self) -> f64 {
        self.variance_v2[0].sqrt()
    }

    /// Lower limit of the standard deviation of any mean, V.
    pub fn floor_v(&self) -> f64 {
        self.variance_v2[LENGTHS.len() - 1].sqrt()
    }
}

/// Returns the variances of means of each length about a straight line, corrected for the line's
/// two degrees of freedom.
fn scatter(series: &TimeSeries, start: usize) -> [f64; LENGTHS.len()] {
    let n = WINDOW as f64;
    let samples: Vec<(f64, f64)> = (start..start + WINDOW)
        .map(|k| (series.time_s[k] - series.time_s[start], series.voltage_v[k]))
        .collect();
    let (mt, mv) = (
        samples.iter().map(|s| s.0).sum::<f64>() / n,
        samples.iter().map(|s| s.1).sum::<f64>() / n,
    );
    let stt: f64 = samples.iter().map(|s| (s.0 - mt).powi(2)).sum();
    let slope = samples.iter().map(|s| (s.0 - mt) * (s.1 - mv)).sum::<f64>() / stt;
    let rest: Vec<f64> = samples
        .iter()
        .map(|s| s.1 - mv - slope * (s.0 - mt))
        .collect();
    LENGTHS.map(|length| {
        let means = rest
            .chunks_exact(length)
            .map(|c| c.iter().sum::<f64>() / length as f64);
        let blocks = (WINDOW / length) as f64;
        means.map(|m| m * m).sum::<f64>() / (blocks - 2.0)
    })
}
