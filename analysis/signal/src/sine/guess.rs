//! A first guess of the frequency: the highest peak of the channels' summed spectra, then the best
//! of some frequencies around it.

use num_complex::Complex64;
use rustfft::FftPlanner;

use super::sample::{code_bounds, is_inside};
use super::{Channel, FitOptions, MIN_PERIODS, Record, SineError, solve};

/// Frequencies tried around the peak, in units of 1/(length of the record): with few periods, the
/// image at negative frequency moves the peak by more than the steps of the frequency can mend.
const TRIALS: [f64; 5] = [-0.5, -0.25, 0.0, 0.25, 0.5];

/// Number of periods below which the peak needs the trials.
const FEW_PERIODS: f64 = 8.0;

/// Guesses the frequency, Hz.
pub(super) fn frequency(record: &Record<'_>, options: &FitOptions) -> Result<f64, SineError> {
    let samples = record.channels.first().map_or(0, Channel::len);
    let duration_s = samples as f64 * record.interval_s;
    let power = summed_power(record, samples)?;
    let bin_hz = 1.0 / (record.interval_s * samples.next_power_of_two() as f64);
    let lowest = ((MIN_PERIODS / duration_s / bin_hz).floor() as usize).max(1);
    let inner = power
        .iter()
        .enumerate()
        .take(power.len().saturating_sub(1))
        .skip(lowest);
    let (peak, height) = inner
        .max_by(|a, b| a.1.total_cmp(b.1))
        .ok_or(SineError::NoSignal)?;
    if !(*height > 0.0 && height.is_finite()) {
        return Err(SineError::NoSignal);
    }
    let peak_hz = (peak as f64 + interpolate(&power, peak)) * bin_hz;
    if peak_hz * duration_s > FEW_PERIODS {
        return Ok(peak_hz);
    }
    let mut best = (f64::INFINITY, peak_hz);
    for trial in TRIALS {
        let freq_hz = (peak_hz + trial / duration_s).max(MIN_PERIODS / duration_s * (1.0 + 1e-9));
        if freq_hz < 0.5 / record.interval_s {
            let misfit = solve::misfit(record, freq_hz, options)?;
            best = if misfit < best.0 {
                (misfit, freq_hz)
            } else {
                best
            };
        }
    }
    Ok(best.1)
}

/// Peak of a parabola through the logarithms of three neighbours, −0.5…0.5 bins off the middle one.
fn interpolate(power: &[f64], peak: usize) -> f64 {
    let log = |index: usize| {
        power
            .get(index)
            .copied()
            .unwrap_or(0.0)
            .max(f64::MIN_POSITIVE)
            .ln()
    };
    let (before, at, after) = (log(peak.wrapping_sub(1)), log(peak), log(peak + 1));
    let bend = before - 2.0 * at + after;
    if bend < 0.0 {
        (0.5 * (before - after) / bend).clamp(-0.5, 0.5)
    } else {
        0.0
    }
}

/// Returns the power over frequency, each channel divided by its own total, from zero to half the
/// sampling rate.
///
/// Two channels share a transform as real and imaginary part: the powers at a frequency and at its
/// image then add up to twice those of both.
fn summed_power(record: &Record<'_>, samples: usize) -> Result<Vec<f64>, SineError> {
    let length = samples.next_power_of_two();
    let transform = FftPlanner::new().plan_fft_forward(length);
    let mut scratch = vec![Complex64::default(); transform.get_inplace_scratch_len()];
    let mut power = vec![0.0; length / 2 + 1];
    for (pair, channels) in record.channels.chunks(2).enumerate() {
        let mut buffer = vec![Complex64::default(); length];
        for (index, channel) in channels.iter().enumerate() {
            let values = normalised(values(channel, 2 * pair + index + 1)?);
            for (cell, value) in buffer.iter_mut().zip(values) {
                if index == 0 {
                    cell.re = value;
                } else {
                    cell.im = value;
                }
            }
        }
        transform.process_with_scratch(&mut buffer, &mut scratch);
        for (k, sum) in power.iter_mut().enumerate() {
            let image = (length - k) % length;
            *sum += 0.5 * (buffer[k].norm_sqr() + buffer[image].norm_sqr());
        }
    }
    Ok(power)
}

/// Windowed samples of unit energy; all zero if there is nothing but a straight line.
fn normalised(mut values: Vec<f64>) -> Vec<f64> {
    let level = values
        .iter()
        .fold(0.0f64, |largest, v| largest.max(v.abs()));
    detrend_and_window(&mut values);
    let energy: f64 = values.iter().map(|v| v * v).sum();
    // Below this energy only the rounding of the straight line remains.
    let least = values.len() as f64 * (1e-14 * level).powi(2);
    let scale = if energy > least {
        energy.sqrt().recip()
    } else {
        0.0
    };
    for value in &mut values {
        *value *= scale;
    }
    values
}

/// Samples in their own unit. A clipped one is kept: it is near the true value, and this is only a
/// guess.
fn values(channel: &Channel<'_>, number: usize) -> Result<Vec<f64>, SineError> {
    match channel {
        Channel::Volts {
            samples, range_v, ..
        } => match samples.iter().enumerate().find(|(_, v)| !v.is_finite()) {
            Some((index, value)) => Err(SineError::NotFinite {
                channel: number,
                index,
                value: *value,
            }),
            None if samples.iter().any(|v| is_inside(*v, *range_v)) => Ok(samples.to_vec()),
            None => Err(SineError::AllClipped {
                channel: number,
                clipped: samples.len(),
            }),
        },
        Channel::Stored(_) => Err(SineError::Unreadable {
            channel: number,
            reason: "a frequency is needed to begin with".to_owned(),
        }),
        Channel::Codes { codes, scale } => {
            if !codes
                .iter()
                .any(|code| is_inside(*code, code_bounds(scale)))
            {
                return Err(SineError::AllClipped {
                    channel: number,
                    clipped: codes.len(),
                });
            }
            Ok(codes.iter().map(|code| f64::from(*code)).collect())
        }
    }
}

/// Takes the mean and the straight line off, and applies a Hann window.
fn detrend_and_window(values: &mut [f64]) {
    let count = values.len() as f64;
    let centre = 0.5 * (count - 1.0);
    let mean = values.iter().sum::<f64>() / count;
    let moment: f64 = values
        .iter()
        .enumerate()
        .map(|(n, v)| (n as f64 - centre) * (v - mean))
        .sum();
    let slope = moment / (count * (count * count - 1.0) / 12.0);
    for (n, value) in values.iter_mut().enumerate() {
        let window = 0.5 - 0.5 * (std::f64::consts::TAU * (n as f64 + 0.5) / count).cos();
        *value = (*value - mean - slope * (n as f64 - centre)) * window;
    }
}
