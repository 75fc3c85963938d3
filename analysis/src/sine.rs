//! Least-squares fit of one sinusoid per channel to a sampled record, after IEEE Std 1057 (clauses on the three- and four-parameter sine fit),
//! with a linear drift and one frequency shared by all channels.
//!
//! Model of channel c, with t = 0 at sample 0 and tₘ the middle of the record:
//! x(t) = Re{p · exp(jωt)} + offset + drift · (t − tₘ). [`fit_known_frequency`] solves for p, offset and drift, which are linear;
//! [`fit_free_frequency`] also finds ω by Gauss–Newton steps on the linear solution.
//!
//! Time runs from −1 to 1 over the record while solving, and phases are evaluated anew every block, so that neither the length of the record nor
//! the number of its periods costs digits; the number of periods need not be whole. Knows no impedance and no file.

mod guess;
mod linear;
mod moments;
mod residual;
mod solve;

use num_complex::Complex64;

use crate::spectrum::Covariance2;

/// Fewest periods in a record that a fit accepts: below, sine, offset and drift cannot be told apart reliably.
pub const MIN_PERIODS: f64 = 1.4;

/// Fewest usable samples of a channel that a fit accepts.
pub const MIN_SAMPLES: usize = 10;

/// Samples of one or more channels taken at the same instants.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Record<'a> {
    /// The channels, all of one length.
    pub channels: &'a [Channel<'a>],
    /// Time between two samples, s.
    pub interval_s: f64,
}

/// Samples of one channel, borrowed as they are.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Channel<'a> {
    /// Volts.
    Volts {
        /// The samples, V.
        samples: &'a [f64],
        /// Step of the quantisation, V; `None` if there is none that matters.
        lsb_v: Option<f64>,
        /// Samples at or beyond these bounds are clipped; V.
        range_v: Option<(f64, f64)>,
    },
    /// ADC codes with their scaling.
    Codes {
        /// The samples, codes.
        codes: &'a [i16],
        /// What they mean.
        scale: CodeScale,
    },
}

impl<'a> Channel<'a> {
    /// Volts without quantisation and without bounds.
    pub const fn volts(samples: &'a [f64]) -> Self {
        Self::Volts { samples, lsb_v: None, range_v: None }
    }

    /// ADC codes.
    pub const fn codes(codes: &'a [i16], scale: CodeScale) -> Self {
        Self::Codes { codes, scale }
    }

    /// Number of samples.
    pub const fn len(&self) -> usize {
        match self {
            Self::Volts { samples, .. } => samples.len(),
            Self::Codes { codes, .. } => codes.len(),
        }
    }

    /// There is no sample.
    pub const fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// Meaning of an ADC code: V = code · `volts_per_code` − `offset_v`.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct CodeScale {
    /// Volts per code, V; positive.
    pub volts_per_code: f64,
    /// Offset that was added before the ADC, V.
    pub offset_v: f64,
    /// Least code of the ADC; samples at or below it are clipped.
    pub code_min: i16,
    /// Greatest code of the ADC; samples at or above it are clipped.
    pub code_max: i16,
}

impl CodeScale {
    /// Volts of a code.
    pub fn volts(&self, code: i16) -> f64 {
        f64::from(code) * self.volts_per_code - self.offset_v
    }
}

/// What a fit models and leaves out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FitOptions {
    /// Fit a linear drift besides the offset.
    pub linear_drift: bool,
    /// Leave clipped samples out; else they are fitted as if they were right, and only counted.
    pub exclude_clipped: bool,
}

impl Default for FitOptions {
    fn default() -> Self {
        Self { linear_drift: true, exclude_clipped: true }
    }
}

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
}

impl SineFit {
    /// Periods in the record.
    pub fn periods(&self) -> f64 {
        self.freq_hz * self.interval_s * self.samples as f64
    }

    /// Covariance of the phasor of a channel against absolute time, V²: [`ChannelFit::variance`] plus the turn, common to all channels, that the
    /// uncertainty of a fitted frequency gives to phases at sample 0. `None` if there is no such channel.
    pub fn absolute_covariance(&self, channel: usize) -> Option<Covariance2> {
        let fit = self.channels.get(channel)?;
        let middle_s = 0.5 * self.interval_s * (self.samples as f64 - 1.0);
        let turn = std::f64::consts::TAU * middle_s * self.freq_sigma_hz.unwrap_or(0.0);
        let along = Complex64::new(0.0, -turn) * fit.phasor;
        Some(fit.variance + Covariance2::along(along))
    }
}

/// Sinusoid fitted to one channel.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct ChannelFit {
    /// Phasor p of Re{p · exp(jωt)}, t = 0 at sample 0; V (zero to peak).
    pub phasor: Complex64,
    /// Covariance of the phasor's parts, V², for the frequency as it stands. An error of a fitted frequency turns the phasors of all channels by the
    /// same angle and cancels in their ratios; [`SineFit::absolute_covariance`] has it included.
    pub variance: Covariance2,
    /// Offset in the middle of the record, V.
    pub offset_v: f64,
    /// Drift, V/s; zero unless fitted.
    pub drift_v_per_s: f64,
    /// Root mean square of what the fit leaves, V.
    pub residual_rms_v: f64,
    /// Correlation of neighbouring residuals, −1…1: near 0 for white noise, near 1 if something slow or periodic is left (drift that is not
    /// linear, harmonics, quantisation without dither).
    pub residual_lag1: f64,
    /// Factor that the variance was raised by because the residual is not white; at least 1. See [`fit_known_frequency`].
    pub colour_factor: f64,
    /// Samples at or beyond the bounds of the ADC.
    pub clipped_samples: usize,
    /// Samples that were fitted.
    pub samples_used: usize,
}

