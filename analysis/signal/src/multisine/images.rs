//! Positions in a record at which the images of a generator's steps fall.
//!
//! A converter that holds each of N values of a period outputs, beside a line at harmonic h of
//! amplitude a, images at k·N ± h for k = 1, 2, 3 …, of amplitude a·h/(k·N ± h): the zero-order
//! hold has the zeros of sin x/x at k·N. A scope without a filter folds them: in S samples of P
//! periods harmonic q lies in bin q·P modulo S, counted from either end. Since both rates are
//! whole, the bins repeat after S/gcd(S, N·P) orders. Across an inductance an image has as many
//! volts as its line, less the attenuation of the supply's lag, so only their order makes them
//! small.

/// Lines that are excited.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Excited<'a> {
    /// Base frequency, Hz.
    pub base_hz: f64,
    /// Harmonics of it, rising.
    pub harmonics: &'a [usize],
}

/// Orders that are looked at: with 4096 steps an image of order 4096 has the share 4·10⁻⁶ of a line
/// at harmonic 59, less than a record's noise by a factor of ten.
const ORDERS: usize = 4096;

/// Numbers of steps, periods and samples with which a wave is output and recorded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Sampling {
    /// Steps of the generator in a period.
    pub steps: usize,
    /// Periods in the record.
    pub periods: usize,
    /// Samples in the record.
    pub samples: usize,
}

/// An image of a line that falls onto a harmonic.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Image {
    /// Harmonic of the line.
    pub of: usize,
    /// Harmonic that it falls onto.
    pub onto: usize,
    /// Multiple of the generator's rate that it lies beside.
    pub order: usize,
    /// Harmonic at which it truly lies.
    pub at: usize,
}

impl Image {
    /// Returns the amplitude in the generator's signal, over that of its line.
    pub fn share(&self) -> f64 {
        self.of as f64 / self.at as f64
    }
}

impl Sampling {
    /// Returns the number of orders after which images fall into the same bins again.
    pub fn cycle(&self) -> usize {
        self.samples / gcd(self.samples, self.steps * self.periods).max(1)
    }

    /// Bin of a harmonic, folded to the lower half.
    pub fn bin(&self, harmonic: usize) -> usize {
        let bin = harmonic * self.periods % self.samples;
        bin.min(self.samples - bin)
    }

    /// Returns the true harmonics of both images of a line at an order.
    pub fn beside(&self, line: usize, order: usize) -> [usize; 2] {
        [
            order * self.steps - line.min(order * self.steps),
            order * self.steps + line,
        ]
    }
}

/// All images of the lines that a record folds onto one of the harmonics, by rising order.
pub fn images(lines: &[usize], onto: &[usize], sampling: Sampling) -> Vec<Image> {
    let mut bins: Vec<(usize, usize)> = onto
        .iter()
        .map(|harmonic| (sampling.bin(*harmonic), *harmonic))
        .collect();
    bins.sort_unstable();
    // Two cycles: what comes behind them is a tenth of their power.
    let most = (2 * sampling.cycle()).clamp(1, ORDERS);
    let mut found = Vec::new();
    for order in 1..=most {
        for of in lines {
            for at in sampling.beside(*of, order).into_iter().filter(|at| *at > 0) {
                if let Ok(place) = bins.binary_search_by_key(&sampling.bin(at), |(bin, _)| *bin) {
                    found.push(Image {
                        of: *of,
                        onto: bins[place].1,
                        order,
                        at,
                    });
                }
            }
        }
    }
    found
}

