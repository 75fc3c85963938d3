//! Judges the sign of the imaginary part of a spectrum, in words that `kk` and the fits share.

use super::kramers_kronig::{FEWEST_POINTS, KkOutcome, kramers_kronig};
use super::noise::Noise;
use super::thin::thinned;
use analysis_numeric::significant::format_significant;
use analysis_signal::spectrum::{ImpedancePoint, Spectrum};
use serde::Serialize;

/// Of a spectrum that obeys Kramers–Kronig with the other sign of its imaginary part only.
pub(super) const WRONG_SIGN: &str =
    "the imaginary part has the wrong sign; with the other sign it agrees with Kramers–Kronig";
/// Number of standard uncertainties by which an imaginary part must be above zero.
const SIGNIFICANT: f64 = 3.0;
/// The same if no uncertainty is known, as a share of |Z|: the limit of `kk` for a bad point with
/// an estimated noise.
const LARGE: f64 = 0.01;
/// Least size of a slow loop, as a share of |Z|: what `kk` doubts.
const LOOP: f64 = 0.003;

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

/// Returns the lowest frequency from which on, up to the end of the band, all points are inductive,
/// Hz; `None` if the last one is not, or the first one is.
pub fn inductive_from_hz(points: &[ImpedancePoint]) -> Option<f64> {
    let upper = points.iter().rev().take_while(|p| is_inductive(p)).count();
    (upper > 0 && upper < points.len()).then(|| points[points.len() - upper].freq_hz)
}

/// A run of points with Im Z > 0 below the upper end of the band: a slow inductive loop.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct LoopBand {
    /// The lowest frequency, Hz.
    pub from_hz: f64,
    /// The highest frequency, Hz.
    pub to_hz: f64,
}

/// Returns the widest run of points with Im Z > 0 that does not reach the upper end of the band:
/// beyond three standard deviations of the noise and 0.3 % of |Z|, at two neighbours at least.
/// `None` without such a run.
pub fn slow_loop_band(spectrum: &Spectrum, noise: &Noise) -> Option<LoopBand> {
    let points = &spectrum.points;
    let above: Vec<bool> = points
        .iter()
        .zip(&noise.covariance)
        .map(|(p, c)| p.z_ohm.im > (SIGNIFICANT * c.im_im.sqrt()).max(LOOP * p.z_ohm.norm()))
        .collect();
    let mut runs: Vec<(usize, usize)> = Vec::new();
    for k in (0..above.len()).filter(|k| above[*k]) {
        match runs.last_mut() {
            Some((_, last)) if *last + 1 == k => *last = k,
            _ => runs.push((k, k)),
        }
    }
    let (first, last) = runs
        .into_iter()
        .filter(|(first, last)| last > first && last + 1 < points.len())
        .max_by_key(|(first, last)| last - first)?;
    Some(LoopBand {
        from_hz: points[first].freq_hz,
        to_hz: points[last].freq_hz,
    })
}

/// Returns a remark on a slow inductive loop, by the known or estimated noise; `None` without a
/// loop.
fn slow_loop(spectrum: &Spectrum) -> Option<String> {
    let mut measured = spectrum.clone();
    if let Some(slope) = spectrum.less {
        // What was taken out of the points is capacitive, so that without it they may look
        // inductive.
        let put_back = |p: &mut ImpedancePoint| p.z_ohm += slope.impedance(p.freq_hz);
        measured.points.iter_mut().for_each(put_back);
    }
    let inductive = |p: &&ImpedancePoint| p.z_ohm.im > LOOP * p.z_ohm.norm();
    // To estimate the noise is some work, which most spectra need not.
    if measured.points.iter().filter(inductive).count() < 2 || measured.validate().is_err() {
        return None;
    }
    let noise = Noise::of(&measured, &[]).ok()?;
    slow_loop_band(&measured, &noise).map(slow_loop_words)
}

/// Returns the text on a slow loop.
pub(super) fn slow_loop_words(LoopBand { from_hz, to_hz }: LoopBand) -> String {
    let short = |freq_hz| format_significant(freq_hz, 3);
    format!(
        "Im Z > 0 from {} Hz to {} Hz: a slow inductive loop, or a cell that changed during the sweep",
        short(from_hz),
        short(to_hz)
    )
}

/// Returns a remark if the upper end of the band is inductive; `None` otherwise.
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

/// Prefixes the remark with the name of the spectrum if there are several.
fn of(spectrum: &Spectrum, spectra: usize, words: &str) -> String {
    if spectra > 1 {
        format!("{}: {words}", spectrum.name)
    } else {
        words.to_owned()
    }
}

/// Remarks on spectra for a fit of resistances and capacitances: an imaginary part of the wrong
/// sign, an inductive end of the band, a slow inductive loop. `rc` is the number of branches of the
/// fit.
pub fn sign_remarks(spectra: &[Spectrum], rc: usize) -> Vec<String> {
    const ADVICE: &str = "which resistances and capacitances cannot follow: fit below, with \
    --to-hz, or a circuit with L";
    let mut found = wrong_sign_remarks(spectra);
    for spectrum in spectra.iter().filter(|s| !is_conjugated(s)) {
        found.extend(
            inductive(&spectrum.points)
                .map(|words| of(spectrum, spectra.len(), &format!("{words}, {ADVICE}"))),
        );
        let circuit = with_inductive_branch(spectrum, rc);
        found.extend(slow_loop(spectrum).map(|words| {
            let advice = format!(
                "{words}; resistances and capacitances cannot follow it, and the slow ones come out \
                wrong: fit with --circuit '{circuit}', whose last branch is inductive"
            );
            of(spectrum, spectra.len(), &advice)
        }));
    }
    found
}

/// Names the spectra with a slow loop, for a fit of a circuit without an inductance.
pub fn slow_loop_remarks(spectra: &[Spectrum]) -> Vec<String> {
    let words = |s: &Spectrum| {
        let advice = format!(
            "{}; without an inductance the circuit cannot follow it: put -p(R,L) in series",
            slow_loop(s)?
        );
        Some(of(s, spectra.len(), &advice))
    };
    let sound = spectra.iter().filter(|s| !is_conjugated(s));
    sound.filter_map(words).collect()
}

/// Returns a circuit of R, `rc` RC branches, and a resistance in parallel with an inductance; with
/// an inductance in series if the upper end of the band shows one.
fn with_inductive_branch(spectrum: &Spectrum, rc: usize) -> String {
    let leads = inductive_from_hz(&spectrum.points).map_or("", |_| "L0-");
    let branches: String = (1..=rc).map(|k| format!("-p(R{k},C{k})")).collect();
    format!("{leads}R0{branches}-p(R{0},L{0})", rc + 1)
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
