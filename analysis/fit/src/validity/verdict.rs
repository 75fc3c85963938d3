//! Verdict of all tests together, in words: one per point, one per spectrum.

use super::ceiling::{along_the_curve, not_judged};
use super::kramers_kronig::{KkOutcome, KkPoint, KramersKronig};
use super::linearity::Linearity;
use super::noise::{Noise, NoiseSource};
use super::record::{Record, beyond_noise};
use super::signs::{WRONG_SIGN, inductive, slow_loop_band, slow_loop_words};
use super::stationarity::Stationarity;
use super::z_hit::ZHit;
use super::{DOUBTFUL_RATE, FALSE_ALARM_RATE};
use analysis_numeric::significant::format_significant;
use analysis_signal::spectrum::Spectrum;
use serde::Serialize;
use std::fmt;

/// Share of the false-alarm rate that Z-HIT has.
const Z_HIT_SHARE: f64 = 0.3;
/// Limits of Z-HIT, which is an approximation, %: below the first it does not count for any noise,
/// and only above the second is a point bad.
const Z_HIT_ERROR_PERCENT: (f64, f64) = (0.3, 1.0);
/// An error of Z that its record makes possible, %: doubtful above the first, bad above the second.
const RECORD_ERROR_PERCENT: (f64, f64) = (0.3, 1.0);

/// However significant, a residual of the Kramers–Kronig test is doubtful only above the first and
/// bad only above the second, % of |Z|: of a stated noise, and of one that was estimated. An
/// estimate is one number for the whole band and may be wrong by a factor where the noise is not in
/// proportion to |Z|.
const KK_STATED_PERCENT: (f64, f64) = (0.1, 0.3);
const KK_ESTIMATED_PERCENT: (f64, f64) = (0.3, 1.0);

/// Grade of a number: how far it is valid.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Grade {
    /// No test contradicts it.
    Good,
    /// Something does, but chance or a small effect could explain it.
    Doubtful,
    /// The noise is so large that no test can decide.
    CannotBeJudged,
    /// It is wrong, or the system was not linear or not steady.
    Bad,
}

impl Grade {
    /// Name as JSON and tables have it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Good => "good",
            Self::Doubtful => "doubtful",
            Self::CannotBeJudged => "cannot-be-judged",
            Self::Bad => "bad",
        }
    }
}

impl fmt::Display for Grade {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::CannotBeJudged => "cannot be judged",
            named => named.name(),
        })
    }
}

/// The verdict on one point.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PointVerdict {
    /// Frequency, Hz.
    pub freq_hz: f64,
    /// Grade of the point.
    pub grade: Grade,
    /// Reasons for the grade, in words.
    pub reasons: Vec<String>,
    /// The comparison with repeats is one of the reasons.
    pub repeats_differ: bool,
}

/// The verdict on a spectrum.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SpectrumVerdict {
    /// Grade of the spectrum: bad if a point is bad. Where only single points are bad, it is
    /// doubtful.
    pub grade: Grade,
    /// One sentence or more.
    pub text: String,
    /// Lowest and highest frequency between which no more than single points are bad, Hz; `None` if
    /// no such band exists.
    pub valid_band_hz: Option<(f64, f64)>,
    /// The points, by rising frequency.
    pub points: Vec<PointVerdict>,
}

/// Results of the tests of one spectrum.
pub(super) struct Findings<'a> {
    pub(super) kk: &'a KramersKronig,
    pub(super) z_hit: &'a ZHit,
    pub(super) linearity: Option<&'a Linearity>,
    pub(super) stationarity: Option<&'a Stationarity>,
    pub(super) records: &'a [Record],
    pub(super) spectrum: &'a Spectrum,
    pub(super) noise: &'a Noise,
}

impl PointVerdict {
    fn add(&mut self, grade: Grade, reason: String) {
        self.grade = self.grade.max(grade);
        self.reasons.push(reason);
    }
}

