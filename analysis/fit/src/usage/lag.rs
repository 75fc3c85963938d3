//! Lag of the current channel behind the voltages.
//!
//! A sum of RC branches with positive resistances, a resistance and a capacitance cannot turn its
//! phase as a lag does. The lag is the one with which such a sum fits the impedance best; its
//! uncertainty follows from the rise of χ². A low-pass has a wide uncertainty, because a fast branch
//! undoes a part of it; a series inductance looks like one.

use std::f64::consts::TAU;

use analysis_numeric::Covariance2;
use analysis_signal::spectrum::{ImpedancePoint, Spectrum};
use nalgebra::{DMatrix, DVector};
use num_complex::Complex64;
use serde::Serialize;

use crate::drt::nonnegative;

/// Time constants of the branches per decade.
const PER_DECADE: f64 = 4.0;
/// Fewest points that show a lag.
const FEWEST: usize = 6;
/// Lags that are tried: intervals of the record, and s, of which the greater counts; as many in steps.
const MOST_INTERVALS: f64 = 5.0;
const MOST_S: f64 = 0.05;
const TRIED: i32 = 100;
/// Standard uncertainties by which the impedances contradict that there is no lag.
const CERTAIN: f64 = 4.0;

/// How a channel lags.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum LagKind {
    /// A delay of all frequencies by the same time.
    Delay,
    /// A low-pass of first order.
    LowPass,
}

/// Lag of the current channel.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Lag {
    /// Its kind.
    pub kind: LagKind,
    /// Delay or time constant, s; negative if the voltages lag.
    pub lag_s: f64,
    /// Standard uncertainty, s.
    pub sigma_s: f64,
}

impl Lag {
    /// Returns what the channel makes of an impedance at this frequency.
    fn factor(kind: LagKind, lag_s: f64, freq_hz: f64) -> Complex64 {
        let turn = TAU * freq_hz * lag_s;
        match kind {
            LagKind::Delay => Complex64::cis(turn),
            LagKind::LowPass => Complex64::new(1.0, turn),
        }
    }

    /// Takes the lag out of a spectrum; its uncertainty joins that of the points.
    pub(super) fn remove(&self, spectrum: &mut Spectrum) {
        for point in &mut spectrum.points {
            let by = Self::factor(self.kind, self.lag_s, point.freq_hz).inv();
            point.z_ohm *= by;
            // What a change of the lag by its uncertainty does, Ω.
            let turn = Complex64::new(0.0, TAU * point.freq_hz * self.sigma_s);
            let moved = match self.kind {
                LagKind::Delay => turn * point.z_ohm,
                LagKind::LowPass => turn * point.z_ohm * by,
            };
            let own = Covariance2 {
                re_re: moved.re * moved.re,
                re_im: moved.re * moved.im,
                im_im: moved.im * moved.im,
            };
            point.covariance = point.covariance.scaled(by) + own;
        }
    }
}

/// Returns the lag with which the spectra of all cells fit best; `None` if they have too few
/// frequencies.
pub(super) fn fit_lag(spectra: &[&Spectrum], interval_s: f64) -> Option<LagFit> {
    let mean = mean_points(spectra)?;
    let train = Train::new(&mean);
    let most_s = MOST_S.max(MOST_INTERVALS * interval_s);
    let candidates = [(LagKind::Delay, -TRIED), (LagKind::LowPass, 0)];
    let found = candidates.into_iter().filter_map(|(kind, from)| {
        let lags: Vec<f64> = (from..=TRIED)
            .map(|k| most_s * f64::from(k) / f64::from(TRIED))
            .collect();
        best_lag(&train, kind, &lags)
    });
    found.min_by(|a, b| a.chi2.total_cmp(&b.chi2))
}

/// The lags of a kind whose χ² is near the least.
pub(super) struct LagFit {
    pub(super) lag: Lag,
    /// The least χ².
    chi2: f64,
    /// χ² without a lag.
    chi2_without: f64,
    /// Factor by which the sum misses more than the uncertainties, as variance; 1 or more.
    excess: f64,
}

impl LagFit {
    /// Returns whether the impedances contradict that there is no lag.
    pub(super) fn is_certain(&self) -> bool {
        self.chi2_without > self.chi2 + CERTAIN * CERTAIN * self.excess
    }
}

