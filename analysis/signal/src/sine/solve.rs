//! From the sums to the fit: checks, the solution at one frequency, and the steps of the frequency.

use num_complex::Complex64;

use super::basis::{Basis, Make, dot};
use super::linear::{self, Normal};
use super::moments::{Moments, Stage, accumulate};
use super::plan::Plan;
use super::quantisation::{Quantised, Systematic};
use super::residual::{Residual, residual};
use super::sample::pivot;
use super::{
    Channel, ChannelFit, FitOptions, MIN_PERIODS, MIN_SAMPLES, Note, Phasor, Record, SineError,
    SineFit, Tone,
};
use analysis_numeric::Covariance2;

/// Steps of the frequency before giving up.
const MAX_STEPS: usize = 40;
/// Longest step, as phase at the ends of the record, rad: a longer one leaves the region in which
/// the linearised model is valid.
const LONGEST_STEP: f64 = 1.0;
/// A step below this part of the frequency's standard deviation changes nothing that matters.
const SETTLED: f64 = 1e-4;
/// Steps after which the weights of the channels stay as they are. The bound on the quantisation's
/// error is the greatest of some trials and jumps with the frequency: weights that follow it leave
/// steps that never end where channels of a quiet scope ask for different frequencies. Others
/// settle before.
const WEIGHED_ANEW: usize = 8;
/// Rounding of the step, rad at the ends of the record.
const ROUNDING: f64 = 1e-12;

/// Checks what does not depend on the frequency.
pub(super) fn check_record(record: &Record<'_>) -> Result<(), SineError> {
    let Some(first) = record.channels.first() else {
        return Err(SineError::NoChannels);
    };
    if !(record.interval_s > 0.0 && record.interval_s.is_finite()) {
        return Err(SineError::Interval {
            found: record.interval_s,
        });
    }
    for (index, channel) in record.channels.iter().enumerate() {
        let number = index + 1;
        if channel.len() != first.len() {
            return Err(SineError::UnequalLengths {
                channel: number,
                expected: first.len(),
                found: channel.len(),
            });
        }
        let (step_v, offset_v) = match channel {
            Channel::Volts { lsb_v, .. } => (lsb_v.unwrap_or(1.0), 0.0),
            Channel::Stored(stored) => stored
                .scale
                .map_or((stored.lsb_v.unwrap_or(1.0), 0.0), |scale| {
                    (scale.volts_per_code, scale.offset_v)
                }),
            Channel::Codes { scale, .. } => (scale.volts_per_code, scale.offset_v),
        };
        if !(step_v > 0.0 && step_v.is_finite() && offset_v.is_finite()) {
            return Err(SineError::Scale {
                channel: number,
                found_v: step_v,
                offset_v,
            });
        }
        if channel.len() < MIN_SAMPLES {
            return Err(SineError::TooFewSamples {
                channel: number,
                needed: MIN_SAMPLES,
                found: channel.len(),
                clipped: 0,
            });
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
        return Err(SineError::AboveNyquist {
            freq_hz,
            nyquist_hz,
        });
    }
    let periods = freq_hz * record.interval_s * samples(record) as f64;
    if periods < MIN_PERIODS {
        return Err(SineError::TooFewPeriods {
            freq_hz,
            periods,
            needed: MIN_PERIODS,
        });
    }
    Ok(())
}

fn samples(record: &Record<'_>) -> usize {
    record.channels.first().map_or(0, Channel::len)
}

/// Description of a solution at one frequency.
#[derive(Debug, Clone, Copy)]
struct Task<'a> {
    record: &'a Record<'a>,
    plan: &'a Plan,
    exclude_clipped: bool,
    /// A step of the frequency is to follow.
    free: bool,
}

/// Number of places in a record at which the sum of the relaxations is evaluated.
const LOOKS: u32 = 64;

/// The sum of the relaxations of a channel, in the unit of its samples.
#[derive(Debug, Clone, Copy, Default)]
struct Relaxed {
    /// Mean slope, per unit of normalised time.
    slope: f64,
    /// Value in the middle of the record.
    middle: f64,
    /// Greatest distance from the line through its ends.
    excursion: f64,
}

/// The solution at one frequency.
#[derive(Debug)]
struct State {
    freq_hz: f64,
    basis: Basis,
    channels: Vec<Solved>,
}

