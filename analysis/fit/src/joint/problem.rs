//! The likelihood: whitened residuals of the mean spectrum and of every pulse, and the priors of
//! the instruments' parameters.
//!
//! Parameters: ln R, ln R₁, ln C₁, …; ln g, the pulses' resistance over the spectra's (another
//! cell, another instrument); e, where between two samples the edge of the current is (0 at the
//! earlier, 1 at the later sample).

use super::pooled::PooledSpectrum;
use super::window::PulseWindow;
use analysis_model::model::Erm;
use analysis_numeric::Smooth;

/// Mean and standard deviation of the place of an edge, if only the two samples around it are
/// known.
pub(super) const EDGE: (f64, f64) = (0.5, 0.288_675_134_594_812_9);

/// Likelihood to minimise: χ² of spectra and pulses, and of the priors.
pub(super) struct Likelihood<'a> {
    pub(super) spectrum: &'a PooledSpectrum,
    /// Cholesky factor of the covariance of its points.
    pub(super) factor: Vec<f64>,
    pub(super) windows: &'a [PulseWindow],
    /// Standard deviation of ln g.
    pub(super) gain_sigma: f64,
}

/// A whitened residual and its derivatives.
type Residual = (f64, Vec<f64>);

impl Likelihood<'_> {
    /// Residuals of the spectrum, two per point.
    pub(super) fn spectral(&self, x: &[f64]) -> Vec<Residual> {
        let Some(erm) = erm(x) else { return Vec::new() };
        let n = 2 * self.spectrum.points.len();
        let mut values = Vec::with_capacity(n);
        let mut columns = vec![Vec::with_capacity(n); x.len()];
        for p in &self.spectrum.points {
            let z = erm.impedance(p.freq_hz) - p.z_ohm;
            values.extend([z.re, z.im]);
            let slopes = erm.log_gradient(p.freq_hz);
            for (i, column) in columns.iter_mut().enumerate() {
                let slope = slopes.get(i).copied().unwrap_or_default();
                column.extend([slope.re, slope.im]);
            }
        }
        self.whiten(&mut values);
        columns[..x.len() - 2]
            .iter_mut()
            .for_each(|column| self.whiten(column));
        values
            .into_iter()
            .enumerate()
            .map(|(k, v)| (v, columns.iter().map(|c| c[k]).collect()))
            .collect()
    }

    /// Divides by the Cholesky factor of the points' covariance.
    fn whiten(&self, values: &mut [f64]) {
        let n = values.len();
        for i in 0..n {
            let row = &self.factor[i * n..i * n + i];
            let known: f64 = row.iter().zip(&values[..i]).map(|(l, v)| l * v).sum();
            values[i] = (values[i] - known) / self.factor[i * n + i];
        }
    }

    /// Residuals of all pulses, one per bin.
    pub(super) fn temporal(&self, x: &[f64]) -> Vec<Residual> {
        let Some(erm) = erm(x) else { return Vec::new() };
        let (gain, edge) = (x[x.len() - 2].exp(), x[x.len() - 1]);
        let mut all = Vec::new();
        for window in self.windows {
            let model = window.model(&erm, gain, edge);
            let start = window.bins[0].voltage_v;
            let mut values: Vec<f64> = window
                .bins
                .iter()
                .zip(&model)
                .map(|(b, m)| m.0 - (b.voltage_v - start))
                .collect();
            window.whiten(&mut values);
            let mut columns: Vec<Vec<f64>> = (0..x.len())
                .map(|i| model.iter().map(|m| m.1[i]).collect())
                .collect();
            columns.iter_mut().for_each(|c| window.whiten(c));
            all.extend(
                values
                    .iter()
                    .enumerate()
                    .map(|(k, v)| (*v, columns.iter().map(|c| c[k]).collect())),
            );
        }
        all
    }

    /// Residuals of the priors.
    pub(super) fn prior(&self, x: &[f64]) -> [Residual; 2] {
        let n = x.len();
        let unit = |i: usize, sigma: f64| {
            (0..n)
                .map(|k| if k == i { 1.0 / sigma } else { 0.0 })
                .collect::<Vec<f64>>()
        };
        [
            (x[n - 2] / self.gain_sigma, unit(n - 2, self.gain_sigma)),
            ((x[n - 1] - EDGE.0) / EDGE.1, unit(n - 1, EDGE.1)),
        ]
    }

    fn all(&self, x: &[f64]) -> Vec<Residual> {
        let mut all = self.spectral(x);
        all.extend(self.temporal(x));
        all.extend(self.prior(x));
        all
    }
}

/// JᵀJ of residuals of n parameters, row-major.
pub(super) fn information(residuals: &[Residual], n: usize) -> Vec<f64> {
    let mut sum = vec![0.0; n * n];
    for (_, slopes) in residuals {
        for i in 0..n {
            for j in 0..n {
                sum[i * n + j] += slopes[i] * slopes[j];
            }
        }
    }
    sum
}

/// Σr².
pub(super) fn square(residuals: &[Residual]) -> f64 {
    residuals.iter().map(|r| r.0 * r.0).sum()
}

pub(super) fn erm(x: &[f64]) -> Option<Erm> {
    Erm::from_log_parameters(x.get(..x.len().checked_sub(2)?)?).ok()
}

impl Smooth for Likelihood<'_> {
    fn value(&self, x: &[f64]) -> f64 {
        let Some(erm) = erm(x) else {
            return f64::INFINITY;
        };
        let (gain, edge) = (x[x.len() - 2].exp(), x[x.len() - 1]);
        let mut sum = square(&self.spectral(x)) + square(&self.prior(x));
        for window in self.windows {
            let start = window.bins[0].voltage_v;
            let voltages = window.voltages(&erm, gain, edge);
            let mut values: Vec<f64> = window
                .bins
                .iter()
                .zip(voltages)
                .map(|(b, v)| v - (b.voltage_v - start))
                .collect();
            window.whiten(&mut values);
            sum += values.iter().map(|v| v * v).sum::<f64>();
        }
        sum
    }

    fn expand(&self, x: &[f64], gradient: &mut [f64], hessian: &mut [f64]) -> f64 {
        let all = self.all(x);
        let n = x.len();
        gradient.fill(0.0);
        for (r, slopes) in &all {
            gradient
                .iter_mut()
                .zip(slopes)
                .for_each(|(g, s)| *g += 2.0 * r * s);
        }
        // Gauss and Newton's: positive semidefinite, and exact where the residuals are small.
        hessian
            .iter_mut()
            .zip(information(&all, n))
            .for_each(|(h, v)| *h = 2.0 * v);
        square(&all)
    }
}
