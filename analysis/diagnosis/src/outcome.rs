//! Result of a diagnosis: `diagnosis.json`, and the curves behind its pictures.

use super::findings::{Finding, FindingKind};
use crate::thresholds::{NAMED_SHARE, SHARE_ERROR};
use analysis_effects::{
    contract::{Facts, Group},
    effects::Mechanism,
};
use analysis_model::model::Erm;
use num_complex::Complex64;
use serde::Serialize;

/// Name of the file's schema.
pub const DIAGNOSIS_SCHEMA: &str = "eis-bench/diagnosis";
/// The claim of a [`Predictive`].
pub const PREDICTION_ONLY: &str = "prediction_only";
/// Version of the file's schema.
pub const DIAGNOSIS_SCHEMA_VERSION: u32 = 1;

/// Verdict of a diagnosis.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// Nothing is missing that repeats could show.
    AtNoiseFloor,
    /// The named effects were missing.
    Explained,
    /// The named effects were missing, but their form differs from the catalogue's, or something
    /// far smaller is missing beside them.
    Mostly,
    /// Something is missing; these data cannot decide between several effects.
    Ambiguous,
    /// Something is missing that no effect of the catalogue explains.
    Unexplained,
    /// The data cannot be used.
    Invalid,
}

impl Verdict {
    /// Returns true if a further run could reveal more of what is missing.
    pub fn is_open(self) -> bool {
        matches!(self, Self::Mostly | Self::Ambiguous | Self::Unexplained)
    }

    /// Returns true if something is missing that has no name.
    pub fn leaves_a_rest(self) -> bool {
        matches!(self, Self::Mostly | Self::Unexplained)
    }

    /// Returns the label as text.
    pub fn label(self) -> &'static str {
        match self {
            Self::AtNoiseFloor => "at the noise floor",
            Self::Explained => "explained",
            Self::Mostly => "mostly explained",
            Self::Ambiguous => "ambiguous",
            Self::Unexplained => "unexplained",
            Self::Invalid => "invalid",
        }
    }
}

/// A diagnosis as it is written.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Diagnosis {
    /// [`DIAGNOSIS_SCHEMA`].
    pub schema: &'static str,
    /// [`DIAGNOSIS_SCHEMA_VERSION`].
    pub schema_version: u32,
    /// Program and version that wrote it.
    pub program: &'static str,
    /// Name of the data set.
    pub data_set: String,
    /// Name of the model.
    pub model: String,
    /// The end.
    pub verdict: Verdict,
    /// The verdict as text.
    pub summary: String,
    /// Effects that were added and stay; for [`Verdict::Ambiguous`] the best representative.
    pub effects: Vec<NamedEffect>,
    /// Effects that explain the data about as well as a named one.
    pub rivals: Vec<Rival>,
    /// Blocks in which the base model misses the measurement, most significant first.
    #[serde(rename = "where")]
    pub blocks: Vec<Block>,
    /// The same with the named effects added.
    pub where_after: Vec<Block>,
    /// Gap per held-out record in time.
    pub gap: Vec<Gap>,
    /// Gap per held-out spectrum.
    pub gap_spectra: Vec<SpectrumGap>,
    /// The run that would decide the open question.
    pub next_experiment: Option<NextExperiment>,
    /// Effects, each with one that would imitate it in every run of the menu regardless of the
    /// number of repeats. The second name is empty if the signal is too small for any run to make
    /// the name certain.
    pub inseparable: Vec<[&'static str; 2]>,
    /// Oddities of the data as they were written, before any physics.
    pub findings: Vec<Finding>,
    /// The findings whose correction replaced the raw data.
    pub accepted: Vec<FindingKind>,
    /// Warnings to the user, in sentences.
    pub notes: Vec<String>,
    /// Quality of the fits.
    pub quality: Quality,
    /// The noise that everything was judged by.
    pub noise: NoiseReport,
    /// All candidates of the first round, best first.
    pub ranking: Vec<Candidate>,
    /// The base model refitted to spectra and training records.
    pub base: Option<Erm>,
    /// The base model refitted together with the named effects.
    pub augmented: Option<Erm>,
    /// The best prediction if no name is certain.
    pub predictive: Option<Predictive>,
    /// Shares of the mechanisms that explain the data together, the largest first.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub shares: Vec<Share>,
    /// Effects that the base had from the start, fitted again; the named ones come on top.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub given: Vec<PredictiveTerm>,
    /// What was put in or left out by hand; `None` if nothing was requested.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub by_hand: Option<ByHandGap>,
}