#[derive(Debug)]
struct Solved {
    moments: Moments,
    normal: Normal,
    beta: Vec<f64>,
    residual: Residual,
    /// Variance of the residual, in the unit of the samples squared.
    noise: f64,
    /// Variance of the quantisation.
    floor: f64,
    /// Error that the quantisation may make.
    systematic: Option<Systematic>,
    /// The same as variance of a sample.
    extra: f64,
}

/// Fits at a known frequency.
pub(super) fn known(
    record: &Record<'_>,
    freq_hz: f64,
    options: &FitOptions,
) -> Result<SineFit, SineError> {
    check_frequency(record, freq_hz)?;
    planned(record, freq_hz, options, |task| {
        Ok(task.evaluate(freq_hz)?.into_fit(&task, None, 1))
    })
}

/// Finds the frequency from a start.
pub(super) fn iterate(
    record: &Record<'_>,
    start_hz: f64,
    options: &FitOptions,
) -> Result<SineFit, SineError> {
    check_frequency(record, start_hz)?;
    planned(record, start_hz, options, |task| {
        Task { free: true, ..task }.iterate(start_hz)
    })
}

/// Fits everything that the record supports; if a channel with gaps does not support the extras,
/// fits without them.
fn planned<T>(
    record: &Record<'_>,
    freq_hz: f64,
    options: &FitOptions,
    fit: impl Fn(Task<'_>) -> Result<T, SineError>,
) -> Result<T, SineError> {
    let plan = Plan::new(options, freq_hz, samples(record), record.interval_s);
    let task = |plan| Task {
        record,
        plan,
        exclude_clipped: options.exclude_clipped,
        free: false,
    };
    let result = fit(Task {
        plan: &plan,
        ..task(&plan)
    });
    let Err(SineError::Undetermined { channel, .. } | SineError::TooFewSamples { channel, .. }) =
        &result
    else {
        return result;
    };
    match plan.reduced(freq_hz, *channel) {
        Some(reduced) => fit(task(&reduced)),
        None => result,
    }
}

/// Misfit of sinusoids of a frequency, each channel against its noise; to compare frequencies by.
pub(super) fn misfit(
    record: &Record<'_>,
    freq_hz: f64,
    options: &FitOptions,
) -> Result<f64, SineError> {
    check_frequency(record, freq_hz)?;
    let plain = FitOptions {
        drift: options.drift,
        exclude_clipped: options.exclude_clipped,
        ..FitOptions::default()
    };
    planned(record, freq_hz, &plain, |task| {
        let state = task.evaluate(freq_hz)?;
        // The logarithm weighs a channel by its residual relative to its signal: the likelihood
        // with unknown noise.
        let log_left = |solved: &Solved| {
            let there =
                dot(&solved.beta, &solved.moments.right).abs() + solved.residual.sum_squares;
            solved.moments.used as f64
                * (solved.residual.sum_squares + 1e-24 * there + f64::MIN_POSITIVE).ln()
        };
        Ok(state.channels.iter().map(log_left).sum())
    })
}

impl Task<'_> {
    fn evaluate(&self, freq_hz: f64) -> Result<State, SineError> {
        check_frequency(self.record, freq_hz)?;
        let extras = self.plan.tones(freq_hz);
        let freqs_hz: Vec<f64> = std::iter::once(freq_hz)
            .chain(extras.iter().map(|(_, freq_hz)| *freq_hz))
            .collect();
        // A fitted change of the sinusoid contains that by its frequency.
        let varying = self.plan.varying && !self.free;
        let timed = if self.free {
            1 + self.plan.harmonics.len()
        } else {
            0
        };
        let make = Make {
            freqs_hz: &freqs_hz,
            degree: self.plan.degree,
            decays_s: &self.plan.decays_s,
            timed,
            varying,
        };
        let basis = Basis::new(&make, self.record.interval_s, samples(self.record));
        let stage = Stage::new(basis, self.record, self.exclude_clipped);
        let all = accumulate(self.record, &stage, self.exclude_clipped)?;
        let mut channels = Vec::with_capacity(all.len());
        for (index, (channel, moments)) in self.record.channels.iter().zip(all).enumerate() {
            channels.push(self.solve(&stage, index, channel, moments, freq_hz)?);
        }
        Ok(State {
            freq_hz,
            basis: stage.basis,
            channels,
        })
    }

    fn solve(
        &self,
        stage: &Stage,
        index: usize,
        channel: &Channel<'_>,
        mut moments: Moments,
        freq_hz: f64,
    ) -> Result<Solved, SineError> {
        let (number, found, clipped) = (index + 1, moments.used, channel.len() - moments.used);
        if found == 0 {
            return Err(SineError::AllClipped {
                channel: number,
                clipped,
            });
        }
        let needed = MIN_SAMPLES.max(stage.basis.fitted() + 1);
        if found < needed {
            return Err(SineError::TooFewSamples {
                channel: number,
                needed,
                found,
                clipped,
            });
        }
        let normal = Normal::new(&moments.gram, stage.basis.fitted());
        let normal = normal.ok_or(SineError::Undetermined {
            channel: number,
            used: found,
            freq_hz,
        })?;
        if let Some(rounding) = &moments.rounding {
            // Error of the sums by the rounding of the columns, for the model that they give.
            let taken = rounding.times(&normal.solve(&moments.right));
            moments
                .right
                .iter_mut()
                .zip(&taken)
                .for_each(|(sum, part)| *sum += part);
        }
        let beta = normal.solve(&moments.right);
        let residual = residual(
            number,
            channel,
            stage,
            &moments,
            &beta,
            self.exclude_clipped,
        )?;
        let freedom = (found - normal.size()).max(1) as f64;
        let (noise, step) = (residual.sum_squares / freedom, lsb(channel).unwrap_or(0.0));
        let mut solved = Solved {
            moments,
            normal,
            beta,
            residual,
            noise,
            floor: step * step / 12.0,
            systematic: None,
            extra: 0.0,
        };
        if step > 0.0 {
            solved.quantise(step, self.record.interval_s * freq_hz);
        }
        Ok(solved)
    }

    fn iterate(&self, start_hz: f64) -> Result<SineFit, SineError> {
        let half_record =
            std::f64::consts::PI * self.record.interval_s * samples(self.record) as f64;
        let mut freq_hz = start_hz;
        let mut step_hz = f64::NAN;
        let mut weights = Vec::new();
        for steps in 1..=MAX_STEPS {
            let state = self.evaluate(freq_hz)?;
            if steps <= WEIGHED_ANEW {
                weights = state.weights(self);
            }
            let (step, sigma) = state.step(self, &weights)?;
            step_hz = step.clamp(-LONGEST_STEP, LONGEST_STEP) / half_record;
            if step.abs()
                < (SETTLED * sigma)
                    .max(ROUNDING)
                    .max(4.0 * f64::EPSILON * half_record * freq_hz)
            {
                return Ok(state.into_fit(self, Some(sigma / half_record), steps));
            }
            freq_hz += step_hz;
        }
        Err(SineError::NotConverged {
            iterations: MAX_STEPS,
            start_hz,
            freq_hz: freq_hz - step_hz,
            step_hz,
        })
    }
}

