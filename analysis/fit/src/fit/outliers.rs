//! Outliers: single points that belong to no impedance of a linear system, such as a wrong sign, a
//! wrong digit, or a record of something else. Least squares follows them, so that all residuals
//! become large together and none of them stands out. The Kramers–Kronig test, which needs no
//! order, finds them.

use std::collections::BTreeSet;
use std::iter;

use num_complex::Complex64;

use super::options::Objective;
use super::problem::{Group, Problem, quadratic};
use crate::validity::{
    FEWEST_POINTS, KkOutcome, KkPoint, KramersKronig, Noise, NoiseSource, kramers_kronig, thinned,
};
use analysis_model::model::Erm;
use analysis_numeric::{Covariance2, significant::format_significant};
use analysis_signal::spectrum::Spectrum;

/// Share of clean data sets in which a point may be taken to stand out.
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
    // The chance that one of so many squares exceeds x is about n·exp(−x/2).
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

/// Names the points that stand out of a fit of these spectra; nothing where none does. Of many
/// spectra those are looked at that hold the furthest.
pub(super) fn remarks(spectra: &[Spectrum], erm: &Erm) -> Vec<String> {
    let suspects = standing_out(&Problem::new(spectra, Objective::Complex), erm);
    let found: Vec<String> = suspects
        .iter()
        .take(MOST_NAMED)
        .flat_map(|number| of_spectrum(&spectra[*number], spectra.len() > 1))
        .collect();
    let more = found.len().saturating_sub(MOST_NAMED);
    let mut named: Vec<String> = found.into_iter().take(MOST_NAMED).collect();
    if more > 0 {
        named.push(format!("{more} more points lie as far off"));
    }
    named
}

fn of_spectrum(spectrum: &Spectrum, several: bool) -> Vec<String> {
    let Some(kk) = tested(spectrum) else {
        return Vec::new();
    };
    let source = if kk.noise == NoiseSource::Stated {
        ""
    } else {
        ", by the scatter of the others"
    };
    let of = if several {
        format!(" of {}", spectrum.name)
    } else {
        String::new()
    };
    let name = |p: &KkPoint| {
        let (freq_hz, sigmas, percent) = (
            format_significant(p.freq_hz, 3),
            format_significant(p.sigmas, 3),
            format_significant(p.percent(), 3),
        );
        format!(
            "the point at {freq_hz} Hz{of} lies {sigmas} σ off the fit to the others ({percent} % \
            of |Z|{source}): measure it again or leave it out"
        )
    };
    kk.points.iter().filter(|p| p.left_out).map(name).collect()
}

/// The Kramers–Kronig test, where it holds but for single points: by the noise as stated, else by
/// the spectrum's own, for σ may be stated too small.
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
