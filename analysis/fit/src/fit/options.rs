//! Options of a fit, checked before any work is done.

use crate::sizes::sizes_ohm;
use analysis_signal::spectrum::Spectrum;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;
use std::fmt;
use std::ops::RangeInclusive;
use std::str::FromStr;

/// Values that SCPI-99 (7.2.1.4 and 7.2.1.5) uses for infinity, 9.9e37, and for not-a-number,
/// 9.91e37, in one part or in both.
const OVERLOAD_OHM: RangeInclusive<f64> = 9.8e37..=1.5e38;
/// Resistance, as a share of the least |Z|, of the smallest branch for which the bounds of C
/// suffice.
const SMALL: f64 = 0.01;

/// Most RC branches a fit may have.
pub const MAX_RC: usize = 8;

/// Objective that the fit minimises.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Objective {
    /// Σ|Z_model − Z_data|, Ω: what the thesis minimised (complex, though its text speaks of
    /// magnitudes). Robust against outliers.
    SumAbs,
    /// Σ(|Z_model| − |Z_data|)², Ω²: magnitudes only, as the thesis' text says. The phase is
    /// ignored, and with it most of what separates slow branches: with four branches and one sweep,
    /// seeds may end up to 1e-4 apart in the value. Squares were chosen over absolute values
    /// because they are smooth and the best estimate under normal noise.
    Modulus,
    /// Complex least squares. With a covariance at every point the weight is its inverse and the
    /// objective is χ², without unit; otherwise every residual is taken relative to |Z_data|, also
    /// without unit.
    Complex,
}

impl Objective {
    /// Name on the command line and in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::SumAbs => "sum-abs",
            Self::Modulus => "modulus",
            Self::Complex => "complex",
        }
    }

    /// Unit of the objective's value; empty where it has none.
    pub fn unit(self) -> &'static str {
        match self {
            Self::SumAbs => "Ω",
            Self::Modulus => "Ω²",
            Self::Complex => "",
        }
    }
}

impl fmt::Display for Objective {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

impl FromStr for Objective {
    type Err = FitError;

    fn from_str(text: &str) -> Result<Self, FitError> {
        let all = [Self::SumAbs, Self::Modulus, Self::Complex];
        all.into_iter()
            .find(|o| o.name() == text)
            .ok_or_else(|| FitError::UnknownObjective {
                met: text.to_owned(),
            })
    }
}

/// Limits of the parameters: (lower, upper).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Bounds {
    /// Every resistance, Ω.
    pub r_ohm: (f64, f64),
    /// Every capacitance, F.
    pub c_f: (f64, f64),
}

impl Default for Bounds {
    /// The thesis' bounds: 1 µΩ…100 mΩ, 10 mF…100 kF.
    fn default() -> Self {
        Self {
            r_ohm: (1e-6, 0.1),
            c_f: (0.01, 1e5),
        }
    }
}

impl Bounds {
    /// The thesis' bounds, which suit power cells, moved by powers of ten for impedances of another
    /// size: the lower ones of R by the least |Z|, the upper ones by the greatest, so that neither
    /// hides the other. The bounds of C are wide enough for every branch within the band. One wrong
    /// row moves none of them.
    pub fn for_spectra(spectra: &[Spectrum]) -> Self {
        let thesis = Self::default();
        let sizes = || spectra.iter().flat_map(|s| sizes_ohm(&s.points));
        let (least, greatest) = (
            sizes().fold(f64::INFINITY, f64::min),
            sizes().fold(0.0, f64::max),
        );
        if !(least > 0.0 && greatest.is_finite()) {
            return thesis;
        }
        let (low, high) = (Self::factor(least), Self::factor(greatest));
        let omega = || {
            let points = spectra.iter().flat_map(|s| &s.points);
            points.map(|point| TAU * point.freq_hz)
        };
        let fastest = 1.0 / omega().fold(0.0, f64::max);
        let slowest = 1.0 / omega().fold(f64::INFINITY, f64::min);
        Self {
            r_ohm: (thesis.r_ohm.0 * low, thesis.r_ohm.1 * high),
            c_f: (
                (thesis.c_f.0 / high).min(fastest / greatest),
                (thesis.c_f.1 / low).max(slowest / (SMALL * least)),
            ),
        }
    }

    /// The power of ten that brings an impedance to a size that the thesis' bounds suit.
    fn factor(z_ohm: f64) -> f64 {
        let greatest = Self::default().r_ohm.1;
        if (0.01 * greatest..=0.5 * greatest).contains(&z_ohm) {
            1.0
        } else {
            10.0_f64.powf((z_ohm / (0.5 * greatest)).log10().ceil())
        }
    }
}

/// Options of a fit of the ERM.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct FitOptions {
    /// Number of RC branches, 0…[`MAX_RC`].
    pub rc: usize,
    /// Objective to minimise.
    pub objective: Objective,
    /// Limits of the parameters.
    pub bounds: Bounds,
    /// Seed of the global search; equal seeds give equal fits.
    pub seed: u64,
}