pub(super) fn verdict(findings: &Findings<'_>) -> SpectrumVerdict {
    let harmonics = beyond_noise(findings.records);
    let points: Vec<PointVerdict> = (0..findings.kk.points.len())
        .map(|k| point(findings, &harmonics, k))
        .collect();
    let valid_band_hz = valid_band(&points, findings.kk);
    let bad: Vec<usize> = (0..points.len())
        .filter(|k| points[*k].grade == Grade::Bad)
        .collect();
    let doubtful = points.iter().any(|p| p.grade == Grade::Doubtful);
    let whole = valid_band_hz
        .is_some_and(|(lo, hi)| bad.iter().all(|k| (lo..=hi).contains(&points[*k].freq_hz)));
    let grade = match (bad.is_empty(), whole) {
        (true, _) if doubtful => Grade::Doubtful,
        (true, _) => Grade::Good,
        (false, true) => Grade::Doubtful,
        (false, false) => Grade::Bad,
    };
    let mut text = text(findings, &points, valid_band_hz);
    let along = along_the_curve(findings.spectrum, findings.noise, findings.kk)
        .filter(|_| grade < Grade::Bad);
    let grade = along.iter().fold(grade, |grade, words| {
        text += &format!("; {words}");
        grade.max(Grade::Doubtful)
    });
    let verdict = SpectrumVerdict {
        grade,
        text,
        valid_band_hz,
        points,
    };
    match not_judged(findings.spectrum, findings.noise).filter(|_| grade != Grade::Bad) {
        Some(why) => cannot_be_judged(verdict, &why),
        None => verdict,
    }
}

/// Replaces a verdict by one without any conclusion: no point is known to be good.
fn cannot_be_judged(verdict: SpectrumVerdict, why: &str) -> SpectrumVerdict {
    let hidden = |point: PointVerdict| PointVerdict {
        grade: point.grade.max(Grade::CannotBeJudged),
        ..point
    };
    SpectrumVerdict {
        grade: Grade::CannotBeJudged,
        text: why.to_owned(),
        valid_band_hz: None,
        points: verdict.points.into_iter().map(hidden).collect(),
    }
}

fn point(findings: &Findings<'_>, harmonics: &[Vec<bool>], k: usize) -> PointVerdict {
    let kk = &findings.kk.points[k];
    let mut verdict = PointVerdict {
        freq_hz: kk.freq_hz,
        grade: Grade::Good,
        reasons: Vec::new(),
        repeats_differ: false,
    };
    by_kramers_kronig(findings.kk, k, &mut verdict);
    let z_hit = &findings.z_hit.points[k];
    let limit = |rate: f64| Z_HIT_SHARE * rate / findings.z_hit.points.len() as f64;
    let size = z_hit.deviation_percent.abs();
    if z_hit.p < limit(DOUBTFUL_RATE) && size > Z_HIT_ERROR_PERCENT.0 {
        let bad = z_hit.p < limit(FALSE_ALARM_RATE) && size > Z_HIT_ERROR_PERCENT.1;
        let grade = if bad { Grade::Bad } else { Grade::Doubtful };
        let side = if z_hit.deviation_percent > 0.0 {
            "above"
        } else {
            "below"
        };
        let sigmas = (z_hit.deviation_percent / z_hit.sigma_percent).abs();
        verdict.add(
            grade,
            format!(
                "|Z| is {size:.2} % ({sigmas:.1} σ) {side} what the phase asks for (Z-HIT), as \
            after a change of the cell"
            ),
        );
    }
    if let Some(l) = findings
        .linearity
        .and_then(|l| l.points.get(k))
        .filter(|l| l.nonlinear)
    {
        verdict.add(
            Grade::Bad,
            format!(
                "Z changes by {:.2} % with the amplitude: not linear",
                l.change_percent
            ),
        );
    }
    for (record, beyond) in findings
        .records
        .iter()
        .zip(harmonics)
        .filter(|(r, _)| (r.freq_hz / kk.freq_hz - 1.0).abs() < 1e-3)
    {
        by_record(record, beyond, &mut verdict);
    }
    if let Some(s) = findings.stationarity.and_then(|s| s.points.get(k)) {
        verdict.repeats_differ = s.drifts() || s.scatters();
        if let Some(trend) = s.trend_percent.filter(|_| s.drifts()) {
            verdict.add(
                Grade::Doubtful,
                format!("the repeats drift by {trend:.2} % from the first to the last"),
            );
        } else if let Some(excess) = s.excess_percent.filter(|_| s.scatters()) {
            verdict.add(
                Grade::Doubtful,
                format!("the repeats scatter by {excess:.2} % beyond the noise"),
            );
        }
    }
    verdict
}

