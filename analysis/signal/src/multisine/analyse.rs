//! A record of whole periods of a multisine: phasors of the four channels at the excited harmonics
//! with their noise, and at the harmonics beside them.
//!
//! A drift is taken off first: the difference of two samples one period apart holds nothing of a
//! periodic signal, so that a straight line and a parabola are found without any leakage. Then one
//! transform of the whole record: with P periods, harmonic h lies in bin h·P, and the bins between
//! harmonics hold nothing but noise.

use num_complex::Complex64;
use rustfft::FftPlanner;
use serde::{Deserialize, Serialize};

use super::{
    changing::{Bins, Change, take_out_change},
    images::{Excited, Sampling},
    measured_images::{MeasuredImages, Pairs, Proof},
};
use crate::spectrum::{ChannelPhasors, PhasorVariance, SpectrumError};
use analysis_numeric::Covariance2;

/// Fewest periods: less leaves no bins between the harmonics worth the name.
const FEWEST_PERIODS: usize = 3;
/// Largest deviation of the record from whole periods, as a share of a sample.
const WHOLE: f64 = 0.05;

/// Reason why a record cannot be analysed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum MultisineError {
    /// It has no whole number of periods, or too few.
    #[error(
        "expected a record of {FEWEST_PERIODS} or more whole periods of {base_hz} Hz, met \
        {periods:.4}"
    )]
    Periods {
        /// Base frequency, Hz.
        base_hz: f64,
        /// Periods met.
        periods: f64,
    },
    /// A line lies beyond half the sampling rate.
    #[error("expected lines below half the sampling rate ({nyquist_hz} Hz), met {freq_hz} Hz")]
    Nyquist {
        /// Half the sampling rate, Hz.
        nyquist_hz: f64,
        /// The line, Hz.
        freq_hz: f64,
    },
    /// Channels of different lengths.
    #[error("expected four channels of one length, met {0:?} samples")]
    Lengths([usize; 4]),
    /// Not four channels.
    #[error(transparent)]
    Spectrum(#[from] SpectrumError),
}

/// Phasors of one record at its excited and detection lines.
#[derive(Debug, Clone, PartialEq)]
pub struct MultisineFit {
    /// Base frequency, Hz.
    pub base_hz: f64,
    /// Whole periods.
    pub periods: usize,
    /// Phasors at the excited harmonics, rising.
    pub excited: Vec<ChannelPhasors>,
    /// Phasors at even harmonics beside them.
    pub even: Vec<ChannelPhasors>,
    /// Phasors at odd harmonics beside them that were not excited.
    pub odd: Vec<ChannelPhasors>,
    /// Drift of each channel over the record that was taken off, V.
    pub drift_v: [f64; 4],
    /// Variance of either part of the voltage across the jig that images of the generator's steps
    /// put onto the excited harmonics, V²; it is in their noise.
    pub images_v2: Vec<f64>,
    /// Check of the predicted images against the record; `None` if the generator's steps were not
    /// given.
    pub proof: Option<Proof>,
}

/// Noise and distortion of one excited line. Amplitudes are those across the jig, relative to the
/// amplitude of the line.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Line {
    /// Frequency, Hz.
    pub freq_hz: f64,
    /// Standard deviation of the noise at the line.
    pub noise: f64,
    /// Even-order distortion: the largest even neighbour.
    pub even: f64,
    /// Odd-order distortion: the largest odd neighbour that was not excited. A similar amount lies
    /// on the line itself, where it cannot be detected.
    pub odd: f64,
    /// Standard deviation that noise alone gives to either.
    pub sigma: f64,
    /// Standard deviation of what images of the generator's steps put onto the line.
    #[serde(default)]
    pub images: f64,
}

impl Line {
    /// Returns whether the distortion is beyond what noise makes of two or three neighbours: five
    /// standard deviations.
    pub fn is_distorted(&self) -> bool {
        self.even.max(self.odd) > 5.0 * self.sigma
    }
}

