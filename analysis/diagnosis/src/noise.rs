//! Noise of every row: the differences between a run's repeats, and the effect of the current
//! channel's errors on the model's own output.
//!
//! C = diag(σ_w²/m) + σ_d² exp(−|Δt|/τ_d) + σ_V² 11ᵀ + σ_R² ηηᵀ + σ_g² b_g b_gᵀ + σ_o² b_o b_oᵀ + Σ
//! σ_I² b_s b_sᵀ + F, with η what all resistances drop and b the model's responses to a gain, a
//! zero error and a per-stretch error of the logged current, the counted charge included; F is what
//! white noise of the current does to branches and charge, see `current_noise_propagation`.
//! How the σ are found is
//! in `estimate`.

use super::block::{Block, Kind, Model, Workspace};
use super::codes::Codes;
use super::current_noise_propagation;
use super::data::assumed_history;
use super::edges::{self, UNIFORM};
use super::shared::{self, Errors, RecordRows};
use super::time_block::TimeBlock;
use super::whitening::{Whitener, dot};
use crate::thresholds::{EDGE_ROW_PART, HISTORY_SPREAD, IGNORANCE_SPREAD, MOST_STRETCHES};
use analysis_effects::{augmented::Added, contract::Base, effects::resistance_spread};
use analysis_signal::calibration::CommonError;
use analysis_signal::history::BenchHistory;

/// Part by which all resistances are made larger to see what their scatter does.
const LARGER: f64 = 1e-3;

/// The terms that are estimated.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Term {
    White,
    Drift,
    Level,
    Resistance,
    Gain,
    Zero,
    Eis,
}

/// All terms with their names in files.
pub(super) const TERMS: [(Term, &str); 7] = [
    (Term::White, "voltage_noise_v"),
    (Term::Drift, "voltage_drift_v"),
    (Term::Level, "voltage_offset_v"),
    (Term::Resistance, "resistance_rel"),
    (Term::Gain, "current_gain_rel"),
    (Term::Zero, "current_offset_a"),
    (Term::Eis, "eis_noise_rel"),
];

/// Natural logarithms of the σ of [`TERMS`].
pub(super) type LogSigmas = [f64; TERMS.len()];

/// Prior knowledge of a bench, before its repeats.
#[derive(Debug, Clone, Copy)]
pub(super) struct Prior {
    pub(super) log_sigmas: LogSigmas,
    pub(super) spread: f64,
    pub(super) known: bool,
    /// Factor by which repeats contradict the whole history; 1 if they do not.
    pub(super) factor: f64,
    history: BenchHistory,
    calibration: Option<CommonError>,
}

impl Prior {
    pub(super) fn new(
        history: Option<BenchHistory>,
        calibration: Option<CommonError>,
        base: &Base,
    ) -> Self {
        let h = history.unwrap_or_else(|| assumed_history(base.facts.greatest_a));
        let sigma = |term: Term| match term {
            Term::White => h.voltage_noise_v,
            Term::Drift => h.voltage_drift_v,
            Term::Level => h.voltage_offset_v,
            Term::Resistance => h.resistance_rel,
            Term::Gain => h.current_gain_rel,
            Term::Zero => h.current_offset_a,
            Term::Eis => h.eis_noise_rel,
        };
        let log_sigmas = TERMS.map(|(term, _)| sigma(term).max(1e-12).ln());
        let spread = if history.is_some() {
            HISTORY_SPREAD
        } else {
            IGNORANCE_SPREAD
        };
        Self {
            log_sigmas,
            spread,
            known: history.is_some(),
            factor: 1.0,
            history: h,
            calibration,
        }
    }

    /// Returns the same prior for runs whose repeats measure the noise themselves.
    pub(super) fn ignorant(&self) -> Self {
        Self {
            spread: IGNORANCE_SPREAD,
            known: false,
            ..*self
        }
    }

