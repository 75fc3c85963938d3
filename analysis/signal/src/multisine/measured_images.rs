//! Measures the images of the generator's steps in a record, and their error on its lines.
//!
//! Most images fall into bins without other signals. There their power above the noise is measured,
//! octave by octave of their true frequency, as a factor over the share of current that the steps
//! give them. The factor is that of supply, harness and probes, none of which needs to be known.
//! Images on a line belong to the same octaves, and their variance is the factor's square times the
//! share's.

use num_complex::Complex64;
use serde::{Deserialize, Serialize};

use super::images::{Excited, Image, Sampling, images};

/// Up to this multiple of the fastest line distortion may put something onto any harmonic.
const DISTORTED: usize = 7;
/// Power of a bin over that of noise which noise has in one of 7·10¹⁰ bins: 25, five standard
/// deviations' square.
const CERTAIN: f64 = 25.0;
/// Power relative to the prediction, below which an image is missing: noise and other images on the
/// same bin leave less in a thousandth of all cases.
const MISSING: f64 = 1.0e-3;
/// Share of the strong images that may be missing, which a few neighbours of opposite phase
/// explain.
const MOST_MISSING: f64 = 0.05;
/// Strong bins that nothing explains, of which a mains hum and its harmonic make two.
const MOST_STRANGE: usize = 2;

/// The two differences of a record, bins up to its length: across the jig, and across the shunt; V.
#[derive(Debug, Clone)]
pub(super) struct Pairs {
    pub(super) jig: Vec<Complex64>,
    pub(super) shunt: Vec<Complex64>,
}

/// Check of the predicted images against the record.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Proof {
    /// Places beside the lines where images are predicted beyond five standard deviations of the
    /// noise.
    pub predicted: usize,
    /// Number of them that show no image.
    pub missing: usize,
    /// Bins above the lines with more than five times what noise and predicted images have there.
    pub strange: usize,
    /// The strongest of these: Hz.
    pub strange_hz: f64,
    /// Amplitude of the strongest over the noise's.
    pub strange_sigmas: f64,
}

impl Proof {
    fn add_strange(&mut self, freq_hz: f64, sigmas: f64) {
        self.strange += 1;
        if sigmas > self.strange_sigmas {
            (self.strange_hz, self.strange_sigmas) = (freq_hz, sigmas);
        }
    }

    /// Returns whether the record contradicts the rates.
    pub fn contradicts(&self) -> bool {
        let missing = self.missing as f64 > MOST_MISSING * self.predicted as f64
            && self.missing > MOST_STRANGE;
        missing || self.strange > MOST_STRANGE
    }
}

/// Measured images of one record.
#[derive(Debug, Clone)]
pub(super) struct MeasuredImages {
    lines: Vec<(usize, f64)>,
    sampling: Sampling,
    /// Square of the factor over the share, from the generator's rate on, by octave.
    octaves: Vec<f64>,
    pub(super) proof: Proof,
}

/// One place beside the lines.
struct Place {
    bin: usize,
    octave: usize,
    /// Square of the image's current.
    weight: f64,
    power: f64,
}