/// Analyses samples of the four channels, V, of whole periods of the base frequency.
///
/// # Errors
/// [`MultisineError`] for an invalid record.
///
/// # Examples
/// ```
/// use analysis_signal::multisine::{Excited, MultisineError, analyse, design, odd_grid};
/// use analysis_signal::spectrum::raw_impedance;
///
/// // Four periods of 1 s at 1000 samples per second, through 10 mΩ of shunt and 4 mΩ of cell.
/// let harmonics = odd_grid(1.0, 1.0..=50.0, 6);
/// let current_a = design(&harmonics, 0).samples(1000).repeat(4);
/// let volts = |ohm: f64| current_a.iter().map(|a| ohm * a).collect::<Vec<f64>>();
/// let (earth, shunt, jig) = (volts(0.0), volts(0.010), volts(0.014));
/// let excited = Excited {
///     base_hz: 1.0,
///     harmonics: &harmonics,
/// };
/// let fit = analyse([&earth, &shunt, &shunt, &jig], 1e-3, excited)?;
/// assert_eq!(fit.excited.len(), harmonics.len());
/// for phasors in &fit.excited {
///     assert!((raw_impedance(phasors, 0.010).z_ohm.re - 4e-3).abs() < 1e-9);
/// }
/// # Ok::<(), MultisineError>(())
/// ```
pub fn analyse(
    channels: [&[f64]; 4],
    interval_s: f64,
    excited: Excited<'_>,
) -> Result<MultisineFit, MultisineError> {
    analysed(channels, interval_s, excited).map(|(fit, _)| fit)
}

/// Analyses the signal of a generator that outputs `steps` steps per period: the contribution of
/// their images to the lines is measured beside them, and is included in the noise.
///
/// # Errors
/// [`MultisineError`] for an invalid record.
pub fn analyse_played(
    channels: [&[f64]; 4],
    interval_s: f64,
    excited: Excited<'_>,
    steps: usize,
) -> Result<MultisineFit, MultisineError> {
    let (fit, bins) = analysed(channels, interval_s, excited)?;
    Ok(with_images(fit, &bins, excited, steps))
}

/// Analyses a record of a system that may change over it, as a cell under a direct current does. If the
/// bins between the harmonics show a change, it is taken out, and the phasors are those of the middle
/// of the record; otherwise the result is that of [`analyse`] or, with the generator's steps of a
/// period, of [`analyse_played`].
///
/// # Errors
/// [`MultisineError`] for an invalid record.
pub fn analyse_changing(
    channels: [&[f64]; 4],
    interval_s: f64,
    excited: Excited<'_>,
    steps: Option<usize>,
) -> Result<(MultisineFit, Option<Change>), MultisineError> {
    let (mut fit, mut bins) = analysed(channels, interval_s, excited)?;
    let change = take_out_change(&mut bins, fit.periods, excited).map(|(change, variances)| {
        let drift_v = fit.drift_v;
        fit = MultisineFit {
            drift_v,
            ..collected(&bins, excited, fit.periods)
        };
        for (phasors, variance) in fit.excited.iter_mut().zip(variances) {
            phasors.variance = variance;
        }
        change
    });
    let fit = match steps {
        Some(steps) => with_images(fit, &bins, excited, steps),
        None => fit,
    };
    Ok((fit, change))
}

/// Adds what images of the generator's steps put onto the lines to their noise.
fn with_images(
    mut fit: MultisineFit,
    bins: &[Bins],
    excited: Excited<'_>,
    steps: usize,
) -> MultisineFit {
    let difference = |high: usize, low: usize| {
        bins[high]
            .0
            .iter()
            .zip(&bins[low].0)
            .map(|(high, low)| high - low)
            .collect()
    };
    let pairs = Pairs {
        jig: difference(3, 2),
        shunt: difference(1, 0),
    };
    let sampling = Sampling {
        steps,
        periods: fit.periods,
        samples: bins[0].0.len(),
    };
    let seen = MeasuredImages::new(&pairs, excited, sampling);
    for phasors in [&mut fit.excited, &mut fit.even, &mut fit.odd] {
        let at: Vec<usize> = phasors
            .iter()
            .map(|p| (p.freq_hz / excited.base_hz).round() as usize)
            .collect();
        for (p, v2) in phasors.iter_mut().zip(seen.onto(&at)) {
            [2, 3].into_iter().for_each(|slot: usize| {
                p.variance[slot].noise = p.variance[slot].noise + Covariance2::circular(0.5 * v2);
            });
        }
    }
    fit.images_v2 = seen.onto(excited.harmonics);
    fit.proof = Some(seen.proof);
    fit
}