impl Diagnosis {
    /// Returns the mechanisms that are named in place of effects, the largest share first; empty
    /// unless the verdict names mechanisms.
    pub fn mechanisms(&self) -> Vec<&Share> {
        if self.verdict != Verdict::Mostly || !self.effects.is_empty() {
            return Vec::new();
        }
        self.large_shares()
    }

    /// Returns the shares that are large enough to name, on held-out and on fitted runs.
    pub(super) fn large_shares(&self) -> Vec<&Share> {
        let shares = self.shares.iter();
        shares
            .filter(|share| share.held_out.min(share.fitted) >= NAMED_SHARE)
            .collect()
    }

    /// Returns whether effects or mechanisms are named, so that the augmented model is another one
    /// than the base.
    pub fn has_additions(&self) -> bool {
        !self.effects.is_empty() || !self.mechanisms().is_empty()
    }
}

/// Effects put into the base or left out of it by hand, and the change that this makes.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ByHandGap {
    /// Names of the effects put in.
    pub added: Vec<&'static str>,
    /// Names of the effects left out.
    pub left_out: Vec<&'static str>,
    /// χ² of the training runs before.
    pub before_chi2: f64,
    /// The same after, with everything else fitted again.
    pub after_chi2: f64,
    /// Root mean square over the held-out records before, mV; `None` without any.
    pub before_mv: Option<f64>,
    /// The same after, mV.
    pub after_mv: Option<f64>,
    /// Gap per held-out record: `base_mv` is before, `augmented_mv` after.
    pub gap: Vec<Gap>,
}

/// An augmentation for predictions, which claims nothing about the cause.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Predictive {
    /// [`PREDICTION_ONLY`].
    pub claim: &'static str,
    /// χ² that all of its terms together remove from the training runs.
    pub lambda: f64,
    /// The same less the price of their parameters.
    pub score: f64,
    /// Its terms: the named effects first.
    pub terms: Vec<PredictiveTerm>,
    /// Gap per held-out record; `augmented_*` is with these terms.
    pub gap: Vec<Gap>,
    /// Range of the data that it was fitted and tested with; outside it nothing is known.
    pub range: Facts,
    /// The base model refitted together with them.
    pub model: Erm,
}

/// Share of a mechanism in what the refitted base lacks, among the additions that were fitted
/// together.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Share {
    /// The mechanism.
    pub mechanism: Mechanism,
    /// The mechanism as text.
    pub title: &'static str,
    /// Effects of the catalogue that stand for it.
    pub effects: Vec<&'static str>,
    /// Part of the mean square of the gap beyond noise on the held-out runs that it removes.
    pub held_out: f64,
    /// Least and greatest part that it removes, over the orders in which the mechanisms are added.
    pub held_out_range: (f64, f64),
    /// Part of the excess of χ² in the fitted runs that it removes.
    pub fitted: f64,
    /// Gap over the held-out records with it switched off and all else fitted again, mV.
    pub without_mv: f64,
    /// The same gap with all mechanisms, mV.
    pub with_mv: f64,
    /// Other mechanisms, or laws outside the catalogue, that would do as well in its place.
    pub partners: Vec<&'static str>,
}

impl Share {
    /// Returns the mechanism, those that would do as well, and its share.
    pub fn in_words(&self) -> String {
        let others: String = self.partners.iter().map(|p| format!(" or {p}")).collect();
        format!("{}{others} ({} of the gap)", self.title, self.percents())
    }

    /// Returns the range of the share as text, 0 to 100 %: its error about the mean over the orders
    /// in which the mechanisms are added, and what the orders themselves leave open.
    pub fn percents(&self) -> String {
        let percent = |part: f64| (100.0 * part).clamp(0.0, 100.0).round();
        let (least, greatest) = self.held_out_range;
        let low = percent(least.min(self.held_out - SHARE_ERROR));
        let high = percent(greatest.max(self.held_out + SHARE_ERROR));
        if high == 0.0 {
            return "none".to_owned();
        }
        format!("{low:.0} to {high:.0} %")
    }
}

