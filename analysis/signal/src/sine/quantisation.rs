//! Bound of a phasor's error by quantisation, for noise too low to make the quantisation act as
//! noise.
//!
//! An ADC adds the sawtooth of its rounding to every sample. Noise of half a code smooths it (the
//! sawtooth's k-th harmonic fades with exp(−2π²k²σ²), σ in codes; Widrow and Kollár, Quantization
//! Noise, ch. 4 and 10). Without noise, the sawtooth is a function of the signal's phase: samples
//! at only a few phases, or a signal of few codes, repeat the same errors, and averaging does not
//! help.
//!
//! The bound is found by simulation: sinusoids of the fitted amplitude, at several positions
//! between the codes, are rounded at the phases of the record, and the greatest error of the phasor
//! is used. It does not depend on the samples.

use num_complex::Complex64;

/// Noise, in codes rms, from which on the quantisation is noise.
pub(super) const ENOUGH_NOISE_LSB: f64 = 0.4;
/// A bound below this share of the standard deviation changes nothing.
const MATTERS: f64 = 0.5;
/// Phases of the record that are tried.
const PHASES: usize = 8192;
/// Sinusoids that are tried.
const TRIALS: usize = 16;
/// The same where few phases make each of them cheap, and different.
const TRIALS_FEW: usize = 2048;
/// Noise, in codes rms, below which the sawtooth is as sharp as without.
const SHARP_LSB: f64 = 0.12;
/// A record with at most this number of phases may hide any noise between the codes.
const FEW_PHASES: usize = 32;

/// A fitted channel in units of its quantisation.
#[derive(Debug, Clone, Copy)]
pub(super) struct Quantised {
    /// Amplitude, codes.
    pub(super) amplitude_lsb: f64,
    /// Mean square of the residual, codes².
    pub(super) residual_lsb2: f64,
    /// Standard deviation of a part of the phasor as the residual has it, codes.
    pub(super) sigma_lsb: f64,
    /// Cycles per sample.
    pub(super) cycles: f64,
    /// Samples of the record.
    pub(super) samples: usize,
}

/// Systematic error of a phasor by quantisation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Systematic {
    /// Noise before the quantisation, codes rms.
    pub(super) noise_lsb: f64,
    /// Number of different phases, if the record comes back to few.
    pub(super) phases: Option<usize>,
    /// Greatest error of the phasor, codes.
    pub(super) bound_lsb: f64,
}

impl Quantised {
    /// Returns the systematic error, if there is one that matters.
    pub(super) fn systematic(&self) -> Option<Systematic> {
        let noise_lsb = (self.residual_lsb2 - 1.0 / 12.0).max(0.0).sqrt();
        if noise_lsb >= ENOUGH_NOISE_LSB {
            return None;
        }
        let phases = few_phases(self.cycles, self.samples);
        let bound_lsb = self.bound(self.certain_noise(phases), phases);
        (bound_lsb > MATTERS * self.sigma_lsb).then_some(Systematic {
            noise_lsb,
            phases,
            bound_lsb,
        })
    }

    /// Noise that is there for certain, codes rms. The error of rounding has a mean square of 1/12
    /// only on average over the position between codes: it may take up to 1/4 − 1/12 more where few
    /// positions are met.
    fn certain_noise(&self, phases: Option<usize>) -> f64 {
        let few_codes = if phases.is_some() {
            1.0
        } else {
            (std::f64::consts::PI * self.amplitude_lsb.sqrt())
                .recip()
                .min(1.0)
        };
        (self.residual_lsb2 - 1.0 / 12.0 - few_codes / 6.0)
            .max(0.0)
            .sqrt()
    }

    fn bound(&self, noise_lsb: f64, few: Option<usize>) -> f64 {
        let count = few.unwrap_or(self.samples.min(PHASES));
        // Whole samples of the record, spread over all of it; if it has few phases, the first of
        // each.
        let index = |n: usize| {
            if few.is_some() {
                n
            } else {
                n * self.samples / count
            }
        };
        let phase = |n: usize| {
            Complex64::cis(std::f64::consts::TAU * (self.cycles * index(n) as f64).fract())
        };
        let phases: Vec<Complex64> = (0..count).map(phase).collect();
        let fade = (-2.0 * (std::f64::consts::PI * noise_lsb).powi(2)).exp() / std::f64::consts::PI;
        let sharp = noise_lsb < SHARP_LSB;
        let trials = if few.is_some() { TRIALS_FEW } else { TRIALS };
        let error = |trial: usize| {
            // Amplitude, offset and phase are known less well than a code: steps by irrational
            // numbers fill the space evenly.
            let part = |irrational: f64| (trial as f64 * irrational).fract();
            let amplitude = (self.amplitude_lsb + 1.25 * part(0.754_877_666_247) - 0.5).max(0.0);
            let (offset, start) = (
                part(0.569_840_290_998),
                Complex64::cis(std::f64::consts::TAU * part(0.819_172_513_397)),
            );
            let one = |turn: &Complex64| {
                let value = amplitude * (start * turn).re + offset;
                // Distance from the code, −½…½; the parabola is the sine of 2π times it within 6 %.
                let from_code = value - value.round();
                let sine = 8.0 * from_code * (1.0 - 2.0 * from_code.abs());
                turn.conj() * if sharp { -from_code } else { -fade * sine }
            };
            2.0 / count as f64 * phases.iter().map(one).sum::<Complex64>().norm()
        };
        (0..trials).map(error).fold(0.0, f64::max)
    }
}

/// Returns the number of different phases, if the samples repeat few of them: after q samples the
/// phase repeats, and continues to do so over the record.
fn few_phases(cycles: f64, samples: usize) -> Option<usize> {
    (1..=FEW_PHASES).find(|q| {
        let turns = cycles * *q as f64;
        // Over the record, the phases must not creep so far that they fill the gaps between them.
        (turns - turns.round()).abs() * (samples as f64) < 1.0
    })
}
