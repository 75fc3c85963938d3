//! Results of a fit: sinusoids with their uncertainty, the terms fitted beside them, and notes.

use num_complex::Complex64;

use analysis_numeric::Covariance2;

/// Sinusoids of one frequency fitted to the channels of a record.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct SineFit {
    /// Frequency, Hz: as given, or fitted.
    pub freq_hz: f64,
    /// Standard deviation of the frequency, Hz, if it was fitted.
    pub freq_sigma_hz: Option<f64>,
    /// One fit per channel.
    pub channels: Vec<ChannelFit>,
    /// Number of samples per channel.
    pub samples: usize,
    /// Time between two samples, s.
    pub interval_s: f64,
    /// Number of passes over the samples that found the frequency; 1 if it was given.
    pub iterations: usize,
    /// True if relaxations were fitted.
    #[serde(default)]
    pub relaxed: bool,
    /// True if a change of the sinusoid over the record was fitted.
    #[serde(default)]
    pub varying: bool,
    /// Tones at other frequencies: first the harmonics, then the rest.
    pub tones: Vec<Tone>,
    /// Notes on terms left out and on limits that the numbers do not show.
    pub notes: Vec<Note>,
}

/// Tone fitted at one other frequency.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Tone {
    /// Kind of the tone.
    pub kind: ToneKind,
    /// Its frequency, Hz.
    pub freq_hz: f64,
    /// Its phasor in each channel.
    pub channels: Vec<Phasor>,
}

/// Kind of an extra frequency.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ToneKind {
    /// A harmonic of the sinusoid, by its order.
    Harmonic(u32),
    /// A separate frequency.
    Other,
}

/// A phasor with its uncertainty.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Phasor {
    /// Phasor p of Re{p · exp(jωt)}, t = 0 at sample 0; V (zero to peak).
    pub phasor: Complex64,
    /// Covariance of its parts, V².
    pub variance: Covariance2,
}

/// Total harmonic distortion of a channel.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Distortion {
    /// Root of the summed squares of the harmonics' amplitudes over that of the sinusoid. Noise
    /// alone gives about `sigma`.
    pub thd: f64,
    /// Value that noise alone gives: root of the harmonics' summed variances over the sinusoid's
    /// amplitude.
    pub sigma: f64,
}

/// Note on a fit besides its numbers.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Note {
    /// An extra frequency was not fitted.
    LeftOut {
        /// Kind of the tone.
        kind: ToneKind,
        /// Its frequency, Hz.
        freq_hz: f64,
        /// Why.
        why: LeftOut,
    },
    /// The drift was fitted as a straight line, because the record is too short to separate a
    /// parabola from the sinusoid.
    DriftLeftOut {
        /// Periods in the record.
        periods: f64,
        /// Periods needed.
        needed: f64,
    },
    /// Relaxations were not fitted, because the record is too short to separate them from the
    /// sinusoid.
    RelaxationLeftOut {
        /// Periods in the record.
        periods: f64,
        /// Periods needed.
        needed: f64,
    },
    /// Relaxations were not fitted, for the usable samples of a channel do not determine them.
    RelaxationUndetermined {
        /// Channel, counted from 1.
        channel: usize,
    },
    /// The sinusoid was fitted as constant, because the record is too short to show a change.
    VaryingLeftOut {
        /// Periods in the record.
        periods: f64,
        /// Periods needed.
        needed: f64,
    },
    /// The sinusoid was fitted as constant, for the usable samples of a channel do not determine a
    /// change.
    VaryingUndetermined {
        /// Channel, counted from 1.
        channel: usize,
    },
    /// The drift was fitted as a straight line, for the usable samples of a channel do not
    /// determine a parabola.
    DriftUndetermined {
        /// Channel, counted from 1.
        channel: usize,
    },
    /// The noise is too low for the quantisation to act as noise: its error is systematic. The
    /// covariance includes the bound.
    Quantisation {
        /// Channel, counted from 1.
        channel: usize,
        /// Noise before the quantisation, LSB rms.
        noise_lsb: f64,
        /// Number of different phases that the samples come back to, if it is small.
        phases: Option<usize>,
        /// Bound of the phasor's error, V.
        bound_v: f64,
        /// The same over the amplitude.
        bound_relative: f64,
    },
}