fn gcd(a: usize, b: usize) -> usize {
    if b == 0 { a } else { gcd(b, a % b) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use num_complex::Complex64;
    use rustfft::FftPlanner;
    use std::f64::consts::TAU;

    /// Amplitudes of the bins of a stair that holds cosines of the lines, sampled at the record's
    /// instants: nothing is known of images here.
    fn synthesised(lines: &[usize], sampling: Sampling) -> Vec<f64> {
        let Sampling {
            steps,
            periods,
            samples,
        } = sampling;
        let held = |step: usize| {
            let turn = TAU * ((step % steps) as f64 + 0.5) / steps as f64;
            lines
                .iter()
                .map(|h| (*h as f64 * turn + 0.3 * *h as f64).cos())
                .sum::<f64>()
        };
        // An instant within a step that is never its edge.
        let step = |sample: usize| {
            ((sample as f64 + 0.37) * (periods * steps) as f64 / samples as f64).floor() as usize
        };
        let mut bins: Vec<Complex64> = (0..samples)
            .map(|sample| Complex64::from(held(step(sample))))
            .collect();
        FftPlanner::new()
            .plan_fft_forward(samples)
            .process(&mut bins);
        bins.iter()
            .map(|bin| 2.0 * bin.norm() / samples as f64)
            .collect()
    }

    #[test]
    fn each_image_lies_where_brute_force_has_it_with_its_amplitude() {
        // 32 steps and 1000 samples a period: images of orders up to 125 lie in bins of their own.
        let (lines, sampling) = (
            [3_usize, 5],
            Sampling {
                steps: 256,
                periods: 3,
                samples: 3 * 10_007,
            },
        );
        let met = synthesised(&lines, sampling);
        let line = met[sampling.bin(3)];
        for order in 1..=30 {
            for of in lines {
                for at in sampling.beside(of, order) {
                    let image = Image {
                        of,
                        onto: 0,
                        order,
                        at,
                    };
                    let ratio = met[sampling.bin(at)] / line / image.share();
                    // Images of thousands of further orders are spread over all bins.
                    assert!((ratio - 1.0).abs() < 0.1, "order {order} of {of}: {ratio}");
                }
            }
        }
        assert_eq!(sampling.cycle(), 10_007);
    }

    #[test]
    fn the_images_on_a_line_are_those_that_brute_force_finds_there() {
        // 4096 steps to 10 000 samples: sixteen times any number beside a line.
        let sampling = Sampling {
            steps: 4096,
            periods: 3,
            samples: 30_000,
        };
        let found = images(&[59, 39], &[5, 9, 11, 25, 17], sampling);
        let onto = |of: usize, onto: usize| {
            found
                .iter()
                .find(|image| image.of == of && image.onto == onto)
                .map(|image| image.order)
        };
        assert_eq!(
            [onto(59, 5), onto(59, 11), onto(39, 25), onto(39, 9)],
            [Some(166), Some(188), Some(166), Some(188)]
        );
        assert_eq!([onto(59, 17), onto(39, 11), onto(59, 25)], [None; 3]);
        let met = synthesised(&[59, 39], sampling);
        let line = met[sampling.bin(59)];
        for harmonic in [5, 9, 11, 25] {
            let all: Vec<f64> = found
                .iter()
                .filter(|image| image.onto == harmonic)
                .map(Image::share)
                .collect();
            let (most, level) = (all.iter().sum::<f64>(), met[sampling.bin(harmonic)] / line);
            assert!(
                level < 1.3 * most && level > 0.02 * most,
                "{harmonic}: {level:e} of at most {most:e}"
            );
        }
        assert!(
            met[sampling.bin(17)] / line < 1.0e-9,
            "{:e}",
            met[sampling.bin(17)]
        );
    }

    #[test]
    fn unequal_primes_of_the_rates_keep_images_apart() {
        let lines = [3, 5, 9, 11, 17, 25, 39, 59];
        // 125 divides both: no sum and no difference of two lines is a multiple of it.
        let sampling = Sampling {
            steps: 16_125,
            periods: 10,
            samples: 100_000,
        };
        assert!(
            images(&lines, &lines, sampling)
                .iter()
                .all(|image| image.of == image.onto && image.order % 80 == 0)
        );
    }
}