/// Step of the quantisation in the unit of the samples.
fn lsb(channel: &Channel<'_>) -> Option<f64> {
    match channel {
        Channel::Volts { lsb_v, .. } => *lsb_v,
        Channel::Stored(stored) => stored.scale.map_or(stored.lsb_v, |scale| {
            Some(f64::from(scale.code_step.max(1)))
        }),
        Channel::Codes { scale, .. } => Some(f64::from(scale.code_step.max(1))),
    }
}

impl State {
    /// Returns the weight of each channel in the step of the frequency.
    fn weights(&self, task: &Task<'_>) -> Vec<f64> {
        let weight = |solved: &Solved| {
            let power = solved.beta[0].powi(2) + solved.beta[1].powi(2);
            // Without the floor, channels that the model fits exactly would be weighed by their
            // rounding errors.
            1.0 / (solved.variance(rad_per_sample(self.freq_hz, task.record))
                + 1e-24 * power
                + f64::MIN_POSITIVE)
        };
        self.channels.iter().map(weight).collect()
    }

    /// Step of the frequency and its standard deviation, as phase at the ends of the record, rad.
    fn step(&self, task: &Task<'_>, weights: &[f64]) -> Result<(f64, f64), SineError> {
        let (mut curvature, mut slope) = (0.0, 0.0);
        for (solved, weight) in self.channels.iter().zip(weights) {
            let derivative = self.derivative(&solved.beta, task.plan);
            let (own_curvature, own_slope) = linear::frequency_step(
                &solved.moments.gram,
                &solved.moments.right,
                &solved.normal,
                &solved.beta,
                &derivative,
            );
            curvature += weight * own_curvature;
            slope += weight * own_slope;
        }
        let sigma = curvature.sqrt().recip();
        // If the phase at the ends of the record is uncertain by a turn, the frequency is not
        // determined.
        if sigma.is_finite() && sigma < std::f64::consts::PI {
            Ok((slope / curvature, sigma))
        } else {
            Err(SineError::NoSignal)
        }
    }

