//! Tests whether the residual oscillates: hum that the sampling has folded to a slow wave, or a
//! thermostat that switches. Such a wave is the same in all records except for its phase, and small
//! in each of them. No block of residuals and no χ² of a thousand rows shows it.
//!
//! Per record and frequency a sine and a cosine, averaged over the samples of each row and
//! whitened, take up χ² of two degrees of freedom if nothing oscillates (the periodogram of
//! unevenly sampled data, Lomb 1976, Scargle 1982). The test uses the sum over all records, at as
//! many frequencies as the longest record can resolve, and multiplies its probability by their
//! number.

use super::block::{Block, Kind};
use super::problem::{Fit, Problem};
use super::time_block::TimeBlock;
use super::whitening::dot;
use crate::thresholds::{
    WAVE_LEAST_PERIODS, WAVE_LONGEST_PERIODS, WAVE_MOST_FREQUENCIES, WAVE_PER_PEAK, WAVE_PERIODS_S,
};
use analysis_fit::validity::tail::chi2_tail;
use std::f64::consts::TAU;

/// Keeps a quotient finite.
const TINY: f64 = 1e-12;

/// The wave that takes up most.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Wave {
    pub(super) period_s: f64,
    /// χ² that it takes up, and as how many quantities.
    pub(super) chi2: f64,
    pub(super) dof: usize,
    /// Probability of an equal χ² beyond the allowed residual without an oscillation, at any of the
    /// periods.
    pub(super) p_value: f64,
}

/// The rest that a fit leaves of one training record.
struct Record<'a> {
    block: usize,
    time: &'a TimeBlock,
    /// Whitened.
    residuals: &'a [f64],
}

/// Returns the least probable wave in the residuals of the training records, or `None` without
/// records that are long enough. `beyond` returns the part of a χ² that exceeds the allowed
/// residual.
pub(super) fn wave<'a>(
    problem: &'a Problem,
    fit: &'a Fit,
    beyond: impl Fn(f64) -> f64,
) -> Option<Wave> {
    let of_record = |(block, run, residuals): (usize, &'a Block, &'a [f64])| match &run.kind {
        Kind::Time(time) => Some(Record {
            block,
            time,
            residuals,
        }),
        Kind::Eis { .. } => None,
    };
    let records: Vec<Record<'_>> = problem
        .whitened_residuals(fit)
        .filter_map(of_record)
        .collect();
    let longest_s = records
        .iter()
        .filter_map(|record| record.time.time_s.last().copied())
        .fold(0.0, f64::max);
    let (slowest_hz, fastest_hz) = (
        WAVE_PERIODS_S
            .1
            .recip()
            .max(WAVE_LONGEST_PERIODS / longest_s),
        WAVE_PERIODS_S.0.recip(),
    );
    let count = (WAVE_PER_PEAK * longest_s * (fastest_hz - slowest_hz))
        .floor()
        .min(WAVE_MOST_FREQUENCIES);
    if !(count >= 1.0 && count.is_finite()) {
        return None;
    }
    let step_hz = (fastest_hz - slowest_hz) / count;
    let at = |freq_hz: f64| {
        let held = |record: &&Record<'_>| {
            record
                .time
                .time_s
                .last()
                .is_some_and(|span_s| span_s * freq_hz >= WAVE_LEAST_PERIODS)
        };
        let (chi2, dof) = records
            .iter()
            .filter(held)
            .fold((0.0, 0), |(chi2, dof), r| {
                (chi2 + taken_up(problem, r, freq_hz), dof + 2)
            });
        let p_value = if dof == 0 {
            1.0
        } else {
            (chi2_tail(beyond(chi2), f64::from(dof)) * (count + 1.0)).min(1.0)
        };
        Wave {
            period_s: freq_hz.recip(),
            chi2,
            dof: dof as usize,
            p_value,
        }
    };
    (0..=count as usize)
        .map(|n| at(slowest_hz + step_hz * n as f64))
        .min_by(|a, b| {
            a.p_value
                .total_cmp(&b.p_value)
                .then(b.chi2.total_cmp(&a.chi2))
        })
}

/// χ² of a record that a wave of this frequency takes up.
fn taken_up(problem: &Problem, record: &Record<'_>, freq_hz: f64) -> f64 {
    let Record {
        block,
        time,
        residuals,
    } = *record;
    let (sines, cosines): (Vec<f64>, Vec<f64>) = time
        .time_s
        .iter()
        .map(|t| (TAU * freq_hz * t).sin_cos())
        .unzip();
    let column = |samples: &[f64]| {
        let mut white = Vec::with_capacity(residuals.len());
        problem.whiteners[block].apply(&time.average(samples), &mut white);
        white
    };
    let (sine, mut cosine) = (column(&sines), column(&cosines));
    let part = dot(&sine, &cosine) / dot(&sine, &sine).max(TINY);
    cosine
        .iter_mut()
        .zip(&sine)
        .for_each(|(c, s)| *c -= part * s);
    let of = |column: &[f64]| dot(column, residuals).powi(2) / dot(column, column).max(TINY);
    of(&sine) + of(&cosine)
}
