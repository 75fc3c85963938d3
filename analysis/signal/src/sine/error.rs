//! Reasons why a record cannot be fitted.

/// Reason why a record cannot be fitted.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
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
    /// The sampling interval is not a valid time.
    #[error("expected a sampling interval above 0 s, met {found} s")]
    Interval {
        /// Interval that was given, s.
        found: f64,
    },
    /// The scaling of the samples is unusable.
    #[error(
        "channel {channel}: expected a positive, finite volts-per-code (or LSB) and a finite \
        offset, met {found_v} V and {offset_v} V"
    )]
    Scale {
        /// Channel, counted from 1.
        channel: usize,
        /// Volts per code or LSB, V.
        found_v: f64,
        /// Offset, V.
        offset_v: f64,
    },
    /// The frequency is not valid.
    #[error("expected a frequency above 0 Hz, met {freq_hz} Hz")]
    Frequency {
        /// Frequency that was given, Hz.
        freq_hz: f64,
    },
    /// The frequency cannot be seen at this sampling rate.
    #[error(
        "expected a frequency below half the sampling rate ({nyquist_hz} Hz), met {freq_hz} Hz"
    )]
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
        /// [`super::MIN_PERIODS`].
        needed: f64,
    },
    /// Too few samples are left to fit.
    #[error(
        "channel {channel}: expected at least {needed} usable samples, met {found} ({clipped} more \
        are clipped)"
    )]
    TooFewSamples {
        /// Channel, counted from 1.
        channel: usize,
        /// [`super::MIN_SAMPLES`].
        needed: usize,
        /// Usable samples.
        found: usize,
        /// Clipped samples.
        clipped: usize,
    },
    /// Nothing but clipped samples.
    #[error(
        "channel {channel}: expected samples within the range of the ADC, met {clipped} samples \
        that are all clipped"
    )]
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
    #[error(
        "channel {channel}: the {used} usable samples do not determine a sinusoid of {freq_hz} Hz \
        besides offset and drift"
    )]
    Undetermined {
        /// Channel, counted from 1.
        channel: usize,
        /// Usable samples.
        used: usize,
        /// Frequency, Hz.
        freq_hz: f64,
    },
    /// The fit searches a frequency, but nothing oscillates.
    #[error("expected a sinusoid to find the frequency of, met channels without one")]
    NoSignal,
    /// The frequency does not settle.
    #[error(
        "frequency did not settle after {iterations} steps from {start_hz} Hz; the last step went \
        from {freq_hz} Hz by {step_hz} Hz"
    )]
    NotConverged {
        /// Steps taken.
        iterations: usize,
        /// Frequency at the start, Hz.
        start_hz: f64,
        /// Frequency at the end, Hz.
        freq_hz: f64,
        /// Last step, Hz.
        step_hz: f64,
    },
    /// Samples that are kept elsewhere cannot be read.
    #[error("channel {channel}: {reason}")]
    Unreadable {
        /// Channel, counted from 1.
        channel: usize,
        /// The reason, as text.
        reason: String,
    },
}
