//! The second and third harmonic of a cell: what its voltage holds at a multiple of the frequency beyond
//! what a linear cell makes of the current there.
//!
//! Z_k = (V_k − Z(kω)·I_k)/I₁ᵏ, in Ω for k = 1, V/A² for k = 2, V/A³ for k = 3. All phasors are zero to
//! peak and count from the same instant, so that the power of I₁ turns the phase by the right amount:
//! Z_k does not depend on the start of the record. Even powers of the current, as of an asymmetric charge
//! transfer, make Z₂; odd ones make Z₃. (Kirk et al., *J. Electrochem. Soc.* 2021; Murbach and Schwartz,
//! *J. Electrochem. Soc.* 2017.)

use num_complex::Complex64;
use serde::{Deserialize, Serialize};

use crate::{
    calibration::Correction,
    spectrum::{ChannelPhasors, ImpedancePoint},
};
use analysis_numeric::Covariance2;

/// Possible error of the impedance between two points of a sweep, as a share of it: it is interpolated
/// over the logarithm of the frequency.
const BETWEEN: f64 = 0.02;

/// One harmonic of one record.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct HarmonicPoint {
    /// Frequency of the fundamental, Hz.
    pub freq_hz: f64,
    /// Its order; 1 is the impedance.
    pub order: u32,
    /// Z_k, V/Aᵏ.
    pub z: Complex64,
    /// Covariance of its parts.
    pub covariance: Covariance2,
    /// Amplitude of the current at the fundamental, A.
    pub amplitude_a: f64,
}

impl HarmonicPoint {
    /// Returns the impedance of a point as order 1.
    pub fn first(point: &ImpedancePoint) -> Self {
        Self {
            freq_hz: point.freq_hz,
            order: 1,
            z: point.z_ohm,
            covariance: point.covariance,
            amplitude_a: point.amplitude_a,
        }
    }

    /// Returns the harmonic of a record. `sweep` is the corrected spectrum of the same cell, by rising
    /// frequency; `None` if it ends below the harmonic, where the cell is not known.
    pub fn of(
        order: u32,
        fundamental: &ChannelPhasors,
        harmonic: &ChannelPhasors,
        sweep: &[ImpedancePoint],
        correction: &Correction,
    ) -> Option<Self> {
        let z_ohm = between(sweep, harmonic.freq_hz)?;
        let current = correction.current(fundamental);
        let own = correction.current(harmonic);
        let (rest_v, covariance) = correction.rest(harmonic, z_ohm);
        let power = current.powu(order);
        let z = rest_v / power;
        let linear = Covariance2::circular(0.5 * (BETWEEN * (z_ohm * own).norm()).powi(2));
        Some(Self {
            freq_hz: fundamental.freq_hz,
            order,
            z,
            covariance: (covariance + linear).scaled(power.inv()),
            amplitude_a: current.norm(),
        })
        .filter(|point| point.z.is_finite())
    }

    /// Returns the unit of Z_k.
    pub fn unit(&self) -> &'static str {
        match self.order {
            1 => "V/A",
            2 => "V/A2",
            3 => "V/A3",
            _ => "V/Ak",
        }
    }

    /// Returns the standard uncertainty of the magnitude.
    pub fn sigma(&self) -> f64 {
        (0.5 * (self.covariance.re_re + self.covariance.im_im)).sqrt()
    }
}

