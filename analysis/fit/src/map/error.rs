//! Measures the error of a map's voltage, from logs that it has not seen.
//!
//! Without held-out logs, each fitted log is cut into pieces, and each piece is predicted by a map that
//! is fitted to everything else: the equations lose its rows and are solved again.

use super::design::Design;
use super::log::Log;
use super::rows::CHUNK;
use super::score::{LEAST_SOC, LogErrors, residuals};
use super::solve::{Kinetics, Normal, Solved};
use super::train::{CORRELATION_S, ERROR_V, SOC_ERROR, Train};
use crate::drt::nonnegative;
use analysis_model::{
    map::{BAND_SIGMAS, CellMap, ErrorSource, VoltageError},
    ocv::OcvCurve,
};
use analysis_signal::series::Role;
use nalgebra::{DMatrix, DVector};

/// Pieces of a log at most.
pub(super) const PIECES: usize = 6;
/// Rounds in which the weights of the squares follow their expectation.
const ROUNDS: usize = 8;
/// Weight of the expectation that neighbouring temperatures have the same share.
const ALIKE: f64 = 0.1;
/// Least variance that is expected of a sample, V²: that of 3 mV. Rests would decide alone otherwise.
const LEAST_V2: f64 = 1e-5;

/// Predicts each fitted log piece by piece, from everything else: measured less predicted voltage, V,
/// at each sample; not a number in a piece without which the equations have no solution.
pub(super) fn predict_left_out(
    design: &Design,
    train: &Train,
    kinetics: Kinetics,
    all: &Normal,
    solved: &Solved,
) -> Vec<Vec<f64>> {
    let of_log = |log: &&Log| {
        let chunks = log.rows().div_ceil(CHUNK);
        let per_piece = chunks.div_ceil(PIECES);
        let mut pieces = vec![Normal::new(design.count()); chunks.div_ceil(per_piece)];
        let weight = |stands_s: f64, soc: f64| train.weight(stands_s, soc);
        let mut chunk = 0;
        design.add_log(log, train.lag_s, kinetics, weight, &mut |rows, y| {
            pieces[chunk / per_piece].add(rows, y);
            chunk += 1;
        });
        let samples = per_piece * CHUNK * log.every();
        let mut errors_v = vec![f64::NAN; log.len()];
        for (own, part) in pieces.iter().zip(errors_v.chunks_mut(samples).enumerate()) {
            let mut others = all.clone();
            others.remove(own);
            let Ok(without) = others.solve(design.resistances(), Some(solved)) else {
                continue;
            };
            let of_whole = residuals(&design.map(kinetics, &without), log, train.lag_s);
            let from = part.0 * samples;
            part.1.copy_from_slice(&of_whole[from..from + part.1.len()]);
        }
        errors_v
    };
    train.logs.iter().map(of_log).collect()
}

/// Measures the error on held-out logs, or without any on the left-out pieces of the fitted ones; `None`
/// if no log lies above SOC 0.1.
pub(super) fn measure(
    map: &CellMap,
    ocv: &OcvCurve,
    logs: &[Log],
    errors: &[LogErrors],
) -> Option<VoltageError> {
    let from = if logs.iter().any(|log| log.role == Role::HeldOut) {
        ErrorSource::HeldOut
    } else {
        ErrorSource::LeftOut
    };
    let nodes = map.temperature_degc.len();
    let terms = 1 + nodes;
    let (mut features, mut squares, mut stands) = (Vec::new(), Vec::new(), Vec::new());
    for (log, errors) in logs.iter().zip(errors) {
        let errors_v = match (from, &errors.left_out) {
            (ErrorSource::HeldOut, _) if log.role == Role::HeldOut => &errors.of_map,
            (ErrorSource::LeftOut, Some(errors_v)) => errors_v,
            _ => continue,
        };
        let samples = &log.samples;
        let mut last_s = samples.time_s[0];
        for k in (0..log.len()).step_by(log.every()) {
            let (soc, error_v) = (samples.soc[k], errors_v[k]);
            let stands_s = (samples.time_s[k] - last_s).min(CORRELATION_S);
            last_s = samples.time_s[k];
            if soc <= LEAST_SOC || !error_v.is_finite() || stands_s <= 0.0 {
                continue;
            }
            let mut row = vec![0.0; terms];
            row[0] = ERROR_V.powi(2) + (SOC_ERROR * ocv.slope_v(soc)).powi(2);
            let at = map.place(soc, samples.temperature_degc[k]);
            let overpotential_v = overpotential_v(map, log, k, error_v);
            for (node, weight) in map.temperature_weights(&at) {
                row[1 + node] += weight * overpotential_v.powi(2);
            }
            features.extend(row);
            squares.push(error_v.powi(2));
            stands.push(stands_s);
        }
    }
    if squares.is_empty() {
        return None;
    }
    let rows = DMatrix::from_row_slice(squares.len(), terms, &features);
    let share = variances(
        &rows,
        &DVector::from_vec(squares),
        &DVector::from_vec(stands),
    )?;
    Some(VoltageError {
        rest_v: ERROR_V * share[0].sqrt(),
        soc: SOC_ERROR * share[0].sqrt(),
        share: share.iter().skip(1).map(|s| s.sqrt()).collect(),
        from,
    })
}