    /// Returns the coefficients, on all columns, of the model's derivative by a phase at the ends
    /// of the record: t·(re·(−sin θ) − im·cos θ) of each tone that moves with the fundamental,
    /// times its order.
    fn derivative(&self, beta: &[f64], plan: &Plan) -> Vec<f64> {
        let mut derivative = vec![0.0; self.basis.columns()];
        let orders = std::iter::once(1).chain(plan.harmonics.iter().copied());
        for (tone, order) in orders.enumerate() {
            let at = self.basis.first_timed() + 2 * tone;
            derivative[at] = -f64::from(order) * beta[2 * tone + 1];
            derivative[at + 1] = f64::from(order) * beta[2 * tone];
        }
        derivative
    }

    fn into_fit(self, task: &Task<'_>, freq_sigma_hz: Option<f64>, iterations: usize) -> SineFit {
        let record = task.record;
        let channels = record
            .channels
            .iter()
            .zip(&self.channels)
            .map(|(channel, solved)| self.channel_fit(record, channel, solved));
        let channels: Vec<ChannelFit> = channels.collect();
        let tone = |(index, (kind, freq_hz)): (usize, (super::ToneKind, f64))| {
            let phasors = record.channels.iter().zip(&self.channels);
            let phasors = phasors
                .map(|(channel, solved)| self.phasor(record, channel, solved, index + 1, freq_hz));
            Tone {
                kind,
                freq_hz,
                channels: phasors.collect(),
            }
        };
        let tones = task
            .plan
            .tones(self.freq_hz)
            .into_iter()
            .enumerate()
            .map(tone)
            .collect();
        let mut notes = task.plan.notes.clone();
        for (index, (solved, fit)) in self.channels.iter().zip(&channels).enumerate() {
            if let Some(Systematic {
                noise_lsb,
                phases,
                bound_lsb,
            }) = solved.systematic
            {
                let bound_v = bound_lsb
                    * lsb(&record.channels[index]).unwrap_or(0.0)
                    * volts_per_unit(&record.channels[index]);
                let bound_relative = bound_v / fit.phasor.norm();
                notes.push(Note::Quantisation {
                    channel: index + 1,
                    noise_lsb,
                    phases,
                    bound_v,
                    bound_relative,
                });
            }
        }
        let (samples, interval_s) = (samples(record), record.interval_s);
        let relaxed = !task.plan.decays_s.is_empty();
        SineFit {
            freq_hz: self.freq_hz,
            freq_sigma_hz,
            channels,
            samples,
            interval_s,
            iterations,
            relaxed,
            varying: task.plan.varying && !task.free,
            tones,
            notes,
        }
    }

    /// Returns the phasor of a tone against time zero at sample 0, V.
    fn phasor(
        &self,
        record: &Record<'_>,
        channel: &Channel<'_>,
        solved: &Solved,
        tone: usize,
        freq_hz: f64,
    ) -> Phasor {
        let to_volts = self.basis.place(0).turn(tone) * volts_per_unit(channel);
        let (re_re, re_im, im_im) = solved.normal.phasor_inverse(tone);
        let variance = solved.variance(rad_per_sample(freq_hz, record));
        let in_middle = Covariance2 {
            re_re: re_re * variance,
            re_im: re_im * variance,
            im_im: im_im * variance,
        };
        Phasor {
            phasor: Complex64::new(solved.beta[2 * tone], solved.beta[2 * tone + 1]) * to_volts,
            variance: in_middle.scaled(to_volts),
        }
    }

