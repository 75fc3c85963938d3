//! Choice of the columns: those of the options that the record can separate.

use super::{Drift, FitOptions, LeftOut, Note, ToneKind, Varying};

/// Minimum number of periods in a record to separate a parabola from a slow sinusoid.
const MIN_PERIODS_QUADRATIC: f64 = 2.0;
/// Periods that a record must have for relaxations: from here on they raise the standard deviation
/// of a phasor by less than 8 % (computed from the normal matrix for [`super::relaxations`]); with
/// 2 periods it would be 24 %.
const MIN_PERIODS_RELAXATION: f64 = 4.0;

/// Periods that a record must have for a sinusoid that changes: with fewer its columns are close to
/// those of the drift and of the harmonics.
const MIN_PERIODS_VARYING: f64 = 3.0;

/// Terms that are fitted besides the fundamental.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Plan {
    /// Degree of the drift.
    pub(super) degree: usize,
    /// Time constants of relaxations, s.
    pub(super) decays_s: Vec<f64>,
    /// True for a sinusoid that changes over the record.
    pub(super) varying: bool,
    /// Orders of the harmonics.
    pub(super) harmonics: Vec<u32>,
    /// Frequencies of the others, Hz.
    pub(super) others_hz: Vec<f64>,
    /// Terms that were left out.
    pub(super) notes: Vec<Note>,
}

impl Plan {
    /// Terms that `options` ask for, as far as a record of `samples` can carry it besides a sinusoid of
    /// `freq_hz`.
    pub(super) fn new(options: &FitOptions, freq_hz: f64, samples: usize, interval_s: f64) -> Self {
        let duration_s = samples as f64 * interval_s;
        let mut plan = Self {
            degree: options.drift.degree(),
            decays_s: options.decays_s.clone(),
            varying: options.varying == Varying::Linear,
            harmonics: Vec::new(),
            others_hz: Vec::new(),
            notes: Vec::new(),
        };
        if !plan.decays_s.is_empty() && freq_hz * duration_s < MIN_PERIODS_RELAXATION {
            plan.decays_s.clear();
            plan.notes.push(Note::RelaxationLeftOut {
                periods: freq_hz * duration_s,
                needed: MIN_PERIODS_RELAXATION,
            });
        }
        if plan.varying && freq_hz * duration_s < MIN_PERIODS_VARYING {
            plan.varying = false;
            plan.notes.push(Note::VaryingLeftOut {
                periods: freq_hz * duration_s,
                needed: MIN_PERIODS_VARYING,
            });
        }
        if options.drift == Drift::Quadratic && freq_hz * duration_s < MIN_PERIODS_QUADRATIC {
            plan.degree = 1;
            plan.notes.push(Note::DriftLeftOut {
                periods: freq_hz * duration_s,
                needed: MIN_PERIODS_QUADRATIC,
            });
        }
        let harmonics = options
            .harmonics
            .iter()
            .map(|order| ToneKind::Harmonic(*order));
        let others = options.also_hz.iter().map(|_| ToneKind::Other);
        let freqs = options
            .harmonics
            .iter()
            .map(|order| f64::from(*order) * freq_hz)
            .chain(options.also_hz.iter().copied());
        let mut taken = vec![freq_hz];
        let limits = Limits {
            resolution_hz: 1.0 / duration_s,
            nyquist_hz: 0.5 / interval_s,
        };
        for (kind, extra_hz) in harmonics.chain(others).zip(freqs) {
            match refusal(extra_hz, &taken, limits) {
                Some(why) => plan.notes.push(Note::LeftOut {
                    kind,
                    freq_hz: extra_hz,
                    why,
                }),
                None => {
                    taken.push(extra_hz);
                    match kind {
                        ToneKind::Harmonic(order) => plan.harmonics.push(order),
                        ToneKind::Other => plan.others_hz.push(extra_hz),
                    }
                }
            }
        }
        plan
    }

    /// Returns the minimal plan: the sinusoid, its offset and at most a linear drift, with notes on
    /// the parts left out, or `None` if the plan is already minimal.
    pub(super) fn reduced(&self, freq_hz: f64, channel: usize) -> Option<Self> {
        let degree = self.degree.min(1);
        let mut notes = self.notes.clone();
        if degree < self.degree {
            notes.push(Note::DriftUndetermined { channel });
        }
        if !self.decays_s.is_empty() {
            notes.push(Note::RelaxationUndetermined { channel });
        }
        if self.varying {
            notes.push(Note::VaryingUndetermined { channel });
        }
        let why = LeftOut::Undetermined { channel };
        notes.extend(
            self.tones(freq_hz)
                .into_iter()
                .map(|(kind, freq_hz)| Note::LeftOut { kind, freq_hz, why }),
        );
        (notes.len() > self.notes.len()).then_some(Self {
            degree,
            decays_s: Vec::new(),
            varying: false,
            harmonics: Vec::new(),
            others_hz: Vec::new(),
            notes,
        })
    }

    /// Returns the tones besides the fundamental, for a frequency of it.
    pub(super) fn tones(&self, freq_hz: f64) -> Vec<(ToneKind, f64)> {
        let harmonics = self
            .harmonics
            .iter()
            .map(|order| (ToneKind::Harmonic(*order), f64::from(*order) * freq_hz));
        harmonics
            .chain(
                self.others_hz
                    .iter()
                    .map(|freq_hz| (ToneKind::Other, *freq_hz)),
            )
            .collect()
    }
}

/// Frequencies that a record can resolve.
#[derive(Clone, Copy)]
struct Limits {
    /// Least distance of two tones, Hz: one period over the record.
    resolution_hz: f64,
    /// Half the sampling rate, Hz.
    nyquist_hz: f64,
}

/// Reason why a tone cannot be fitted besides those already taken. Two tones, a tone and the drift,
/// or a tone and its image beyond half the sampling rate must differ by one period over the record.
fn refusal(freq_hz: f64, taken: &[f64], limits: Limits) -> Option<LeftOut> {
    let Limits {
        resolution_hz,
        nyquist_hz,
    } = limits;
    if !(freq_hz.is_finite() && freq_hz > 0.0) {
        return Some(LeftOut::NoFrequency);
    }
    if freq_hz > nyquist_hz - 0.5 * resolution_hz {
        return Some(LeftOut::AboveNyquist { nyquist_hz });
    }
    if freq_hz < resolution_hz {
        return Some(LeftOut::TooSlow { resolution_hz });
    }
    // Frequencies that are meant to be one resolution apart must not fail by rounding.
    let close = |other_hz: &&f64| (freq_hz - **other_hz).abs() < resolution_hz * (1.0 - 1e-9);
    taken.iter().find(close).map(|to_hz| LeftOut::TooClose {
        to_hz: *to_hz,
        resolution_hz,
    })
}
