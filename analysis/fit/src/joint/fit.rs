//! The fit of one order to everything, its uncertainty, and which order is worth having.

use super::pooled::PooledSpectrum;
use super::problem::{EDGE, Likelihood, erm, information, square};
use super::response::{step_resistance_ohm, step_resistance_sigma_ohm};
use super::window::PulseWindow;
use crate::fit::{Bounds, ErmFit, ErmSigma, MAX_RC, Objective, WarningCode, sigma_of};
use analysis_model::model::Erm;
use analysis_numeric::{LocalOptions, Minimum, Rng, linalg, minimise};
use analysis_signal::spectrum::Spectrum;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// Times for which the resistance to a step is stated, s.
pub(super) const STATED_S: [f64; 2] = [10.0, 60.0];

/// Data of a joint fit.
#[derive(Debug, Clone, Copy)]
pub struct JointInput<'a> {
    /// The mean spectrum.
    pub spectrum: &'a PooledSpectrum,
    /// The pulses; empty for a fit of the spectrum alone.
    pub windows: &'a [PulseWindow],
}

/// Options of a joint fit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointOptions {
    /// RC branches, 1…[`MAX_RC`].
    pub rc: usize,
    /// Limits of the parameters.
    pub bounds: Bounds,
    /// Relative standard deviation of gain between the instruments.
    pub instrument_sigma: f64,
    /// Starts of the local search.
    pub starts: usize,
    /// Seed of the starts.
    pub seed: u64,
}

impl Default for JointOptions {
    /// 4 RC, 1 % between the instruments, 48 starts; capacitances up to 1 MF, because a slow branch
    /// of a small resistance has such a capacitance.
    fn default() -> Self {
        let bounds = Bounds {
            c_f: (0.01, 1e6),
            ..Bounds::default()
        };
        Self {
            rc: 4,
            bounds,
            instrument_sigma: 0.01,
            starts: 48,
            seed: 0,
        }
    }
}

impl JointOptions {
    /// Returns options with the bounds of these spectra; capacitances may be ten times larger,
    /// because a slow branch of a small resistance has such a capacitance.
    pub fn for_spectra(spectra: &[Spectrum], seed: u64) -> Self {
        let bounds = Bounds::for_spectra(spectra);
        Self {
            bounds: Bounds {
                c_f: (bounds.c_f.0, 10.0 * bounds.c_f.1),
                ..bounds
            },
            seed,
            ..Self::default()
        }
    }
}

/// Reason why a joint fit cannot be made.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum JointError {
    /// The uncertainties are not a valid covariance.
    #[error(
        "joint fit: expected a positive definite covariance of the spectra's points, met another"
    )]
    Covariance,
    /// An order that cannot be.
    #[error("joint fit: expected 1 to {MAX_RC} RC branches, met {met}")]
    Order {
        /// The order met.
        met: usize,
    },
    /// More parameters than numbers.
    #[error("joint fit: {rc} RC branches have {parameters} parameters, met {numbers} numbers")]
    TooFew {
        /// Requested number of branches.
        rc: usize,
        /// Their parameters.
        parameters: usize,
        /// Numbers in the data.
        numbers: usize,
    },
}