    /// Returns the sum of the relaxations, taken apart into the straight line through its ends and
    /// the rest.
    fn relaxed(&self, beta: &[f64]) -> Relaxed {
        let (first, last) = (self.basis.first_decay(), self.basis.first_timed());
        if first == last {
            return Relaxed::default();
        }
        let count = self.basis.samples() as f64;
        let at = |share: f64| {
            dot(
                &self.basis.row_at(share * count)[first..last],
                &beta[first..last],
            )
        };
        let (start, end) = (at(0.0), at(1.0));
        let off = |k: u32| {
            let share = f64::from(k) / f64::from(LOOKS);
            at(share) - start - share * (end - start)
        };
        // Time runs over two units.
        let farther = |most: f64, off: f64| if off.abs() > most.abs() { off } else { most };
        Relaxed {
            slope: 0.5 * (end - start),
            middle: at(0.5),
            excursion: (1..LOOKS).map(off).fold(0.0, farther),
        }
    }

    fn channel_fit(
        &self,
        record: &Record<'_>,
        channel: &Channel<'_>,
        solved: &Solved,
    ) -> ChannelFit {
        let scale = volts_per_unit(channel);
        let zero_v = match channel {
            Channel::Volts { .. } => 0.0,
            Channel::Codes { scale, .. } => -scale.offset_v,
            Channel::Stored(stored) => stored.scale.map_or(0.0, |scale| -scale.offset_v),
        };
        let Phasor { phasor, variance } = self.phasor(record, channel, solved, 0, self.freq_hz);
        let power = |power: usize| {
            if power < self.basis.powers() {
                solved.beta[2 * self.basis.tones() + power]
            } else {
                0.0
            }
        };
        let relaxed = self.relaxed(&solved.beta);
        let seconds_per_unit = record.interval_s / self.basis.time_step;
        let timed = self.basis.first_timed();
        let slope = match solved.beta.get(timed..timed + 2) {
            Some([re, im]) => Complex64::new(*re, *im),
            _ => Complex64::ZERO,
        };
        let to_sample_0 = self.basis.place(0).turn(0) * scale;
        ChannelFit {
            phasor,
            variance,
            phasor_slope: slope * to_sample_0 / seconds_per_unit,
            offset_v: (power(0) + relaxed.middle + pivot(channel)) * scale + zero_v,
            drift_v_per_s: (power(1) + relaxed.slope) * scale / seconds_per_unit,
            curvature_v_per_s2: power(2) * scale / (seconds_per_unit * seconds_per_unit),
            relaxation_v: relaxed.excursion * scale,
            residual_rms_v: (solved.residual.sum_squares / solved.moments.used as f64).sqrt()
                * scale,
            residual_lag1: solved.residual.lag1(),
            colour_factor: solved
                .residual
                .colour_factor(rad_per_sample(self.freq_hz, record)),
            clipped_samples: solved.moments.clipped,
            samples_used: solved.moments.used,
        }
    }
}

fn rad_per_sample(freq_hz: f64, record: &Record<'_>) -> f64 {
    std::f64::consts::TAU * freq_hz * record.interval_s
}

fn volts_per_unit(channel: &Channel<'_>) -> f64 {
    match channel {
        Channel::Volts { .. } => 1.0,
        Channel::Codes { scale, .. } => scale.volts_per_code,
        Channel::Stored(stored) => stored.scale.map_or(1.0, |scale| scale.volts_per_code),
    }
}

impl Solved {
    /// Returns the variance of a sample, as it counts for a sinusoid of a frequency.
    fn variance(&self, rad_per_sample: f64) -> f64 {
        (self.noise * self.residual.colour_factor(rad_per_sample)).max(self.floor) + self.extra
    }

    /// Finds the error that steps of `lsb` may make, and raises the variance so that no direction
    /// of the phasor is stated better.
    fn quantise(&mut self, lsb: f64, cycles: f64) {
        let (re_re, re_im, im_im) = self.normal.phasor_inverse(0);
        let quantised = Quantised {
            amplitude_lsb: self.beta[0].hypot(self.beta[1]) / lsb,
            residual_lsb2: self.noise / (lsb * lsb),
            sigma_lsb: (0.5 * (re_re + im_im) * self.noise.max(self.floor)).sqrt() / lsb,
            cycles,
            samples: self.moments.used,
        };
        self.systematic = quantised.systematic();
        if let Some(systematic) = self.systematic {
            let least = 0.5 * (re_re + im_im) - (0.5 * (re_re - im_im)).hypot(re_im);
            self.extra = (systematic.bound_lsb * lsb).powi(2) / least.max(f64::MIN_POSITIVE);
        }
    }
}