/// Reason why an extra frequency was not fitted.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LeftOut {
    /// The frequency is not positive.
    NoFrequency,
    /// It cannot be distinguished from its image beyond half the sampling rate.
    AboveNyquist {
        /// Half the sampling rate, Hz.
        nyquist_hz: f64,
    },
    /// It has less than one period in the record, and cannot be separated from drift.
    TooSlow {
        /// One period over the record, Hz.
        resolution_hz: f64,
    },
    /// It differs from another by less than one period over the record.
    TooClose {
        /// The other one, Hz.
        to_hz: f64,
        /// One period over the record, Hz.
        resolution_hz: f64,
    },
    /// The usable samples of a channel do not determine it.
    Undetermined {
        /// Channel, counted from 1.
        channel: usize,
    },
}

impl std::fmt::Display for Note {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::LeftOut {
                kind: ToneKind::Harmonic(order),
                freq_hz,
                why,
            } => {
                write!(f, "harmonic {order} ({freq_hz:.6} Hz) is not fitted: {why}")
            }
            Self::LeftOut {
                kind: ToneKind::Other,
                freq_hz,
                why,
            } => write!(f, "{freq_hz:.6} Hz is not fitted: {why}"),
            Self::DriftLeftOut { periods, needed } => {
                write!(
                    f,
                    "the drift is fitted as a straight line: a parabola needs {needed} periods, \
                    the record has {periods:.2}"
                )
            }
            Self::RelaxationLeftOut { periods, needed } => {
                write!(
                    f,
                    "no relaxation is fitted: it needs {needed} periods, the record has \
                    {periods:.2}"
                )
            }
            Self::RelaxationUndetermined { channel } => {
                write!(
                    f,
                    "no relaxation is fitted: the usable samples of channel {channel} do not \
                    determine one"
                )
            }
            Self::VaryingLeftOut { periods, needed } => {
                write!(
                    f,
                    "the sinusoid is fitted as constant: a change needs {needed} periods, the record \
                    has {periods:.2}"
                )
            }
            Self::VaryingUndetermined { channel } => {
                write!(
                    f,
                    "the sinusoid is fitted as constant: the usable samples of channel {channel} do \
                    not determine a change"
                )
            }
            Self::DriftUndetermined { channel } => {
                write!(
                    f,
                    "the drift is fitted as a straight line: the usable samples of channel \
                    {channel} do not determine a parabola"
                )
            }
            Self::Quantisation {
                channel,
                noise_lsb,
                phases,
                bound_relative,
                ..
            } => {
                write!(
                    f,
                    "channel {channel}: {noise_lsb:.2} LSB of noise are too few to average the \
                    quantisation out"
                )?;
                if let Some(phases) = phases {
                    write!(f, ", for the samples come back to {phases} phases")?;
                }
                write!(
                    f,
                    "; the phasor may be {:.2} % wrong, which its uncertainty includes",
                    100.0 * bound_relative
                )
            }
        }
    }
}

impl std::fmt::Display for LeftOut {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::NoFrequency => f.write_str("expected a frequency above 0 Hz"),
            Self::AboveNyquist { nyquist_hz } => {
                write!(f, "half the sampling rate is {nyquist_hz:.6} Hz")
            }
            Self::TooSlow { resolution_hz } => write!(
                f,
                "one period takes longer than the record ({resolution_hz:.6} Hz)"
            ),
            Self::TooClose {
                to_hz,
                resolution_hz,
            } => {
                write!(
                    f,
                    "the record cannot separate it from {to_hz:.6} Hz, it resolves \
                    {resolution_hz:.6} Hz"
                )
            }
            Self::Undetermined { channel } => write!(
                f,
                "the usable samples of channel {channel} do not determine it"
            ),
        }
    }
}

impl SineFit {
    /// Periods in the record.
    pub fn periods(&self) -> f64 {
        self.freq_hz * self.interval_s * self.samples as f64
    }

    /// Returns the covariance of the phasor of a channel against absolute time, V²:
    /// [`ChannelFit::variance`] plus the rotation, common to all channels, that the uncertainty of
    /// a fitted frequency gives to phases at sample 0. Returns `None` for an unknown channel.
    pub fn absolute_covariance(&self, channel: usize) -> Option<Covariance2> {
        let fit = self.channels.get(channel)?;
        let middle_s = 0.5 * self.interval_s * (self.samples as f64 - 1.0);
        let turn = std::f64::consts::TAU * middle_s * self.freq_sigma_hz.unwrap_or(0.0);
        let along = Complex64::new(0.0, -turn) * fit.phasor;
        Some(fit.variance + Covariance2::along(along))
    }

