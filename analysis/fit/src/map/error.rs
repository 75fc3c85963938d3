//! Measures the error of a map's voltage, from logs that it has not seen.
//!
//! Without enough held-out logs, each fitted log is cut into pieces, and each piece is predicted by a map
//! whose resistances and corrections of the OCV are fitted to everything else: the equations lose its
//! rows and are solved again. Activation energies, the voltage of charge transfer and lag stay those of all data.

use super::log::Log;
use super::score::{LEAST_SOC, LogErrors, residuals};
use super::solution::Solution;
use super::solve::Normal;
use super::train::{CORRELATION_S, ERROR_V, SOC_ERROR, Train};
use crate::drt::nonnegative;
use analysis_model::{
    map::{BAND_SIGMAS, CellMap, ErrorSource, Place, RUN_PROBABILITY, VoltageError},
    ocv::OcvCurve,
};
use analysis_numeric::stats::chi_factor;
use analysis_signal::series::Role;
use nalgebra::{DMatrix, DVector};

/// Pieces of a log.
pub(super) const PIECES: usize = 6;
/// Time above SOC 0.1 that held-out logs must have to show the error, s: some correlation times.
const LEAST_HELD_OUT_S: f64 = 6.0 * CORRELATION_S;
/// Rounds in which the weights of the squares follow their expectation.
const ROUNDS: usize = 8;
/// Weight of the expectation that neighbouring temperatures have the same share, as a part of what the
/// data say of the share that they determine best.
const ALIKE: f64 = 0.1;
/// Least variance that is expected of a sample, V²: that of 3 mV. Rests would decide alone otherwise.
const LEAST_V2: f64 = 1e-5;

/// Least error at rest, V: that of an OCV curve. A few rests can happen to lie closer.
const LEAST_REST_V: f64 = 0.5e-3;

/// Chooses the data that show the error: held-out logs, if they are long enough above SOC 0.1.
pub(super) fn source(logs: &[Log]) -> ErrorSource {
    let held_out = logs.iter().filter(|log| log.role == Role::HeldOut);
    let counted = held_out.flat_map(|log| counted(log, 1).map(|(_, stands_s)| stands_s));
    if counted.sum::<f64>() >= LEAST_HELD_OUT_S {
        ErrorSource::HeldOut
    } else {
        ErrorSource::LeftOut
    }
}

/// Samples of a log above SOC 0.1, and the time that each stands for, s.
fn counted(log: &Log, every: usize) -> impl Iterator<Item = (usize, f64)> {
    let samples = &log.samples;
    (every..log.len()).step_by(every).filter_map(move |k| {
        let stands_s = (samples.time_s[k] - samples.time_s[k - every]).min(CORRELATION_S);
        (samples.soc[k] > LEAST_SOC && stands_s > 0.0).then_some((k, stands_s))
    })
}

