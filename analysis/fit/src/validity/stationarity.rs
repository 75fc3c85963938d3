//! Tests whether the cell changed during the measurement: from repeats of one sweep in their order
//! of time, and from the drift within the records.

use super::noise::{Noise, NoiseSource};
use super::tail::{holm, pair_tail, sum_tail};
use super::{FALSE_ALARM_RATE, same_grid};
use analysis_signal::spectrum::Spectrum;
use num_complex::Complex64;
use serde::Serialize;
use std::f64::consts::PI;

/// Repeats at one frequency.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct StationarityPoint {
    /// Frequency, Hz.
    pub freq_hz: f64,
    /// Standard deviation of a part of Z between repeats, % of |Z|.
    pub scatter_percent: f64,
    /// Standard deviation that the spectra state or show within themselves, %; `None` if the
    /// repeats gave it.
    pub noise_percent: Option<f64>,
    /// Scatter beyond the noise, %; zero if there is none.
    pub excess_percent: Option<f64>,
    /// Probability of such a scatter by noise alone, corrected for the number of frequencies.
    pub p_scatter: Option<f64>,
    /// Change from the first to the last repeat by a straight line, % of |Z|; `None` for two
    /// repeats.
    pub trend_percent: Option<f64>,
    /// Probability of such a line by scatter alone, corrected for the number of frequencies.
    pub p_trend: Option<f64>,
}

/// Comparison of repeats.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Stationarity {
    /// Names of the repeats, in order of time.
    pub repeats: Vec<String>,
    /// Deviation of each repeat from the mean of all over the whole band, %.
    pub shift_percent: Vec<f64>,
    /// Root mean square over the band of the scatter beyond the noise, %; `None` if the repeats
    /// gave the noise.
    pub excess_percent: Option<f64>,
    /// The points, by rising frequency.
    pub points: Vec<StationarityPoint>,
}

impl StationarityPoint {
    /// The repeats differ by more than noise explains.
    pub fn scatters(&self) -> bool {
        self.p_scatter.is_some_and(|p| p < FALSE_ALARM_RATE)
    }

    /// The repeats follow a line in time.
    pub fn drifts(&self) -> bool {
        self.p_trend.is_some_and(|p| p < FALSE_ALARM_RATE)
    }
}

/// Data of one frequency before the judgement: relative deviations from the mean.
struct Column {
    deviations: Vec<Complex64>,
    /// Variance of a part that noise explains, relative to |Z|².
    noise: f64,
    slope: Complex64,
    /// Sum of squares about the line.
    rest: f64,
}

/// Compares repeats on one grid, in order of time; `None` for fewer than two.
pub fn stationarity(repeats: &[&Spectrum], noises: &[&Noise]) -> Option<Stationarity> {
    let first = repeats.first()?;
    if repeats.len() < 2 || !repeats.iter().all(|r| same_grid(r, first)) {
        return None;
    }
    let count = repeats.len() as f64;
    let columns: Vec<Column> = (0..first.points.len())
        .map(|k| column(repeats, noises, k))
        .collect();
    let independent = noises.iter().all(|n| n.source != NoiseSource::Repeats);
    let noise_dof = noises.iter().filter_map(|n| n.dof).reduce(|a, b| a + b);
    let line_dof = 2.0 * (count - 2.0) * columns.len() as f64;
    let about_lines = columns.iter().map(|c| c.rest).sum::<f64>() / line_dof;
    let spread: f64 = (0..repeats.len())
        .map(|k| (k as f64 - 0.5 * (count - 1.0)).powi(2))
        .sum();
    let mut points: Vec<StationarityPoint> = Vec::new();
    for (c, p) in columns.iter().zip(&first.points) {
        let sum: f64 = c.deviations.iter().map(Complex64::norm_sqr).sum();
        let dof = 2.0 * (count - 1.0);
        let trend = (count > 2.0)
            .then(|| pair_tail(c.slope.norm_sqr() * spread / about_lines, Some(line_dof)));
        points.push(StationarityPoint {
            freq_hz: p.freq_hz,
            scatter_percent: 100.0 * (sum / dof).sqrt(),
            noise_percent: independent.then_some(100.0 * c.noise.sqrt()),
            excess_percent: independent.then(|| 100.0 * (sum / dof - c.noise).max(0.0).sqrt()),
            p_scatter: independent.then(|| sum_tail(sum / c.noise, dof, noise_dof)),
            trend_percent: trend.map(|_| 100.0 * c.slope.norm() * (count - 1.0)),
            p_trend: trend,
        });
    }
    correct(&mut points);
    let shift = |r: usize| {
        100.0 * columns.iter().map(|c| c.deviations[r].re).sum::<f64>() / columns.len() as f64
    };
    let mean_square = |p: &StationarityPoint| p.excess_percent.map(|e| e * e);
    let excess: Option<f64> = points.iter().map(mean_square).sum();
    Some(Stationarity {
        repeats: repeats.iter().map(|r| r.name.clone()).collect(),
        shift_percent: (0..repeats.len()).map(shift).collect(),
        excess_percent: excess.map(|e| (e / points.len() as f64).sqrt()),
        points,
    })
}