impl MeasuredImages {
    /// Measures the images of the lines in a record; the base frequency converts harmonics to
    /// frequencies in messages.
    pub(super) fn new(pairs: &Pairs, excited: Excited<'_>, sampling: Sampling) -> Self {
        let Excited { base_hz, harmonics } = excited;
        let bin = |harmonic: usize| harmonic * sampling.periods;
        let lines: Vec<(usize, f64)> = harmonics
            .iter()
            .map(|h| (*h, pairs.shunt[bin(*h)].norm_sqr()))
            .collect();
        let quotient = |h: usize| pairs.jig[bin(h)] / pairs.shunt[bin(h)];
        let last = harmonics.last().copied().unwrap_or(1);
        let rest = |at: usize| (pairs.jig[at] - quotient(last) * pairs.shunt[at]).norm_sqr();
        let noise = noise_power(rest, bin(last + 3), sampling);
        let mut places: Vec<Place> = Vec::new();
        for order in 1..=(sampling.cycle() / 2).clamp(1, 4096) {
            for (of, square) in &lines {
                for at in sampling.beside(*of, order) {
                    let (image, bin) = (
                        Image {
                            of: *of,
                            onto: 0,
                            order,
                            at,
                        },
                        sampling.bin(at),
                    );
                    if bin > (last + 3) * sampling.periods && 2 * bin < sampling.samples {
                        let power = rest(bin);
                        places.push(Place {
                            bin,
                            octave: octave(&image, sampling),
                            weight: image.share().powi(2) * square,
                            power,
                        });
                    }
                }
            }
        }
        // Where several fall into a bin the first is the largest.
        places.sort_by(|a, b| a.bin.cmp(&b.bin).then(b.weight.total_cmp(&a.weight)));
        places.dedup_by(|later, first| {
            let same = later.bin == first.bin;
            if same {
                first.weight += later.weight;
            }
            same
        });
        let octaves = factors(&places, noise);
        let mut proof = proof(&places, &octaves, noise);
        // Power that is predicted for a bin, V².
        let expected = |bin: usize| {
            let place = places
                .binary_search_by_key(&bin, |place| place.bin)
                .ok()
                .map(|at| &places[at]);
            place.map_or(0.0, |place| octaves[place.octave] * place.weight)
        };
        for bin in bin(last + 3)..sampling.samples / 2 {
            let distorted =
                bin.is_multiple_of(sampling.periods) && bin <= DISTORTED * last * sampling.periods;
            let (power, freq_hz) = (rest(bin), bin as f64 * base_hz / sampling.periods as f64);
            if !distorted && power > CERTAIN * (noise + expected(bin)) {
                proof.add_strange(freq_hz, (power / noise).sqrt());
            }
        }
        Self {
            lines,
            sampling,
            octaves,
            proof,
        }
    }

    /// Returns the variance of either part of the voltage across the jig that images put onto
    /// harmonics, V².
    pub(super) fn onto(&self, harmonics: &[usize]) -> Vec<f64> {
        let lines: Vec<usize> = self.lines.iter().map(|(h, _)| *h).collect();
        let found = images(&lines, harmonics, self.sampling);
        let power = |image: &Image| {
            let square = self
                .lines
                .iter()
                .find(|(h, _)| *h == image.of)
                .map_or(0.0, |(_, square)| *square);
            let octave = octave(image, self.sampling).min(self.octaves.len().saturating_sub(1));
            square * image.share().powi(2) * self.octaves.get(octave).copied().unwrap_or(0.0)
        };
        let on = |harmonic: &usize| {
            0.5 * found
                .iter()
                .filter(|image| image.onto == *harmonic)
                .map(power)
                .sum::<f64>()
        };
        harmonics.iter().map(on).collect()
    }
}

/// Octaves above the generator's rate.
fn octave(image: &Image, sampling: Sampling) -> usize {
    (image.at / sampling.steps).max(1).ilog2() as usize
}

/// Returns the mean power of a bin above the lines, V²: from the median of those between the
/// harmonics, which is ln 2 of the mean.
fn noise_power(rest: impl Fn(usize) -> f64, from: usize, sampling: Sampling) -> f64 {
    let between = (from..sampling.samples / 2).filter(|bin| !bin.is_multiple_of(sampling.periods));
    let mut powers: Vec<f64> = between.map(rest).collect();
    if powers.is_empty() {
        return 0.0;
    }
    let middle = powers.len() / 2;
    let (_, median, _) = powers.select_nth_unstable_by(middle, f64::total_cmp);
    *median / std::f64::consts::LN_2
}

/// Square of the factor in each octave; one that holds no place has that of the octave before.
fn factors(places: &[Place], noise: f64) -> Vec<f64> {
    let most = places
        .iter()
        .map(|place| place.octave + 1)
        .max()
        .unwrap_or(0);
    let mut sums = vec![(0.0, 0.0); most];
    for place in places {
        let sum: &mut (f64, f64) = &mut sums[place.octave];
        *sum = (sum.0 + place.power - noise, sum.1 + place.weight);
    }
    let mut before = 0.0;
    let factor = |(power, weight): (f64, f64)| {
        if weight > 0.0 {
            before = (power / weight).max(0.0);
        }
        before
    };
    sums.into_iter().map(factor).collect()
}