impl Default for FitOptions {
    /// 4 RC branches, the thesis' objective and bounds.
    fn default() -> Self {
        Self {
            rc: 4,
            objective: Objective::SumAbs,
            bounds: Bounds::default(),
            seed: 0,
        }
    }
}

/// Reason why a fit was refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum FitError {
    /// The data have no points.
    #[error("fit: expected at least one point, met none in {spectra} spectra")]
    NoPoints {
        /// Number of spectra given.
        spectra: usize,
    },
    /// A point is not a valid measurement.
    #[error(
        "fit: spectrum \"{spectrum}\", point {index} (counted from 1): expected {expected}, met \
        {met}"
    )]
    BadPoint {
        /// Name of the spectrum.
        spectrum: String,
        /// Number of the point, from 1.
        index: usize,
        /// Allowed values, in words.
        expected: &'static str,
        /// Value found.
        met: String,
    },
    /// More parameters than the data have independent points.
    #[error(
        "fit: {rc} RC branches have {parameters} parameters and need as many points, met \
        {frequencies} distinct frequencies"
    )]
    TooFewFrequencies {
        /// Requested number of branches.
        rc: usize,
        /// Their parameters.
        parameters: usize,
        /// Distinct frequencies in the data.
        frequencies: usize,
    },
    /// More branches than supported.
    #[error("fit: expected 0 to {MAX_RC} RC branches, met {met}")]
    TooManyBranches {
        /// Requested number of branches.
        met: usize,
    },
    /// The bounds are empty or not finite.
    #[error(
        "fit: bounds of {parameter}: expected 0 < lower < upper, both finite, met {lower} to \
        {upper} {unit}"
    )]
    BadBounds {
        /// R or C.
        parameter: &'static str,
        /// The lower bound met.
        lower: f64,
        /// The upper bound met.
        upper: f64,
        /// Unit.
        unit: &'static str,
    },
    /// The squares of the impedances overflow.
    #[error("fit: expected impedances that can be squared, met too large ones")]
    TooLarge,
    /// The name is not an objective.
    #[error("objective: expected sum-abs, modulus or complex, met \"{met}\"")]
    UnknownObjective {
        /// The name met.
        met: String,
    },
}

impl FitOptions {
    /// Returns the number of parameters of the requested model.
    pub fn parameter_count(&self) -> usize {
        1 + 2 * self.rc
    }

    pub(crate) fn check(&self) -> Result<(), FitError> {
        if self.rc > MAX_RC {
            return Err(FitError::TooManyBranches { met: self.rc });
        }
        for (parameter, unit, (lower, upper)) in
            [("R", "Ω", self.bounds.r_ohm), ("C", "F", self.bounds.c_f)]
        {
            if !(lower > 0.0 && upper > lower && upper.is_finite()) {
                return Err(FitError::BadBounds {
                    parameter,
                    lower,
                    upper,
                    unit,
                });
            }
        }
        Ok(())
    }

    /// Refuses more parameters than independent points. Real and imaginary part of one point are
    /// related by Kramers and Kronig and share the errors of its record, so that they do not count
    /// as two.
    pub(crate) fn check_size(&self, frequencies: usize) -> Result<(), FitError> {
        let (rc, parameters) = (self.rc, self.parameter_count());
        if parameters > frequencies {
            return Err(FitError::TooFewFrequencies {
                rc,
                parameters,
                frequencies,
            });
        }
        Ok(())
    }
}

pub(crate) fn check_spectra(spectra: &[Spectrum]) -> Result<(), FitError> {
    if spectra.iter().all(|s| s.points.is_empty()) {
        return Err(FitError::NoPoints {
            spectra: spectra.len(),
        });
    }
    for s in spectra {
        for (i, p) in s.points.iter().enumerate() {
            let bad = |expected, met| {
                Err(FitError::BadPoint {
                    spectrum: s.name.clone(),
                    index: i + 1,
                    expected,
                    met,
                })
            };
            if !(p.freq_hz.is_finite() && p.freq_hz > 0.0) {
                return bad("a positive finite frequency in Hz", p.freq_hz.to_string());
            }
            let parts = [p.z_ohm.re.abs(), p.z_ohm.im.abs(), p.z_ohm.norm()];
            if parts.iter().any(|part| OVERLOAD_OHM.contains(part)) {
                return bad(
                    "an impedance (9.9e37 is what meters send of an overload: leave the row out)",
                    format!("{:e} + {:e}i", p.z_ohm.re, p.z_ohm.im),
                );
            }
            if !(p.z_ohm.is_finite() && p.z_ohm.norm_sqr() > 0.0) {
                return bad(
                    "a finite impedance other than zero in Ω",
                    p.z_ohm.to_string(),
                );
            }
        }
    }
    Ok(())
}
