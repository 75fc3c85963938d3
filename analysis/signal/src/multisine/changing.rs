//! Multisines of a system that changes over the record: the bins between the harmonics then hold more
//! than noise.
//!
//! A phasor that moves along a straight line over the record, Z₀ + Z₁·u with u = −1…1, puts Z₁·j/(πm)
//! into the m-th bin beside its harmonic: an odd skirt. A drift that is not a parabola, and the skirts of
//! other harmonics, are smooth there. So the bins on both sides of a harmonic are fitted by the skirt and
//! a parabola in the bin. What the parabola has on the harmonic itself is subtracted: the phasor is that
//! of the middle of the record. The residual is the noise. (Local polynomial method: Pintelon and
//! Schoukens, *System Identification*, 2nd ed. 2012, chapter 7; for a changing system: Hallemans et al.,
//! *Automatica*, 2022.)

use num_complex::Complex64;

use super::images::Excited;
use crate::spectrum::PhasorVariance;
use analysis_numeric::{Covariance2, linalg::invert, stats::FDistribution};

/// Amplitudes of all bins of a channel, V, and its drift, V.
pub(super) type Bins = (Vec<Complex64>, f64);

/// Terms beside a harmonic: the skirt of its change, and a parabola.
const TERMS: usize = 4;
/// Fewest periods: with fewer the bins beside a harmonic do not determine the terms and the noise.
const FEWEST_PERIODS: usize = 6;
/// Probability of such terms by chance below which the record shows a change, over all lines.
const CHANCE: f64 = 1e-6;

/// Change of a system over a record.
#[derive(Debug, Clone, PartialEq)]
pub struct Change {
    /// Change of the impedance at each excited line over the record, relative to it.
    pub relative: Vec<Complex64>,
}

/// The bins beside one harmonic, as the terms explain them.
struct Local {
    /// Rows of (skirt, 1, m, m²) by bin.
    rows: Vec<[f64; TERMS]>,
    /// The bin of the harmonic.
    centre: usize,
    /// The bins beside it.
    bins: Vec<usize>,
    /// Inverse of the normal matrix, row by row.
    inverse: Vec<f64>,
}

/// Terms of one channel at one harmonic.
struct Terms {
    /// Change over half the record, over j; then the parabola.
    values: [Complex64; TERMS],
    /// Mean square of the bins before, and what the terms leave, per degree of freedom.
    before: f64,
    after: f64,
}

/// The harmonics that are excited, and the periods of the record.
#[derive(Clone, Copy)]
struct Lines<'a> {
    harmonics: &'a [usize],
    periods: usize,
}

/// Returns the skirt of a unit change over half the record, over j, at a distance in bins.
fn skirt(offset: f64, count: usize) -> f64 {
    1.0 / ((std::f64::consts::PI * offset / count as f64).tan() * count as f64)
}

impl Local {
    /// The bins beside a harmonic, in a record of `periods` periods and `count` samples.
    fn new(harmonic: usize, periods: usize, count: usize) -> Option<Self> {
        let centre = harmonic * periods;
        // Below half a period lies what the drift leaves.
        let beside = |bin: &usize| *bin != centre && *bin > periods / 2 && *bin < count;
        let bins: Vec<usize> = (centre + 1 - periods..centre + periods)
            .filter(beside)
            .collect();
        let row = |bin: &usize| {
            let offset = *bin as f64 - centre as f64;
            let near = offset / periods as f64;
            [skirt(offset, count), 1.0, near, near * near]
        };
        let rows: Vec<[f64; TERMS]> = bins.iter().map(row).collect();
        let mut normal = vec![0.0; TERMS * TERMS];
        for row in &rows {
            for i in 0..TERMS {
                (0..TERMS).for_each(|j| normal[i * TERMS + j] += row[i] * row[j]);
            }
        }
        let inverse = invert(&normal, TERMS)?;
        (rows.len() > TERMS).then_some(Self {
            rows,
            centre,
            bins,
            inverse,
        })
    }

    fn freedom(&self) -> f64 {
        (self.rows.len() - TERMS) as f64
    }

    fn fit(&self, at: impl Fn(usize) -> Complex64) -> Terms {
        let bins: Vec<Complex64> = self.bins.iter().map(|bin| at(*bin)).collect();
        let mut right = [Complex64::ZERO; TERMS];
        for (row, bin) in self.rows.iter().zip(&bins) {
            right
                .iter_mut()
                .zip(row)
                .for_each(|(sum, term)| *sum += term * bin);
        }
        let value = |i: usize| -> Complex64 {
            (0..TERMS)
                .map(|j| self.inverse[i * TERMS + j] * right[j])
                .sum()
        };
        let values = [0, 1, 2, 3].map(value);
        let left = |(row, bin): (&[f64; TERMS], &Complex64)| {
            let explained: Complex64 = row
                .iter()
                .zip(&values)
                .map(|(term, value)| term * value)
                .sum();
            (bin - explained).norm_sqr()
        };
        let before: f64 = bins.iter().map(Complex64::norm_sqr).sum();
        let after: f64 = self.rows.iter().zip(&bins).map(left).sum();
        Terms {
            values,
            before: (before - after) / TERMS as f64,
            after: after / self.freedom(),
        }
    }

