//! From the sums to the fit: checks, the solution at one frequency, and the steps of the frequency.

use num_complex::Complex64;

use super::linear::{self, Normal};
use super::moments::{Grid, Moments, Table, accumulate};
use super::residual::{Residual, Wave, residual};
use super::{Channel, ChannelFit, FitOptions, MIN_PERIODS, MIN_SAMPLES, Record, SineError, SineFit};
use crate::spectrum::Covariance2;

/// Steps of the frequency before giving up.
const MAX_STEPS: usize = 40;
/// Longest step, as phase at the ends of the record, rad: a longer one leaves the region where the linearised model means anything.
const LONGEST_STEP: f64 = 1.0;
/// A step below this part of the frequency's standard deviation changes nothing that matters.
const SETTLED: f64 = 1e-4;
/// Rounding of the step, rad at the ends of the record.
const ROUNDING: f64 = 1e-12;

/// Checks what does not depend on the frequency.
pub(super) fn check_record(record: &Record<'_>) -> Result<(), SineError> {
    let Some(first) = record.channels.first() else { return Err(SineError::NoChannels) };
    if !(record.interval_s > 0.0 && record.interval_s.is_finite()) {
        return Err(SineError::Interval { found: record.interval_s });
    }
    for (index, channel) in record.channels.iter().enumerate() {
        let number = index + 1;
        if channel.len() != first.len() {
            return Err(SineError::UnequalLengths { channel: number, expected: first.len(), found: channel.len() });
        }
        let (step_v, offset_v) = match channel {
            Channel::Volts { lsb_v, .. } => (lsb_v.unwrap_or(1.0), 0.0),
            Channel::Codes { scale, .. } => (scale.volts_per_code, scale.offset_v),
        };
        if !(step_v > 0.0 && step_v.is_finite() && offset_v.is_finite()) {
            return Err(SineError::Scale { channel: number, found_v: step_v, offset_v });
        }
        if channel.len() < MIN_SAMPLES {
            return Err(SineError::TooFewSamples { channel: number, needed: MIN_SAMPLES, found: channel.len(), clipped: 0 });
        }
    }
    Ok(())
}

fn check_frequency(record: &Record<'_>, freq_hz: f64) -> Result<(), SineError> {
    if !(freq_hz > 0.0 && freq_hz.is_finite()) {
        return Err(SineError::Frequency { freq_hz });
    }
    let nyquist_hz = 0.5 / record.interval_s;
    if freq_hz >= nyquist_hz {
        return Err(SineError::AboveNyquist { freq_hz, nyquist_hz });
    }
    let periods = freq_hz * record.interval_s * samples(record) as f64;
    if periods < MIN_PERIODS {
        return Err(SineError::TooFewPeriods { freq_hz, periods, needed: MIN_PERIODS });
    }
    Ok(())
}

fn samples(record: &Record<'_>) -> usize {
    record.channels.first().map_or(0, Channel::len)
}

/// A level taken from the samples before summing, so that a large offset costs no digits. Codes are small whole numbers and need none.
pub(super) fn pivot(channel: &Channel<'_>) -> f64 {
    match channel {
        Channel::Volts { samples, .. } => samples.first().copied().filter(|v| v.is_finite()).unwrap_or(0.0),
        Channel::Codes { .. } => 0.0,
    }
}

/// The solution at one frequency.
#[derive(Debug)]
pub(super) struct State {
    freq_hz: f64,
    channels: Vec<Solved>,
}

#[derive(Debug)]
struct Solved {
    moments: Moments,
    normal: Normal,
    beta: [f64; 4],
    left: Residual,
    colour_factor: f64,
    /// Variance of the noise in the unit of the samples squared, quantisation and colour included.
    variance: f64,
}

/// Fits at one frequency.
pub(super) fn evaluate(record: &Record<'_>, freq_hz: f64, options: &FitOptions) -> Result<State, SineError> {
    evaluate_for(record, freq_hz, options, false)
}

fn evaluate_for(record: &Record<'_>, freq_hz: f64, options: &FitOptions, free: bool) -> Result<State, SineError> {
    check_frequency(record, freq_hz)?;
    let grid = Grid::new(freq_hz, record.interval_s, samples(record));
    let table = Table::new(&grid);
    let all = accumulate(record, (&grid, &table), options, free)?;
    let mut channels = Vec::with_capacity(all.len());
    for (index, (channel, moments)) in record.channels.iter().zip(all).enumerate() {
        let (normal, beta) = solve_channel(&moments, freq_hz, options, (index + 1, channel.len()))?;
        let wave = Wave { phasor: Complex64::new(beta[0], beta[1]), offset: beta[2], drift: beta[3], pivot: pivot(channel) };
        let left = residual(channel, &wave, (&grid, &table), options);
        let colour_factor = left.colour_factor(std::f64::consts::TAU * freq_hz * record.interval_s);
        let freedom = (moments.used - normal.size()).max(1) as f64;
        let variance = (left.sum_squares / freedom * colour_factor).max(quantisation_variance(channel));
        channels.push(Solved { moments, normal, beta, left, colour_factor, variance });
    }
    Ok(State { freq_hz, channels })
}

