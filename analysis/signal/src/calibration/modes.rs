//! Common error of a correction: a few independent errors that all impedances of one run share.
//!
//! The covariance of the harness' parameters is C = LLᵀ. An error of one standard deviation along a
//! column of L moves every point along the derivatives of its impedance. A singular value
//! decomposition of these directions, each over the noise of its point, orders them by their effect
//! on a spectrum; a direction without effect is left out and stays noise of the single points.

use nalgebra::{DMatrix, SymmetricEigen};
use num_complex::Complex64;

use super::Correction;
use super::model::{COUNT, Harness};
use crate::spectrum::{ChannelPhasors, SharedError, Spectrum};

/// Least sum over all points of (deviation over noise)² that makes an error worth carrying: it
/// would change a χ² by this much.
const LEAST: f64 = 1e-2;

/// Impedance of a cell over that of the control: the 3.75 mΩ of the thesis' fake cell represent
/// cells of 10 mΩ.
const FACTOR: f64 = 3.0;
const SPAN: [Complex64; 3] = [
    Complex64::ZERO,
    Complex64::new(FACTOR, 0.0),
    Complex64::new(0.0, FACTOR),
];

/// Independent errors of a correction, common to all spectra that it corrects.
#[derive(Debug, Clone, PartialEq)]
pub struct CorrectionModes {
    run: String,
    /// Change of the harness' parameters by one standard deviation of each error.
    modes: Vec<[f64; COUNT]>,
}

impl CorrectionModes {
    /// Returns the errors that matter to impedances in the jig. `control` is a sweep of a known
    /// impedance; without it all errors are kept. `run` names the run: errors of two runs are
    /// different.
    ///
    /// The error of an impedance is affine in it. A short, an impedance three times that of the
    /// control and one rotated by 90° therefore span every cell. The control alone would not
    /// suffice, because the correction is fitted to be right on it.
    pub fn new(correction: &Correction, control: &[ChannelPhasors], run: &str) -> Self {
        let roots = root(&correction.covariance);
        let run = run.to_owned();
        if control.is_empty() {
            let modes = roots
                .into_iter()
                .filter(|column| column.iter().any(|change| *change != 0.0))
                .collect();
            return Self { run, modes };
        }
        let sweep: Vec<ChannelPhasors> = SPAN
            .iter()
            .flat_map(|factor| control.iter().map(|phasors| across(phasors, *factor)))
            .collect();
        let mut rows = DMatrix::zeros(2 * sweep.len(), COUNT);
        for (k, phasors) in sweep.iter().enumerate() {
            let own = correction
                .measured_parts(phasors)
                .into_iter()
                .sum::<analysis_numeric::Covariance2>();
            let sigma = (0.5 * (own.re_re + own.im_im))
                .sqrt()
                .max(f64::MIN_POSITIVE);
            let slopes = Harness::new(&correction.values, phasors)
                .impedance()
                .by_parameters();
            for (j, column) in roots.iter().enumerate() {
                let d: Complex64 = slopes
                    .iter()
                    .zip(column)
                    .map(|(slope, by)| slope * by)
                    .sum();
                (rows[(2 * k, j)], rows[(2 * k + 1, j)]) = (d.re / sigma, d.im / sigma);
            }
        }
        let eigen = SymmetricEigen::new(rows.transpose() * rows);
        let mut order: Vec<usize> = (0..COUNT)
            .filter(|k| eigen.eigenvalues[*k] > LEAST)
            .collect();
        order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
        let mode = |k: &usize| {
            let turn = eigen.eigenvectors.column(*k);
            std::array::from_fn(|p| {
                roots
                    .iter()
                    .zip(turn.iter())
                    .map(|(column, t)| column[p] * t)
                    .sum()
            })
        };
        Self {
            run,
            modes: order.iter().map(mode).collect(),
        }
    }

    /// Returns the errors at the points of a sweep, in its order.
    pub fn shared(&self, correction: &Correction, sweep: &[ChannelPhasors]) -> Vec<SharedError> {
        let slopes: Vec<[Complex64; COUNT]> = sweep
            .iter()
            .map(|phasors| {
                Harness::new(&correction.values, phasors)
                    .impedance()
                    .by_parameters()
            })
            .collect();
        let of = |(number, mode): (usize, &[f64; COUNT])| SharedError {
            name: format!("correction {} of {}", number + 1, self.run),
            at_ohm: slopes
                .iter()
                .map(|slopes| slopes.iter().zip(mode).map(|(slope, by)| slope * by).sum())
                .collect(),
        };
        self.modes.iter().enumerate().map(of).collect()
    }
}

impl Correction {
    /// Adds the common errors of this correction to a spectrum; `sweep` are the phasors of its
    /// points. The spectrum is unchanged if the numbers of points differ.
    #[must_use]
    pub fn with_shared(
        &self,
        spectrum: Spectrum,
        sweep: &[ChannelPhasors],
        modes: &CorrectionModes,
    ) -> Spectrum {
        if sweep.len() != spectrum.points.len() {
            return spectrum;
        }
        Spectrum {
            shared: modes.shared(self, sweep),
            ..spectrum
        }
    }
}

/// Phasors of a control with another object in its place: the voltage between C3 and C4 is `factor`
/// times as large.
fn across(phasors: &ChannelPhasors, factor: Complex64) -> ChannelPhasors {
    let [v1, v2, v3, v4] = phasors.volts;
    ChannelPhasors {
        volts: [v1, v2, v3, v3 + factor * (v4 - v3)],
        ..*phasors
    }
}

/// Columns L of a covariance C = LLᵀ, by its eigenvalues over scaled parameters, so that units do
/// not matter.
fn root(covariance: &[[f64; COUNT]; COUNT]) -> [[f64; COUNT]; COUNT] {
    let scale: [f64; COUNT] = std::array::from_fn(|k| covariance[k][k].max(0.0).sqrt());
    let scaled = DMatrix::from_fn(COUNT, COUNT, |i, j| {
        if scale[i] > 0.0 && scale[j] > 0.0 {
            covariance[i][j] / (scale[i] * scale[j])
        } else {
            0.0
        }
    });
    let eigen = SymmetricEigen::new(scaled);
    std::array::from_fn(|k| {
        let size = eigen.eigenvalues[k].max(0.0).sqrt();
        std::array::from_fn(|p| scale[p] * eigen.eigenvectors[(p, k)] * size)
    })
}