fn analysed(
    channels: [&[f64]; 4],
    interval_s: f64,
    excited: Excited<'_>,
) -> Result<(MultisineFit, Vec<Bins>), MultisineError> {
    let Excited { base_hz, harmonics } = excited;
    let count = channels[0].len();
    if channels.iter().any(|samples| samples.len() != count) {
        return Err(MultisineError::Lengths(channels.map(<[f64]>::len)));
    }
    let periods = count as f64 * interval_s * base_hz;
    let whole = periods.round() as usize;
    let off_samples = (periods - periods.round()).abs() / (base_hz * interval_s);
    if whole < FEWEST_PERIODS || off_samples > WHOLE {
        return Err(MultisineError::Periods { base_hz, periods });
    }
    let last = harmonics.iter().copied().max().unwrap_or(0);
    if 2 * (last + 2) * whole >= count {
        return Err(MultisineError::Nyquist {
            nyquist_hz: 0.5 / interval_s,
            freq_hz: last as f64 * base_hz,
        });
    }
    let bins: Vec<Bins> = channels
        .iter()
        .map(|samples| transformed(samples, whole))
        .collect();
    Ok((collected(&bins, excited, whole), bins))
}

/// Returns the phasors at the excited lines and beside them.
fn collected(bins: &[Bins], excited: Excited<'_>, whole: usize) -> MultisineFit {
    let Excited { base_hz, harmonics } = excited;
    let phasors = |harmonic: &usize| ChannelPhasors {
        freq_hz: *harmonic as f64 * base_hz,
        volts: [0, 1, 2, 3].map(|slot: usize| bins[slot].0[harmonic * whole]),
        variance: [0, 1, 2, 3]
            .map(|slot: usize| PhasorVariance::circular(noise(&bins[slot].0, *harmonic, whole))),
    };
    let beside = |even: bool| -> Vec<ChannelPhasors> {
        let mut found: Vec<usize> = harmonics
            .iter()
            .flat_map(|h| {
                if even {
                    vec![h - 1, h + 1]
                } else {
                    vec![h.saturating_sub(2), h + 2]
                }
            })
            .collect();
        found.retain(|h| *h > 0 && !harmonics.contains(h));
        found.sort_unstable();
        found.dedup();
        found.iter().map(phasors).collect()
    };
    MultisineFit {
        base_hz,
        periods: whole,
        excited: harmonics.iter().map(phasors).collect(),
        even: beside(true),
        odd: beside(false),
        drift_v: [0, 1, 2, 3].map(|slot: usize| bins[slot].1),
        images_v2: vec![0.0; harmonics.len()],
        proof: None,
    }
}

/// Amplitudes of all bins (t = 0 at sample 0), V, and the drift over the record, V.
fn transformed(samples: &[f64], periods: usize) -> (Vec<Complex64>, f64) {
    let count = samples.len();
    let (slope, curvature) = drift(samples, periods);
    let middle = 0.5 * (count as f64 - 1.0);
    let flat = |(k, value): (usize, &f64)| {
        let t = k as f64 - middle;
        Complex64::from(value - slope * t - curvature * t * t)
    };
    let mut bins: Vec<Complex64> = samples.iter().enumerate().map(flat).collect();
    FftPlanner::new().plan_fft_forward(count).process(&mut bins);
    let scale = 2.0 / count as f64;
    bins.iter_mut().for_each(|bin| *bin *= scale);
    (bins, slope * count as f64)
}