/// Grade of a residual of `percent` % of |Z|; no test makes it worse.
pub(super) fn by_size(kk: &KramersKronig, percent: f64) -> Grade {
    let (doubtful, bad) = if kk.noise == NoiseSource::Stated {
        KK_STATED_PERCENT
    } else {
        KK_ESTIMATED_PERCENT
    };
    if percent > bad {
        Grade::Bad
    } else if percent > doubtful {
        Grade::Doubtful
    } else {
        Grade::Good
    }
}

/// Grade of the largest residual over the band; no test makes it worse.
pub(super) fn by_worst(kk: &KramersKronig) -> Grade {
    by_size(kk, kk.worst().map_or(0.0, KkPoint::percent))
}

fn by_kramers_kronig(kk: &KramersKronig, k: usize, verdict: &mut PointVerdict) {
    let point = &kk.points[k];
    if kk.is_reversed() {
        verdict.add(
            Grade::Bad,
            "the real part is negative: leads reversed?".to_owned(),
        );
    }
    let whole = match kk.outcome {
        KkOutcome::SignSwapped => {
            "the imaginary part has the wrong sign (Kramers–Kronig holds with the other)"
        }
        KkOutcome::Disagrees => "the spectrum disagrees with Kramers–Kronig as a whole",
        KkOutcome::PartOfBand if point.left_out => {
            "this end of the band disagrees with Kramers–Kronig"
        }
        // The others agree with each other; their residuals are those of the fit to all.
        KkOutcome::PartOfBand => return,
        KkOutcome::Agrees | KkOutcome::SinglePoints => "",
    };
    if !whole.is_empty() {
        match by_worst(kk) {
            Grade::Good => {}
            grade => verdict.add(
                if kk.outcome == KkOutcome::SignSwapped {
                    Grade::Bad
                } else {
                    grade
                },
                whole.to_owned(),
            ),
        }
        return;
    }
    let limit = |rate| KramersKronig::point_limit(kk.points.len(), rate);
    if point.p < limit(DOUBTFUL_RATE) || point.left_out {
        let grade = if point.p < limit(FALSE_ALARM_RATE) {
            Grade::Bad
        } else {
            Grade::Doubtful
        }
        .min(by_size(kk, point.percent()));
        if grade != Grade::Good {
            verdict.add(
                grade,
                format!(
                    "disagrees with Kramers–Kronig by {:.2} % ({:.1} σ)",
                    point.percent(),
                    point.sigmas
                ),
            );
        }
    }
}

fn by_record(record: &Record, beyond: &[bool], verdict: &mut PointVerdict) {
    let grade = |percent: f64| {
        if percent > RECORD_ERROR_PERCENT.1 {
            Grade::Bad
        } else {
            Grade::Doubtful
        }
    };
    let found = record
        .harmonics
        .iter()
        .zip(beyond)
        .filter(|(harmonic, beyond)| **beyond && harmonic.error_percent() > RECORD_ERROR_PERCENT.0);
    for (harmonic, _) in found {
        let error = harmonic.error_percent();
        let (order, ratio) = (harmonic.order, 100.0 * harmonic.ratio);
        verdict.add(
            grade(error),
            format!("harmonic {order} of {ratio:.2} %: not linear, Z may be off by {error:.1} %"),
        );
    }
    if let Some(error) = record
        .drift
        .map(|d| d.error_percent())
        .filter(|e| *e > RECORD_ERROR_PERCENT.0)
    {
        verdict.add(
            grade(error),
            format!("the offset drifts within the record: Z may be off by {error:.1} %"),
        );
    }
}

/// Returns whether all points are invalid for a common reason.
pub(super) fn is_nothing_valid(kk: &KramersKronig) -> bool {
    let whole = match kk.outcome {
        KkOutcome::SignSwapped => by_worst(kk) != Grade::Good,
        KkOutcome::Disagrees => by_worst(kk) == Grade::Bad,
        _ => false,
    };
    whole || kk.is_reversed()
}