fn solve_channel(
    moments: &Moments,
    freq_hz: f64,
    options: &FitOptions,
    (channel, samples): (usize, usize),
) -> Result<(Normal, [f64; 4]), SineError> {
    let clipped = samples - moments.used;
    if moments.used == 0 {
        return Err(SineError::AllClipped { channel, clipped });
    }
    if moments.used < MIN_SAMPLES {
        return Err(SineError::TooFewSamples { channel, needed: MIN_SAMPLES, found: moments.used, clipped });
    }
    let normal =
        Normal::new(&moments.gram, options.linear_drift).ok_or(SineError::Undetermined { channel, used: moments.used, freq_hz })?;
    let beta = normal.solve(&linear::right_side(moments));
    Ok((normal, beta))
}

/// Variance of rounding to whole steps, in the unit of the samples squared.
fn quantisation_variance(channel: &Channel<'_>) -> f64 {
    match channel {
        Channel::Volts { lsb_v, .. } => lsb_v.map_or(0.0, |lsb| lsb * lsb / 12.0),
        Channel::Codes { .. } => 1.0 / 12.0,
    }
}

/// Part of the sum of squares that sinusoids of a frequency explain, each channel against its noise; to compare frequencies by.
pub(super) fn misfit(record: &Record<'_>, freq_hz: f64, options: &FitOptions) -> Result<f64, SineError> {
    let state = evaluate(record, freq_hz, options)?;
    // The logarithm weighs a channel by what is left relative to what was there: the likelihood with unknown noise.
    let log_left = |solved: &Solved| {
        let there = linear::explained(&solved.moments, &solved.beta).abs() + solved.left.sum_squares;
        solved.moments.used as f64 * (solved.left.sum_squares + 1e-24 * there + f64::MIN_POSITIVE).ln()
    };
    Ok(state.channels.iter().map(log_left).sum())
}

/// Finds the frequency from a start.
pub(super) fn iterate(record: &Record<'_>, start_hz: f64, options: &FitOptions) -> Result<SineFit, SineError> {
    let half_record = std::f64::consts::PI * record.interval_s * samples(record) as f64;
    let mut freq_hz = start_hz;
    let mut step_hz = f64::NAN;
    for steps in 1..=MAX_STEPS {
        let state = evaluate_for(record, freq_hz, options, true)?;
        let (step, sigma) = state.step()?;
        step_hz = step.clamp(-LONGEST_STEP, LONGEST_STEP) / half_record;
        if step.abs() < (SETTLED * sigma).max(ROUNDING).max(4.0 * f64::EPSILON * half_record * freq_hz) {
            return Ok(state.into_fit(record, Some(sigma / half_record), steps));
        }
        freq_hz += step_hz;
    }
    Err(SineError::NotConverged { iterations: MAX_STEPS, start_hz, freq_hz: freq_hz - step_hz, step_hz })
}

impl State {
    /// Step of the frequency and its standard deviation, as phase at the ends of the record, rad.
    fn step(&self) -> Result<(f64, f64), SineError> {
        let (mut curvature, mut slope) = (0.0, 0.0);
        for solved in &self.channels {
            let (own_curvature, own_slope) = linear::frequency_step(&solved.moments, &solved.normal, &solved.beta);
            let power = solved.beta[0].powi(2) + solved.beta[1].powi(2);
            // Without the floor, channels that the model fits to the last digit would be weighed by their rounding errors.
            let weight = 1.0 / (solved.variance + 1e-24 * power + f64::MIN_POSITIVE);
            curvature += weight * own_curvature;
            slope += weight * own_slope;
        }
        let sigma = curvature.sqrt().recip();
        // A phase at the ends of the record that is uncertain by a turn is no frequency.
        if sigma.is_finite() && sigma < std::f64::consts::PI { Ok((slope / curvature, sigma)) } else { Err(SineError::NoSignal) }
    }

    pub(super) fn into_fit(self, record: &Record<'_>, freq_sigma_hz: Option<f64>, iterations: usize) -> SineFit {
        let samples = samples(record);
        let grid = Grid::new(self.freq_hz, record.interval_s, samples);
        // exp(jθ) at sample 0 takes a phasor from the middle of the record to time zero.
        let to_start = grid.phase(0);
        let seconds_per_unit = record.interval_s / grid.time_step;
        let channels = record
            .channels
            .iter()
            .zip(&self.channels)
            .map(|(channel, solved)| solved.finish(channel, to_start, seconds_per_unit))
            .collect();
        SineFit { freq_hz: self.freq_hz, freq_sigma_hz, channels, samples, interval_s: record.interval_s, iterations }
    }
}

impl Solved {
    fn finish(&self, channel: &Channel<'_>, to_start: Complex64, seconds_per_unit: f64) -> ChannelFit {
        let (volts_per_unit, zero_v) = match channel {
            Channel::Volts { .. } => (1.0, pivot(channel)),
            Channel::Codes { scale, .. } => (scale.volts_per_code, -scale.offset_v),
        };
        let [re, im, offset, drift] = self.beta;
        let to_volts = to_start * volts_per_unit;
        let (re_re, re_im, im_im) = self.normal.phasor_inverse();
        let in_middle = Covariance2 { re_re: re_re * self.variance, re_im: re_im * self.variance, im_im: im_im * self.variance };
        ChannelFit {
            phasor: Complex64::new(re, im) * to_volts,
            variance: in_middle.scaled(to_volts),
            offset_v: offset * volts_per_unit + zero_v,
            drift_v_per_s: drift * volts_per_unit / seconds_per_unit,
            residual_rms_v: (self.left.sum_squares / self.moments.used as f64).sqrt() * volts_per_unit,
            residual_lag1: self.left.lag1(),
            colour_factor: self.colour_factor,
            clipped_samples: self.left.clipped,
            samples_used: self.moments.used,
        }
    }
}