/// Returns the middle of the lags whose χ² is near the least.
fn best_lag(train: &Train<'_>, kind: LagKind, lags: &[f64]) -> Option<LagFit> {
    let all: Vec<f64> = lags
        .iter()
        .map(|lag_s| train.chi2(kind, *lag_s).unwrap_or(f64::INFINITY))
        .collect();
    let least = (0..all.len()).min_by(|a, b| all[*a].total_cmp(&all[*b]))?;
    let chi2 = all[least];
    // At the end of the lags that are tried it is not known.
    if !chi2.is_finite() || least + 1 == all.len() || (least == 0 && lags[0] < 0.0) {
        return None;
    }
    // A sum that misses by more than the uncertainties makes the lag as much less certain.
    let excess = (chi2 / train.dof()).max(1.0);
    let limit = chi2 + excess;
    let step_s = lags[1] - lags[0];
    // The distance, in steps, at which χ² reaches the limit on one side.
    let reach = |side: &[f64]| {
        let mut before = chi2;
        for (k, chi2) in side.iter().enumerate() {
            if *chi2 > limit {
                let part = (limit - before) / (chi2 - before);
                return k as f64 + if chi2.is_finite() { part } else { 0.5 };
            }
            before = *chi2;
        }
        side.len() as f64
    };
    let left: Vec<f64> = all[..least].iter().rev().copied().collect();
    let (left, right) = (reach(&left), reach(&all[least + 1..]));
    let lag = Lag {
        kind,
        lag_s: lags[least] + 0.5 * (right - left) * step_s,
        sigma_s: 0.5 * (left + right) * step_s,
    };
    Some(LagFit {
        lag,
        chi2,
        chi2_without: train.chi2(kind, 0.0)?,
        excess,
    })
}

/// Mean of the spectra at the frequencies that all have; the uncertainty is that of one.
fn mean_points(spectra: &[&Spectrum]) -> Option<Vec<ImpedancePoint>> {
    let first = spectra.first()?;
    let of = |point: &ImpedancePoint| {
        let each = spectra.iter().map(|one| {
            let points = one.points.iter();
            let mut same = points.filter(|p| (p.freq_hz / point.freq_hz - 1.0).abs() < 1e-6);
            same.next().map(|p| p.z_ohm)
        });
        let sum: Option<Complex64> = each.sum();
        Some(ImpedancePoint {
            z_ohm: sum? / spectra.len() as f64,
            ..*point
        })
    };
    let points: Vec<ImpedancePoint> = first.points.iter().filter_map(of).collect();
    (points.len() >= FEWEST).then_some(points)
}

/// The branches that are fitted to points.
struct Train<'a> {
    points: &'a [ImpedancePoint],
    tau_s: Vec<f64>,
}

impl<'a> Train<'a> {
    fn new(points: &'a [ImpedancePoint]) -> Self {
        let freqs = || points.iter().map(|point| TAU * point.freq_hz);
        let (low, high) = (
            freqs().fold(f64::INFINITY, f64::min),
            freqs().fold(0.0, f64::max),
        );
        // From a third of the shortest to three times the longest.
        let decades = (9.0 * high / low).log10();
        let count = (decades * PER_DECADE).ceil() as usize;
        let tau = |k: usize| 10f64.powf(decades * k as f64 / count as f64) / (3.0 * high);
        Self {
            points,
            tau_s: (0..=count).map(tau).collect(),
        }
    }

    fn dof(&self) -> f64 {
        (2.0 * self.points.len() as f64 - 4.0).max(1.0)
    }

    /// χ² of the best sum behind a lag.
    fn chi2(&self, kind: LagKind, lag_s: f64) -> Option<f64> {
        let columns = self.tau_s.len() + 2;
        let rows = 2 * self.points.len();
        let mut matrix = DMatrix::<f64>::zeros(rows, columns);
        let mut right = DVector::<f64>::zeros(rows);
        for (k, point) in self.points.iter().enumerate() {
            let omega = TAU * point.freq_hz;
            let factor = Lag::factor(kind, lag_s, point.freq_hz);
            let weight = point.magnitude_sigma_ohm().recip();
            let mut put = |column: usize, z: Complex64| {
                let z = weight * factor * z;
                matrix[(2 * k, column)] = z.re;
                matrix[(2 * k + 1, column)] = z.im;
            };
            put(0, Complex64::ONE);
            put(1, Complex64::new(0.0, -omega.recip()));
            for (column, tau_s) in self.tau_s.iter().enumerate() {
                put(column + 2, Complex64::new(1.0, omega * tau_s).inv());
            }
            right[2 * k] = weight * point.z_ohm.re;
            right[2 * k + 1] = weight * point.z_ohm.im;
        }
        let scale = DVector::from_fn(columns, |c, _| matrix.column(c).norm().recip());
        let scaled = &matrix * DMatrix::from_diagonal(&scale);
        // A ridge far below the uncertainties keeps equal columns apart.
        let normal =
            scaled.transpose() * &scaled + 1e-7 * DMatrix::<f64>::identity(columns, columns);
        let solution = nonnegative::solve(&normal, &(scaled.transpose() * &right), &[])?;
        Some((scaled * solution.x - right).norm_squared())
    }
}