/// The impedance at a frequency within a sweep, interpolated.
fn between(sweep: &[ImpedancePoint], freq_hz: f64) -> Option<Complex64> {
    let after = sweep.partition_point(|point| point.freq_hz < freq_hz * (1.0 - 1e-9));
    let (end, before) = (
        sweep.get(after)?,
        after.checked_sub(1).and_then(|k| sweep.get(k)),
    );
    Some(before.map_or(end.z_ohm, |begin| {
        let share = (freq_hz / begin.freq_hz).ln() / (end.freq_hz / begin.freq_hz).ln();
        begin.z_ohm + (end.z_ohm - begin.z_ohm) * share
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        calibration::KnownImpedance,
        sine::{Channel, FitOptions, Record, ToneKind, fit_known_frequency},
        spectrum::PhasorVariance,
    };
    use analysis_numeric::Rng;
    use std::f64::consts::TAU;

    const SHUNT_OHM: f64 = 0.01;

    fn correction() -> Correction {
        Correction::none(KnownImpedance {
            r_ohm: SHUNT_OHM,
            r_sigma_ohm: 1e-7,
            l_h: 0.0,
            l_sigma_h: 1e-12,
        })
    }

    /// Returns fundamental, second and third of a cell u = R·i + a·i² + b·i³, whose current has 1 % of
    /// second harmonic itself, in a record that begins at any phase.
    fn record(phase: f64, noise_v: f64, seed: u64) -> [ChannelPhasors; 3] {
        let mut rng = Rng::new(seed);
        let mut channels = [const { Vec::new() }; 4];
        for k in 0..4000 {
            let turn = TAU * 2.5e-3 * f64::from(k) + phase;
            let i = 2.0 * turn.cos() + 0.02 * (2.0 * turn + 0.5).cos();
            let u = 0.010 * i + 1e-4 * i * i + 2e-5 * i * i * i;
            let shunt = SHUNT_OHM * i;
            for (channel, clean) in channels.iter_mut().zip([0.0, shunt, shunt, shunt + u]) {
                channel.push(clean + noise_v * rng.normal());
            }
        }
        let samples = channels.each_ref().map(|v| Channel::volts(v));
        let record = Record {
            channels: &samples,
            interval_s: 1e-3,
        };
        let options = FitOptions {
            harmonics: vec![2, 3],
            ..FitOptions::default()
        };
        let fit = fit_known_frequency(&record, 2.5, &options).unwrap();
        let fundamental = ChannelPhasors::from_fit(&fit).unwrap();
        let harmonic = |order: u32| {
            let tone = fit
                .tones
                .iter()
                .find(|tone| tone.kind == ToneKind::Harmonic(order))
                .unwrap();
            let of = |slot: usize| tone.channels[slot];
            ChannelPhasors {
                freq_hz: tone.freq_hz,
                volts: [0, 1, 2, 3].map(|slot| of(slot).phasor),
                variance: [0, 1, 2, 3].map(|slot| PhasorVariance {
                    noise: of(slot).variance,
                    ..PhasorVariance::circular(0.0)
                }),
            }
        };
        [fundamental, harmonic(2), harmonic(3)]
    }

    fn sweep() -> Vec<ImpedancePoint> {
        let point = |freq_hz| ImpedancePoint {
            freq_hz,
            // The third power also acts at the fundamental.
            z_ohm: Complex64::from(0.010),
            covariance: Covariance2::circular(1e-16),
            amplitude_a: 2.0,
        };
        [1.0, 2.5, 5.0, 10.0].map(point).to_vec()
    }

    #[test]
    fn the_powers_of_a_cell_are_found_whatever_the_start_of_the_record() {
        for phase in [0.0, 0.4, 2.0] {
            let [one, two, three] = record(phase, 0.0, 1);
            let second = HarmonicPoint::of(2, &one, &two, &sweep(), &correction()).unwrap();
            let third = HarmonicPoint::of(3, &one, &three, &sweep(), &correction()).unwrap();
            // cos² is ½ cos 2θ, cos³ is ¼ cos 3θ; the second harmonic of the current mixes with the
            // fundamental, so that they are off by about its share.
            assert!((second.z - 0.5e-4).norm() < 3e-6, "{phase}: {}", second.z);
            assert!(
                (third.z - 0.25 * 2e-5).norm() < 6e-7,
                "{phase}: {}",
                third.z
            );
            assert!((second.amplitude_a - 2.0).abs() < 1e-3);
            assert_eq!((second.unit(), third.unit()), ("V/A2", "V/A3"));
        }
    }

    #[test]
    fn the_interval_covers_a_linear_cell_and_no_harmonic_is_stated_beyond_the_sweep() {
        let mut inside = 0;
        let third = |seed: u64, noise_v: f64| {
            let [one, _, three] = record(0.3, noise_v, seed);
            HarmonicPoint::of(3, &one, &three, &sweep(), &correction()).unwrap()
        };
        let truth = third(0, 0.0).z;
        let [one, two, _] = record(0.3, 0.0, 0);
        let short = &sweep()[..2];
        assert_eq!(HarmonicPoint::of(2, &one, &two, short, &correction()), None);
        for seed in 0..200 {
            let found = third(seed, 1e-4);
            let off = found.z - truth;
            inside += usize::from(off.re.abs() < 1.96 * found.covariance.re_re.sqrt());
        }
        assert!(
            (182..=198).contains(&inside),
            "{inside} of 200 lie within 95 %"
        );
    }
}
