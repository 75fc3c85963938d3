//! Least-squares fit of one sinusoid per channel to a sampled record, after IEEE Std 1057 (clauses
//! on the three- and four-parameter sine fit), with drift, harmonics and mains pick-up beside it
//! and one frequency shared by all channels.
//!
//! Model of channel c, with t = 0 at sample 0 and tₘ the middle of the record: x(t) = Re{p ·
//! exp(jωt)} + Σ Re{pₖ · exp(jωₖt)} + offset + drift · (t − tₘ) + curvature · (t − tₘ)² + Σ aₖ ·
//! exp(−t/τₖ), where p may be p + slope · (t − tₘ), with ωₖ harmonics of ω or given frequencies, and
//! τₖ given time constants ([`relaxations`]). [`fit_known_frequency`] solves for all but ω, which are linear;
//! [`fit_free_frequency`] also finds ω by Gauss–Newton steps on the linear solution.
//!
//! The samples are read once, in place, by all cores: blocks of ADC codes are summed over the
//! model's columns in integers, and the sums of the blocks are rotated to their position in the
//! record. Time runs from −1 to 1 over the record while solving, and phases are evaluated anew in
//! every block, so that neither the length of the record nor the number of its periods costs
//! digits; the number of periods need not be whole. Contains no impedances and no file access.

mod amplitudes;
mod basis;
mod block;
mod change;
mod code_scale;
mod error;
mod guess;
mod kernel;
mod linear;
mod moments;
mod options;
mod plan;
mod quantisation;
mod record;
mod residual;
mod result;
mod sample;
mod solve;
mod stored;
mod table;

pub use amplitudes::amplitudes;
pub use code_scale::CodeScale;
pub use error::SineError;
pub use options::{Drift, FitOptions, RELAXATION_LEFT, Varying, relaxations};
pub use record::{Channel, MIN_PERIODS, MIN_SAMPLES, Record};
pub use result::{ChannelFit, Distortion, LeftOut, Note, Phasor, SineFit, Tone, ToneKind};
pub use stored::{Samples, Stored};

/// Fits sinusoids of a known frequency as [`fit_known_frequency`], and lets their phasors move along a
/// straight line if the residual shows that they do. The phasors are then those of the middle of the
/// record, and [`SineFit::varying`] is true.
///
/// # Errors
/// As [`fit_known_frequency`].
pub fn fit_with_change(
    record: &Record<'_>,
    freq_hz: f64,
    options: &FitOptions,
) -> Result<SineFit, SineError> {
    let with = |varying| FitOptions {
        varying,
        ..options.clone()
    };
    let constant = fit_known_frequency(record, freq_hz, &with(Varying::None))?;
    let changing = fit_known_frequency(record, freq_hz, &with(Varying::Linear));
    Ok(match changing {
        Ok(changing) if change::is_shown(&constant, &changing) => changing,
        _ => constant,
    })
}

/// Fits sinusoids of a known frequency: amplitude and phase, offset and optionally drift of each
/// channel.
///
/// The covariance is the variance of the residual, but never below that of the quantisation
/// (LSB²/12), times the inverse of the normal matrix. If neighbouring residuals correlate
/// significantly, it is raised by the ratio of the noise density at the frequency to its mean, with
/// the residual modelled as a first-order autoregression. If the noise is too low for the
/// quantisation to act as noise, it is raised to the possible error from quantisation, and
/// [`Note::Quantisation`] reports this.
///
/// Extra frequencies that the record cannot resolve are left out, and [`SineFit::notes`] lists
/// them.
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
/// [`SineError`] if the record is too short, the frequency is out of range, samples are not finite
/// or too few of them are unclipped.
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
/// the highest peak of the summed spectra is used.
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
