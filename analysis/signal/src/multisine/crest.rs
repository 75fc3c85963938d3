//! Phases with a low crest factor: the lower it is, the more current each line has within the same
//! peak.
//!
//! Iterative swapping between time and frequency (Van der Ouderaa, Schoukens and Renneboog, IEEE
//! Trans. Instrum. Meas. 37 (1988) 145): the signal is clipped a little, its phases at the excited
//! lines are kept and its amplitudes restored, repeatedly. Of several random starts, the best
//! result is kept.

use num_complex::Complex64;
use rustfft::{Fft, FftPlanner};
use std::{f64::consts::TAU, sync::Arc};

use analysis_numeric::Rng;

/// Random starts.
const STARTS: usize = 8;
/// Swaps from each.
const SWAPS: usize = 400;
/// Share of the peak that is clipped, at the first and at the last swap.
const CLIP: (f64, f64) = (0.80, 0.98);
/// Points per period of the fastest line that the peak is looked for at, at least.
const POINTS: usize = 16;

/// A multisine: lines of equal amplitude with their phases.
#[derive(Debug, Clone, PartialEq)]
pub struct Design {
    /// Harmonics that are excited, rising.
    pub harmonics: Vec<usize>,
    /// Phase of each as that of a cosine, rad.
    pub phases_rad: Vec<f64>,
    /// Peak over effective value.
    pub crest_factor: f64,
    /// That of the first random phases, for comparison.
    pub random_crest_factor: f64,
    /// Amplitude of each line, as a share of the peak.
    pub amplitude: f64,
}

/// Finds phases for the lines; equal seeds give equal phases.
///
/// ```
/// use analysis_signal::multisine::{design, odd_grid};
///
/// // Up to 20 odd harmonics of 0.1 Hz, from 0.1 to 100 Hz.
/// let harmonics = odd_grid(0.1, 0.1..=100.0, 20);
/// assert!(harmonics.iter().all(|harmonic| harmonic % 2 == 1));
/// let design = design(&harmonics, 1);
/// // The peak is at least a fifth lower than with random phases.
/// assert!(design.crest_factor < 0.8 * design.random_crest_factor);
/// let period = design.samples(4096);
/// assert!(period.iter().all(|share| share.abs() <= 1.0));
/// ```
pub fn design(harmonics: &[usize], seed: u64) -> Design {
    let greatest = harmonics.iter().copied().max().unwrap_or(1);
    let count = (POINTS * greatest).next_power_of_two();
    let mut planner = FftPlanner::new();
    let swap = Swap {
        harmonics,
        count,
        forward: planner.plan_fft_forward(count),
        back: planner.plan_fft_inverse(count),
    };
    let mut rng = Rng::new(seed);
    let mut best: Option<(f64, Vec<f64>)> = None;
    let mut random_crest_factor = f64::NAN;
    for start in 0..STARTS {
        let phases: Vec<f64> = harmonics.iter().map(|_| TAU * rng.uniform()).collect();
        if start == 0 {
            random_crest_factor = crest(&swap.signal(&phases));
        }
        let found = swap.improved(phases);
        if best.as_ref().is_none_or(|best| found.0 < best.0) {
            best = Some(found);
        }
    }
    let (crest_factor, phases_rad) = best.unwrap_or((f64::NAN, Vec::new()));
    // n lines of amplitude a have an effective value of a·√(n/2).
    let amplitude = 1.0 / (crest_factor * (0.5 * harmonics.len() as f64).sqrt());
    Design {
        harmonics: harmonics.to_vec(),
        phases_rad,
        crest_factor,
        random_crest_factor,
        amplitude,
    }
}

impl Design {
    /// Returns one period in `steps` steps, each the value in its middle, as a converter holds it:
    /// the peak of the finer signal is 1.
    pub fn samples(&self, steps: usize) -> Vec<f64> {
        let at = |k: usize| {
            let turn = TAU * (k as f64 + 0.5) / steps as f64;
            self.harmonics
                .iter()
                .zip(&self.phases_rad)
                .map(|(h, phase)| (*h as f64 * turn + phase).cos())
                .sum::<f64>()
                * self.amplitude
        };
        (0..steps).map(at).collect()
    }
}

struct Swap<'a> {
    harmonics: &'a [usize],
    count: usize,
    forward: Arc<dyn Fft<f64>>,
    back: Arc<dyn Fft<f64>>,
}

impl Swap<'_> {
    /// Returns the signal of these phases; amplitudes of one half and their mirror images.
    fn signal(&self, phases: &[f64]) -> Vec<Complex64> {
        let mut bins = vec![Complex64::ZERO; self.count];
        for (h, phase) in self.harmonics.iter().zip(phases) {
            bins[*h] = Complex64::from_polar(0.5, *phase);
            bins[self.count - h] = bins[*h].conj();
        }
        self.back.process(&mut bins);
        bins
    }

    /// Returns the lowest crest factor on the way from these phases, with its phases.
    fn improved(&self, mut phases: Vec<f64>) -> (f64, Vec<f64>) {
        let mut best = (f64::INFINITY, phases.clone());
        for round in 0..SWAPS {
            let mut signal = self.signal(&phases);
            let found = crest(&signal);
            if found < best.0 {
                best = (found, phases.clone());
            }
            let share = CLIP.0 + (CLIP.1 - CLIP.0) * round as f64 / SWAPS as f64;
            let limit = share
                * signal
                    .iter()
                    .map(|value| value.re.abs())
                    .fold(0.0, f64::max);
            signal
                .iter_mut()
                .for_each(|value| *value = Complex64::from(value.re.clamp(-limit, limit)));
            self.forward.process(&mut signal);
            phases = self.harmonics.iter().map(|h| signal[*h].arg()).collect();
        }
        best
    }
}

/// Peak over effective value.
fn crest(signal: &[Complex64]) -> f64 {
    let peak = signal
        .iter()
        .map(|value| value.re.abs())
        .fold(0.0, f64::max);
    peak / (signal.iter().map(|value| value.re * value.re).sum::<f64>() / signal.len() as f64)
        .sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::multisine::odd_grid;

    #[test]
    fn the_crest_factor_falls_well_below_that_of_random_phases_and_the_samples_have_it() {
        for (grid, most) in [
            (odd_grid(0.1, 0.1..=10.0, 12), 1.8),
            (odd_grid(5.0, 15.0..=300.0, 8), 1.8),
            (vec![1], 1.415),
        ] {
            let found = design(&grid, 3);
            assert!(
                found.crest_factor < most,
                "{grid:?}: {}",
                found.crest_factor
            );
            assert!(
                grid.len() == 1 || found.crest_factor < 0.85 * found.random_crest_factor,
                "{found:?}"
            );
            assert_eq!(found, design(&grid, 3), "the same from the same seed");
            let samples = found.samples(64 * grid.last().unwrap());
            let peak = samples
                .iter()
                .fold(0.0_f64, |peak, value| peak.max(value.abs()));
            assert!((peak - 1.0).abs() < 0.02, "{peak}");
            let effective = (samples.iter().map(|value| value * value).sum::<f64>()
                / samples.len() as f64)
                .sqrt();
            assert!((peak / effective / found.crest_factor - 1.0).abs() < 0.02);
        }
    }
}
