//! Can a spectrum be judged at all? A noise that is learnt from the spectrum itself excuses
//! whatever is rough: values in the wrong order over the frequencies look like much noise. So there
//! is a ceiling, and what noise makes of a spectrum is held against what the system does over the
//! band.

use super::kramers_kronig::KramersKronig;
use super::noise::{Noise, NoiseSource};
use analysis_numeric::{significant::format_significant, stats::FDistribution};
use analysis_signal::spectrum::Spectrum;
use num_complex::Complex64;

/// Roughness of a spectrum.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Roughness {
    /// Standard deviation of the noise of one part, relative to |Z|.
    pub(super) noise: f64,
    /// Share of the noise in the variance of the impedance over the band.
    pub(super) share: f64,
}

/// Noise, relative to |Z|, above which no spectrum is judged: two and a half times what is notable.
/// A violation of 2 % in each of forty points then raises the sum of squares by half of its standard
/// deviation.
const CEILING: f64 = 0.05;
/// Noise above which it is compared with the variation of Z over the band. Kanoun and Kallel,
/// Electrochim. Acta (2024) 144351, and the manual of EIS Spectrum Analyser (Bondarenko and
/// Ragoisha, log-KK check) call deviations of up to 2 % acceptable; such a violation in each of
/// forty points can just be detected in this noise at one false alarm in a hundred.
const NOTABLE: f64 = 0.02;
/// Share of the noise in the variance over the band from which on the system is not visible.
const MOST_SHARE: f64 = 0.1;

/// Returns why a spectrum cannot be judged; `None` if it can.
pub(super) fn not_judged(spectrum: &Spectrum, noise: &Noise) -> Option<String> {
    let Roughness { noise, share } = Roughness::of(spectrum, noise);
    let percent = |value: f64| format_significant(100.0 * value, 2);
    if noise > CEILING {
        return Some(format!(
            "its noise is {} % of |Z|, and above {} % a violation hides in it",
            percent(noise),
            percent(CEILING)
        ));
    }
    (noise > NOTABLE && share > MOST_SHARE).then(|| {
        format!(
            "its noise of {} % of |Z| is {} % of all that Z does over the band, so that the order of \
            the frequencies hardly shows",
            percent(noise),
            percent(share.sqrt())
        )
    })
}

/// Least ratio of the squares of residuals along the curve to those across it that indicates wrong
/// frequencies, and its greatest probability in noise without a preferred direction.
const ALONG: f64 = 4.0;
const ALONG_RATE: f64 = 1e-4;
/// Noise below which the direction is not tested: the limit for doubt with an estimated noise.
const SMALL: f64 = 0.003;

/// Returns a remark if the apparent noise lies along the curve, as when points have the frequencies
/// of others; `None` otherwise. Noise has no preferred direction around a point. A stated noise
/// needs no such test.
pub(super) fn along_the_curve(
    spectrum: &Spectrum,
    noise: &Noise,
    kk: &KramersKronig,
) -> Option<String> {
    if noise.source == NoiseSource::Stated || noise.relative(&spectrum.points) < SMALL {
        return None;
    }
    let (z, last) = (&kk.fitted_ohm, kk.fitted_ohm.len() - 1);
    let (mut along, mut across) = (0.0, 0.0);
    for (k, p) in spectrum
        .points
        .iter()
        .enumerate()
        .filter(|(k, _)| !kk.points[*k].left_out)
    {
        let tangent = z[(k + 1).min(last)] - z[k.saturating_sub(1)];
        let turned = (p.z_ohm - z[k]) / p.z_ohm.norm() * tangent.conj() / tangent.norm();
        along += turned.re * turned.re;
        across += turned.im * turned.im;
    }
    let freedom = 0.5 * kk.dof.max(1.0);
    let by_chance = FDistribution {
        above: freedom,
        below: freedom,
    };
    let found = along > ALONG * across && by_chance.tail(along / across) < ALONG_RATE;
    found.then(|| {
        format!(
            "what looks like noise lies along the curve, {} times as large as across it: points \
            may have wrong frequencies, or the gain changes from one to the next",
            format_significant((along / across).sqrt(), 2)
        )
    })
}

impl Roughness {
    pub(super) fn of(spectrum: &Spectrum, noise: &Noise) -> Self {
        let points = &spectrum.points;
        let relative = noise.relative(points);
        let weight = |z: &Complex64| z.norm_sqr().recip();
        let z = || points.iter().map(|p| p.z_ohm);
        let total: f64 = z().map(|z| weight(&z)).sum();
        let mean = z().map(|z| weight(&z) * z).sum::<Complex64>() / total;
        let variance = z().map(|z| weight(&z) * (z - mean).norm_sqr()).sum::<f64>()
            / (2.0 * (points.len() as f64 - 1.0));
        Self {
            noise: relative,
            share: relative * relative / variance,
        }
    }
}
