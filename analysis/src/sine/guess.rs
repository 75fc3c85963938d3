//! A first guess of the frequency: the highest peak of the channels' summed spectra, then the best of some frequencies around it.

use num_complex::Complex64;
use rustfft::FftPlanner;

use super::moments::{code_bounds, is_inside, volt_bounds};
use super::{Channel, FitOptions, MIN_PERIODS, Record, SineError, solve};

/// Frequencies tried around the peak, in units of 1/(length of the record): with few periods, the image at negative frequency moves the peak by
/// more than the steps of the frequency can mend.
const TRIALS: [f64; 5] = [-0.5, -0.25, 0.0, 0.25, 0.5];

/// Few periods, where the peak needs the trials, end here.
const FEW_PERIODS: f64 = 8.0;

/// Guesses the frequency, Hz.
pub(super) fn frequency(record: &Record<'_>, options: &FitOptions) -> Result<f64, SineError> {
    let samples = record.channels.first().map_or(0, Channel::len);
    let duration_s = samples as f64 * record.interval_s;
    let power = summed_power(record, samples)?;
    let bin_hz = 1.0 / (record.interval_s * 2.0 * (power.len() as f64 - 1.0));
    let lowest = ((MIN_PERIODS / duration_s / bin_hz).floor() as usize).max(1);
    let inner = power.iter().enumerate().take(power.len().saturating_sub(1)).skip(lowest);
    let (peak, height) = inner.max_by(|a, b| a.1.total_cmp(b.1)).ok_or(SineError::NoSignal)?;
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
            best = if misfit < best.0 { (misfit, freq_hz) } else { best };
        }
    }
    Ok(best.1)
}

/// Where a parabola through the logarithms of three neighbours peaks, −0.5…0.5 bins off the middle one.
fn interpolate(power: &[f64], peak: usize) -> f64 {
    let log = |index: usize| power.get(index).copied().unwrap_or(0.0).max(f64::MIN_POSITIVE).ln();
    let (before, at, after) = (log(peak.wrapping_sub(1)), log(peak), log(peak + 1));
    let bend = before - 2.0 * at + after;
    if bend < 0.0 { (0.5 * (before - after) / bend).clamp(-0.5, 0.5) } else { 0.0 }
}

/// Power over frequency, each channel divided by its own total, from zero to half the sampling rate.
fn summed_power(record: &Record<'_>, samples: usize) -> Result<Vec<f64>, SineError> {
    let length = (2 * samples).next_power_of_two();
    let transform = FftPlanner::new().plan_fft_forward(length);
    let mut scratch = vec![Complex64::default(); transform.get_inplace_scratch_len()];
    let mut power = vec![0.0; length / 2 + 1];
    for (index, channel) in record.channels.iter().enumerate() {
        let mut values = values(channel, index + 1)?;
        detrend_and_window(&mut values);
        let energy: f64 = values.iter().map(|v| v * v).sum();
        if energy <= 0.0 {
            continue;
        }
        let mut buffer: Vec<Complex64> = values.iter().map(|v| Complex64::new(*v, 0.0)).collect();
        buffer.resize(length, Complex64::default());
        transform.process_with_scratch(&mut buffer, &mut scratch);
        for (sum, bin) in power.iter_mut().zip(&buffer) {
            *sum += bin.norm_sqr() / energy;
        }
    }
    Ok(power)
}

/// Samples in their own unit; a clipped one is kept, for it is near the truth and this is only a guess.
fn values(channel: &Channel<'_>, number: usize) -> Result<Vec<f64>, SineError> {
    match channel {
        Channel::Volts { samples, .. } => match samples.iter().enumerate().find(|(_, v)| !v.is_finite()) {
            Some((index, value)) => Err(SineError::NotFinite { channel: number, index, value: *value }),
            None if samples.iter().any(|v| is_inside(*v, volt_bounds(channel))) => Ok(samples.to_vec()),
            None => Err(SineError::AllClipped { channel: number, clipped: samples.len() }),
        },
        Channel::Codes { codes, .. } => {
            if !codes.iter().any(|code| is_inside(*code, code_bounds(channel))) {
                return Err(SineError::AllClipped { channel: number, clipped: codes.len() });
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
    let moment: f64 = values.iter().enumerate().map(|(n, v)| (n as f64 - centre) * (v - mean)).sum();
    let slope = moment / (count * (count * count - 1.0) / 12.0);
    for (n, value) in values.iter_mut().enumerate() {
        let window = 0.5 - 0.5 * (std::f64::consts::TAU * (n as f64 + 0.5) / count).cos();
        *value = (*value - mean - slope * (n as f64 - centre)) * window;
    }
}
