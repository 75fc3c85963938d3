//! Distributions of circuits whose answer is known in closed form.

use super::*;
use crate::fit::Rng;
use crate::spectrum::{Covariance2, ImpedancePoint, Spectrum};
use crate::validity::Noise;
use std::f64::consts::{PI, TAU};

fn made(points: u32, (low, high): (f64, f64), sigma: f64, cell: impl Fn(f64) -> Complex64) -> Spectrum {
    let mut rng = Rng::new(3);
    let mut normal = || (-2.0 * (1.0 - rng.uniform()).ln()).sqrt() * (TAU * rng.uniform()).cos();
    let points = (0..points).map(|k| {
        let freq_hz = low * (high / low).powf(f64::from(k) / f64::from(points - 1));
        let z = cell(TAU * freq_hz);
        let s = sigma * z.norm();
        let z_ohm = z + Complex64::new(s * normal(), s * normal());
        ImpedancePoint { freq_hz, z_ohm, covariance: Covariance2::circular(s * s), amplitude_a: 1.0 }
    });
    Spectrum { name: "made".into(), points: points.collect() }
}

fn distribution(spectrum: &Spectrum) -> Drt {
    drt(spectrum, &Noise::of(spectrum, &[]).unwrap()).unwrap()
}

#[test]
fn explore() {
    for sigma in [5e-4, 2e-3, 5e-3] {
        let rc2 = |w: f64| 7e-3 + 2e-3 / Complex64::new(1.0, w * 3e-3) + 3e-3 / Complex64::new(1.0, w * 0.3);
        let zarc = |w: f64| 7e-3 + 3e-3 / (1.0 + Complex64::from_polar((w * 0.05).powf(0.75), 0.75 * PI / 2.0));
        let ends = |w: f64| rc2(w) + Complex64::new(0.0, w * 3e-7) + 1.5e-3 * Complex64::from_polar(w.powf(-0.5), -PI / 4.0);
        for (name, cell) in [("rc2", &rc2 as &dyn Fn(f64) -> Complex64), ("zarc", &zarc), ("ends", &ends)] {
            for (n, band) in [(20, (0.1, 300.0)), (50, (0.01, 5000.0))] {
                let d = distribution(&made(n, band, sigma, cell));
                println!(
                    "{name} {sigma} {n} {}: R {:?} L {:?} S {:?} A {:?} pol {:?} lambda {} freedom {} chi {}",
                    d.tau_s.last().unwrap() / d.band_tau_s.1,
                    d.r_inf_ohm,
                    d.inductance_h,
                    d.elastance_per_f,
                    d.warburg_ohm_per_sqrt_s,
                    d.polarisation_ohm,
                    d.lambda,
                    d.freedom,
                    d.reduced_chi2
                );
                for p in &d.peaks {
                    println!("    {:.4e} s {:.4e} ± {:.1e} w {:.3} {}", p.tau_s, p.r_ohm, p.sigma_ohm, p.width_decades, p.in_band);
                }
            }
        }
    }
}