    /// Returns the value of the model of a channel at a time since sample 0, V: sinusoid, offset,
    /// drift and tones, without the relaxations, whose parts are not kept. Returns `None` for an
    /// unknown channel.
    ///
    /// ```
    /// use analysis_signal::sine::{Channel, FitOptions, Record, fit_known_frequency};
    ///
    /// let at = |k: i32| 1e-4 * f64::from(k);
    /// let volts = |k: i32| 0.1 + (314.159 * at(k)).sin() + 0.05 * (628.318 * at(k)).cos() + at(k);
    /// let samples: Vec<f64> = (0..2000).map(volts).collect();
    /// let record = Record { channels: &[Channel::volts(&samples)], interval_s: 1e-4 };
    /// let options = FitOptions { harmonics: vec![2], ..FitOptions::default() };
    /// let fit = fit_known_frequency(&record, 314.159 / std::f64::consts::TAU, &options)?;
    /// for k in [0, 77, 1999] {
    ///     assert!((fit.value_v(0, at(k)).unwrap() - volts(k)).abs() < 1e-9);
    /// }
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn value_v(&self, channel: usize, time_s: f64) -> Option<f64> {
        let fit = self.channels.get(channel)?;
        let turned = |phasor: Complex64, freq_hz: f64| {
            (phasor * Complex64::cis(std::f64::consts::TAU * freq_hz * time_s)).re
        };
        let tones: f64 = self
            .tones
            .iter()
            .filter_map(|tone| Some(turned(tone.channels.get(channel)?.phasor, tone.freq_hz)))
            .sum();
        let from_middle_s = time_s - 0.5 * self.interval_s * (self.samples as f64 - 1.0);
        let slow = fit.offset_v
            + from_middle_s * (fit.drift_v_per_s + from_middle_s * fit.curvature_v_per_s2);
        let phasor = fit.phasor + fit.phasor_slope * from_middle_s;
        Some(turned(phasor, self.freq_hz) + tones + slow)
    }

    /// Returns the distortion of a channel by the fitted harmonics, or `None` without harmonics or
    /// for an unknown channel.
    pub fn distortion(&self, channel: usize) -> Option<Distortion> {
        let amplitude_v = self.channels.get(channel)?.phasor.norm();
        let harmonics = self
            .tones
            .iter()
            .filter(|tone| matches!(tone.kind, ToneKind::Harmonic(_)));
        let harmonics: Vec<&Phasor> = harmonics
            .filter_map(|tone| tone.channels.get(channel))
            .collect();
        let squares: f64 = harmonics
            .iter()
            .map(|harmonic| harmonic.phasor.norm_sqr())
            .sum();
        let variances: f64 = harmonics
            .iter()
            .map(|harmonic| harmonic.variance.re_re + harmonic.variance.im_im)
            .sum();
        (!harmonics.is_empty()).then(|| Distortion {
            thd: squares.sqrt() / amplitude_v,
            sigma: variances.sqrt() / amplitude_v,
        })
    }
}

/// Sinusoid fitted to one channel.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct ChannelFit {
    /// Phasor p of Re{p · exp(jωt)}, t = 0 at sample 0; V (zero to peak).
    pub phasor: Complex64,
    /// Covariance of the phasor's parts, V², for a fixed frequency. An error of a fitted frequency
    /// rotates the phasors of all channels by the same angle and cancels in their ratios;
    /// [`SineFit::absolute_covariance`] includes it.
    pub variance: Covariance2,
    /// Change of the phasor per second, V/s, against time zero at sample 0; zero unless fitted.
    #[serde(default)]
    pub phasor_slope: Complex64,
    /// Offset in the middle of the record, V.
    pub offset_v: f64,
    /// Drift in the middle of the record, V/s; zero unless fitted.
    pub drift_v_per_s: f64,
    /// Greatest distance of the sum of the relaxations from the line through its ends, V; zero
    /// unless they were fitted.
    #[serde(default)]
    pub relaxation_v: f64,
    /// Curvature c of the drift's c·(t − tₘ)², V/s²; zero unless fitted.
    pub curvature_v_per_s2: f64,
    /// Root mean square of the residual, V.
    pub residual_rms_v: f64,
    /// Correlation of neighbouring residuals, −1…1: near 0 for white noise, near 1 if something
    /// slow or periodic is left (drift that is not linear, harmonics, quantisation without dither).
    pub residual_lag1: f64,
    /// Factor that the variance was raised by because the residual is not white; at least 1. See
    /// [`fit_known_frequency`](super::fit_known_frequency).
    pub colour_factor: f64,
    /// Samples at or beyond the bounds of the ADC.
    pub clipped_samples: usize,
    /// Samples that were fitted.
    pub samples_used: usize,
}