    /// Returns the same with all noise of the history stated by a factor wrong.
    pub(super) fn times(&self, factor: f64) -> Self {
        Self {
            log_sigmas: self.log_sigmas.map(|log| log + factor.ln()),
            factor: self.factor * factor,
            ..*self
        }
    }

    /// Returns the difference of a constant current between two samples, A: one standard deviation;
    /// 0 if nothing is known.
    pub(super) fn jitter_a(&self) -> f64 {
        if self.known {
            current_jitter_a(&self.history)
        } else {
            0.0
        }
    }

    /// Returns the variance of one voltage sample that no estimate touches: codes of both channels
    /// and noise of the current, V².
    pub(super) fn sample_variance(&self, base: &Base) -> f64 {
        let h = &self.history;
        (h.voltage_resolution_v * UNIFORM).powi(2) + current_variance_a2(h) * base.erm.r_ohm.powi(2)
    }
}

/// The shape of a block's covariance: every matrix that a σ² multiplies.
#[derive(Debug, Clone)]
pub(super) struct Shape {
    pub(super) n: usize,
    /// Variance that no estimate touches: codes of both channels, noise of the current, stated σ.
    fixed: Vec<f64>,
    /// Diagonal of the white term, voltage or spectrum.
    white: (Term, Vec<f64>),
    /// Current-noise propagation: covariance from white noise of the current after its own sample,
    /// row-major; empty without such noise.
    propagated: Vec<f64>,
    /// Correlation of the drift, row-major; empty for a spectrum.
    pub(super) drift: Vec<f64>,
    /// One vector per estimated term of rank one.
    vectors: Vec<(Term, Vec<f64>)>,
    /// Covariance of the run's own errors of known size, which its repeats may share, row-major,
    /// its lower triangle; empty if there are none.
    known: Vec<f64>,
    /// Variance of each row from the errors at edges of the current, which `known` contains; empty
    /// if there are none.
    edge_v2: Vec<f64>,
    /// The same of what all runs share.
    shared: Errors,
    /// Covariance of the codes' error if the noise does not dither them, row-major; empty if it
    /// does.
    codes: Vec<f64>,
}

impl Shape {
    /// Creates the shape at a base model with effects.
    pub(super) fn new(
        block: &Block,
        model: &Model<'_>,
        prior: &Prior,
        workspace: &mut Workspace,
    ) -> Self {
        let mut predicted = Vec::new();
        block.predict(model, 1, workspace, &mut predicted);
        let resistance = resistance(block, model, &predicted, workspace);
        match &block.kind {
            Kind::Eis {
                points,
                harmonics,
                sigma_ohm,
                ..
            } => {
                let size: Vec<f64> = predicted[..2 * points.len()]
                    .chunks_exact(2)
                    .flat_map(|z| [z[0].hypot(z[1]); 2])
                    .chain(harmonics.iter().flat_map(|_| [0.0; 2]))
                    .collect();
                let stated = |k: usize| {
                    sigma_ohm[k / 2].map_or(0.0, |s| if k.is_multiple_of(2) { s.0 } else { s.1 })
                };
                Self {
                    n: size.len(),
                    fixed: (0..size.len())
                        .map(|k| stated(k).powi(2) + (1e-7 * size[k]).powi(2))
                        .collect(),
                    white: (Term::Eis, size.iter().map(|z| z * z).collect()),
                    propagated: Vec::new(),
                    drift: Vec::new(),
                    shared: shared::of_spectrum(
                        &block.kind,
                        &predicted,
                        &prior.history,
                        prior.calibration,
                    ),
                    vectors: vec![(Term::Resistance, resistance)],
                    known: Vec::new(),
                    edge_v2: Vec::new(),
                    codes: Vec::new(),
                }
            }
            Kind::Time(time) => {
                Self::time(block, time, model, &predicted, resistance, prior, workspace)
            }
        }
    }