    /// Takes the terms off the bins, and what the parabola has on the harmonic off the harmonic; the
    /// skirt alone off the harmonics beside it that are not excited, where it would look like distortion.
    fn subtract(&self, terms: &Terms, bins: &mut [Complex64], lines: Lines<'_>) {
        for (row, bin) in self.rows.iter().zip(&self.bins) {
            let explained: Complex64 = row
                .iter()
                .zip(&terms.values)
                .map(|(term, value)| term * value)
                .sum();
            bins[*bin] -= explained;
        }
        bins[self.centre] -= terms.values[1];
        for apart in [-2.0, -1.0, 1.0, 2.0] {
            let offset = apart * lines.periods as f64;
            let bin = (self.centre as f64 + offset) as usize;
            let is_excited = lines.harmonics.contains(&(bin / lines.periods));
            if offset + self.centre as f64 > 0.0 && bin < bins.len() && !is_excited {
                bins[bin] -= terms.values[0] * skirt(offset, bins.len());
            }
        }
    }

    /// Returns the probability of such terms by chance.
    fn chance(&self, terms: &Terms) -> f64 {
        let ratio = FDistribution {
            above: 2.0 * TERMS as f64,
            below: 2.0 * self.freedom(),
        };
        ratio.tail(terms.before / terms.after)
    }
}

/// The change, and the variance of each channel's phasor at each excited line.
pub(super) type TakenOut = (Change, Vec<[PhasorVariance; 4]>);

