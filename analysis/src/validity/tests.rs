//! Spectra made here by closed formulas, with noise of a stated size, valid and spoilt.

use super::*;
use crate::fit::Rng;
use crate::spectrum::{Covariance2, ImpedancePoint};
use num_complex::Complex64;
use std::f64::consts::{PI, TAU};

/// What is wrong with a spectrum, as the frequency and the impedance at a point go in.
type Fault = fn(usize, f64, Complex64) -> Complex64;

struct Noisy(Rng);

impl Noisy {
    fn normal(&mut self) -> f64 {
        let u = 1.0 - self.0.uniform();
        (-2.0 * u.ln()).sqrt() * (TAU * self.0.uniform()).cos()
    }
    fn between(&mut self, lo: f64, hi: f64) -> f64 {
        lo + (hi - lo) * self.0.uniform()
    }
    fn log_between(&mut self, lo: f64, hi: f64) -> f64 {
        self.between(lo.ln(), hi.ln()).exp()
    }
}

fn thesis_grid() -> Vec<f64> {
    (0..20).map(|k| 0.1 * 3000f64.powf(f64::from(k) / 20.0)).collect()
}

/// (jω)^a.
fn power(omega: f64, a: f64) -> Complex64 {
    Complex64::from_polar(omega.powf(a), a * PI / 2.0)
}

/// R + jωL + two RC + ZARC + Warburg, with sizes drawn as cells have them.
fn any_cell(noise: &mut Noisy) -> impl Fn(f64) -> Complex64 + use<> {
    let r = 7e-3;
    let l = noise.between(0.0, 4e-7);
    let rc: Vec<(f64, f64)> = (0..2).map(|_| (r * noise.between(0.02, 0.4), noise.log_between(3e-4, 5.0))).collect();
    let zarc = (r * noise.between(0.05, 0.5), noise.log_between(1e-3, 1.0), noise.between(0.6, 1.0));
    let warburg = r * noise.between(0.0, 0.3);
    move |f: f64| {
        let w = TAU * f;
        let rcs: Complex64 = rc.iter().map(|(r, tau)| *r / Complex64::new(1.0, w * tau)).sum();
        let arc = zarc.0 / (1.0 + power(w * zarc.1, zarc.2));
        Complex64::new(r, w * l) + rcs + arc + warburg * power(w, -0.5)
    }
}

fn measured(grid: &[f64], cell: impl Fn(f64) -> Complex64, (sigma, stated): (f64, bool), noise: &mut Noisy, fault: Fault) -> Spectrum {
    let point = |(k, freq_hz): (usize, &f64)| {
        let z = fault(k, *freq_hz, cell(*freq_hz));
        let s = sigma * z.norm();
        let z_ohm = z + Complex64::new(s * noise.normal(), s * noise.normal());
        let covariance = if stated { Covariance2::circular(s * s) } else { Covariance2::UNKNOWN };
        ImpedancePoint { freq_hz: *freq_hz, z_ohm, covariance, amplitude_a: f64::NAN }
    };
    Spectrum { name: "made".into(), points: grid.iter().enumerate().map(point).collect() }
}

#[test]
fn explore() {
    for stated in [true, false] {
        for sigma in [1e-4, 5e-4, 2e-3, 1e-2] {
            let mut noise = Noisy(Rng::new(11));
            let (mut kk_bad, mut zh_bad, mut doubt, mut orders, mut mus, mut chi, mut zz) = (0, 0, 0, 0, 0, 0.0, 0.0);
            let total = 300;
            for _ in 0..total {
                let cell = any_cell(&mut noise);
                let s = measured(&thesis_grid(), cell, (sigma, stated), &mut noise, |_, _, z| z);
                let n = Noise::of(&s, &[]).unwrap();
                let kk = kramers_kronig(&s, &n).unwrap();
                let zh = z_hit(&s, &n, &kk);
                kk_bad += i32::from(kk.outcome != KkOutcome::Agrees);
                let pmin = zh.points.iter().map(|p| p.p).fold(1.0, f64::min);
                zh_bad += i32::from(pmin < 0.3 * 0.01 / 20.0);
                doubt += i32::from(kk.points.iter().any(|p| p.p < 0.4 * 0.05 / 20.0));
                orders += kk.order;
                mus += kk.mu_order.unwrap_or(99);
                chi += kk.chi2 / kk.dof;
                zz += zh.points[0].deviation_percent.powi(2) / zh.points[0].sigma_percent.powi(2);
            }
            println!(
                "stated {stated} sigma {sigma}: kk {kk_bad} zhit {zh_bad} doubt {doubt} order {} mu {} chi {} zrms {}",
                orders / total,
                mus / total,
                chi / total as f64,
                (zz / total as f64).sqrt()
            );
        }
    }
    let faults: [(&str, Fault); 5] = [
        ("drift", |k, _, z| z * (1.0 + 0.02 * (-(k as f64) * 0.4).exp())),
        ("drift R", |k, _, z| z + 0.02 * 7e-3 * (-(k as f64) * 0.4).exp()),
        ("sign", |_, _, z| z.conj()),
        ("spike", |k, _, z| if k == 6 { z * 1.02 } else { z }),
        ("clip", |_, _, z| z * (8e-3 / z.norm()).min(1.0)),
    ];
    for (name, fault) in faults {
        for sigma in [2e-4, 5e-4, 1e-3, 2e-3] {
            for stated in [true, false] {
                let mut noise = Noisy(Rng::new(12));
                let mut count = [0; 6];
                for _ in 0..200 {
                    let cell = any_cell(&mut noise);
                    let s = measured(&thesis_grid(), cell, (sigma, stated), &mut noise, fault);
                    let n = Noise::of(&s, &[]).unwrap();
                    let kk = kramers_kronig(&s, &n).unwrap();
                    let zh = z_hit(&s, &n, &kk);
                    count[kk.outcome as usize] += 1;
                    count[5] += i32::from(zh.points.iter().any(|p| p.p < 0.3 * 0.01 / 20.0));
                }
                println!("{name} {sigma} {stated}: agrees/single/part/sign/dis/zhit {count:?}");
            }
        }
    }
}
