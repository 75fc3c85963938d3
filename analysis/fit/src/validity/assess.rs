//! All tests over the spectra of one cell, and the verdicts.

use super::kramers_kronig::{KramersKronig, kramers_kronig};
use super::linearity::{Linearity, amplitude, linearity};
use super::noise::Noise;
use super::record::Record;
use super::stationarity::{Stationarity, stationarity};
use super::thin::{remark, thinned};
use super::verdict::{Findings, SpectrumVerdict, verdict};
use super::z_hit::{ZHit, z_hit};
use super::{ValidityError, same_grid};
use analysis_signal::spectrum::Spectrum;
use serde::Serialize;

/// One spectrum and what is to be thought of it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Assessed {
    /// Its name.
    pub name: String,
    /// The verdict.
    pub verdict: SpectrumVerdict,
    /// The linear Kramers–Kronig test.
    pub kramers_kronig: KramersKronig,
    /// Z-HIT.
    pub z_hit: ZHit,
}

/// The spectra of one cell and what is to be thought of them.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Assessment {
    /// The spectra, as given.
    pub spectra: Vec<Assessed>,
    /// Comparison of sweeps at different amplitudes; `None` for a single amplitude.
    pub linearity: Option<Linearity>,
    /// Comparison of repeats; `None` for a single sweep.
    pub stationarity: Option<Stationarity>,
}

/// Judges the spectra of one cell, given in order of time. Those on the grid and at the amplitude
/// of the first are its repeats; those at other amplitudes show whether the cell is linear. Records
/// may be few or none. Of a spectrum with more than [`super::MOST_POINTS`] points only this number
/// is judged, and its verdict says so.
///
/// # Errors
/// [`ValidityError`] for a spectrum that is invalid or too short.
///
/// # Examples
/// ```
/// use analysis_model::model::{Erm, RcBranch};
/// use analysis_numeric::Covariance2;
/// use analysis_signal::spectrum::{ImpedancePoint, Spectrum};
/// use analysis_fit::validity::{Grade, ValidityError, assess};
///
/// // A cell of one RC branch, 0.1 Hz to 1 kHz, with 0.1 % of noise.
/// let cell = Erm {
///     r_ohm: 5e-3,
///     branches: vec![RcBranch { r_ohm: 3e-3, c_f: 10.0 }],
/// };
/// let point = |k: i32| {
///     let freq_hz = 0.1 * 10f64.powf(f64::from(k) / 5.0);
///     let z_ohm = cell.impedance(freq_hz);
///     ImpedancePoint {
///         freq_hz,
///         z_ohm,
///         covariance: Covariance2::circular((1e-3 * z_ohm.norm()).powi(2)),
///         amplitude_a: 1.0,
///     }
/// };
/// let mut spectrum = Spectrum {
///     name: "cell".to_owned(),
///     points: (0..=20).map(point).collect(),
///     ..Spectrum::default()
/// };
/// let verdict = assess(&[spectrum.clone()], &[])?.spectra.remove(0).verdict;
/// assert_eq!(verdict.grade, Grade::Good);
/// // A point that is 10 % too large violates the Kramers–Kronig relations.
/// spectrum.points[10].z_ohm *= 1.1;
/// let verdict = assess(&[spectrum], &[])?.spectra.remove(0).verdict;
/// assert_eq!(verdict.points[10].grade, Grade::Bad);
/// # Ok::<(), ValidityError>(())
/// ```
pub fn assess(spectra: &[Spectrum], records: &[Record]) -> Result<Assessment, ValidityError> {
    spectra.iter().try_for_each(Spectrum::validate)?;
    if spectra.iter().any(|s| thinned(s).is_some()) {
        let judged: Vec<Spectrum> = spectra
            .iter()
            .map(|s| thinned(s).unwrap_or_else(|| s.clone()))
            .collect();
        let mut assessment = assess(&judged, records)?;
        assessment
            .spectra
            .iter_mut()
            .zip(spectra)
            .for_each(|(assessed, whole)| tell(assessed, whole));
        return Ok(assessment);
    }
    let noises: Vec<Noise> = spectra
        .iter()
        .map(|s| Noise::of(s, spectra))
        .collect::<Result<_, _>>()?;
    let alike = |s: &Spectrum| {
        let (a, b) = (amplitude(s), spectra.first().map_or(f64::NAN, amplitude));
        spectra.first().is_some_and(|first| same_grid(s, first))
            && (a.is_nan() || b.is_nan() || (a / b - 1.0).abs() < 0.1)
    };
    let (repeats, their_noise): (Vec<&Spectrum>, Vec<&Noise>) = spectra
        .iter()
        .zip(&noises)
        .filter(|(s, _)| alike(s))
        .unzip();
    let stationarity = stationarity(&repeats, &their_noise);
    let linearity = linearity(spectra, &noises);
    let on_grid = |s: &Spectrum| spectra.first().is_some_and(|first| same_grid(s, first));
    let judge = |(spectrum, noise): (&Spectrum, &Noise)| {
        let kramers_kronig = kramers_kronig(spectrum, noise)?;
        let z_hit = z_hit(spectrum, noise, &kramers_kronig);
        let findings = Findings {
            kk: &kramers_kronig,
            z_hit: &z_hit,
            linearity: linearity.as_ref().filter(|_| on_grid(spectrum)),
            stationarity: stationarity.as_ref().filter(|_| alike(spectrum)),
            records,
            spectrum,
            noise,
        };
        Ok(Assessed {
            name: spectrum.name.clone(),
            verdict: verdict(&findings),
            kramers_kronig,
            z_hit,
        })
    };
    let judged = spectra
        .iter()
        .zip(&noises)
        .map(judge)
        .collect::<Result<_, ValidityError>>()?;
    Ok(Assessment {
        spectra: judged,
        linearity,
        stationarity,
    })
}

/// Adds to the verdict of a spectrum the number of points that were judged.
fn tell(assessed: &mut Assessed, whole: &Spectrum) {
    let judged = assessed.kramers_kronig.points.len();
    if judged < whole.points.len() {
        assessed.verdict.text += &remark(judged, whole.points.len());
    }
}

/// Judges one spectrum by a noise that is known of it, such as an estimate of few degrees of
/// freedom.
///
/// # Errors
/// As [`assess`].
pub fn assess_by(spectrum: &Spectrum, noise: &Noise) -> Result<Assessed, ValidityError> {
    spectrum.validate()?;
    let kramers_kronig = kramers_kronig(spectrum, noise)?;
    let z_hit = z_hit(spectrum, noise, &kramers_kronig);
    let findings = Findings {
        kk: &kramers_kronig,
        z_hit: &z_hit,
        linearity: None,
        stationarity: None,
        records: &[],
        spectrum,
        noise,
    };
    Ok(Assessed {
        name: spectrum.name.clone(),
        verdict: verdict(&findings),
        kramers_kronig,
        z_hit,
    })
}
