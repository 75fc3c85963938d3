//! The mean of repeated sweeps over several cells, with the scatter within a cell and between
//! cells.
//!
//! Cells differ mostly by a factor; what differs besides is scatter. The mean spectrum carries the
//! scatter of the cells' means after their factors are taken out (with one cell: of the repeats)
//! over their number. The factor's spread does not blur the mean of *these* cells, but says how far
//! another cell may be from it.

use analysis_numeric::{Covariance2, linalg::cholesky};
use analysis_signal::spectrum::{SharedError, SourcedSpectrum};
use num_complex::Complex64;

/// Relative uncertainty assumed per part if the data give none.
const ASSUMED: f64 = 0.005;
/// Frequencies to each side over which the relative scatter is averaged.
const NEIGHBOURS: usize = 2;

/// One point of the mean.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PooledPoint {
    /// Frequency, Hz.
    pub freq_hz: f64,
    /// Mean impedance, Ω.
    pub z_ohm: Complex64,
    /// Covariance of the mean, Ω².
    pub covariance: Covariance2,
}

/// The mean of spectra.
#[derive(Debug, Clone, PartialEq)]
pub struct PooledSpectrum {
    /// Points by rising frequency.
    pub points: Vec<PooledPoint>,
    /// Sweeps.
    pub sweeps: usize,
    /// Cells.
    pub cells: usize,
    /// Relative standard deviation of a cell's factor; none for one cell.
    pub cell_spread: Option<f64>,
    /// Relative standard deviation of one sweep within its cell; none without repeats.
    pub repeatability: Option<f64>,
    /// Source of the uncertainty, in words.
    pub basis: String,
    /// Errors that the points have in common; their shares are not in the covariances of the
    /// points.
    pub shared: Vec<SharedError>,
}

/// Reason why spectra have no mean.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum PooledError {
    /// No spectrum or no point.
    #[error("expected at least one spectrum with points, met none")]
    Empty,
    /// Frequencies that do not match.
    #[error(
        "spectrum {name:?}: expected the {expected} frequencies of {first:?}, met others ({met})"
    )]
    Frequencies {
        /// The spectrum.
        name: String,
        /// The first spectrum.
        first: String,
        /// Number of frequencies of the first.
        expected: usize,
        /// Number met.
        met: usize,
    },
}

impl PooledSpectrum {
    /// Pools spectra of one kind of cell, all at the same frequencies. The file or a name such as
    /// `cell0_3` identifies the cell of a spectrum; a spectrum without one is a cell of its own.
    ///
    /// # Errors
    /// [`PooledError`] for no spectra or frequencies that differ.
    pub fn new(spectra: &[SourcedSpectrum]) -> Result<Self, PooledError> {
        let first = spectra
            .first()
            .filter(|s| !s.spectrum.points.is_empty())
            .ok_or(PooledError::Empty)?;
        let freqs: Vec<f64> = first.spectrum.points.iter().map(|p| p.freq_hz).collect();
        for s in spectra {
            let points = &s.spectrum.points;
            let same = points.len() == freqs.len()
                && points
                    .iter()
                    .zip(&freqs)
                    .all(|(p, f)| (p.freq_hz / f - 1.0).abs() < 1e-6);
            if !same {
                let (name, first) = (s.spectrum.name.clone(), first.spectrum.name.clone());
                return Err(PooledError::Frequencies {
                    name,
                    first,
                    expected: freqs.len(),
                    met: points.len(),
                });
            }
        }
        let cells = by_cell(spectra);
        let sweeps = spectra.len();
        let means: Vec<Vec<Complex64>> = cells
            .iter()
            .map(|(_, members)| mean(members.iter().map(|s| z(s))))
            .collect();
        let weights: Vec<f64> = cells
            .iter()
            .map(|(_, members)| members.len() as f64 / sweeps as f64)
            .collect();
        let total: Vec<Complex64> = (0..freqs.len())
            .map(|f| means.iter().zip(&weights).map(|(m, w)| m[f] * w).sum())
            .collect();
        let factors: Vec<f64> = means.iter().map(|m| factor(m, &total)).collect();
        let within: Vec<Vec<Complex64>> = cells
            .iter()
            .zip(&means)
            .flat_map(|((_, members), m)| members.iter().map(|s| relative(&z(s), m)))
            .collect();
        let between: Vec<Vec<Complex64>> = means
            .iter()
            .zip(&factors)
            .map(|(m, g)| relative(m, &total.iter().map(|z| z * g).collect::<Vec<_>>()))
            .collect();
        let pooled = Pool {
            spectra,
            total: &total,
            within: &within,
            between: &between,
        };
        let (relative, basis) = pooled.uncertainty(cells.len());
        let point = |(k, z_ohm): (usize, &Complex64)| PooledPoint {
            freq_hz: freqs[k],
            z_ohm: *z_ohm,
            covariance: relative[k].scaled(*z_ohm),
        };
        Ok(Self {
            points: total.iter().enumerate().map(point).collect(),
            sweeps,
            cells: cells.len(),
            cell_spread: (cells.len() > 1).then(|| deviation(&factors)),
            repeatability: (sweeps > cells.len())
                .then(|| rms(&within) * (sweeps as f64 / (sweeps - cells.len()) as f64).sqrt()),
            basis,
            shared: shared(spectra, freqs.len()),
        })
    }