/// A model and what is known of it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JointFit {
    /// The model of the mean of the cells that the spectra are of, branches by rising time
    /// constant.
    pub erm: Erm,
    /// Standard uncertainty of its parameters.
    pub sigma: ErmSigma,
    /// Resistance at zero frequency, Ω.
    pub dc_resistance_ohm: f64,
    /// Resistance to a step of current, Ω, after 10 and 60 s, with its standard uncertainty.
    pub step_resistance: Vec<(f64, f64, Option<f64>)>,
    /// Resistance of the pulses' cell and instrument over the spectra's.
    pub gain: f64,
    /// Its standard uncertainty; that of the prior if the data have no pulses.
    pub gain_sigma: Option<f64>,
    /// Place of the edges between their two samples, 0…1.
    pub edge: f64,
    /// Its standard uncertainty.
    pub edge_sigma: Option<f64>,
    /// χ² and numbers of the spectrum.
    pub spectrum_chi2: (f64, usize),
    /// χ² and bins of the pulses.
    pub pulses_chi2: (f64, usize),
    /// χ² over the degrees of freedom.
    pub reduced_chi2: f64,
    /// Covariance of ln R, ln R₁, ln C₁, …, ln g, e; `None` if a parameter is held by a bound or
    /// not determined.
    pub covariance: Option<Vec<Vec<f64>>>,
    /// Starts that ended at this minimum, of all.
    pub starts: (usize, usize),
    /// Branches that the data do not support: those at a bound, and two with the same time
    /// constant, which are one.
    #[serde(default)]
    pub not_borne: Vec<String>,
    /// Warnings to the user, in sentences.
    pub warnings: Vec<String>,
}

/// Fits one order to the spectrum and the pulses.
///
/// # Errors
/// [`JointError`] for an order that cannot be or more parameters than numbers.
pub fn fit_joint(input: &JointInput<'_>, options: &JointOptions) -> Result<JointFit, JointError> {
    let numbers = 2 * input.spectrum.points.len()
        + input.windows.iter().map(PulseWindow::bins).sum::<usize>();
    let parameters = 1 + 2 * options.rc;
    if !(1..=MAX_RC).contains(&options.rc) {
        return Err(JointError::Order { met: options.rc });
    }
    if numbers <= parameters {
        return Err(JointError::TooFew {
            rc: options.rc,
            parameters,
            numbers,
        });
    }
    // Another cell than those of the spectra, on another instrument.
    let spread = input.spectrum.cell_spread.map_or(0.0, |s| {
        s * (1.0 + 1.0 / input.spectrum.cells as f64).sqrt()
    });
    let factor = input.spectrum.factor().ok_or(JointError::Covariance)?;
    let gain_sigma = options.instrument_sigma.hypot(spread);
    let likelihood = Likelihood {
        spectrum: input.spectrum,
        factor,
        windows: input.windows,
        gain_sigma,
    };
    let bounds = bounds(options);
    let found: Vec<Minimum> = starts(input, options)
        .par_iter()
        .map(|start| {
            minimise(
                &likelihood,
                start,
                &bounds,
                &LocalOptions {
                    iterations: 200,
                    tolerance: 1e-12,
                    longest_step: 1.0,
                },
            )
        })
        .collect();
    let lowest = found.iter().map(|m| m.value).fold(f64::INFINITY, f64::min);
    let same = found
        .iter()
        .filter(|m| m.value <= lowest * (1.0 + 1e-6) + 1e-6)
        .count();
    let best = found
        .iter()
        .find(|m| m.value <= lowest)
        .ok_or(JointError::TooFew {
            rc: options.rc,
            parameters,
            numbers,
        })?;
    let mut fit = describe(&likelihood, &ordered(&best.x), &bounds, parameters)
        .ok_or(JointError::Order { met: options.rc })?;
    fit.starts = (same, found.len());
    fit.not_borne = not_borne(&fit.erm, &options.bounds);
    fit.warnings = warnings(&fit, input, best, options);
    Ok(fit)
}

/// Fits one order to the spectrum alone; gain and edge keep their priors, so that a prediction of
/// pulses carries them.
///
/// # Errors
/// As [`fit_joint`].
pub fn fit_spectra(
    spectrum: &PooledSpectrum,
    options: &JointOptions,
) -> Result<JointFit, JointError> {
    fit_joint(
        &JointInput {
            spectrum,
            windows: &[],
        },
        options,
    )
}

