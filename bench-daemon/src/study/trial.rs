//! One trial: hidden truth, data set, diagnosis, score.

use analysis::diagnosis::{Block, Candidate, Diagnosis, Gap, Outcome, Verdict, gate, yardstick};
use fixtures::hidden::{Case, EffectKind, LabelledEffect, Spec, Stratum};
use serde::Serialize;

use super::{
    convert,
    names::{catalogue_name, true_strength},
    settle::{options, placebo, settle},
};

/// How a trial ended, against the truth.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum End {
    /// Nothing named, the floor claimed.
    None,
    /// Exactly what was hidden.
    Right,
    /// Ambiguous, and what was hidden is among the effects that it names; of what no catalogue has,
    /// that it may be something else.
    Twin,
    /// What was hidden and more.
    Extra,
    /// A part of what was hidden, and nothing else.
    Part,
    /// Ambiguous without the truth.
    Misled,
    /// Confidently something that was not hidden.
    Wrong,
    /// Refused: something is there, without a name.
    Unexplained,
    /// Refused: the data cannot be used.
    Invalid,
}

/// The score of one trial.
#[derive(Debug, Clone, Serialize)]
pub struct Score {
    /// Where it comes from.
    pub stratum: &'static str,
    /// What was hidden, by the names of labels.
    pub hidden: Vec<&'static str>,
    /// Strength of each.
    pub strengths: Vec<f64>,
    /// λ of the truth; none where nothing is hidden or the files are damaged.
    pub lambda: Option<f64>,
    /// The end.
    pub end: End,
    /// Verdict.
    pub verdict: Verdict,
    /// Names given.
    pub named: Vec<&'static str>,
    /// Rivals given.
    pub rivals: Vec<&'static str>,
    /// (χ² − dof)/√(2·dof) of base and augmented model.
    pub fit_z: (f64, f64),
    /// Share of the oracle's gap that was closed on held-out records, where there was one to close.
    pub closed: Option<f64>,
    /// The strength of every effect that was rightly named, against its true value.
    pub parameters: Vec<ParameterScore>,
    /// The most significant blocks of the base's residual: dimension, part, χ² against its
    /// expectation.
    pub places: Vec<String>,
    /// The candidates of the first round: name, Lagrange score, penalised gain, why not.
    pub ranking: Vec<String>,
    /// Summary and notes.
    pub notes: Vec<String>,
    /// λ that each name removes.
    pub lambdas: Vec<f64>,
    /// Rivals with their score less that of the named one, and r.
    pub gaps: Vec<(&'static str, f64, f64)>,
    /// What no run of the menu would tell: an effect and what imitates it.
    pub inseparable: Vec<[&'static str; 2]>,
    /// The runs that an ambiguous end asked for, in the order in which they were played.
    pub recommended: Vec<Recommended>,
    /// The end of a bench with nothing hidden after the first of them.
    pub placebo: Option<End>,
}

/// A recommended run, and the end with it among the training runs.
#[derive(Debug, Clone, Serialize)]
pub struct Recommended {
    /// Name in the menu.
    pub name: &'static str,
    /// Expected separation with it and with the data at hand, in standard deviations.
    pub separation_sigma: (f64, f64),
    /// Time on the bench, min.
    pub duration_min: f64,
    /// Whether it was expected to settle everything that was open.
    pub settles: bool,
    /// The end with it.
    pub settled: End,
    /// Names given then, with the λ of each.
    pub named: Vec<(&'static str, f64)>,
    /// Rivals given then, with their score less that of the named one.
    pub rivals: Vec<(&'static str, f64)>,
    /// What no run of the menu would tell then.
    pub inseparable: Vec<[&'static str; 2]>,
    /// Summary and notes then.
    pub notes: Vec<String>,
}

/// Error of one fitted parameter.
#[derive(Debug, Clone, Serialize)]
pub struct ParameterScore {
    /// Effect and parameter.
    pub name: String,
    /// True value.
    pub truth: f64,
    /// Fitted value.
    pub value: f64,
    /// Its standard deviation, where the data fix it.
    pub sigma: Option<f64>,
    /// True where the 95 % interval holds the truth.
    pub covered: bool,
}

/// Stratum's name in tables.
pub fn stratum_name(stratum: Stratum) -> &'static str {
    match stratum {
        Stratum::Null => "null",
        Stratum::Single => "single",
        Stratum::Pair => "pair",
        Stratum::Triple => "triple",
        Stratum::Outside => "outside",
        Stratum::StrangeNoise => "strange noise",
        Stratum::Corrupted => "corrupted",
    }
}

/// Plays one specification, with so many at most of the experiments that an ambiguous end
/// recommends.
///
/// # Errors
/// A data set that cannot be used although nothing was damaged, or a model that cannot be fitted.
pub fn play(stratum: Stratum, spec: &Spec, follow_ups: usize) -> anyhow::Result<Score> {
    let case = Case::new(spec);
    let set = convert::data_set(&case);
    let (outcome, model) = match convert::model(&set, &case.base)
        .and_then(|m| Ok((gate::diagnose_gated(&set, Vec::new(), &m, &options())?, m)))
    {
        Ok(done) => done,
        Err(e) if spec.corruption.is_some() => {
            tracing::debug!("refused: {e:#}");
            return Ok(score(stratum, &case, None, (None, None)));
        }
        Err(e) => return Err(e),
    };
    let lambda = if spec.corruption.is_none() && !spec.hidden.is_empty() {
        strength(spec, &case).ok()
    } else {
        None
    };
    let closed = closed(&case, &set, &model, &outcome);
    let (mut asked, mut nothing) = (Vec::new(), None);
    if outcome.diagnosis.verdict == Verdict::Ambiguous {
        let after = settle(spec, (&set, follow_ups), &model, &outcome)?;
        let before = std::iter::once(&outcome).chain(&after);
        asked.extend(
            before
                .zip(&after)
                .filter_map(|(before, after)| recommended(&Truth::of(&case), before, after)),
        );
        if !after.is_empty() {
            nothing = Some(end(
                Some(placebo(spec, &outcome.next_runs)?.diagnosis.verdict),
                &Truth::default(),
                &[],
                &[],
            ));
        }
    }
    Ok(Score {
        recommended: asked,
        placebo: nothing,
        ..score(stratum, &case, Some(&outcome), (lambda, closed))
    })
}

/// How the recommended run ends it.
fn recommended(truth: &Truth, before: &Outcome, after: &Outcome) -> Option<Recommended> {
    let (next, d) = (before.diagnosis.next_experiment.as_ref()?, &after.diagnosis);
    let named: Vec<&'static str> = d.effects.iter().map(|e| e.name).collect();
    let rivals: Vec<&'static str> = d.rivals.iter().map(|r| r.name).collect();
    Some(Recommended {
        name: next.name,
        separation_sigma: (next.separation_sigma, next.separation_now_sigma),
        duration_min: next.duration_min,
        settles: next.settles,
        settled: end(Some(d.verdict), truth, &named, &rivals),
        named: d
            .effects
            .iter()
            .map(|e| (e.name, e.evidence.lambda))
            .collect(),
        rivals: d.rivals.iter().map(|r| (r.name, r.score_gap)).collect(),
        inseparable: d.inseparable.clone(),
        notes: std::iter::once(&d.summary)
            .chain(&d.notes)
            .cloned()
            .collect(),
    })
}

/// λ of a specification.
///
/// # Errors
/// As [`yardstick::removable_chi2`].
pub fn strength(spec: &Spec, noisy: &Case) -> anyhow::Result<f64> {
    let clean = convert::data_set(&Case::new(&spec.without_noise()));
    let set = convert::data_set(noisy);
    let model = convert::model(&clean, &noisy.base)?;
    Ok(yardstick::removable_chi2(&set, &clean, &model)?)
}

/// What was hidden, as far as the catalogue has it, and whether there was anything that it has not.
#[derive(Default)]
struct Truth {
    names: Vec<&'static str>,
    outside: bool,
}

impl Truth {
    fn of(case: &Case) -> Self {
        let names: Vec<&'static str> = case
            .label
            .effects
            .iter()
            .filter_map(|e| catalogue_name(e.kind))
            .collect();
        Self {
            outside: names.len() < case.label.effects.len(),
            names,
        }
    }
}

fn sum_square(gaps: &[Gap], pick: fn(&Gap) -> f64) -> f64 {
    gaps.iter().map(|g| pick(g).powi(2)).sum()
}

/// (base² − augmented²)/(base² − oracle²) over the held-out records.
fn closed(
    case: &Case,
    set: &analysis::diagnosis::DataSet,
    model: &analysis::diagnosis::BaseModel,
    outcome: &Outcome,
) -> Option<f64> {
    let Truth { names, outside } = Truth::of(case);
    if names.is_empty() || outside {
        return None;
    }
    let (_, best) = yardstick::oracle(set, model, &names).ok()?;
    let (base, left) = (
        sum_square(&best, |g| g.base_mv),
        sum_square(&best, |g| g.augmented_mv),
    );
    let ours = sum_square(&outcome.diagnosis.gap, |g| g.augmented_mv);
    (base - left > 0.02 * base).then(|| (base - ours) / (base - left))
}

fn end(
    verdict: Option<Verdict>,
    Truth {
        names: truth,
        outside,
    }: &Truth,
    named: &[&str],
    rivals: &[&str],
) -> End {
    let among = |t: &&str| named.contains(t) || rivals.contains(t);
    let only_true = named.iter().all(|n| truth.contains(n));
    match verdict {
        None | Some(Verdict::Invalid) => End::Invalid,
        Some(Verdict::AtNoiseFloor) => End::None,
        Some(Verdict::Unexplained) => End::Unexplained,
        Some(Verdict::Explained) if only_true && named.len() == truth.len() => End::Right,
        Some(Verdict::Explained) if only_true => End::Part,
        Some(Verdict::Explained)
            if truth.iter().all(|t| named.contains(t)) && !truth.is_empty() =>
        {
            End::Extra
        }
        Some(Verdict::Explained) => End::Wrong,
        Some(Verdict::Ambiguous) if !truth.is_empty() && truth.iter().all(&among) => End::Twin,
        Some(Verdict::Ambiguous)
            if *outside && rivals.iter().any(|r| analysis::effects::find(r).is_none()) =>
        {
            End::Twin
        }
        Some(Verdict::Ambiguous) if truth.iter().any(among) => End::Part,
        Some(Verdict::Ambiguous) => End::Misled,
    }
}

/// How the strength of a named effect compares with the truth.
fn parameter(effect: &LabelledEffect, d: &Diagnosis) -> Option<ParameterScore> {
    let name = catalogue_name(effect.kind)?;
    let fitted = d
        .effects
        .iter()
        .find(|e| e.name == name)?
        .parameters
        .first()?;
    let truth = true_strength(effect)?;
    let covered = fitted.interval.0 <= truth && truth <= fitted.interval.1;
    Some(ParameterScore {
        name: format!("{name}.{}", fitted.name),
        truth,
        value: fitted.value,
        sigma: fitted.sigma,
        covered,
    })
}

fn candidate(c: &Candidate) -> String {
    format!(
        "{}: Lagrange {:.1}, score {:.1}, {}",
        c.name,
        c.lagrange,
        c.score.unwrap_or(f64::NAN),
        c.refused_because
    )
}

fn place(b: &Block) -> String {
    format!(
        "{}, {}: χ² {:.0} of {:.0}, mean {:.1} σ, p {:.1e}",
        b.dimension, b.part, b.chi2, b.expected_chi2, b.mean_z, b.p_value
    )
}

fn score(
    stratum: Stratum,
    case: &Case,
    outcome: Option<&Outcome>,
    (lambda, closed): (Option<f64>, Option<f64>),
) -> Score {
    let truth = Truth::of(case);
    let d = outcome.map(|o| &o.diagnosis);
    let named: Vec<&'static str> =
        d.map_or(Vec::new(), |d| d.effects.iter().map(|e| e.name).collect());
    let rivals: Vec<&'static str> =
        d.map_or(Vec::new(), |d| d.rivals.iter().map(|r| r.name).collect());
    Score {
        stratum: stratum_name(stratum),
        hidden: case
            .label
            .effects
            .iter()
            .map(|e| e.kind.name())
            .chain(case.label.corruption.map(|c| c.name()))
            .collect(),
        strengths: case.label.effects.iter().map(|e| e.strength).collect(),
        lambda,
        end: end(d.map(|d| d.verdict), &truth, &named, &rivals),
        verdict: d.map_or(Verdict::Invalid, |d| d.verdict),
        named,
        rivals,
        fit_z: d.map_or((f64::NAN, f64::NAN), |d| {
            (d.quality.base_z, d.quality.augmented_z)
        }),
        closed,
        parameters: case
            .label
            .effects
            .iter()
            .filter_map(|e| parameter(e, d?))
            .collect(),
        places: d.map_or(Vec::new(), |d| d.blocks.iter().take(5).map(place).collect()),
        ranking: d.map_or(Vec::new(), |d| {
            d.ranking.iter().take(6).map(candidate).collect()
        }),
        notes: d.map_or(Vec::new(), |d| {
            std::iter::once(&d.summary)
                .chain(&d.notes)
                .cloned()
                .collect()
        }),
        lambdas: d.map_or(Vec::new(), |d| {
            d.effects.iter().map(|e| e.evidence.lambda).collect()
        }),
        gaps: d.map_or(Vec::new(), |d| {
            d.rivals
                .iter()
                .map(|r| (r.name, r.score_gap, r.discriminability))
                .collect()
        }),
        inseparable: d.map_or(Vec::new(), |d| d.inseparable.clone()),
        recommended: Vec::new(),
        placebo: None,
    }
}

/// The strength of a kind at which λ is about as wanted, by a secant in logarithms: λ grows with
/// some power of the strength.
///
/// # Errors
/// As [`strength`].
pub fn strength_for(seed: u64, kind: EffectKind, lambda: f64) -> anyhow::Result<f64> {
    let mut before: Option<(f64, f64)> = None;
    let mut at: f64 = 0.1;
    for _ in 0..6 {
        let spec = Spec::single(seed, kind, at);
        let met = strength(&spec, &Case::new(&spec))?.max(1e-6);
        if (met / lambda).ln().abs() < 0.15 {
            break;
        }
        let power = before.map_or(2.0, |(s, l)| {
            ((met / l).ln() / (at / s).ln()).clamp(0.5, 6.0)
        });
        before = Some((at, met));
        let next = (at * ((lambda / met).ln() / power).exp().clamp(1e-3, 20.0)).clamp(1e-7, 3.0);
        if (next / at).ln().abs() < 1e-3 {
            break;
        }
        at = next;
    }
    Ok(at)
}