    fn time(
        block: &Block,
        time: &TimeBlock,
        model: &Model<'_>,
        predicted: &[f64],
        resistance: Vec<f64>,
        prior: &Prior,
        workspace: &mut Workspace,
    ) -> Self {
        let (base, h) = (model.base, &prior.history);
        let n = time.bins.len();
        let counts: Vec<f64> = time.bins.iter().map(|b| (b.to - b.from) as f64).collect();
        // Rows that state their noise are means of many samples, whose own noise is far above a
        // code.
        let stated = time.bins.iter().any(|b| b.stated_v2 > 0.0);
        let fresh_a2 = current_variance_a2(h);
        let codes = Codes {
            step: h.voltage_resolution_v,
            sigma: if stated {
                f64::INFINITY
            } else {
                h.voltage_noise_v
            },
        };
        let own_a2 = if stated {
            h.current_noise_a.powi(2)
        } else {
            fresh_a2
        };
        let fixed_v = codes.fresh() + own_a2 * base.erm.r_ohm.powi(2) + 1e-14;
        let mut respond = |change: &dyn Fn(usize, f64) -> f64, scale: f64| {
            let current_a: Vec<f64> = time
                .current_a
                .iter()
                .enumerate()
                .map(|(k, i)| i + change(k, *i))
                .collect();
            block.play(time, model, &current_a, 1, &mut *workspace);
            time.average(&workspace.voltage_v)
                .iter()
                .zip(predicted)
                .map(|(a, b)| (a - b) * scale)
                .collect::<Vec<f64>>()
        };
        let gain = respond(&|_, i| 1e-2 * i, 1e2);
        let at_edges = if time.linear {
            edges::of_record(time, block.at.soc, base)
        } else {
            Vec::new()
        };
        let rows = RecordRows {
            predicted_v: predicted,
            gain_v: &gain,
            edges: &at_edges,
        };
        let shared = shared::of_record(time, block.at.soc, base, rows, h);
        let vectors = vec![
            (Term::Level, vec![1.0; n]),
            (Term::Resistance, resistance),
            (Term::Gain, gain),
            (Term::Zero, respond(&|_, _| 1e-1, 1e1)),
        ];
        let mut known = Vec::new();
        let mut add = |v: &[f64]| {
            known.resize(n * n, 0.0);
            add_square(&mut known, v, 1.0);
        };
        let step_a = h.current_resolution_a * UNIFORM;
        if !time.current_errors_a.is_empty() {
            for error_a in &time.current_errors_a {
                add(&respond(&|k, _| error_a[k], 1.0));
            }
        } else if step_a > 0.0 {
            for (from, to) in stretches(time) {
                add(&respond(
                    &|k, _| if (from..to).contains(&k) { step_a } else { 0.0 },
                    1.0,
                ));
            }
        }
        let mut edge_v2 = vec![0.0; n];
        for errors in at_edges {
            edge_v2
                .iter_mut()
                .zip(&errors.passing_v2)
                .for_each(|(v2, e2)| *v2 += e2);
            errors.common_v.iter().for_each(|v| add(v));
            add(&errors.first_v);
        }
        // A logger whose rows run free has all edges of a record at one position of that record.
        shared[shared::CHANNELS..shared::CHANNELS + edges::COMMON]
            .iter()
            .for_each(|v| add(v));
        if time.level_sigma_v > 0.0 {
            add(&vec![time.level_sigma_v; n]);
        }
        let correlation = |i: usize, j: usize| {
            (-(time.bins[i].time_s - time.bins[j].time_s).abs() / h.voltage_drift_s.max(1e-3)).exp()
        };
        Self {
            n,
            fixed: time
                .bins
                .iter()
                .zip(&counts)
                .map(|(b, m)| fixed_v / m + b.stated_v2)
                .collect(),
            white: (Term::White, counts.iter().map(|m| 1.0 / m).collect()),
            // Means over many samples have hardly any noise left, and they state it.
            propagated: if stated || fresh_a2 <= 0.0 {
                Vec::new()
            } else {
                current_noise_propagation::covariance(time, block.at.soc, base, fresh_a2)
            },
            drift: (0..n * n).map(|ij| correlation(ij / n, ij % n)).collect(),
            vectors,
            known,
            edge_v2,
            shared,
            codes: codes.shared().map_or_else(Vec::new, |_| {
                (0..n * n)
                    .map(|ij| codes.covariance(predicted[ij / n] - predicted[ij % n]))
                    .collect()
            }),
        }
    }