/// Returns the order of least corrected information criterion (AICc, Hurvich and Tsai, 1989), with
/// χ² scaled by the best order's reduced χ² if that exceeds one. Orders with branches that the data
/// do not support are eligible only if all have such branches.
pub fn choose_order(fits: &[JointFit]) -> Option<usize> {
    let scale = fits
        .iter()
        .map(|f| f.reduced_chi2)
        .fold(f64::INFINITY, f64::min)
        .max(1.0);
    let criterion = |f: &JointFit| {
        let (k, n) = (
            f.erm.parameter_count() as f64,
            (f.spectrum_chi2.1 + f.pulses_chi2.1) as f64,
        );
        (f.spectrum_chi2.0 + f.pulses_chi2.0) / scale
            + 2.0 * k
            + 2.0 * k * (k + 1.0) / (n - k - 1.0).max(1.0)
    };
    let borne = fits.iter().any(|f| f.not_borne.is_empty());
    fits.iter()
        .filter(|f| !borne || f.not_borne.is_empty())
        .min_by(|a, b| criterion(a).total_cmp(&criterion(b)))
        .map(|f| f.erm.branches.len())
}

impl JointFit {
    /// As a fit that a model file holds: the objective is χ² of spectra and pulses.
    pub fn to_erm_fit(&self, spectrum: &PooledSpectrum, options: &JointOptions) -> ErmFit {
        let square: f64 = spectrum
            .points
            .iter()
            .map(|p| (self.erm.impedance(p.freq_hz) - p.z_ohm).norm_sqr())
            .sum();
        let parameters = self.erm.parameter_count();
        ErmFit {
            erm: self.erm.clone(),
            objective: self.spectrum_chi2.0 + self.pulses_chi2.0,
            objective_kind: Objective::Complex,
            points: spectrum.points.len() + self.pulses_chi2.1,
            spectra: spectrum.sweeps,
            cells: None,
            sigma: self.sigma.clone(),
            log_covariance: self.covariance.as_ref().map(|c| {
                c[..parameters]
                    .iter()
                    .map(|row| row[..parameters].to_vec())
                    .collect()
            }),
            charge_storage: None,
            rms_ohm: (square / spectrum.points.len() as f64).sqrt(),
            reduced_chi2: Some(self.reduced_chi2),
            warnings: self
                .warnings
                .iter()
                .map(|words| WarningCode::Joint.says(words))
                .collect(),
            bounds: options.bounds,
            other_minima: Vec::new(),
            seed: options.seed,
        }
    }
}

fn bounds(options: &JointOptions) -> Vec<(f64, f64)> {
    let ln = |(lo, hi): (f64, f64)| (lo.ln(), hi.ln());
    let (r, c) = (ln(options.bounds.r_ohm), ln(options.bounds.c_f));
    let circuit = std::iter::once(r).chain((0..options.rc).flat_map(|_| [r, c]));
    circuit.chain([(-0.5, 0.5), (0.0, 1.0)]).collect()
}

/// Time constants spread over what the data reach, jittered; resistances of the size of what is
/// left.
fn starts(input: &JointInput<'_>, options: &JointOptions) -> Vec<Vec<f64>> {
    let mut rng = Rng::new(options.seed);
    let points = &input.spectrum.points;
    let (Some(slow), Some(fast)) = (points.first(), points.last()) else {
        return Vec::new();
    };
    let last = input
        .windows
        .iter()
        .filter_map(|w| Some(w.bins.last()?.times_s.last()? - w.pulse.start_s()))
        .fold(0.0, f64::max);
    let (lo, hi) = (
        (0.1 / (TAU * fast.freq_hz)).ln(),
        (2.0 / (TAU * slow.freq_hz)).max(last).ln(),
    );
    let base = points
        .iter()
        .map(|p| p.z_ohm.re)
        .fold(f64::INFINITY, f64::min)
        .max(1e-6);
    let rise = (slow.z_ohm.re - base).max(0.05 * base);
    let one = |_| {
        let n = options.rc as f64;
        let mut x = vec![(base * (0.8 + 0.2 * rng.uniform())).ln()];
        for k in 0..options.rc {
            let place = (k as f64 + rng.uniform()) / n;
            let log_tau = lo
                + (hi - lo)
                    * if rng.uniform() < 0.3 {
                        rng.uniform()
                    } else {
                        place
                    };
            let log_r = (rise / n).ln() + 2.0 * (rng.uniform() - 0.5);
            x.extend([log_r, log_tau - log_r]);
        }
        x.extend([0.0, EDGE.0]);
        x
    };
    (0..options.starts.max(1)).map(one).collect()
}

