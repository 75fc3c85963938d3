//! Spectra against the Kramers–Kronig relations, by [`analysis_fit::validity`], judged by their own noise.

use super::super::data::Sweep;
use super::{Check, Findings, Inspection};
use crate::thresholds::{KK_END_PART, KK_LEAST_PERCENT, KK_LEAST_SIGMAS};
use analysis_fit::validity::{FEWEST_POINTS, KkOutcome, Noise, kramers_kronig};
use analysis_numeric::Covariance2;
use analysis_signal::spectrum::{ImpedancePoint, Spectrum};

pub(super) fn check(at: &Inspection<'_>) -> Findings {
    let mut found = Findings::default();
    for subject in &at.runs {
        let Some((sweep, _)) = subject
            .sweep()
            .filter(|(sweep, _)| sweep.points.len() >= FEWEST_POINTS)
        else {
            continue;
        };
        let spectrum = spectrum(
            &subject.run.name,
            sweep,
            at.set.history.map(|h| h.eis_noise_rel),
        );
        let tested = Noise::of(&spectrum, std::slice::from_ref(&spectrum))
            .and_then(|noise| kramers_kronig(&spectrum, &noise));
        let kk = match tested {
            Ok(kk) => kk,
            Err(error) => {
                found.notes.push(format!(
                    "{}: not tested by Kramers–Kronig: {error}",
                    subject.run.name
                ));
                continue;
            }
        };
        let worst = kk.points.iter().map(|p| p.percent()).fold(0.0, f64::max);
        let left_out = kk.points.iter().filter(|p| p.left_out).count();
        let large = worst > KK_LEAST_PERCENT.max(KK_LEAST_SIGMAS * kk.noise_percent);
        let small_end = (left_out as f64) < KK_END_PART * kk.points.len() as f64;
        match kk.outcome {
            KkOutcome::Disagrees | KkOutcome::SignSwapped | KkOutcome::PartOfBand
                if large && !(kk.outcome == KkOutcome::PartOfBand && small_end) =>
            {
                let text = format!(
                    "it violates the Kramers–Kronig relations by up to {worst:.1} % of |Z| at a \
                    noise of {:.2} %: the cell drifted or was not at rest",
                    kk.noise_percent
                );
                found.add(Check::KramersKronig, subject.run, text);
            }
            KkOutcome::PartOfBand | KkOutcome::SinglePoints if large => {
                found.notes.push(format!(
                    "{}: {left_out} points disagree with Kramers–Kronig by up to \
                    {worst:.1} % of |Z|",
                    subject.run.name
                ));
            }
            _ => {}
        }
    }
    found
}

/// Uses the noise that the sweep states, otherwise the bench's history; otherwise it is estimated.
fn spectrum(name: &str, sweep: &Sweep, history_rel: Option<f64>) -> Spectrum {
    let points = sweep.points.iter().map(|p| {
        let known = history_rel
            .filter(|rel| *rel > 0.0)
            .map(|rel| (rel * p.z_ohm.norm(), rel * p.z_ohm.norm()));
        let covariance = p
            .sigma_ohm
            .or(known)
            .map_or(Covariance2::UNKNOWN, |(re, im)| Covariance2 {
                re_re: re * re,
                re_im: 0.0,
                im_im: im * im,
            });
        ImpedancePoint {
            freq_hz: p.freq_hz,
            z_ohm: p.z_ohm,
            covariance,
            amplitude_a: p.amplitude_a.unwrap_or(f64::NAN),
        }
    });
    Spectrum {
        name: name.to_owned(),
        points: points.collect(),
        ..Spectrum::default()
    }
}