fn proof(places: &[Place], octaves: &[f64], noise: f64) -> Proof {
    let mut proof = Proof::default();
    for place in places {
        let expected = octaves[place.octave] * place.weight;
        if expected > CERTAIN * noise {
            proof.predicted += 1;
            proof.missing += usize::from(place.power < MISSING * expected);
        }
    }
    proof
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::multisine::{MultisineFit, analyse, analyse_played};
    use analysis_numeric::Rng;
    use rustfft::FftPlanner;
    use std::f64::consts::TAU;

    const LINES: [usize; 7] = [1, 3, 7, 9, 13, 15, 19];
    const PLAYED: Sampling = Sampling {
        steps: 256,
        periods: 5,
        samples: 5000,
    };
    const PLAYED_LINES: Excited<'_> = Excited {
        base_hz: 1.0,
        harmonics: &LINES,
    };
    const SHUNT_OHM: f64 = 0.01;
    const Z_OHM: f64 = 0.02;
    /// Factor of an image, V per A of its current.
    const FACTOR_OHM: f64 = 3.0;

    /// Four channels: lines of an ampere through a resistance, their images with volts of their own
    /// phase, and noise.
    fn record(seed: u64, noise_v: f64) -> [Vec<f64>; 4] {
        let mut rng = Rng::new(seed);
        let (mut current, mut jig) = (
            vec![Complex64::ZERO; PLAYED.samples],
            vec![Complex64::ZERO; PLAYED.samples],
        );
        for of in LINES {
            let own = Complex64::from_polar(1.0, TAU * rng.uniform());
            current[PLAYED.bin(of)] += own;
            jig[PLAYED.bin(of)] += own * Z_OHM;
            for order in 1..=2 * PLAYED.cycle() {
                for at in PLAYED.beside(of, order) {
                    let image = Complex64::from_polar(of as f64 / at as f64, TAU * rng.uniform());
                    current[PLAYED.bin(at)] += image;
                    jig[PLAYED.bin(at)] += image * FACTOR_OHM;
                }
            }
        }
        let back = FftPlanner::new().plan_fft_inverse(PLAYED.samples);
        [&mut current, &mut jig]
            .into_iter()
            .for_each(|bins| back.process(bins));
        let mut gauss = || noise_v * ((0..12).map(|_| rng.uniform()).sum::<f64>() - 6.0);
        let mut of = |offset_v: f64, bins: &[Complex64], factor: f64| -> Vec<f64> {
            bins.iter()
                .map(|value| offset_v + factor * value.re + gauss())
                .collect()
        };
        [
            of(0.2, &current, 0.0),
            of(0.2, &current, SHUNT_OHM),
            of(3.0, &jig, 0.0),
            of(3.0, &jig, 1.0),
        ]
    }

    fn played(seed: u64, steps: usize) -> MultisineFit {
        let volts = record(seed, 1.0e-3);
        analyse_played(
            volts.each_ref().map(Vec::as_slice),
            1.0e-3,
            PLAYED_LINES,
            steps,
        )
        .unwrap()
    }

    /// Returns the mean square of the errors over their variance.
    fn reduced(fits: impl Iterator<Item = MultisineFit>) -> f64 {
        let (mut squares, mut count) = (0.0, 0.0);
        for fit in fits {
            for phasors in &fit.excited {
                let point = crate::spectrum::raw_impedance(phasors, SHUNT_OHM);
                squares += (point.z_ohm - Z_OHM).norm_sqr()
                    / (point.covariance.re_re + point.covariance.im_im);
                count += 1.0;
            }
        }
        squares / count
    }

    #[test]
    fn what_images_put_onto_the_lines_is_in_the_variance() {
        let without = reduced((0..30).map(|seed| {
            let volts = record(seed, 1.0e-3);
            analyse(volts.each_ref().map(Vec::as_slice), 1.0e-3, PLAYED_LINES).unwrap()
        }));
        let with = reduced((0..30).map(|seed| played(seed, PLAYED.steps)));
        assert!(without > 2.0, "{without}");
        // 16 degrees of freedom of the noise.
        assert!((0.75..1.35).contains(&with), "{with}, without {without}");
    }

    #[test]
    fn the_record_proves_the_images_or_contradicts_them() {
        let proven = played(1, PLAYED.steps).proof.unwrap();
        assert!(
            proven.predicted > 100 && !proven.contradicts(),
            "{proven:?}"
        );
        // A generator whose steps differ from those of the plan.
        let contradicted = played(1, 264).proof.unwrap();
        assert!(
            contradicted.contradicts() && contradicted.strange_sigmas > 5.0,
            "{contradicted:?}"
        );
    }
}