fn ordered(x: &[f64]) -> Vec<f64> {
    let Some(erm) = erm(x) else { return x.to_vec() };
    let mut sorted = erm.ordered().log_parameters();
    sorted.extend(&x[x.len() - 2..]);
    sorted
}

fn describe(
    likelihood: &Likelihood<'_>,
    x: &[f64],
    bounds: &[(f64, f64)],
    parameters: usize,
) -> Option<JointFit> {
    let erm = erm(x)?;
    let n = x.len();
    let (spectral, temporal) = (likelihood.spectral(x), likelihood.temporal(x));
    let (spectrum_chi2, pulses_chi2) = (square(&spectral), square(&temporal));
    let used = parameters + if temporal.is_empty() { 0 } else { 2 };
    let freedom = (spectral.len() + temporal.len())
        .saturating_sub(used)
        .max(1) as f64;
    let reduced_chi2 = (spectrum_chi2 + pulses_chi2) / freedom;
    // Birge's ratio widens what the data say, not what was known before.
    let widening = reduced_chi2.max(1.0);
    let data: Vec<_> = spectral.iter().chain(&temporal).cloned().collect();
    let total: Vec<f64> = information(&data, n)
        .iter()
        .zip(information(&likelihood.prior(x), n))
        .map(|(d, p)| d / widening + p)
        .collect();
    let free: Vec<usize> = (0..n)
        .filter(|i| x[*i] > bounds[*i].0 + 1e-9 && x[*i] < bounds[*i].1 - 1e-9)
        .collect();
    let m = free.len();
    let kept: Vec<f64> = free
        .iter()
        .flat_map(|i| free.iter().map(|j| total[i * n + j]).collect::<Vec<_>>())
        .collect();
    let inverse = linalg::invert(&kept, m);
    let place = |i: usize| free.iter().position(|f| *f == i);
    let entry = |i: usize, j: usize| Some(inverse.as_ref()?[place(i)? * m + place(j)?]);
    // An edge that lies at a sample is known to be there.
    let held = |i: usize, j: usize| {
        if i >= n - 2 || j >= n - 2 {
            entry(i, j).or(place(i.max(j)).is_none().then_some(0.0))
        } else {
            entry(i, j)
        }
    };
    let covariance: Option<Vec<Vec<f64>>> = (0..n)
        .map(|i| (0..n).map(|j| held(i, j)).collect())
        .collect();
    let root = |i: usize| entry(i, i).map(f64::sqrt);
    let gain = x[n - 2].exp();
    let stated = |t: f64| {
        (
            t,
            step_resistance_ohm(&erm, t),
            covariance
                .as_ref()
                .and_then(|c| step_resistance_sigma_ohm(&erm, c, t)),
        )
    };
    Some(JointFit {
        sigma: sigma_of(&erm, &entry),
        dc_resistance_ohm: erm.dc_resistance_ohm(),
        step_resistance: STATED_S.iter().map(|t| stated(*t)).collect(),
        gain,
        gain_sigma: root(n - 2).map(|s| s * gain),
        edge: x[n - 1],
        edge_sigma: root(n - 1),
        spectrum_chi2: (spectrum_chi2, spectral.len()),
        pulses_chi2: (pulses_chi2, temporal.len()),
        reduced_chi2,
        covariance,
        starts: (0, 0),
        not_borne: Vec::new(),
        warnings: Vec::new(),
        erm,
    })
}

