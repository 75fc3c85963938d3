//! What the Kramers–Kronig test finds wrong with a spectrum that is to be fitted, so that a fit says
//! what `kk` says.

use super::FALSE_ALARM_RATE;
use super::ceiling::not_judged;
use super::kramers_kronig::{FEWEST_POINTS, KkOutcome, KkPoint, KramersKronig, kramers_kronig};
use super::noise::Noise;
use super::thin::thinned;
use super::verdict::{Grade, by_size, by_worst, is_nothing_valid, nothing_valid, short};
use analysis_signal::spectrum::Spectrum;

/// Factor by which the rate of false alarms is smaller if several spectra are fitted together.
const SEVERAL: f64 = 10.0;

/// Faults of one spectrum that `kk` calls bad.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Flaws {
    /// Single points that disagree with the others.
    pub points: Vec<KkPoint>,
    /// Fault of the spectrum or of an end of it, as text.
    pub whole: Option<String>,
}

/// Tests a spectrum by itself. A single spectrum (`among` = 1) is tested as by `kk`; of several
/// spectra that are fitted together, at most one in a thousand sound fits is flagged. A spectrum
/// that cannot be tested has no flaws. An imaginary part of the wrong sign is left to
/// [`super::wrong_sign_remarks`].
pub fn flaws(spectrum: &Spectrum, among: usize) -> Flaws {
    if spectrum.points.len() < FEWEST_POINTS || spectrum.validate().is_err() {
        return Flaws::default();
    }
    let thin = thinned(spectrum);
    let spectrum = thin.as_ref().unwrap_or(spectrum);
    let tested = Noise::of(spectrum, &[])
        .and_then(|noise| kramers_kronig(spectrum, &noise).map(|kk| (kk, noise)));
    let Ok((kk, noise)) = tested else {
        return Flaws::default();
    };
    let among = if among > 1 {
        SEVERAL * among as f64
    } else {
        1.0
    };
    let limit = KramersKronig::point_limit(kk.points.len(), FALSE_ALARM_RATE) / among;
    let is_bad =
        |p: &&KkPoint| p.left_out && p.p < limit && by_size(&kk, p.percent()) == Grade::Bad;
    let is_sure = kk.p < FALSE_ALARM_RATE / among;
    let bad: Vec<KkPoint> = kk.points.iter().filter(is_bad).copied().collect();
    match kk.outcome {
        KkOutcome::SinglePoints => Flaws {
            points: bad,
            whole: cannot_be_judged(spectrum, &noise),
        },
        KkOutcome::PartOfBand => Flaws {
            whole: end(&kk).filter(|_| is_sure && by_worst(&kk) == Grade::Bad),
            ..Flaws::default()
        },
        KkOutcome::Disagrees if is_sure && is_nothing_valid(&kk) => Flaws {
            whole: Some(nothing_valid(&kk)),
            ..Flaws::default()
        },
        KkOutcome::SignSwapped => Flaws::default(),
        KkOutcome::Agrees | KkOutcome::Disagrees => Flaws {
            whole: cannot_be_judged(spectrum, &noise),
            ..Flaws::default()
        },
    }
}

fn cannot_be_judged(spectrum: &Spectrum, noise: &Noise) -> Option<String> {
    not_judged(spectrum, noise).map(|why| format!("the spectrum cannot be judged: {why}"))
}

/// The end of the band that disagrees with the rest.
fn end(kk: &KramersKronig) -> Option<String> {
    let out = |p: &KkPoint| p.left_out;
    let (first, last) = (kk.points.first()?, kk.points.last()?);
    let border = if out(first) {
        kk.points.iter().rfind(|p| out(p)).map(|p| (p, "up to"))
    } else {
        kk.points
            .iter()
            .find(|p| out(p))
            .filter(|_| out(last))
            .map(|p| (p, "from"))
    };
    border.map(|(p, side)| {
        format!(
            "the {} points {side} {} Hz disagree with Kramers–Kronig",
            kk.points.iter().filter(|p| out(p)).count(),
            short(p.freq_hz)
        )
    })
}
