//! Least-squares fit of one sinusoid per channel to a sampled record, after IEEE Std 1057 (clauses
//! on the three- and four-parameter sine fit), with drift, harmonics and mains pick-up beside it
//! and one frequency shared by all channels.
//!
//! Model of channel c, with t = 0 at sample 0 and tₘ the middle of the record: x(t) = Re{p ·
//! exp(jωt)} + Σ Re{pₖ · exp(jωₖt)} + offset + drift · (t − tₘ) + curvature · (t − tₘ)² + Σ aₖ ·
//! exp(−t/τₖ), with ωₖ harmonics of ω or frequencies given, and τₖ time constants given
//! ([`relaxations`]). [`fit_known_frequency`] solves for all but ω, which are linear;
//! [`fit_free_frequency`] also finds ω by Gauss–Newton steps on the linear solution.
//!
//! The samples are read once, where they lie, by all cores: blocks of ADC codes are summed over the
//! model's columns in whole numbers, and the blocks' sums are turned to their place in the record.
//! Time runs from −1 to 1 over the record while solving, and phases are evaluated anew every block,
//! so that neither the length of the record nor the number of its periods costs digits; the number
//! of periods need not be whole. Knows no impedance and no file.

mod basis;
mod block;
mod error;
mod guess;
mod kernel;
mod linear;
mod moments;
mod plan;
mod quantisation;
mod residual;
mod result;
mod sample;
mod solve;
mod stored;
mod table;

pub use error::SineError;
pub use result::{ChannelFit, Distortion, LeftOut, Note, Phasor, SineFit, Tone, ToneKind};
pub use stored::{Samples, Stored};

/// Fewest periods in a record that a fit accepts: below, sine, offset and drift cannot be told
/// apart reliably.
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

/// Samples of one channel, borrowed as they are, or read from where they are kept.
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
        /// Conversion of the codes to volts.
        scale: CodeScale,
    },
    /// Samples that are kept elsewhere: read by pieces, whenever they are summed over, so that a
    /// record may be larger than the memory.
    Stored(Stored<'a>),
}

impl<'a> Channel<'a> {
    /// Volts without quantisation and without bounds.
    pub const fn volts(samples: &'a [f64]) -> Self {
        Self::Volts {
            samples,
            lsb_v: None,
            range_v: None,
        }
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
            Self::Stored(stored) => stored.count,
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
    /// From one code of the ADC to the next: 16 where twelve bits come in the upper part of
    /// sixteen, else 1.
    pub code_step: u16,
}

impl CodeScale {
    /// Volts of a code.
    pub fn volts(&self, code: i16) -> f64 {
        f64::from(code) * self.volts_per_code - self.offset_v
    }
}

/// Terms that a fit models, and samples that it leaves out.
#[derive(Debug, Clone, PartialEq)]
pub struct FitOptions {
    /// Slow change fitted besides the offset.
    pub drift: Drift,
    /// Orders of harmonics fitted besides the sinusoid; 2 is twice its frequency.
    pub harmonics: Vec<u32>,
    /// Other frequencies fitted, Hz: mains pick-up, a neighbour's switching. See
    /// [`FitOptions::with_mains`].
    pub also_hz: Vec<f64>,
    /// Time constants of relaxations fitted, s: what a change of the current before the record has
    /// left. See [`relaxations`].
    pub decays_s: Vec<f64>,
    /// Leave clipped samples out; else they are fitted as if they were right, and only counted.
    pub exclude_clipped: bool,
}

impl Default for FitOptions {
    fn default() -> Self {
        Self {
            drift: Drift::Linear,
            harmonics: Vec::new(),
            also_hz: Vec::new(),
            decays_s: Vec::new(),
            exclude_clipped: true,
        }
    }
}

impl FitOptions {
    /// Adds the pick-up of the mains: its frequency (50 or 60 Hz) and its harmonics up to an order.
    /// The fit leaves out a tone that the record cannot tell from the sinusoid or is too short for.
    /// It says so in its notes.
    #[must_use]
    pub fn with_mains(mut self, mains_hz: f64, orders: u32) -> Self {
        self.also_hz
            .extend((1..=orders).map(|order| f64::from(order) * mains_hz));
        self
    }
}

/// Time constants, s, whose exponentials with a straight line span the relaxation of a linear
/// system over a record of `length_s`, whatever its own time constants are.
///
/// Of a single exponential of any time constant from 1.5 % to 8 lengths that began a tenth of a
/// length or more before the record, a fit of at least four periods leaves at most
/// [`RELAXATION_LEFT`] in the phasor (computed for 18 numbers of periods from 4 to 30, 5 delays and
/// 40 time constants). Faster ones have died away; slower ones are straight lines.
pub fn relaxations(length_s: f64) -> Vec<f64> {
    [0.03, 0.12, 0.4].map(|share| share * length_s).to_vec()
}

/// Greatest share of a relaxation that [`relaxations`] leave in a phasor.
pub const RELAXATION_LEFT: f64 = 8.0e-4;

/// Slow change of a channel, as a polynomial of time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Drift {
    /// Only the offset.
    None,
    /// A straight line.
    Linear,
    /// A parabola. Needs 2 periods, or it is left out.
    Quadratic,
}