fn column(repeats: &[&Spectrum], noises: &[&Noise], k: usize) -> Column {
    let count = repeats.len() as f64;
    let mean = repeats.iter().map(|r| r.points[k].z_ohm).sum::<Complex64>() / count;
    let deviations: Vec<Complex64> = repeats
        .iter()
        .map(|r| r.points[k].z_ohm / mean - 1.0)
        .collect();
    let place = |r: usize| r as f64 - 0.5 * (count - 1.0);
    let spread: f64 = (0..repeats.len()).map(|r| place(r).powi(2)).sum();
    let slope = deviations
        .iter()
        .enumerate()
        .map(|(r, d)| d * place(r))
        .sum::<Complex64>()
        / spread;
    let rest = deviations
        .iter()
        .enumerate()
        .map(|(r, d)| (d - slope * place(r)).norm_sqr())
        .sum();
    let variance =
        |n: &&Noise| 0.5 * (n.covariance[k].re_re + n.covariance[k].im_im) / mean.norm_sqr();
    Column {
        noise: noises.iter().map(variance).sum::<f64>() / count,
        deviations,
        slope,
        rest,
    }
}

/// Corrects the probabilities for the number of frequencies.
fn correct(points: &mut [StationarityPoint]) {
    let scatter: Option<Vec<f64>> = points.iter().map(|p| p.p_scatter).collect();
    let trend: Option<Vec<f64>> = points.iter().map(|p| p.p_trend).collect();
    let (scatter, trend) = (scatter.map(|p| holm(&p)), trend.map(|p| holm(&p)));
    for (k, point) in points.iter_mut().enumerate() {
        point.p_scatter = scatter.as_ref().map(|p| p[k]);
        point.p_trend = trend.as_ref().map(|p| p[k]);
    }
}

/// Drift of a channel's offset within a record, as far as the fit of the sine did not take it out.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Drift {
    /// Change of the offset, relative to the amplitude: over the record for a ramp, from its middle
    /// to its ends for a bend.
    pub over_amplitude: f64,
    /// Periods in the record.
    pub periods: f64,
    /// Shape of the drift.
    pub shape: DriftShape,
}

/// Shape of the drift that a fit left.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum DriftShape {
    /// A straight line: the sine was fitted without a trend.
    Ramp,
    /// A parabola: the sine was fitted with a straight line.
    Bend,
}

impl Drift {
    /// Largest error that the drift gives to Z, %: the Fourier coefficient at the n-th harmonic of
    /// the record, d/(πn) of a ramp of height d and 4d/(πn)² of a parabola that bends by d.
    pub fn error_percent(&self) -> f64 {
        let turn = PI * self.periods;
        100.0
            * match self.shape {
                DriftShape::Ramp => self.over_amplitude.abs() / turn,
                DriftShape::Bend => 4.0 * self.over_amplitude.abs() / (turn * turn),
            }
    }
}