/// Fits squares as sums of features with factors of zero or more. A square scatters by its own
/// expectation, so that each round weights by that of the round before.
pub(super) fn variances(
    rows: &DMatrix<f64>,
    squares: &DVector<f64>,
    stands: &DVector<f64>,
) -> Option<DVector<f64>> {
    let n = rows.ncols();
    let mut expected = DVector::from_element(squares.len(), squares.mean().max(LEAST_V2));
    let mut found = None;
    for _ in 0..ROUNDS {
        let weights = stands.zip_map(&expected, |stands, v| stands.sqrt() / v);
        let mut weighted = rows.clone();
        for mut column in weighted.column_iter_mut() {
            column.component_mul_assign(&weights);
        }
        let right = weighted.transpose() * squares.component_mul(&weights);
        let mut normal = weighted.transpose() * &weighted;
        couple(&mut normal);
        let unit = DVector::from_fn(n, |k, _| normal[(k, k)].max(1e-300).sqrt().recip());
        let scaled = DMatrix::from_fn(n, n, |i, j| {
            let ridge = if i == j { 1e-12 } else { 0.0 };
            normal[(i, j)] * unit[i] * unit[j] + ridge
        });
        let all: Vec<usize> = (0..n).collect();
        let solution = nonnegative::solve(&scaled, &right.component_mul(&unit), &all)?;
        let x = solution.x.component_mul(&unit).map(|x| x.max(0.0));
        expected = (rows * &x).map(|v| v.max(LEAST_V2));
        found = Some(x);
    }
    found
}

/// Expects neighbouring nodes to have the same share, a tenth as firmly as the data of the less known of
/// both say theirs, or as those of the better known if the other has none.
fn couple(normal: &mut DMatrix<f64>) {
    let diagonal = normal.diagonal();
    for (a, b) in (1..diagonal.len()).zip(2..diagonal.len()) {
        let (less, more) = (diagonal[a].min(diagonal[b]), diagonal[a].max(diagonal[b]));
        let factor = ALIKE * if less > 0.0 { less } else { more };
        for (i, j, sign) in [(a, a, 1.0), (b, b, 1.0), (a, b, -1.0), (b, a, -1.0)] {
            normal[(i, j)] += sign * factor;
        }
    }
}

/// Overpotential that a map predicts where it misses the voltage by an error, V.
pub(super) fn overpotential_v(map: &CellMap, log: &Log, k: usize, error_v: f64) -> f64 {
    let samples = &log.samples;
    let degc = samples.temperature_degc[k];
    let at = map.place(samples.soc[k], degc);
    let rest_v = samples.ocv_v[k] + map.ocv_correction_v(&at, degc);
    rest_v - (samples.voltage_v[k] - error_v)
}

/// Returns the share of the samples above SOC 0.1 that lie within the band of 95 %, each counted by the
/// time that it stands for; `None` without an error or without such samples.
pub(super) fn covered(map: &CellMap, ocv: &OcvCurve, log: &Log, errors_v: &[f64]) -> Option<f64> {
    let samples = &log.samples;
    let (mut inside_s, mut all_s) = (0.0, 0.0);
    for k in 1..log.len() {
        let soc = samples.soc[k];
        if soc <= LEAST_SOC {
            continue;
        }
        let at = map.place(soc, samples.temperature_degc[k]);
        let overpotential_v = overpotential_v(map, log, k, errors_v[k]);
        let sigma_v = map.sigma_v(&at, ocv.slope_v(soc), overpotential_v)?;
        let stands_s = (samples.time_s[k] - samples.time_s[k - 1]).min(CORRELATION_S);
        all_s += stands_s;
        if errors_v[k].abs() <= BAND_SIGMAS * sigma_v {
            inside_s += stands_s;
        }
    }
    (all_s > 0.0).then(|| inside_s / all_s)
}