/// One term of a [`Predictive`], or of a base.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PredictiveTerm {
    /// Name in the catalogue of the form that it has.
    pub name: &'static str,
    /// Name as text.
    pub title: &'static str,
    /// Cell or bench.
    pub group: Group,
    /// Form of the signal that it represents.
    pub stands_for: &'static str,
    /// Its parameters, the strength first; the interval is the range that was searched.
    pub parameters: Vec<FittedParameter>,
}

/// An effect with its parameters and evidence.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct NamedEffect {
    /// Name in the catalogue.
    pub name: &'static str,
    /// Name as text.
    pub title: &'static str,
    /// Cell or bench.
    pub group: Group,
    /// Its parameters, the strength first.
    pub parameters: Vec<FittedParameter>,
    /// Evidence for it.
    pub evidence: Evidence,
    /// Observation that would falsify it.
    pub falsified_by: String,
}

/// A fitted parameter of an effect.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FittedParameter {
    /// Name with unit.
    pub name: &'static str,
    /// Value.
    pub value: f64,
    /// Standard uncertainty; `None` if the data do not determine it.
    pub sigma: Option<f64>,
    /// Ends of the 95 % interval; equal to the bound if the data leave it open.
    pub interval: (f64, f64),
    /// Unit.
    pub unit: &'static str,
    /// Reason why the value is not that of a sound cell or bench; `None` if it may be.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub caution: Option<&'static str>,
}

/// Evidence for an added effect.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Evidence {
    /// λ: χ² that it removes from the training runs.
    pub lambda: f64,
    /// λ less k·ln N, the penalised gain.
    pub score: f64,
    /// Part of the excess of χ² over its degrees of freedom that it removes.
    pub share_of_excess: f64,
    /// Change of the whitened χ² of the held-out runs; negative is better.
    pub held_out_change: f64,
    /// Largest error of integration on any sample, as a part of the noise floor.
    pub integration_error: f64,
}

/// An effect that would do as well.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Rival {
    /// Name in the catalogue.
    pub name: &'static str,
    /// The named effect that it could replace.
    pub instead_of: &'static str,
    /// Penalised gain less that of the named one.
    pub score_gap: f64,
    /// r: part of the named effect's λ that this one cannot imitate, 0 identical, 1 distinct.
    pub discriminability: f64,
}

/// One block of residuals.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Block {
    /// Dimension that the residuals are split by: `frequency`, `time since edge`, `current`, ….
    pub dimension: &'static str,
    /// Part of the dimension: `below 1 Hz, imaginary part`.
    pub part: String,
    /// Residuals in the block.
    pub count: usize,
    /// Their χ², outside the tangent space of the model.
    pub chi2: f64,
    /// χ² that noise alone would give.
    pub expected_chi2: f64,
    /// Mean of the residuals in standard deviations of that mean.
    pub mean_z: f64,
    /// Probability of as much by noise alone, corrected for the number of blocks (Holm).
    pub p_value: f64,
    /// Root mean square of the residuals: mV for records, parts per thousand of |Z| for spectra.
    /// Rows at edges of the current are left out if there are others.
    pub rms: f64,
}

/// Gap between prediction and measurement of a held-out record, root mean square over its samples.
///
/// If a logger leaves the time of an edge of the current open, samples at an edge are excluded from
/// the gaps and from their floor; `*_with_edges_mv` cover all samples.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Gap {
    /// Name of the run.
    pub run: String,
    /// Prediction from the model file alone, mV.
    pub eis_only_mv: f64,
    /// Base model after the joint refit, mV.
    pub base_mv: f64,
    /// RMS with the named effects, mV.
    pub augmented_mv: f64,
    /// Floor that noise and repeatability set for any model over the same samples, mV.
    pub floor_mv: f64,
    /// As `eis_only_mv`, samples at edges among them, mV.
    pub eis_only_with_edges_mv: f64,
    /// As `base_mv`, samples at edges among them, mV.
    pub base_with_edges_mv: f64,
    /// As `augmented_mv`, samples at edges among them, mV.
    pub augmented_with_edges_mv: f64,
    /// As `floor_mv`, samples at edges among them, mV.
    pub floor_with_edges_mv: f64,
    /// Samples at edges.
    pub edge_samples: usize,
    /// Largest miss with the named effects beside edges, over the movement of the voltage
    /// ([`HeldOutError`](analysis_effects::contract::HeldOutError)).
    pub augmented_share: f64,
}