/// Takes the change of the system out of the bins around the excited lines, if the bins show one. Returns
/// the change, and what the phasors of the lines are uncertain by; `None` if the record shows no change.
pub(super) fn take_out_change(
    bins: &mut [Bins],
    periods: usize,
    excited: Excited<'_>,
) -> Option<TakenOut> {
    if periods < FEWEST_PERIODS {
        return None;
    }
    let count = bins.first()?.0.len();
    let locals: Vec<Local> = excited
        .harmonics
        .iter()
        .map(|harmonic| Local::new(*harmonic, periods, count))
        .collect::<Option<_>>()?;
    // The voltage across the jig shows the change; the current is driven.
    let chance = |local: &Local| local.chance(&local.fit(|bin| bins[3].0[bin] - bins[2].0[bin]));
    let least = locals.iter().map(chance).fold(1.0, f64::min);
    if least * locals.len() as f64 >= CHANCE {
        return None;
    }
    let (mut relative, mut variances) = (Vec::new(), Vec::new());
    for local in &locals {
        let mut slopes = [Complex64::ZERO; 4];
        let mut variance = [PhasorVariance::circular(0.0); 4];
        for slot in 0..4 {
            let terms = local.fit(|bin| bins[slot].0[bin]);
            // The skirt is j times its cotangent; u covers two units over the record.
            slopes[slot] = terms.values[0] * Complex64::new(0.0, -1.0);
            let noise = 0.5 * terms.after * (1.0 + local.inverse[TERMS + 1]);
            variance[slot] = PhasorVariance {
                // A change that is not straight bends by its own size over the record.
                drift: Covariance2::along(slopes[slot] / 12.0),
                ..PhasorVariance::circular(noise)
            };
            let lines = Lines {
                harmonics: excited.harmonics,
                periods,
            };
            local.subtract(&terms, &mut bins[slot].0, lines);
        }
        let [c1, c2, c3, c4] = [0, 1, 2, 3].map(|slot: usize| bins[slot].0[local.centre]);
        let change = (slopes[3] - slopes[2]) / (c4 - c3) - (slopes[1] - slopes[0]) / (c2 - c1);
        relative.push(2.0 * change);
        variances.push(variance);
    }
    Some((Change { relative }, variances))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        multisine::{Design, MultisineFit, analyse, analyse_changing, design, odd_grid},
        spectrum::raw_impedance,
    };
    use analysis_numeric::Rng;
    use std::f64::consts::TAU;

    const SHUNT_OHM: f64 = 0.01;
    const BASE_HZ: f64 = 1.0;

    /// A record of twelve periods of a cell whose impedance changes.
    struct Case {
        /// Change over the record, as a share.
        change: f64,
        noise_v: f64,
        /// An exponential under the voltage, V, with a time constant of a third of the record.
        relaxes_v: f64,
    }

    fn grid() -> Vec<usize> {
        odd_grid(BASE_HZ, 1.0..=60.0, 8)
    }

    fn record(case: &Case, seed: u64) -> [Vec<f64>; 4] {
        let mut rng = Rng::new(seed);
        let harmonics = grid();
        let Design {
            phases_rad,
            amplitude,
            ..
        } = design(&harmonics, 0);
        let (count, per_period) = (12 * 1000, 1000.0);
        let mut channels = [const { Vec::new() }; 4];
        for k in 0..count {
            let (u, share) = (
                (2.0 * k as f64 + 1.0) / count as f64 - 1.0,
                k as f64 / count as f64,
            );
            let (mut current, mut voltage) = (0.0, 0.0);
            for (h, phase) in harmonics.iter().zip(&phases_rad) {
                let turn = TAU * *h as f64 * k as f64 / per_period + phase;
                let z = truth(*h) * (1.0 + 0.5 * case.change * u);
                current += amplitude * turn.cos();
                voltage += amplitude * (z.re * turn.cos() - z.im * turn.sin());
            }
            voltage += case.relaxes_v * (-3.0 * share).exp() + 0.01 * u;
            let clean = [
                0.0,
                SHUNT_OHM * current,
                SHUNT_OHM * current,
                SHUNT_OHM * current + voltage,
            ];
            for (channel, value) in channels.iter_mut().zip(clean) {
                channel.push(value + case.noise_v * rng.normal());
            }
        }
        channels
    }

    fn truth(harmonic: usize) -> Complex64 {
        let omega = TAU * harmonic as f64 * BASE_HZ;
        Complex64::from(0.005) + 0.004 / Complex64::new(1.0, 0.05 * omega)
    }

    fn analysed(case: &Case, seed: u64) -> (MultisineFit, Option<Change>) {
        let (channels, harmonics) = (record(case, seed), grid());
        let excited = Excited {
            base_hz: BASE_HZ,
            harmonics: &harmonics,
        };
        analyse_changing(channels.each_ref().map(Vec::as_slice), 1e-3, excited, None).unwrap()
    }

    #[test]
    fn the_middle_of_a_changing_relaxing_record_is_found_where_the_plain_analysis_is_noisy() {
        let case = Case {
            change: 0.1,
            noise_v: 1e-9,
            relaxes_v: 0.02,
        };
        let (fit, change) = analysed(&case, 1);
        let change = change.unwrap();
        for ((phasors, change), harmonic) in fit.excited.iter().zip(&change.relative).zip(grid()) {
            let off = (raw_impedance(phasors, SHUNT_OHM).z_ohm / truth(harmonic) - 1.0).norm();
            assert!(off < 2e-3, "{harmonic}: off by {off}");
            assert!((change - 0.1).norm() < 0.02, "{harmonic}: {change}");
        }
        let (channels, harmonics) = (record(&case, 1), grid());
        let excited = Excited {
            base_hz: BASE_HZ,
            harmonics: &harmonics,
        };
        let plain = analyse(channels.each_ref().map(Vec::as_slice), 1e-3, excited).unwrap();
        let noise = |fit: &MultisineFit| fit.excited[0].variance[3].noise.re_re.sqrt();
        assert!(
            noise(&fit) < 0.2 * noise(&plain),
            "{} V against {} V",
            noise(&fit),
            noise(&plain)
        );
    }

    #[test]
    fn the_interval_covers_the_impedance_of_the_middle() {
        let case = Case {
            change: 0.02,
            noise_v: 2e-5,
            relaxes_v: 0.002,
        };
        let (mut inside, mut all, mut seen) = (0, 0, 0);
        for seed in 0..60 {
            let (fit, change) = analysed(&case, seed);
            seen += usize::from(change.is_some());
            for (phasors, harmonic) in fit.excited.iter().zip(grid()) {
                let point = raw_impedance(phasors, SHUNT_OHM);
                let off = point.z_ohm - truth(harmonic);
                inside += usize::from(off.re.abs() < 1.96 * point.covariance.re_re.sqrt());
                inside += usize::from(off.im.abs() < 1.96 * point.covariance.im_im.sqrt());
                all += 2;
            }
        }
        assert!(seen >= 55, "the change is seen in {seen} of 60");
        let share = inside as f64 / f64::from(all);
        assert!((0.93..=0.985).contains(&share), "{share} lie within 95 %");
    }

    #[test]
    fn a_record_that_does_not_change_keeps_the_plain_analysis() {
        let case = Case {
            change: 0.0,
            noise_v: 2e-5,
            relaxes_v: 0.0,
        };
        for seed in 0..40 {
            let (fit, change) = analysed(&case, seed);
            assert_eq!(change, None, "seed {seed}");
            if seed == 0 {
                let (channels, harmonics) = (record(&case, seed), grid());
                let excited = Excited {
                    base_hz: BASE_HZ,
                    harmonics: &harmonics,
                };
                let plain = analyse(channels.each_ref().map(Vec::as_slice), 1e-3, excited).unwrap();
                assert_eq!(fit, plain);
            }
        }
    }
}
