//! Errors that are equal in all runs of a campaign: the error of the current's gain after
//! calibration, the gain that calibration cannot detect because current and voltage share it, the
//! error of the meter for start voltages, the position of edges between a logger's rows, which may
//! be equal at all of them, the distortion of the voltage channel, and the common error of a
//! correction by control impedances. Repeats do
//! not show them, and more repeats do not reduce them.
//!
//! With v the effect of one standard deviation of such an error on the whitened rows of all runs,
//! their covariance is I + v·vᵀ. The operator I − c·u·uᵀ, u = v/|v|, c = 1 − 1/√(1 + |v|²), makes
//! it I again. For several errors one such operator follows the other, each with v after the
//! operators before it. This is equivalent to fitting every error once, for all runs together, with
//! its standard deviation as the prior.

use super::block::Kind;
use super::edges::{self, EdgeErrors};
use super::time_block::TimeBlock;
use super::whitening::dot;
use crate::thresholds::ASSUMED_DISTORTION_PART;
use analysis_effects::contract::{Base, Point};
use analysis_signal::calibration::{COMMON, CommonError};
use analysis_signal::history::BenchHistory;
use num_complex::Complex64;

/// Change of the rows of a block by one standard deviation of each shared error: of the
/// calibration, of the gain of both channels, of the start voltage, of all edges, of the distortion,
/// and of each independent error that the correction leaves.
pub(super) type Errors = [Vec<f64>; OWN + COMMON];

/// Errors of the channels and of the start.
pub(super) const CHANNELS: usize = 3;
/// Errors beside those of the correction.
const OWN: usize = DISTORTION + 4;
/// First of the distortions of the voltage channel: real and imaginary part of the second, then of the
/// third harmonic.
const DISTORTION: usize = CHANNELS + edges::COMMON;

/// Rows of a record, V.
#[derive(Debug, Clone, Copy)]
pub(super) struct RecordRows<'a> {
    pub(super) predicted_v: &'a [f64],
    /// Change of them by the current's gain, V per unit.
    pub(super) gain_v: &'a [f64],
    /// Errors of its edges.
    pub(super) edges: &'a [EdgeErrors],
}

/// Of a record with these rows that starts at this state of charge.
pub(super) fn of_record(
    time: &TimeBlock,
    soc: f64,
    base: &Base,
    rows: RecordRows<'_>,
    history: &BenchHistory,
) -> Errors {
    let (predicted, gain) = (rows.predicted_v, rows.gain_v);
    let capacity_coulomb = 3600.0 * base.ocv.capacity_ah;
    let slope_v = |charge_coulomb: f64| base.ocv.slope_v(soc - charge_coulomb / capacity_coulomb);
    let start_v = slope_v(0.0).max(1e-6);
    // The level is read by the same meter. The remaining error is that the curve's slope is read at
    // the wrong position.
    let started = time
        .bins
        .iter()
        .map(|b| history.start_voltage_v * (1.0 - slope_v(b.charge_coulomb) / start_v))
        .collect();
    // The voltage counts from rest: both channels too large by a part show that part more of every
    // change.
    let rest_v = base.ocv.voltage_v(soc);
    let both = predicted
        .iter()
        .zip(gain)
        .map(|(v, g)| history.channel_gain_rel * (v - rest_v - g))
        .collect();
    // Microseconds are nothing to a record.
    let mut errors: Errors = std::array::from_fn(|_| vec![0.0; predicted.len()]);
    for edge in rows.edges {
        for (sum, change_v) in errors[CHANNELS..].iter_mut().zip(&edge.common_v) {
            sum.iter_mut().zip(change_v).for_each(|(s, v)| *s += v);
        }
    }
    [errors[0], errors[1], errors[2]] = [
        gain.iter().map(|v| history.calibration_rel * v).collect(),
        both,
        started,
    ];
    errors
}