    /// Returns the change of the rows by one standard deviation of each error that all runs share.
    pub(super) fn shared(&self) -> &Errors {
        &self.shared
    }

    /// Returns the covariance of a run's errors that its repeats may share or not, row-major, its
    /// lower triangle; empty if there are none.
    pub(super) fn known(&self) -> &[f64] {
        &self.known
    }

    /// Returns which rows lie at edges of the current: those with more than a given part of their
    /// variance from an edge. `whole` is the variance of each row.
    pub(super) fn at_edges(&self, whole: &[f64]) -> Vec<bool> {
        let edges = self.edge_v2.iter().chain(std::iter::repeat(&0.0));
        whole
            .iter()
            .zip(edges)
            .map(|(whole, edge)| *edge > EDGE_ROW_PART * whole)
            .collect()
    }

    /// Keeps the codes' error in the mean of `repeats` runs: they meet the same codes at the same
    /// voltages, so averaging does not reduce it.
    pub(super) fn share_codes(&mut self, repeats: usize) {
        self.codes.iter_mut().for_each(|c| *c *= repeats as f64);
    }

    /// Returns the change of the rows when all resistances grow in proportion to an order.
    pub(super) fn trend(&self, order: f64) -> Vec<f64> {
        let resistance = self
            .vectors
            .iter()
            .find(|(term, _)| *term == Term::Resistance);
        resistance.map_or_else(
            || vec![0.0; self.n],
            |(_, v)| v.iter().map(|x| order * x).collect(),
        )
    }

    /// Leaves the errors of the current channel out.
    pub(super) fn forget_current_channel(&mut self) {
        self.vectors
            .retain(|(term, _)| !matches!(term, Term::Gain | Term::Zero));
        self.known.clear();
        self.edge_v2.clear();
        self.propagated.clear();
        self.shared.iter_mut().for_each(|v| v.fill(0.0));
    }

    /// Returns the covariance of a run that `repeat` runs are the mean of, what all runs share with
    /// it, row-major.
    pub(super) fn whole_covariance(&self, log_sigmas: &LogSigmas, repeat: usize) -> Vec<f64> {
        let mut c = self.covariance(log_sigmas);
        c.iter_mut().for_each(|c| *c /= repeat as f64);
        self.shared.iter().for_each(|v| add_square(&mut c, v, 1.0));
        c
    }

    /// Returns the covariance of the run's own errors, row-major.
    pub(super) fn covariance(&self, log_sigmas: &LogSigmas) -> Vec<f64> {
        let n = self.n;
        let variance = |term: Term| (2.0 * log_sigmas[term as usize]).exp();
        let mut c = vec![0.0; n * n];
        if !self.drift.is_empty() {
            let scale = variance(Term::Drift);
            c.iter_mut()
                .zip(&self.drift)
                .for_each(|(c, r)| *c = scale * r);
        }
        c.iter_mut().zip(&self.codes).for_each(|(c, k)| *c += k);
        c.iter_mut()
            .zip(&self.propagated)
            .for_each(|(c, k)| *c += k);
        let white = variance(self.white.0);
        for i in 0..n {
            c[i * n + i] += self.fixed[i] + white * self.white.1[i];
        }
        let scaled = self.vectors.iter().map(|(term, v)| (variance(*term), v));
        c.iter_mut().zip(&self.known).for_each(|(c, k)| *c += k);
        scaled.for_each(|(scale, v)| add_square(&mut c, v, scale));
        c
    }

