//! Judges the sign of the imaginary part of a spectrum, in words that `kk` and the fits share.

use super::kramers_kronig::{FEWEST_POINTS, KkOutcome, kramers_kronig};
use super::noise::Noise;
use super::thin::thinned;
use analysis_numeric::significant::format_significant;
use analysis_signal::spectrum::{ImpedancePoint, Spectrum};

/// Of a spectrum that obeys Kramers–Kronig with the other sign of its imaginary part only.
pub(super) const WRONG_SIGN: &str =
    "the imaginary part has the wrong sign; with the other sign it agrees with Kramers–Kronig";
/// Standard uncertainties by which an imaginary part must be above zero.
const SIGNIFICANT: f64 = 3.0;
/// The same where no uncertainty is known, as a share of |Z|: what `kk` calls bad of a noise that
/// it had to estimate.
const LARGE: f64 = 0.01;

/// Im Z is above zero beyond its uncertainty.
fn is_inductive(point: &ImpedancePoint) -> bool {
    let variance = point.covariance.im_im;
    let least = if point.covariance.is_valid() && variance > 0.0 {
        SIGNIFICANT * variance.sqrt()
    } else {
        LARGE * point.z_ohm.norm()
    };
    point.z_ohm.im > least
}

/// The lowest frequency from which on, up to the end of the band, all points are inductive, Hz;
/// none where the last one is not, or the first one is.
pub fn inductive_from_hz(points: &[ImpedancePoint]) -> Option<f64> {
    let upper = points.iter().rev().take_while(|p| is_inductive(p)).count();
    (upper > 0 && upper < points.len()).then(|| points[points.len() - upper].freq_hz)
}

/// That the upper end of the band is inductive; none where it is not.
pub(super) fn inductive(points: &[ImpedancePoint]) -> Option<String> {
    let from_hz = inductive_from_hz(points)?;
    Some(format!(
        "the band is inductive from {} Hz on (Im Z > 0)",
        format_significant(from_hz, 3)
    ))
}

/// Names the spectra whose imaginary part has the wrong sign.
pub fn wrong_sign_remarks(spectra: &[Spectrum]) -> Vec<String> {
    spectra
        .iter()
        .filter(|s| is_conjugated(s))
        .map(|s| {
            of(
                s,
                spectra.len(),
                &format!("{WRONG_SIGN}: turn the sign and fit again"),
            )
        })
        .collect()
}

/// Words on one of so many spectra.
fn of(spectrum: &Spectrum, spectra: usize, words: &str) -> String {
    if spectra > 1 {
        format!("{}: {words}", spectrum.name)
    } else {
        words.to_owned()
    }
}

/// Remarks on spectra for a fit of resistances and capacitances: an imaginary part of the wrong
/// sign, an inductive end of the band.
pub fn sign_remarks(spectra: &[Spectrum]) -> Vec<String> {
    const ADVICE: &str = "which resistances and capacitances cannot follow: fit below, with \
    --to-hz, or a circuit with L";
    let mut found = wrong_sign_remarks(spectra);
    for spectrum in spectra.iter().filter(|s| !is_conjugated(s)) {
        found.extend(
            inductive(&spectrum.points)
                .map(|words| of(spectrum, spectra.len(), &format!("{words}, {ADVICE}"))),
        );
    }
    found
}

/// As the Kramers–Kronig test finds it. Where less than half of the points are above the axis there
/// is nothing to test.
fn is_conjugated(spectrum: &Spectrum) -> bool {
    let above = spectrum.points.iter().filter(|p| p.z_ohm.im > 0.0).count();
    if spectrum.points.len() < FEWEST_POINTS
        || 2 * above < spectrum.points.len()
        || spectrum.validate().is_err()
    {
        return false;
    }
    let thin = thinned(spectrum);
    let spectrum = thin.as_ref().unwrap_or(spectrum);
    let tested = Noise::of(spectrum, std::slice::from_ref(spectrum))
        .and_then(|noise| kramers_kronig(spectrum, &noise));
    tested.is_ok_and(|kk| kk.outcome == KkOutcome::SignSwapped)
}