/// Returns the errors of a spectrum with these predicted rows. The calibration uses the control, so
/// its error cannot be seen there.
pub(super) fn of_spectrum(
    kind: &Kind,
    predicted: &[f64],
    history: &BenchHistory,
    calibration: Option<CommonError>,
) -> Errors {
    let Kind::Eis {
        points,
        harmonics,
        control_ohm,
        ..
    } = kind
    else {
        return Errors::default();
    };
    let is_cell = control_ohm.is_none();
    let gain = if is_cell {
        history.calibration_rel
    } else {
        0.0
    };
    let left = |error: usize| -> Vec<f64> {
        let of = |(point, z): (&Point, &[f64])| {
            let off = calibration.map_or(Complex64::ZERO, |left| {
                left.at(error, point.freq_hz, Complex64::new(z[0], z[1]), is_cell)
            });
            [off.re, off.im]
        };
        points
            .iter()
            .zip(predicted.chunks_exact(2))
            .flat_map(of)
            .chain(harmonics.iter().flat_map(|_| [0.0; 2]))
            .collect()
    };
    // The row of a harmonic goes with the current's amplitude to the power of its order.
    let gains = points
        .iter()
        .map(|_| 1.0)
        .chain(harmonics.iter().map(|h| f64::from(h.order)))
        .flat_map(|order| [order * gain; 2]);
    // The channel measures what lies below the cell, too.
    let distorted = |kind: usize| -> Vec<f64> {
        let rows = harmonics.iter().flat_map(|h| {
            let at = points.iter().position(|p| p.freq_hz == h.at.freq_hz);
            let z = at.map_or(Complex64::ZERO, |at| {
                Complex64::new(predicted[2 * at], predicted[2 * at + 1])
            });
            let shown_ohm = (z + h.at.common_mode.impedance(h.at.freq_hz)).norm();
            let own = usize::from(h.order == 3) == kind / 2;
            let part = |quadrature: usize| {
                let is_own = own && quadrature == kind % 2;
                if is_own {
                    ASSUMED_DISTORTION_PART * shown_ohm
                } else {
                    0.0
                }
            };
            [part(0), part(1)]
        });
        vec![0.0; 2 * points.len()]
            .into_iter()
            .chain(rows)
            .collect()
    };
    // An error common to two channels cancels in their ratio.
    std::array::from_fn(|k| match k {
        0 => predicted
            .iter()
            .zip(gains.clone())
            .map(|(z, gain)| gain * z)
            .collect(),
        DISTORTION..OWN => distorted(k - DISTORTION),
        1..DISTORTION => vec![0.0; predicted.len()],
        _ => left(k - OWN),
    })
}

/// The operator that takes shared errors out of whitened rows.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Shared {
    /// u and c of each error.
    directions: Vec<(Vec<f64>, f64)>,
}

impl Shared {
    /// From what one standard deviation of each error does to the whitened rows of all runs.
    pub(super) fn new(errors: impl IntoIterator<Item = Vec<f64>>) -> Self {
        let mut shared = Self::default();
        for mut v in errors {
            shared.apply(&mut v);
            let size = dot(&v, &v).sqrt();
            if size > 1e-9 {
                v.iter_mut().for_each(|x| *x /= size);
                shared.directions.push((v, 1.0 - 1.0 / size.hypot(1.0)));
            }
        }
        shared
    }

    /// Takes them out.
    pub(super) fn apply(&self, rows: &mut [f64]) {
        for (u, part) in &self.directions {
            let along = part * dot(u, rows);
            rows.iter_mut().zip(u).for_each(|(r, u)| *r -= along * u);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// For r ~ N(0, I + a·aᵀ + b·bᵀ) the operator A gives A·(I + a·aᵀ + b·bᵀ)·Aᵀ = I.
    #[test]
    fn what_is_left_is_white() {
        let a: Vec<f64> = (0..6).map(|k| 3.0 * f64::from(k)).collect();
        let b: Vec<f64> = (0..6).map(|k| 2.0 + 0.5 * f64::from(k * k)).collect();
        let shared = Shared::new([a.clone(), b.clone(), vec![0.0; 6]]);
        let applied = |v: &[f64]| {
            let mut v = v.to_vec();
            shared.apply(&mut v);
            v
        };
        let unit = |k: usize| {
            (0..6)
                .map(|i| f64::from(u8::from(i == k)))
                .collect::<Vec<f64>>()
        };
        let columns: Vec<Vec<f64>> = (0..6).map(|k| applied(&unit(k))).collect();
        let (a, b) = (applied(&a), applied(&b));
        for i in 0..6 {
            for j in 0..6 {
                let covariance =
                    columns.iter().map(|c| c[i] * c[j]).sum::<f64>() + a[i] * a[j] + b[i] * b[j];
                assert!(
                    (covariance - f64::from(u8::from(i == j))).abs() < 1e-12,
                    "{i} {j} {covariance}"
                );
            }
        }
    }
}