    /// Returns (∂C/∂ln σ)·x for a term, or `None` if the shape does not have it.
    pub(super) fn derivative_times(
        &self,
        term: Term,
        variance: f64,
        x: &[f64],
    ) -> Option<Vec<f64>> {
        let scale = 2.0 * variance;
        if term == self.white.0 {
            return Some(
                x.iter()
                    .zip(&self.white.1)
                    .map(|(x, g)| scale * g * x)
                    .collect(),
            );
        }
        if term == Term::Drift && !self.drift.is_empty() {
            return Some(
                self.drift
                    .chunks_exact(self.n)
                    .map(|row| scale * dot(row, x))
                    .collect(),
            );
        }
        let (_, v) = self.vectors.iter().find(|(t, _)| *t == term)?;
        let along = scale * dot(v, x);
        Some(v.iter().map(|b| along * b).collect())
    }

    /// tr(C⁻¹·∂C/∂ln σ).
    pub(super) fn trace(
        &self,
        term: Term,
        variance: f64,
        white: &Whitener,
        inverse: &[f64],
    ) -> f64 {
        let scale = 2.0 * variance;
        if term == self.white.0 {
            return scale * white.trace_with_diagonal(&self.white.1);
        }
        if term == Term::Drift && !self.drift.is_empty() {
            return scale * dot(inverse, &self.drift);
        }
        self.vectors
            .iter()
            .find(|(t, _)| *t == term)
            .map_or(0.0, |(_, v)| {
                let mut w = Vec::with_capacity(self.n);
                white.apply(v, &mut w);
                scale * dot(&w, &w)
            })
    }
}

/// Returns the standard deviation of the difference of two samples of a current that stays, A.
pub(super) fn current_jitter_a(history: &BenchHistory) -> f64 {
    2f64.sqrt()
        * history
            .current_noise_a
            .hypot(history.current_resolution_a * UNIFORM)
}

/// Returns the variance that is independent in every sample of the current, its codes included, A².
fn current_variance_a2(h: &BenchHistory) -> f64 {
    h.current_noise_a.powi(2)
        + Codes {
            step: h.current_resolution_a,
            sigma: h.current_noise_a,
        }
        .fresh()
}

/// Returns the change of the rows by a growth of all resistances, per unit. A control is larger as
/// a whole.
fn resistance(
    block: &Block,
    model: &Model<'_>,
    predicted: &[f64],
    workspace: &mut Workspace,
) -> Vec<f64> {
    if !block.at.is_cell {
        return predicted.to_vec();
    }
    let larger: Vec<Added<'_>> = model
        .added
        .iter()
        .copied()
        .chain([Added {
            effect: resistance_spread(),
            p: &[LARGER],
        }])
        .collect();
    let mut rows = Vec::with_capacity(predicted.len());
    block.predict(&Model::new(model.base, &larger), 1, workspace, &mut rows);
    rows.iter()
        .zip(predicted)
        .map(|(r, p)| (r - p) / LARGER)
        .collect()
}

/// Adds scale·v·vᵀ to the lower triangle of a matrix.
fn add_square(c: &mut [f64], v: &[f64], scale: f64) {
    let n = v.len();
    for i in 0..n {
        let x = scale * v[i];
        if x != 0.0 {
            c[i * n..=i * n + i]
                .iter_mut()
                .zip(v)
                .for_each(|(c, y)| *c += x * y);
        }
    }
}

/// Stretches of samples between edges, merged to at most [`MOST_STRETCHES`].
fn stretches(time: &TimeBlock) -> impl Iterator<Item = (usize, usize)> {
    let every = time.edges.len().div_ceil(MOST_STRETCHES);
    let starts: Vec<usize> = time.edges.iter().copied().step_by(every).collect();
    let end = time.current_a.len();
    (0..starts.len()).map(move |k| (starts[k], starts.get(k + 1).copied().unwrap_or(end)))
}