/// Predicts each fitted log piece by piece, from everything else: measured less predicted voltage, V,
/// at each sample; not a number in a piece without which the equations have no solution.
pub(super) fn predict_left_out(all: &Solution, train: &Train) -> Vec<Vec<f64>> {
    let (design, kinetics) = (&all.design, &all.kinetics);
    let of_log = |log: &&Log| {
        let per_piece = log.rows().div_ceil(PIECES);
        let mut pieces = vec![Normal::new(design.count()); log.rows().div_ceil(per_piece)];
        let weight = |stands_s: f64, soc: f64| train.weight(stands_s, soc);
        let mut row = 0;
        design.add_log(log, train.lag_s, kinetics, weight, &mut |rows, y| {
            let mut from = 0;
            while from < rows.nrows() {
                let count = (per_piece - row % per_piece).min(rows.nrows() - from);
                let (part, right) = (rows.rows(from, count), y.rows(from, count));
                pieces[row / per_piece].add(&part.into_owned(), &right.into_owned());
                (from, row) = (from + count, row + count);
            }
        });
        let samples = per_piece * log.every();
        let mut errors_v = vec![f64::NAN; log.len()];
        for (own, part) in pieces.iter().zip(errors_v.chunks_mut(samples).enumerate()) {
            let mut others = all.equations.clone();
            others.remove(own);
            let Ok(without) = others.solve(design.resistances(), Some(&all.solved)) else {
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

/// Root of the mean squared error above SOC 0.1, V, each sample counted by the time that it stands for.
pub(super) fn rms_v(logs: &[&Log], errors_v: &[Vec<f64>]) -> f64 {
    let (mut square, mut all_s) = (0.0, 0.0);
    for (log, errors_v) in logs.iter().zip(errors_v) {
        for (k, stands_s) in counted(log, 1).filter(|(k, _)| errors_v[*k].is_finite()) {
            square += stands_s * errors_v[k].powi(2);
            all_s += stands_s;
        }
    }
    (square / f64::max(all_s, f64::MIN_POSITIVE)).sqrt()
}

/// Writes the error into the map, and how much of each log lies in the band that the others show.
pub(super) fn write(
    map: &mut CellMap,
    ocv: &OcvCurve,
    from: ErrorSource,
    logs: &[Log],
    errors: &mut [LogErrors],
) {
    let both = logs.iter().zip(&*errors);
    let unseen =
        both.map(|(log, errors)| Some(Squares::new(map, ocv, log, errors.unseen(from, log)?)));
    let unseen: Vec<Option<Squares>> = unseen.collect();
    for (own, log) in logs.iter().enumerate() {
        let Some(errors_v) = errors[own].unseen(from, log) else {
            continue;
        };
        let others = unseen.iter().enumerate().filter(|(other, _)| *other != own);
        let others: Vec<&Squares> = others.filter_map(|(_, squares)| squares.as_ref()).collect();
        map.voltage_error = measure(from, &others);
        let covered = covered(map, ocv, log, errors_v);
        errors[own].covered = covered;
    }
    let all: Vec<&Squares> = unseen.iter().flatten().collect();
    map.voltage_error = measure(from, &all);
    let farthest = logs.iter().zip(&*errors).filter_map(|(log, errors)| {
        let errors_v = errors.unseen(from, log)?;
        Some(farthest(map, ocv, log, &errors.lasting_v, errors_v))
    });
    let factor = whole_runs(farthest.flatten().collect());
    if let Some(error) = &mut map.voltage_error {
        error.whole_runs = factor;
    }
}

/// Largest error of each piece of a log above SOC 0.1, over the half width of the band for whole runs.
pub(super) fn farthest(
    map: &CellMap,
    ocv: &OcvCurve,
    log: &Log,
    lasting_v: &[f64],
    errors_v: &[f64],
) -> Vec<f64> {
    let samples = &log.samples;
    let sigmas = chi_factor(RUN_PROBABILITY, map.lasting_errors() as f64);
    let of_row = |k: usize| {
        let soc = samples.soc[k];
        let at = map.place(soc, samples.temperature_degc[k]);
        let sigma_v = map.sigma_v(&at, ocv.slope_v(soc), lasting_v[k])?;
        Some(errors_v[k].abs() / (sigmas * sigma_v))
    };
    let mut pieces = vec![None; PIECES];
    let per_piece = log.len().div_ceil(PIECES);
    for k in counted(log, 1)
        .map(|(k, _)| k)
        .filter(|k| errors_v[*k].is_finite())
    {
        let piece: &mut Option<f64> = &mut pieces[k / per_piece];
        *piece = of_row(k).into_iter().chain(*piece).reduce(f64::max);
    }
    pieces.into_iter().flatten().collect()
}

/// Factor that widens the band so that it holds 95 % of the pieces: the value of that rank, or the largest
/// of few, which hold less. The same pieces have set the standard deviation, so that it is rather too
/// small. It does not narrow the band.
pub(super) fn whole_runs(mut farthest: Vec<f64>) -> Option<f64> {
    farthest.retain(|far| far.is_finite() && *far > 0.0);
    farthest.sort_by(f64::total_cmp);
    let rank = (RUN_PROBABILITY * (farthest.len() + 1) as f64).ceil() as usize;
    let last = farthest.len().checked_sub(1)?;
    farthest
        .get(rank.saturating_sub(1).min(last))
        .map(|far| far.max(1.0))
}

/// Squares of the errors of a log, what they are fitted to, and the time that each stands for, s.
struct Squares {
    /// Rows of the square of the assumed error, and of the squared overpotential by temperature node.
    features: Vec<f64>,
    squares: Vec<f64>,
    stands_s: Vec<f64>,
}

impl Squares {
    fn new(map: &CellMap, ocv: &OcvCurve, log: &Log, errors_v: &[f64]) -> Self {
        let samples = &log.samples;
        let (mut features, mut squares, mut stands) = (Vec::new(), Vec::new(), Vec::new());
        for (k, stands_s) in counted(log, log.every()) {
            let (soc, error_v) = (samples.soc[k], errors_v[k]);
            if !error_v.is_finite() {
                continue;
            }
            let mut row = vec![0.0; 1 + map.temperature_degc.len()];
            row[0] = ERROR_V.powi(2) + (SOC_ERROR * ocv.slope_v(soc)).powi(2);
            let at = map.place(soc, samples.temperature_degc[k]);
            let overpotential_v = overpotential_v(map, &at, log, k, error_v);
            for (node, weight) in map.temperature_weights(&at) {
                row[1 + node] += weight * overpotential_v.powi(2);
            }
            features.extend(row);
            squares.push(error_v.powi(2));
            stands.push(stands_s);
        }
        Self {
            features,
            squares,
            stands_s: stands,
        }
    }
}

/// Measures the error on logs that a map has not seen; `None` if none lies above SOC 0.1.
fn measure(from: ErrorSource, logs: &[&Squares]) -> Option<VoltageError> {
    let joined = |of: fn(&Squares) -> &[f64]| -> Vec<f64> {
        let columns: Vec<&[f64]> = logs.iter().map(|log| of(log)).collect();
        columns.concat()
    };
    let (features, squares) = (joined(|log| &log.features), joined(|log| &log.squares));
    if squares.is_empty() {
        return None;
    }
    let terms = features.len() / squares.len();
    let rows = DMatrix::from_row_slice(squares.len(), terms, &features);
    let share = variances(
        &rows,
        &DVector::from_vec(squares),
        &DVector::from_vec(joined(|log| &log.stands_s)),
    )?;
    Some(VoltageError {
        rest_v: (ERROR_V * share[0].sqrt()).max(LEAST_REST_V),
        soc: SOC_ERROR * share[0].sqrt(),
        share: share.iter().skip(1).map(|s| s.sqrt()).collect(),
        from,
        whole_runs: None,
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

/// Expects neighbouring nodes to have the same share, so that a node with few samples, or with none, has
/// that of its neighbours.
fn couple(normal: &mut DMatrix<f64>) {
    let nodes = 1..normal.nrows();
    let most = nodes.fold(0.0, |most: f64, k| most.max(normal[(k, k)]));
    for (a, b) in (1..normal.nrows()).zip(2..normal.nrows()) {
        for (i, j, sign) in [(a, a, 1.0), (b, b, 1.0), (a, b, -1.0), (b, a, -1.0)] {
            normal[(i, j)] += sign * ALIKE * most;
        }
    }
}

/// Overpotential that a map predicts where it misses the voltage by an error, V.
fn overpotential_v(map: &CellMap, at: &Place, log: &Log, k: usize, error_v: f64) -> f64 {
    let samples = &log.samples;
    let rest_v = samples.ocv_v[k] + map.ocv_correction_v(at, samples.temperature_degc[k]);
    rest_v - (samples.voltage_v[k] - error_v)
}

/// Returns the share of the samples above SOC 0.1 that lie within the band of 95 %, each counted by the
/// time that it stands for; `None` without an error or without such samples.
pub(super) fn covered(map: &CellMap, ocv: &OcvCurve, log: &Log, errors_v: &[f64]) -> Option<f64> {
    let samples = &log.samples;
    let (mut inside_s, mut all_s) = (0.0, 0.0);
    for (k, stands_s) in counted(log, 1).filter(|(k, _)| errors_v[*k].is_finite()) {
        let soc = samples.soc[k];
        let at = map.place(soc, samples.temperature_degc[k]);
        let overpotential_v = overpotential_v(map, &at, log, k, errors_v[k]);
        let sigma_v = map.sigma_v(&at, ocv.slope_v(soc), overpotential_v)?;
        all_s += stands_s;
        if errors_v[k].abs() <= BAND_SIGMAS * sigma_v {
            inside_s += stands_s;
        }
    }
    (all_s > 0.0).then(|| inside_s / all_s)
}