/// Returns the slope per sample in the middle of the record and the curvature per sample squared,
/// from differences over a period. With s(k) = x(k + N) − x(k) a parabola a·t + c·t² gives
/// s = N·a + c·(2tN + N²): a straight line in t, whose mean and slope determine both.
fn drift(samples: &[f64], periods: usize) -> (f64, f64) {
    let length = samples.len() as f64 / periods as f64;
    let shift = length.round() as usize;
    let middle = 0.5 * (samples.len() as f64 - 1.0);
    let (mut n, mut sum, mut moment, mut square) = (0.0, 0.0, 0.0, 0.0);
    // The period may be a fractional number of samples: whole records are shifted by whole periods
    // exactly only if it is an integer.
    for (k, pair) in samples.iter().zip(&samples[shift..]).enumerate() {
        let (t, step) = (k as f64 + 0.5 * shift as f64 - middle, pair.1 - pair.0);
        (n, sum, moment, square) = (n + 1.0, sum + step, moment + t * step, square + t * t);
    }
    let width = shift as f64;
    (sum / n / width, moment / square / (2.0 * width))
}

/// Returns the variance of each part of the phasor at a harmonic, V²: the mean over the bins
/// between its two neighbouring harmonics.
fn noise(bins: &[Complex64], harmonic: usize, periods: usize) -> f64 {
    let centre = harmonic * periods;
    let around = (centre.saturating_sub(periods) + 1..centre + periods)
        .filter(|bin| bin % periods != 0 && *bin > periods / 2);
    let (sum, count) = around.fold((0.0, 0.0), |(sum, count), bin| {
        (sum + bins[bin].norm_sqr(), count + 1.0)
    });
    0.5 * sum / count
}

/// Detection lines on either side whose mean square estimates the background on an excited line.
const BESIDE: usize = 2;

/// Returns the phasors at the excited lines with the added variance from odd powers and everything
/// else that repeats with every period: it cannot be detected at the lines themselves, and is as
/// large there as at the omitted odd harmonics beside them. It counts for the voltage across the
/// jig. It does not include the effect of a nonlinearity on all lines alike, a change of Z with the
/// amplitude.
pub fn with_distortion(fit: &MultisineFit) -> Vec<ChannelPhasors> {
    let known = quotients(fit);
    let found: Vec<(f64, (f64, f64))> = fit
        .odd
        .iter()
        .map(|p| (p.freq_hz, rest(p, &known)))
        .collect();
    let widened = |p: &ChannelPhasors| {
        let after = found.partition_point(|(freq_hz, _)| *freq_hz < p.freq_hz);
        let near = &found[after.saturating_sub(BESIDE)..(after + BESIDE).min(found.len())];
        let count = near.len().max(1) as f64;
        let excess = near
            .iter()
            .map(|(_, (value, variance))| value * value - variance)
            .sum::<f64>()
            / count;
        let more = Covariance2::circular(0.25 * excess.max(0.0));
        let mut widened = *p;
        for slot in [2, 3] {
            widened.variance[slot].noise = widened.variance[slot].noise + more;
        }
        widened
    };
    fit.excited.iter().map(widened).collect()
}

/// (V₄ − V₃)/(V₂ − V₁) at the excited lines.
fn quotients(fit: &MultisineFit) -> Vec<(f64, Complex64)> {
    fit.excited
        .iter()
        .map(|p| {
            (
                p.freq_hz,
                (p.volts[3] - p.volts[2]) / (p.volts[1] - p.volts[0]),
            )
        })
        .collect()
}

/// Returns the residual voltage at a detection line that the current there does not explain:
/// magnitude, V, and its variance by noise, V².
fn rest(p: &ChannelPhasors, known: &[(f64, Complex64)]) -> (f64, f64) {
    let per_volt = between(known, p.freq_hz);
    let [v1, v2, v3, v4] = p.volts;
    let [n1, n2, n3, n4] = p.totals();
    let variance = n3 + n4 + (n1 + n2).scaled(per_volt);
    (
        (v4 - v3 - per_volt * (v2 - v1)).norm(),
        variance.re_re + variance.im_im,
    )
}