impl Drift {
    const fn degree(self) -> usize {
        match self {
            Self::None => 0,
            Self::Linear => 1,
            Self::Quadratic => 2,
        }
    }
}

/// Fits sinusoids of a known frequency: amplitude and phase, offset and, if asked for, drift of
/// each channel.
///
/// The covariance is the variance of the residual, but never below that of the quantisation
/// (LSB²/12), times the inverse of the normal matrix. Where neighbouring residuals correlate
/// significantly, it is raised by the ratio of the noise density at the frequency to its mean,
/// taking the residual for a first-order autoregression. Where the noise is too low for the
/// quantisation to act as noise, it is raised to the error that the quantisation may make, and
/// [`Note::Quantisation`] says so.
///
/// Extra frequencies that the record cannot tell apart are left out, and [`SineFit::notes`] says
/// which.
///
/// ```
/// use analysis_signal::sine::{Channel, FitOptions, Record, fit_known_frequency};
///
/// // 2 V at 50 Hz beside an offset of 0.1 V: ten periods at 10 kHz.
/// let angle = |k: i32| std::f64::consts::TAU * 50.0 * 1e-4 * f64::from(k);
/// let samples: Vec<f64> = (0..2000).map(|k| 0.1 + 2.0 * angle(k).cos()).collect();
/// let channels = [Channel::volts(&samples)];
/// let record = Record { channels: &channels, interval_s: 1e-4 };
/// let fit = fit_known_frequency(&record, 50.0, &FitOptions::default())?;
/// assert!((fit.channels[0].phasor.norm() - 2.0).abs() < 1e-9);
/// assert!((fit.channels[0].offset_v - 0.1).abs() < 1e-9);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`SineError`] if the record is too short, the frequency out of range, samples are not finite or
/// too few of them unclipped.
pub fn fit_known_frequency(
    record: &Record<'_>,
    freq_hz: f64,
    options: &FitOptions,
) -> Result<SineFit, SineError> {
    solve::check_record(record)?;
    solve::known(record, freq_hz, options)
}

/// Fits sinusoids of one unknown frequency, common to all channels, which count by the inverse of
/// their noise. See [`fit_known_frequency`] for the rest.
///
/// `freq_guess_hz` must lie within about half of 1/(length of the record) of the truth; without it,
/// the highest peak of the summed spectra is taken.
///
/// ```
/// use analysis_signal::sine::{Channel, FitOptions, Record, fit_free_frequency};
///
/// // A generator that is 0.1 % off its 50 Hz.
/// let angle = |k: i32| std::f64::consts::TAU * 50.05 * 1e-4 * f64::from(k);
/// let samples: Vec<f64> = (0..2000).map(|k| 0.5 * angle(k).sin()).collect();
/// let channels = [Channel::volts(&samples)];
/// let record = Record { channels: &channels, interval_s: 1e-4 };
/// let fit = fit_free_frequency(&record, Some(50.0), &FitOptions::default())?;
/// assert!((fit.freq_hz - 50.05).abs() < 1e-6);
/// assert!((fit.channels[0].phasor.norm() - 0.5).abs() < 1e-6);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// As [`fit_known_frequency`]; also [`SineError::NoSignal`] and [`SineError::NotConverged`].
pub fn fit_free_frequency(
    record: &Record<'_>,
    freq_guess_hz: Option<f64>,
    options: &FitOptions,
) -> Result<SineFit, SineError> {
    solve::check_record(record)?;
    let start_hz = match freq_guess_hz {
        Some(freq_hz) => freq_hz,
        None => guess::frequency(record, options)?,
    };
    solve::iterate(record, start_hz, options)
}