/// Returns the band that remains after runs of bad points at the ends are cut off; `None` if fewer
/// than half of its points are good.
fn valid_band(points: &[PointVerdict], kk: &KramersKronig) -> Option<(f64, f64)> {
    if is_nothing_valid(kk) {
        return None;
    }
    let usable = |p: &PointVerdict| p.grade != Grade::Bad;
    let (first, last) = (
        points.iter().position(usable)?,
        points.iter().rposition(usable)?,
    );
    let bad = points[first..=last].iter().filter(|p| !usable(p)).count();
    (2 * bad < last - first).then(|| (points[first].freq_hz, points[last].freq_hz))
}

/// Sentence on why no point is valid.
pub(super) fn nothing_valid(kk: &KramersKronig) -> String {
    if kk.is_reversed() {
        return "not valid: the real part is negative: leads reversed? (Kramers–Kronig cannot see \
        it)"
        .to_owned();
    }
    if kk.outcome == KkOutcome::SignSwapped {
        return format!("not valid: {WRONG_SIGN}");
    }
    let named = |w: &KkPoint| {
        format!(
            ", worst at {} Hz with {:.2} % ({:.0} σ)",
            short(w.freq_hz),
            w.percent(),
            w.sigmas
        )
    };
    let worst = kk.worst().map_or_else(String::new, named);
    let chi2 = kk.chi2 / kk.dof;
    format!(
        "not valid: it disagrees with Kramers–Kronig over more than single points or one end \
        (reduced χ² {chi2:.1}{worst})"
    )
}

fn text(findings: &Findings<'_>, points: &[PointVerdict], band: Option<(f64, f64)>) -> String {
    let kk = findings.kk;
    let slight = kk.outcome == KkOutcome::Disagrees && by_worst(kk) == Grade::Doubtful;
    let mut text = match (band, kk.worst()) {
        _ if is_nothing_valid(kk) => nothing_valid(kk),
        (Some((lo, hi)), Some(worst)) if slight => format!(
            "valid from {} Hz to {} Hz within {:.2} %: Kramers–Kronig leaves more than the noise \
            explains, but no more than that (at {} Hz)",
            short(lo),
            short(hi),
            worst.percent(),
            short(worst.freq_hz)
        ),
        (Some((lo, hi)), _) => format!("valid from {} Hz to {} Hz", short(lo), short(hi)),
        (None, _) => "not valid: too many points are bad".to_owned(),
    };
    let whole = slight || is_nothing_valid(kk);
    let differ = points.iter().filter(|p| p.repeats_differ).count();
    // Of a point that is suspect by its repeats alone, the number is enough.
    let own = |p: &PointVerdict| {
        p.grade != Grade::Good && p.reasons.len() > usize::from(p.repeats_differ)
    };
    let named: Vec<(usize, &PointVerdict)> = points
        .iter()
        .enumerate()
        .filter(|(_, p)| own(p) && !whole)
        .collect();
    const MOST_NAMED: usize = 4;
    for (k, p) in named.iter().take(MOST_NAMED) {
        let reasons = &p.reasons[..p.reasons.len() - usize::from(p.repeats_differ)];
        text += &format!(
            "; point {} ({} Hz): {}",
            k + 1,
            short(p.freq_hz),
            reasons.join(", ")
        );
    }
    if named.len() > MOST_NAMED {
        text += &format!("; and {} more points", named.len() - MOST_NAMED);
    }
    if differ > 0 {
        text += &format!("; its repeats differ by more than noise at {differ} frequencies");
    }
    if kk.outcome != KkOutcome::SignSwapped {
        let slow = slow_loop_band(findings.spectrum, findings.noise).map(slow_loop_words);
        for words in inductive(&findings.spectrum.points).into_iter().chain(slow) {
            text += &format!("; {words}");
        }
    }
    text
}

/// Frequency with three significant digits.
pub(super) fn short(freq_hz: f64) -> String {
    format_significant(freq_hz, 3)
}