/// Returns noise and distortion of every excited line. The current's own part at the neighbours
/// passes through the impedance there, which is interpolated over ln f between the excited lines.
/// The residual is the system's distortion.
pub fn nonlinear(fit: &MultisineFit) -> Vec<Line> {
    let known = quotients(fit);
    let line = |(p, image_v2): (&ChannelPhasors, &f64)| {
        let amplitude = (p.volts[3] - p.volts[2]).norm();
        let near = |lines: &[ChannelPhasors], reach: f64| {
            let close = lines
                .iter()
                .filter(|other| (other.freq_hz - p.freq_hz).abs() < (reach + 0.5) * fit.base_hz);
            close
                .map(|other| rest(other, &known))
                .fold((0.0_f64, 0.0_f64), |(most, variance), (value, square)| {
                    (most.max(value), variance.max(square))
                })
        };
        let (even, odd) = (near(&fit.even, 1.0), near(&fit.odd, 2.0));
        let [_, _, n3, n4] = p.totals();
        let own: Covariance2 = n3 + n4;
        Line {
            freq_hz: p.freq_hz,
            noise: (own.re_re + own.im_im - 2.0 * image_v2).max(0.0).sqrt() / amplitude,
            even: even.0 / amplitude,
            odd: odd.0 / amplitude,
            sigma: even.1.max(odd.1).sqrt() / amplitude,
            images: (2.0 * image_v2).sqrt() / amplitude,
        }
    };
    fit.excited.iter().zip(&fit.images_v2).map(line).collect()
}

/// Relative lead of the excitation's clock over the record's, and its standard deviation. Between
/// an early and a late part of the record, whole periods each, the phase of the current's line at f
/// turns by 2π·f·ε·Δt. `None` for a record of fewer than four periods.
pub fn clock_offset(
    channels: [&[f64]; 4],
    interval_s: f64,
    excited: Excited<'_>,
) -> Option<(f64, f64)> {
    let Excited { base_hz, harmonics } = excited;
    let count = channels[0].len();
    let whole = (count as f64 * interval_s * base_hz).round() as usize;
    let half = whole / 2;
    if half < 2 || harmonics.len() < 2 {
        return None;
    }
    let period = count as f64 / whole as f64;
    // Samples of whole periods, as exactly as there are samples; the phase of each part counts from
    // sample 0.
    let length = (half as f64 * period).round() as usize;
    let later = count - length;
    let phasor = |harmonic: usize, from: usize| -> Complex64 {
        let turn = std::f64::consts::TAU * harmonic as f64 / period;
        let sample = |k: usize| channels[1][k] - channels[0][k];
        let mean = (from..from + length).map(sample).sum::<f64>() / length as f64;
        (from..from + length)
            .map(|k| (sample(k) - mean) * Complex64::from_polar(1.0, -turn * k as f64))
            .sum()
    };
    // Each line's rotation, over that for ε = 1, weighted by the square of the latter.
    let span = std::f64::consts::TAU * later as f64 / period;
    let turns: Vec<(f64, f64)> = harmonics
        .iter()
        .map(|h| (span * *h as f64, (phasor(*h, later) / phasor(*h, 0)).arg()))
        .collect();
    let square: f64 = turns.iter().map(|(of_one, _)| of_one * of_one).sum();
    let offset = turns
        .iter()
        .map(|(of_one, turn)| of_one * turn)
        .sum::<f64>()
        / square;
    let left: f64 = turns
        .iter()
        .map(|(of_one, turn)| (turn - offset * of_one).powi(2))
        .sum();
    Some((offset, (left / (turns.len() - 1) as f64 / square).sqrt()))
}

