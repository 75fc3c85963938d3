//! Time of the linear Kramers–Kronig test with automatic order at 20 and 57 points, and of a
//! distribution of relaxation times at 20.

use analysis::{
    drt::drt,
    numeric::{Covariance2, Rng},
    spectrum::{ImpedancePoint, Spectrum},
    validity::{Noise, kramers_kronig},
};
use num_complex::Complex64;
use std::f64::consts::TAU;
use std::hint::black_box;
use std::ops::RangeInclusive;
use std::time::Instant;

use crate::{Row, Unit};

const BATCHES: u32 = 15;

/// R, L, a ZARC, an RC and a Warburg element with 0.2 % noise that is stated or not.
fn spectrum(points: u32, band_hz: RangeInclusive<f64>, stated: bool, seed: u64) -> Spectrum {
    let (low, high) = band_hz.into_inner();
    let mut rng = Rng::new(seed);
    let point = |k: u32| {
        let freq_hz = low * (high / low).powf(f64::from(k) / f64::from(points - 1));
        let s = Complex64::new(0.0, TAU * freq_hz);
        let z = 7e-3
            + 1e-7 * s
            + 2e-3 / (1.0 + (s * 3e-3).powf(0.8))
            + 1e-3 / (1.0 + s * 0.3)
            + 1e-3 / s.sqrt();
        let sigma = 2e-3 * z.norm();
        let covariance = if stated {
            Covariance2::circular(sigma * sigma)
        } else {
            Covariance2::UNKNOWN
        };
        ImpedancePoint {
            freq_hz,
            z_ohm: z + Complex64::new(sigma * rng.normal(), sigma * rng.normal()),
            covariance,
            amplitude_a: 1.0,
        }
    };
    Spectrum {
        name: format!("seed {seed}"),
        points: (0..points).map(point).collect(),
        ..Spectrum::default()
    }
}

/// Returns seconds per spectrum, the least of several batches over the same twenty spectra.
fn time(spectra: &[Spectrum], rounds: u32, work: impl Fn(&Spectrum)) -> f64 {
    let batch = |_| {
        let start = Instant::now();
        (0..rounds).for_each(|_| spectra.iter().for_each(&work));
        start.elapsed().as_secs_f64() / (f64::from(rounds) * spectra.len() as f64)
    };
    (0..BATCHES).map(batch).fold(f64::INFINITY, f64::min)
}

/// Returns the figures.
pub(crate) fn rows() -> Vec<Row> {
    let many = |points, (low_hz, high_hz), stated| {
        (0..20)
            .map(|seed| spectrum(points, low_hz..=high_hz, stated, seed))
            .collect::<Vec<_>>()
    };
    let test = |s: &Spectrum| {
        if let Ok(noise) = Noise::of(s, &[]) {
            let _ = black_box(kramers_kronig(black_box(s), &noise));
        }
    };
    let distribution = |s: &Spectrum| {
        if let Ok(noise) = Noise::of(s, &[]) {
            let _ = black_box(drt(black_box(s), &noise));
        }
    };
    let (thesis, wide) = ((0.1, 300.0), (0.01, 1e5));
    let row = |work, what, seconds| Row::new(work, what, seconds, Unit::Seconds);
    vec![
        row(
            "lin-kk-20",
            "lin-KK, 20 points, noise stated",
            time(&many(20, thesis, true), 20, test),
        ),
        row(
            "lin-kk-20",
            "lin-KK, 20 points, noise estimated too",
            time(&many(20, thesis, false), 20, test),
        ),
        row(
            "lin-kk-57",
            "lin-KK, 57 points, noise stated",
            time(&many(57, wide, true), 5, test),
        ),
        row(
            "lin-kk-57",
            "lin-KK, 57 points, noise estimated too",
            time(&many(57, wide, false), 5, test),
        ),
        row(
            "",
            "distribution of relaxation times, 20 points",
            time(&many(20, thesis, true), 1, distribution),
        ),
    ]
}