/// The same for a held-out spectrum, root mean square of |ΔZ|/|Z|.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SpectrumGap {
    /// Name of the run.
    pub run: String,
    /// Prediction from the model file alone, %.
    pub eis_only_percent: f64,
    /// Base model after the joint refit, %.
    pub base_percent: f64,
    /// RMS with the named effects, %.
    pub augmented_percent: f64,
    /// Floor that noise and repeatability set for any model, %.
    pub floor_percent: f64,
}

/// The run that separates the rivals most per minute.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct NextExperiment {
    /// Name in the menu: `zero_net_charge_bursts`.
    pub name: &'static str,
    /// Description of the run as text.
    pub description: String,
    /// Effects that it separates.
    pub separates: Vec<&'static str>,
    /// Expected separation √λ of the closest pair, in standard deviations.
    pub separation_sigma: f64,
    /// The same with the present data.
    pub separation_now_sigma: f64,
    /// True if it is expected to decide all open questions; false if it decides some of them.
    pub settles: bool,
    /// Time on the bench, min.
    pub duration_min: f64,
    /// Charge moved in either direction, Ah.
    pub charge_ah: f64,
}

/// Quality of the fits to the training runs.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Quality {
    /// χ² of the base model.
    pub base_chi2: f64,
    /// Its degrees of freedom.
    pub degrees_of_freedom: f64,
    /// (χ² − dof)/√(2·dof) of the base model.
    pub base_z: f64,
    /// χ² with the named effects.
    pub augmented_chi2: f64,
    /// The same measure with the named effects.
    pub augmented_z: f64,
}

/// The noise model and its origin.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct NoiseReport {
    /// True if repeats measured it; false if it was assumed, so that no floor can be claimed.
    pub from_repeats: bool,
    /// One entry per term.
    pub terms: Vec<NoiseTerm>,
}

/// One term of the noise model.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct NoiseTerm {
    /// Name with unit.
    pub name: &'static str,
    /// Standard deviation used.
    pub sigma: f64,
    /// Standard deviation from the bench's history; `None` if the history does not contain it.
    pub history: Option<f64>,
    /// Distance of the repeats from the history, in standard deviations of its logarithm.
    pub z: Option<f64>,
}

/// A candidate of the first round.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Candidate {
    /// Name in the catalogue.
    pub name: &'static str,
    /// Lagrange-multiplier score: χ² that a small step of it would remove.
    pub lagrange: f64,
    /// χ² removed by the full fit; `None` if the score was too low to fit it.
    pub lambda: Option<f64>,
    /// Penalised gain.
    pub score: Option<f64>,
    /// Reason for the refusal; empty for the one taken.
    pub refused_because: String,
}

/// One run's curves for the pictures.
#[derive(Debug, Clone, PartialEq)]
pub struct RunCurves {
    /// Name of the run.
    pub name: String,
    /// True for a held-out run.
    pub held_out: bool,
    /// The curves.
    pub curves: Curves,
}

/// Measured and predicted curves of a run.
#[derive(Debug, Clone, PartialEq)]
pub enum Curves {
    /// A record: time (s), measured voltage (V), predictions (V), floor (V) per sample.
    Time {
        /// Time, s.
        time_s: Vec<f64>,
        /// Current, A, discharge positive.
        current_a: Vec<f64>,
        /// Measured, V.
        measured_v: Vec<f64>,
        /// From the model file alone, V.
        eis_only_v: Vec<f64>,
        /// Base after the joint refit, V.
        base_v: Vec<f64>,
        /// With the named effects, V.
        augmented_v: Vec<f64>,
        /// Standard deviation of noise and repeatability, V.
        floor_v: Vec<f64>,
    },
    /// A spectrum.
    Eis {
        /// Frequency, Hz.
        freq_hz: Vec<f64>,
        /// Measured, Ω.
        measured_ohm: Vec<Complex64>,
        /// From the model file alone, Ω.
        eis_only_ohm: Vec<Complex64>,
        /// Base after the joint refit, Ω.
        base_ohm: Vec<Complex64>,
        /// With the named effects, Ω.
        augmented_ohm: Vec<Complex64>,
        /// Standard deviation of |Z|, Ω.
        floor_ohm: Vec<f64>,
    },
}
