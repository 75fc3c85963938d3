//! Outliers: single points that belong to no impedance of a linear system, such as a wrong sign, a
//! wrong digit, or a record of something else. Least squares follows them, so that all residuals
//! become large together and none of them stands out. The Kramers–Kronig test, which needs no
//! order, finds them.

use std::collections::BTreeSet;
use std::iter;

use num_complex::Complex64;

use super::options::Objective;
use super::pooled::{Group, quadratic};
use super::problem::Problem;
use super::warning::{Warning, WarningCode};
use crate::validity::{
    FEWEST_POINTS, KkOutcome, KkPoint, KramersKronig, Noise, NoiseSource, flaws, kramers_kronig,
    thinned,
};
use analysis_model::model::Erm;
use analysis_numeric::{Covariance2, significant::format_significant};
use analysis_signal::spectrum::Spectrum;

/// Share of clean data sets in which a point may be flagged.
const FALSE_ALARM_RATE: f64 = 0.01;
/// Points named at most.
const MOST_NAMED: usize = 4;

/// A point lies further from the model than the scatter of all residuals explains: their size by
/// its median, of normal noise in two parts √(2 ln 2) of its standard deviation, so that the point
/// itself counts little. What points have in common is at its best, as in the fit.
///
/// Gives the spectra, by number, that hold such a point: the one that holds the furthest first.
pub(super) fn standing_out(problem: &Problem, erm: &Erm) -> Vec<usize> {
    let seen = problem.seen(&erm.log_parameters());
    let off = |(g, seen): (&Group, &Vec<Complex64>)| {
        g.points
            .iter()
            .zip(seen)
            .map(|(p, z)| (quadratic(&p.weight, z - p.z), p.spectrum))
            .collect::<Vec<(f64, usize)>>()
    };
    let mut squares: Vec<(f64, usize)> = problem.groups.iter().zip(&seen).flat_map(off).collect();
    squares.sort_by(|a, b| a.0.total_cmp(&b.0));
    let Some((median, _)) = squares.get(squares.len() / 2) else {
        return Vec::new();
    };
    let scale = median / (2.0 * std::f64::consts::LN_2);
    let scale = if problem.absolute_weights {
        scale.max(1.0)
    } else {
        scale
    };
    // The chance that one of n squares exceeds x is about n·exp(−x/2).
    let limit = 2.0 * (squares.len() as f64 / FALSE_ALARM_RATE).ln() * scale;
    let mut met = BTreeSet::new();
    squares
        .iter()
        .rev()
        .take_while(|(square, _)| *square > limit)
        .map(|(_, spectrum)| *spectrum)
        .filter(|s| met.insert(*s))
        .collect()
}

/// Returns remarks on the points that stand out of a fit of an ERM to these spectra, and on those
/// that `kk` calls bad, because a model that misses the data hides them. Names the spectra that
/// `kk` rejects as a whole. Of many spectra those with the largest deviations are tested first.
pub(super) fn remarks(spectra: &[Spectrum], erm: Option<&Erm>) -> Vec<Warning> {
    let suspects = erm.map_or_else(Vec::new, |erm| {
        standing_out(&Problem::new(spectra, Objective::Complex), erm)
    });
    let several = spectra.len() > 1;
    let mut found: Vec<String> = suspects
        .iter()
        .take(MOST_NAMED)
        .flat_map(|number| of_suspect(&spectra[*number], several))
        .collect();
    let mut whole = Vec::new();
    for (number, spectrum) in spectra.iter().enumerate() {
        let flaws = flaws(spectrum, spectra.len());
        if !suspects.iter().take(MOST_NAMED).any(|n| *n == number) || found.is_empty() {
            let source = source(if is_stated(spectrum) {
                NoiseSource::Stated
            } else {
                NoiseSource::Smoother
            });
            found.extend(
                flaws
                    .points
                    .iter()
                    .map(|p| words(p, spectrum, several, source)),
            );
        }
        whole.extend(flaws.whole.map(|why| {
            if several {
                format!("{}: {why}", spectrum.name)
            } else {
                why
            }
        }));
    }
    let of = |code: WarningCode, all: Vec<String>, others: &str| {
        let more = all.len().saturating_sub(MOST_NAMED);
        let more = (more > 0).then(|| format!("{more} more {others}"));
        all.into_iter()
            .take(MOST_NAMED)
            .chain(more)
            .map(|words| code.says(words))
            .collect::<Vec<Warning>>()
    };
    let mut remarks = of(WarningCode::Outliers, found, "points lie as far off");
    remarks.extend(of(WarningCode::Validity, whole, "spectra are as bad"));
    remarks
}

fn is_stated(spectrum: &Spectrum) -> bool {
    spectrum
        .points
        .iter()
        .all(|p| p.covariance.re_re > 0.0 && p.covariance.im_im > 0.0)
}

fn source(noise: NoiseSource) -> &'static str {
    if noise == NoiseSource::Stated {
        ""
    } else {
        ", by the scatter of the others"
    }
}

fn of_suspect(spectrum: &Spectrum, several: bool) -> Vec<String> {
    let Some(kk) = tested(spectrum) else {
        return Vec::new();
    };
    let out = kk.points.iter().filter(|p| p.left_out);
    out.map(|p| words(p, spectrum, several, source(kk.noise)))
        .collect()
}

fn words(p: &KkPoint, spectrum: &Spectrum, several: bool, source: &str) -> String {
    let of = if several {
        format!(" of {}", spectrum.name)
    } else {
        String::new()
    };
    let (freq_hz, sigmas, percent) = (
        format_significant(p.freq_hz, 3),
        format_significant(p.sigmas, 3),
        format_significant(p.percent(), 3),
    );
    format!(
        "the point at {freq_hz} Hz{of} lies {sigmas} σ off the fit to the others ({percent} % of \
        |Z|{source}): measure it again or leave it out"
    )
}

/// Returns the Kramers–Kronig test if the spectrum passes it except for single points: by the
/// stated noise, otherwise by the spectrum's own noise, because σ may be stated too small.
fn tested(spectrum: &Spectrum) -> Option<KramersKronig> {
    if spectrum.points.len() < FEWEST_POINTS || spectrum.validate().is_err() {
        return None;
    }
    let thin = thinned(spectrum);
    let stated = thin.as_ref().unwrap_or(spectrum);
    let mut bare = stated.clone();
    bare.points
        .iter_mut()
        .for_each(|p| p.covariance = Covariance2::UNKNOWN);
    let by = |noise_of: &Spectrum| kramers_kronig(stated, &Noise::of(noise_of, &[]).ok()?).ok();
    let own = stated
        .points
        .iter()
        .any(|p| p.covariance.re_re.is_finite())
        .then_some(&bare);
    iter::once(stated)
        .chain(own)
        .filter_map(by)
        .find(|kk| kk.outcome == KkOutcome::SinglePoints)
}