/// A parameter this near to a bound, or two time constants this near to each other (as a ratio),
/// count as there.
const NEAR: f64 = 1.02;

/// Returns branches at a bound, and pairs of branches that are one.
pub(super) fn not_borne(erm: &Erm, bounds: &Bounds) -> Vec<String> {
    let mut found = Vec::new();
    let mut held = |name: String, value: f64, (lo, hi): (f64, f64), unit: &str| {
        if value <= lo * NEAR || value >= hi / NEAR {
            found.push(format!(
                "{name} is at one of its bounds ({value:.3e} {unit}): the data do \
            not bear its branch"
            ));
        }
    };
    for (k, branch) in erm.branches.iter().enumerate() {
        held(format!("R{}", k + 1), branch.r_ohm, bounds.r_ohm, "Ω");
        held(format!("C{}", k + 1), branch.c_f, bounds.c_f, "F");
    }
    let tau_s = erm.time_constants_s();
    for (k, pair) in tau_s
        .windows(2)
        .enumerate()
        .filter(|(_, pair)| pair[1] <= NEAR * pair[0])
    {
        found.push(format!(
            "branches {} and {} have one time constant ({:.3e} s): they are one branch, the data \
            bear one less",
            k + 1,
            k + 2,
            pair[0]
        ));
    }
    found
}

fn warnings(
    fit: &JointFit,
    input: &JointInput<'_>,
    best: &Minimum,
    options: &JointOptions,
) -> Vec<String> {
    let mut found = Vec::new();
    if !best.converged {
        found.push(
            "the search stopped before it converged: the parameters may differ in their \
        last digits"
                .to_owned(),
        );
    }
    if fit.reduced_chi2 > 2.0 {
        let times = fit.reduced_chi2.sqrt();
        found.push(format!(
            "reduced χ² is {:.2}: model and data differ by {times:.2} times their uncertainty; the \
            sigmas were widened by it",
            fit.reduced_chi2
        ));
    }
    found.extend(fit.not_borne.iter().cloned());
    let near = |v: f64, (lo, hi): (f64, f64)| v <= lo * NEAR || v >= hi / NEAR;
    let names = fit.erm.parameter_names();
    let sigmas = fit.sigma.branches.iter().flat_map(|b| [b.r_ohm, b.c_f]);
    let values = fit
        .erm
        .branches
        .iter()
        .flat_map(|b| [(b.r_ohm, options.bounds.r_ohm), (b.c_f, options.bounds.c_f)]);
    let all = std::iter::once(((fit.erm.r_ohm, options.bounds.r_ohm), fit.sigma.r_ohm))
        .chain(values.zip(sigmas));
    for (name, ((value, bounds), sigma)) in names.iter().zip(all) {
        if near(value, bounds) {
            // Of a branch it is said already.
            if name == "R" {
                found.push(format!("{name} is at one of its bounds ({value:.3e} Ω)"));
            }
        } else if let Some(relative) = sigma.map(|s| s / value).filter(|r| *r > 0.5) {
            found.push(format!(
                "{name} is not identified by the data: its standard uncertainty is {:.0} %",
                100.0 * relative
            ));
        }
    }
    let reach = input
        .windows
        .iter()
        .filter_map(|w| Some(w.bins.last()?.times_s.last()? - w.pulse.edges_s[1].0))
        .fold(0.0, f64::max);
    let slowest = input
        .spectrum
        .points
        .first()
        .map_or(0.0, |p| 1.0 / (TAU * p.freq_hz))
        .max(reach);
    if let Some(tau) = fit
        .erm
        .time_constants_s()
        .last()
        .filter(|tau| **tau > slowest)
    {
        found.push(format!(
            "the slowest time constant of {tau:.1} s is beyond the {slowest:.1} s that the data \
            reach: the DC resistance is extrapolated"
        ));
    }
    found
}
