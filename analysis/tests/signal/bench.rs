//! A bench made of closed formulas: potentials along the loop, and the channels' readings of them.
//! It does not use the code under test.

use std::f64::consts::TAU;

use analysis::spectrum::{ChannelPhasors, PhasorVariance};
use num_complex::Complex64;

use crate::noise::Noise;

/// Place of the voltage probes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Probes {
    OnShunt,
    OnJig,
}

/// Simulated bench in SI units; channels 2…4 are relative to channel 1.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Bench {
    pub(crate) gains: [f64; 3],
    pub(crate) skews_s: [f64; 3],
    pub(crate) mutual_shunt_h: f64,
    pub(crate) mutual_jig_h: f64,
    pub(crate) shunt: (f64, f64),
    pub(crate) noise_v: f64,
}

/// 9.96 mΩ with the nanohenries of its length.
pub(crate) const SHUNT: (f64, f64) = (9.96e-3, 12e-9);
/// The copper fake cell.
pub(crate) const FAKE_CELL: (f64, f64) = (3.7e-3, 20e-9);

/// A bar.
pub(crate) const SHORT: (f64, f64) = (20e-6, 6e-9);

impl Bench {
    pub(crate) fn ideal() -> Self {
        Self {
            gains: [1.0; 3],
            skews_s: [0.0; 3],
            mutual_shunt_h: 0.0,
            mutual_jig_h: 0.0,
            shunt: SHUNT,
            noise_v: 1e-9,
        }
    }

    /// Returns a bench as it might turn out, from the usual spread.
    pub(crate) fn any(noise: &mut Noise, noise_v: f64) -> Self {
        Self {
            gains: [0; 3].map(|_| 1.0 + 0.01 * noise.gauss()),
            skews_s: [0; 3].map(|_| 1e-6 * noise.gauss()),
            mutual_shunt_h: 1e-6 * noise.gauss(),
            mutual_jig_h: 1e-6 * noise.gauss(),
            shunt: SHUNT,
            noise_v,
        }
    }

    /// Voltages of the four channels for 1 A through the loop.
    pub(crate) fn measure(
        &self,
        freq_hz: f64,
        probes: Probes,
        in_jig: Complex64,
        noise: &mut Noise,
    ) -> ChannelPhasors {
        let jw = Complex64::new(0.0, TAU * freq_hz);
        let i = Complex64::from_polar(1.0, 2.0 * freq_hz.ln());
        let v1 = i * (0.017 + jw * 150e-9);
        let v2 = v1 + i * (self.shunt.0 + jw * self.shunt.1);
        let (v3, v4) = match probes {
            Probes::OnShunt => (v1, v2 + jw * self.mutual_shunt_h * i),
            Probes::OnJig => {
                let v3 = v2 + i * (0.012 + jw * 100e-9);
                (v3, v3 + i * (in_jig + jw * self.mutual_jig_h))
            }
        };
        let mut volts = [v1, v2, v3, v4];
        for (k, volt) in volts.iter_mut().enumerate() {
            if k > 0 {
                *volt *= self.gains[k - 1] * (-jw * self.skews_s[k - 1]).exp();
            }
            *volt += Complex64::new(noise.gauss(), noise.gauss()) * self.noise_v;
        }
        ChannelPhasors {
            freq_hz,
            volts,
            variance: [PhasorVariance::circular(self.noise_v * self.noise_v); 4],
        }
    }

    pub(crate) fn sweep(
        &self,
        probes: Probes,
        in_jig: fn(f64) -> Complex64,
        noise: &mut Noise,
    ) -> Vec<ChannelPhasors> {
        frequencies()
            .map(|freq_hz| self.measure(freq_hz, probes, in_jig(freq_hz), noise))
            .collect()
    }
}

/// Twenty of them, 0.1…300 Hz.
pub(crate) fn frequencies() -> impl Iterator<Item = f64> {
    (0..20).map(|k| 0.1 * 3000f64.powf(f64::from(k) / 19.0))
}

/// Returns a cell: 6.9 mΩ, two RC pairs and some inductance.
pub(crate) fn cell(freq_hz: f64) -> Complex64 {
    let jw = Complex64::new(0.0, TAU * freq_hz);
    let pair = |r: f64, c: f64| r / (1.0 + jw * r * c);
    6.9e-3 + pair(1.6e-3, 1.5) + pair(1.5e-3, 900.0) + jw * 40e-9
}

pub(crate) fn fake_cell(freq_hz: f64) -> Complex64 {
    Complex64::new(FAKE_CELL.0, TAU * freq_hz * FAKE_CELL.1)
}

pub(crate) fn short(freq_hz: f64) -> Complex64 {
    Complex64::new(SHORT.0, TAU * freq_hz * SHORT.1)
}