    /// Cholesky factor of the covariance of all points, real and imaginary parts in turn, row by
    /// row; `None` if the covariance is not positive definite.
    pub(super) fn factor(&self) -> Option<Vec<f64>> {
        let n = 2 * self.points.len();
        let mut covariance = vec![0.0; n * n];
        for (k, point) in self.points.iter().enumerate() {
            let (a, b, c) = (2 * k, 2 * k + 1, point.covariance);
            covariance[a * n + a] = c.re_re;
            covariance[b * n + b] = c.im_im.max(c.re_im * c.re_im / c.re_re * (1.0 + 1e-6));
            covariance[a * n + b] = c.re_im;
            covariance[b * n + a] = c.re_im;
        }
        for error in &self.shared {
            let d: Vec<f64> = error.at_ohm.iter().flat_map(|d| [d.re, d.im]).collect();
            (0..n * n).for_each(|ij| covariance[ij] += d[ij / n] * d[ij % n]);
        }
        cholesky(&mut covariance, n).then_some(covariance)
    }
}

/// Returns the errors that sweeps share, at the points of their mean. An error of only some sweeps
/// counts proportionally.
fn shared(spectra: &[SourcedSpectrum], points: usize) -> Vec<SharedError> {
    let mut all: Vec<SharedError> = Vec::new();
    let share = 1.0 / spectra.len() as f64;
    for error in spectra.iter().flat_map(|s| &s.spectrum.shared) {
        let place = all
            .iter()
            .position(|known| known.name == error.name)
            .unwrap_or_else(|| {
                all.push(SharedError {
                    name: error.name.clone(),
                    at_ohm: vec![Complex64::ZERO; points],
                });
                all.len() - 1
            });
        all[place]
            .at_ohm
            .iter_mut()
            .zip(&error.at_ohm)
            .for_each(|(sum, d)| *sum += d * share);
    }
    all
}

struct Pool<'a> {
    spectra: &'a [SourcedSpectrum],
    total: &'a [Complex64],
    within: &'a [Vec<Complex64>],
    between: &'a [Vec<Complex64>],
}