fn between(known: &[(f64, Complex64)], freq_hz: f64) -> Complex64 {
    let after = known.partition_point(|(f, _)| *f < freq_hz);
    match (
        after.checked_sub(1).and_then(|before| known.get(before)),
        known.get(after),
    ) {
        (Some((f0, z0)), Some((f1, z1))) => z0 + (z1 - z0) * ((freq_hz / f0).ln() / (f1 / f0).ln()),
        (Some((_, end)), None) | (None, Some((_, end))) => *end,
        (None, None) => Complex64::ZERO,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::multisine::{design, odd_grid};
    use analysis_numeric::Rng;
    use std::f64::consts::TAU;

    const SHUNT_OHM: f64 = 0.01;

    /// 20 mΩ and a time constant, as a number per frequency.
    fn z(freq_hz: f64) -> Complex64 {
        Complex64::from(0.01) + 0.01 / Complex64::new(1.0, TAU * freq_hz * 0.05)
    }

    struct Case {
        noise_v: f64,
        square: f64,
        cube: f64,
        drift_v: f64,
    }

    /// Four channels of five periods of 0.5 Hz and the harmonics in them.
    fn record(case: &Case, seed: u64) -> ([Vec<f64>; 4], Vec<usize>, f64) {
        let harmonics = odd_grid(0.5, 0.5..=20.0, 8);
        let found = design(&harmonics, 1);
        let (count, interval_s) = (10_000_usize, 1.0e-3);
        let mut rng = Rng::new(seed);
        let mut gauss = || (0..12).map(|_| rng.uniform()).sum::<f64>() - 6.0;
        let mut volts: [Vec<f64>; 4] = Default::default();
        for k in 0..count {
            let t = interval_s * k as f64;
            let lines = harmonics
                .iter()
                .zip(&found.phases_rad)
                .map(|(h, phase)| (0.5 * *h as f64, *phase));
            let turned = |f: f64, phase: f64| {
                Complex64::from_polar(3.0 * found.amplitude, TAU * f * t + phase)
            };
            let current: f64 = lines.clone().map(|(f, phase)| turned(f, phase).re).sum();
            let linear: f64 = lines.map(|(f, phase)| (z(f) * turned(f, phase)).re).sum();
            let u = (k as f64 - 5000.0) / 5000.0;
            let answer = linear
                + case.square * linear * linear
                + case.cube * linear.powi(3)
                + case.drift_v * (u + 0.3 * u * u);
            for (slot, value) in [0.2, 0.2 + SHUNT_OHM * current, 3.0, 3.0 + answer]
                .into_iter()
                .enumerate()
            {
                volts[slot].push(value + case.noise_v * gauss());
            }
        }
        (volts, harmonics, interval_s)
    }

    fn excited(harmonics: &[usize]) -> Excited<'_> {
        Excited {
            base_hz: 0.5,
            harmonics,
        }
    }

    fn analysed(case: &Case, seed: u64) -> MultisineFit {
        let (volts, harmonics, interval_s) = record(case, seed);
        analyse(
            volts.each_ref().map(Vec::as_slice),
            interval_s,
            excited(&harmonics),
        )
        .unwrap()
    }

    fn off(fit: &MultisineFit) -> Vec<(Complex64, f64)> {
        let point = |p: &ChannelPhasors| {
            let raw = crate::spectrum::raw_impedance(p, SHUNT_OHM);
            (
                raw.z_ohm - z(p.freq_hz),
                (raw.covariance.re_re + raw.covariance.im_im).sqrt(),
            )
        };
        fit.excited.iter().map(point).collect()
    }

    #[test]
    fn impedances_are_exact_without_noise_whatever_drifts() {
        for drift_v in [0.0, 0.05] {
            let fit = analysed(
                &Case {
                    noise_v: 0.0,
                    square: 0.0,
                    cube: 0.0,
                    drift_v,
                },
                1,
            );
            assert_eq!(fit.periods, 5);
            assert!(
                (fit.drift_v[3] - 2.0 * drift_v).abs() < 1e-3 * drift_v.max(1e-9),
                "{:?}",
                fit.drift_v
            );
            for (error, _) in off(&fit) {
                assert!(error.norm() < 1e-9, "{error}");
            }
        }
    }

    #[test]
    fn the_stated_noise_is_the_scatter() {
        let case = Case {
            noise_v: 1.0e-3,
            square: 0.0,
            cube: 0.0,
            drift_v: 0.01,
        };
        let (mut squares, mut count, mut distorted) = (0.0, 0.0, 0);
        for seed in 0..40 {
            let fit = analysed(&case, seed);
            for (error, sigma) in off(&fit) {
                squares += (error.norm() / sigma).powi(2);
                count += 1.0;
            }
            distorted += nonlinear(&fit)
                .iter()
                .filter(|line| line.is_distorted())
                .count();
        }
        let ratio: f64 = squares / count;
        // Sixteen degrees of freedom of the noise make the mean of the quotient's square 16/14.
        assert!((0.95..1.35).contains(&ratio), "{ratio}");
        assert_eq!(distorted, 0, "noise is not distortion");
    }

    #[test]
    fn squares_show_at_even_and_cubes_at_odd_neighbours() {
        let lines = |square: f64, cube: f64| {
            nonlinear(&analysed(
                &Case {
                    noise_v: 1.0e-5,
                    square,
                    cube,
                    drift_v: 0.0,
                },
                1,
            ))
        };
        let most = |lines: &[Line], of: fn(&Line) -> f64| lines.iter().map(of).fold(0.0, f64::max);
        let (linear, squared, cubed) = (lines(0.0, 0.0), lines(2.0, 0.0), lines(0.0, 60.0));
        assert!(!linear.iter().any(Line::is_distorted), "{linear:#?}");
        assert!(
            squared.iter().any(Line::is_distorted)
                && most(&squared, |l| l.even) > 10.0 * most(&squared, |l| l.odd),
            "{squared:#?}"
        );
        assert!(
            cubed.iter().any(Line::is_distorted)
                && most(&cubed, |l| l.odd) > 10.0 * most(&cubed, |l| l.even),
            "{cubed:#?}"
        );
    }

    #[test]
    fn distortion_widens_the_uncertainty_and_noise_does_not() {
        let ratio = |case: &Case| -> f64 {
            let fit = analysed(case, 3);
            let wide = with_distortion(&fit);
            let widest = MultisineFit {
                excited: wide,
                ..fit.clone()
            };
            let squares = |fit: &MultisineFit| {
                off(fit)
                    .iter()
                    .map(|(error, sigma)| (error.norm() / sigma).powi(2))
                    .sum::<f64>()
                    / 8.0
            };
            squares(&fit) / squares(&widest)
        };
        assert!(
            ratio(&Case {
                noise_v: 1.0e-3,
                square: 0.0,
                cube: 0.0,
                drift_v: 0.0
            }) < 3.0
        );
        assert!(
            ratio(&Case {
                noise_v: 1.0e-5,
                square: 0.0,
                cube: 60.0,
                drift_v: 0.0
            }) > 10.0
        );
    }

    #[test]
    fn a_clock_that_runs_fast_shows_in_the_turn_of_the_lines() {
        let harmonics = odd_grid(0.5, 0.5..=20.0, 8);
        let found = design(&harmonics, 1);
        let mut rng = Rng::new(5);
        for ppm in [0.0, 30.0, -200.0] {
            let at = |k: u32| {
                let t = 1.0e-3 * f64::from(k) * (1.0 + 1.0e-6 * ppm);
                harmonics
                    .iter()
                    .zip(&found.phases_rad)
                    .map(|(h, phase)| (TAU * 0.5 * *h as f64 * t + phase).cos())
                    .sum::<f64>()
            };
            let current: Vec<f64> = (0..10_000)
                .map(|k| 0.01 * at(k) + 1.0e-4 * (rng.uniform() - 0.5))
                .collect();
            let nothing = vec![0.0; current.len()];
            let channels = [
                nothing.as_slice(),
                current.as_slice(),
                nothing.as_slice(),
                nothing.as_slice(),
            ];
            let (offset, sigma) = clock_offset(channels, 1.0e-3, excited(&harmonics)).unwrap();
            assert!(
                (1.0e6 * offset - ppm).abs() < 5.0e6 * sigma && sigma < 5.0e-6,
                "{ppm} ppm: {offset:e} ± {sigma:e}"
            );
        }
    }

    #[test]
    fn what_is_not_a_whole_record_is_refused() {
        let (volts, harmonics, interval_s) = record(
            &Case {
                noise_v: 0.0,
                square: 0.0,
                cube: 0.0,
                drift_v: 0.0,
            },
            1,
        );
        let cut =
            |range: std::ops::Range<usize>| volts.each_ref().map(|samples| &samples[range.clone()]);
        let refused = |range, interval_s| {
            analyse(cut(range), interval_s, excited(&harmonics))
                .unwrap_err()
                .to_string()
        };
        assert_eq!(
            refused(0..9000, interval_s),
            "expected a record of 3 or more whole periods of 0.5 Hz, met 4.5000"
        );
        assert_eq!(
            refused(0..4000, interval_s),
            "expected a record of 3 or more whole periods of 0.5 Hz, met 2.0000"
        );
        assert!(
            refused(0..100, 0.1)
                .starts_with("expected lines below half the sampling rate (5 Hz), met ")
        );
    }
}