/// Why a record cannot be fitted.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SineError {
    /// Nothing to fit.
    #[error("expected at least one channel, met none")]
    NoChannels,
    /// Channels are not of one length.
    #[error("channel {channel}: expected {expected} samples as in channel 1, met {found}")]
    UnequalLengths {
        /// Channel, counted from 1.
        channel: usize,
        /// Samples in channel 1.
        expected: usize,
        /// Samples in this one.
        found: usize,
    },
    /// The sampling interval is no time.
    #[error("expected a sampling interval above 0 s, met {found} s")]
    Interval {
        /// What was given, s.
        found: f64,
    },
    /// The scaling of the samples is unusable.
    #[error("channel {channel}: expected a positive, finite volts-per-code (or LSB) and a finite offset, met {found_v} V and {offset_v} V")]
    Scale {
        /// Channel, counted from 1.
        channel: usize,
        /// Volts per code or LSB, V.
        found_v: f64,
        /// Offset, V.
        offset_v: f64,
    },
    /// The frequency is no frequency.
    #[error("expected a frequency above 0 Hz, met {freq_hz} Hz")]
    Frequency {
        /// What was given, Hz.
        freq_hz: f64,
    },
    /// The frequency cannot be seen at this sampling rate.
    #[error("expected a frequency below half the sampling rate ({nyquist_hz} Hz), met {freq_hz} Hz")]
    AboveNyquist {
        /// Frequency, Hz.
        freq_hz: f64,
        /// Half the sampling rate, Hz.
        nyquist_hz: f64,
    },
    /// The record is too short for the frequency.
    #[error("expected at least {needed} periods of {freq_hz} Hz in the record, met {periods:.3}")]
    TooFewPeriods {
        /// Frequency, Hz.
        freq_hz: f64,
        /// Periods in the record.
        periods: f64,
        /// [`MIN_PERIODS`].
        needed: f64,
    },
    /// Too few samples are left to fit.
    #[error("channel {channel}: expected at least {needed} usable samples, met {found} ({clipped} more are clipped)")]
    TooFewSamples {
        /// Channel, counted from 1.
        channel: usize,
        /// [`MIN_SAMPLES`].
        needed: usize,
        /// Usable samples.
        found: usize,
        /// Clipped samples.
        clipped: usize,
    },
    /// Nothing but clipped samples.
    #[error("channel {channel}: expected samples within the range of the ADC, met {clipped} samples that are all clipped")]
    AllClipped {
        /// Channel, counted from 1.
        channel: usize,
        /// Their number.
        clipped: usize,
    },
    /// A sample is not a number or infinite.
    #[error("channel {channel}: expected finite samples, met {value} at sample {index}")]
    NotFinite {
        /// Channel, counted from 1.
        channel: usize,
        /// Index of the sample, from 0.
        index: usize,
        /// The sample.
        value: f64,
    },
    /// The usable samples do not determine the sinusoid.
    #[error("channel {channel}: the {used} usable samples do not determine a sinusoid of {freq_hz} Hz besides offset and drift")]
    Undetermined {
        /// Channel, counted from 1.
        channel: usize,
        /// Usable samples.
        used: usize,
        /// Frequency, Hz.
        freq_hz: f64,
    },
    /// A frequency was to be found where nothing oscillates.
    #[error("expected a sinusoid to find the frequency of, met channels without one")]
    NoSignal,
    /// The frequency does not settle.
    #[error("frequency did not settle after {iterations} steps from {start_hz} Hz; the last step went from {freq_hz} Hz by {step_hz} Hz")]
    NotConverged {
        /// Steps taken.
        iterations: usize,
        /// Where they started, Hz.
        start_hz: f64,
        /// Where they ended, Hz.
        freq_hz: f64,
        /// Last step, Hz.
        step_hz: f64,
    },
}

/// Fits sinusoids of a known frequency: amplitude and phase, offset and, if asked for, drift of each channel.
///
/// The covariance is the variance of the residual, but never below that of the quantisation (LSB²/12), times the inverse of the normal matrix. Where
/// neighbouring residuals correlate significantly, it is raised by the ratio of the noise density at the frequency to its mean, taking the residual
/// for a first-order autoregression.
///
/// # Errors
/// [`SineError`] if the record is too short, the frequency out of range, samples are not finite or too few of them unclipped.
pub fn fit_known_frequency(record: &Record<'_>, freq_hz: f64, options: &FitOptions) -> Result<SineFit, SineError> {
    solve::check_record(record)?;
    let state = solve::evaluate(record, freq_hz, options)?;
    Ok(state.into_fit(record, None, 1))
}

/// Fits sinusoids of one unknown frequency, common to all channels, which count by the inverse of their noise. See [`fit_known_frequency`] for the
/// rest.
///
/// `freq_guess_hz` must lie within about half of 1/(length of the record) of the truth; without it, the highest peak of the summed spectra is
/// taken.
///
/// # Errors
/// As [`fit_known_frequency`]; also [`SineError::NoSignal`] and [`SineError::NotConverged`].
pub fn fit_free_frequency(record: &Record<'_>, freq_guess_hz: Option<f64>, options: &FitOptions) -> Result<SineFit, SineError> {
    solve::check_record(record)?;
    let start_hz = match freq_guess_hz {
        Some(freq_hz) => freq_hz,
        None => guess::frequency(record, options)?,
    };
    solve::iterate(record, start_hz, options)
}