impl Pool<'_> {
    /// Relative covariance of the mean at each frequency, and its origin in words.
    fn uncertainty(&self, cells: usize) -> (Vec<Covariance2>, String) {
        let sweeps = self.spectra.len();
        let shrink = |c: Covariance2, f: f64| c.scaled(Complex64::new(f.sqrt(), 0.0));
        if cells >= 3 {
            // One freedom goes to the mean and one, over all frequencies, to the factors.
            let scale = 1.0 / (cells as f64 * (cells - 1) as f64);
            let all = smoothed(self.between)
                .into_iter()
                .map(|c| shrink(c, scale))
                .collect();
            return (
                all,
                format!("scatter of {cells} cells ({sweeps} sweeps), their factors taken out"),
            );
        }
        if sweeps >= cells + 2 {
            let scale = 1.0 / (sweeps as f64 * (sweeps - cells) as f64);
            let all = smoothed(self.within)
                .into_iter()
                .map(|c| shrink(c, scale))
                .collect();
            return (
                all,
                format!("scatter of {sweeps} sweeps within {cells} cell(s)"),
            );
        }
        let stated = |k: usize| {
            let sum = self.spectra.iter().fold(Covariance2::ZERO, |sum, s| {
                sum + s.spectrum.own_covariance(k)
            });
            shrink(
                sum.scaled(self.total[k].inv()),
                1.0 / (sweeps * sweeps) as f64,
            )
        };
        let all: Vec<Covariance2> = (0..self.total.len()).map(stated).collect();
        if all
            .iter()
            .all(|c| c.is_valid() && c.re_re > 0.0 && c.im_im > 0.0)
        {
            return (all, "as the files state it".to_owned());
        }
        let assumed = Covariance2::circular(ASSUMED * ASSUMED / sweeps as f64);
        (
            vec![assumed; self.total.len()],
            format!(
                "assumed, {} % of |Z| per part: neither repeats nor files give it",
                100.0 * ASSUMED
            ),
        )
    }
}

/// Sums of products of relative residuals per frequency, averaged over neighbours.
fn smoothed(residuals: &[Vec<Complex64>]) -> Vec<Covariance2> {
    let n = residuals.first().map_or(0, Vec::len);
    let at = |k: usize| {
        residuals
            .iter()
            .fold(Covariance2::ZERO, |sum, r| sum + Covariance2::along(r[k]))
    };
    (0..n)
        .map(|k| {
            let (low, high) = (k.saturating_sub(NEIGHBOURS), (k + NEIGHBOURS).min(n - 1));
            let sum = (low..=high).map(at).fold(Covariance2::ZERO, |a, b| a + b);
            sum.scaled(Complex64::new(
                ((high - low + 1) as f64).sqrt().recip(),
                0.0,
            ))
        })
        .collect()
}

fn by_cell(spectra: &[SourcedSpectrum]) -> Vec<(String, Vec<&SourcedSpectrum>)> {
    let mut cells: Vec<(String, Vec<&SourcedSpectrum>)> = Vec::new();
    for s in spectra {
        let key = s.cell().unwrap_or(&s.spectrum.name).to_owned();
        match cells.iter_mut().find(|(k, _)| *k == key) {
            Some((_, members)) => members.push(s),
            None => cells.push((key, vec![s])),
        }
    }
    cells
}

fn z(s: &SourcedSpectrum) -> Vec<Complex64> {
    s.spectrum.points.iter().map(|p| p.z_ohm).collect()
}

fn mean(spectra: impl ExactSizeIterator<Item = Vec<Complex64>>) -> Vec<Complex64> {
    let share = 1.0 / spectra.len() as f64;
    let mut sum: Vec<Complex64> = Vec::new();
    for s in spectra {
        sum.resize(s.len(), Complex64::ZERO);
        sum.iter_mut().zip(&s).for_each(|(a, b)| *a += b * share);
    }
    sum
}

/// The real factor that brings the mean of all closest to one cell's.
fn factor(cell: &[Complex64], total: &[Complex64]) -> f64 {
    cell.iter().zip(total).map(|(a, b)| (a / b).re).sum::<f64>() / cell.len() as f64
}

fn relative(a: &[Complex64], b: &[Complex64]) -> Vec<Complex64> {
    a.iter().zip(b).map(|(a, b)| a / b - 1.0).collect()
}

fn deviation(values: &[f64]) -> f64 {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt()
}

/// Root mean square of a part.
fn rms(residuals: &[Vec<Complex64>]) -> f64 {
    let all = residuals.iter().flatten();
    let count = all.clone().count().max(1) as f64;
    (all.map(Complex64::norm_sqr).sum::<f64>() / (2.0 * count)).sqrt()
}
