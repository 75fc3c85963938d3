//! Evaluates the record of a current that was commanded as a stair of short equal steps: the start
//! of the stair in the record, and means over its steps.
//!
//! The stair begins where its correlation with the record is greatest. As no current flows before
//! and after it, the sum of the squared differences is least there. Means leave out the samples
//! directly after a step, because a supply takes time to settle.

use std::ops::RangeInclusive;

/// Blocks that a long stair is taken together to when it is looked for.
const BLOCKS: usize = 2048;
/// Blocks on either side within which the finer search continues.
const FINE_BLOCKS: f64 = 1.5;

/// A current in equal steps; nothing flows before and behind it.
#[derive(Debug, Clone, Copy)]
pub struct Stair<'a> {
    /// Current of each step, A.
    pub values: &'a [f64],
    /// Time that each step is held, s.
    pub step_s: f64,
}

/// Sums of samples from the first on, so that any mean is a difference.
#[derive(Debug, Clone)]
pub struct Sums {
    sums: Vec<f64>,
    interval_s: f64,
}

/// Steps of equal current that are one row.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Chunk {
    /// The first step.
    pub from: usize,
    /// The step behind the last.
    pub to: usize,
}

impl Sums {
    /// Of samples that are `interval_s` apart, the first at time 0.
    pub fn of(samples: impl Iterator<Item = f64>, interval_s: f64) -> Self {
        let mut sums = vec![0.0];
        let mut sum = 0.0;
        sums.extend(samples.map(|sample| {
            sum += sample;
            sum
        }));
        Self { sums, interval_s }
    }

    /// Returns the mean of the samples between two times and their number, or `None` if there are
    /// no samples.
    pub fn mean(&self, from_s: f64, to_s: f64) -> Option<(f64, usize)> {
        let index = |time_s: f64| {
            ((time_s / self.interval_s).ceil().max(0.0) as usize).min(self.sums.len() - 1)
        };
        let (from, to) = (index(from_s), index(to_s));
        (to > from).then(|| {
            (
                (self.sums[to] - self.sums[from]) / (to - from) as f64,
                to - from,
            )
        })
    }

    /// Returns the time between two samples, s.
    pub fn interval_s(&self) -> f64 {
        self.interval_s
    }
}

/// Where something is sought.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Around {
    /// Middle, s.
    pub near_s: f64,
    /// How far from the middle, s.
    pub reach_s: f64,
}

/// Returns the time in the record at which the stair begins, s, within the given range.
pub fn begins(record: &Sums, stair: &Stair<'_>, around: Around) -> f64 {
    let Around { near_s, reach_s } = around;
    let per_block = stair.values.len().div_ceil(BLOCKS).max(1);
    let blocks: Vec<f64> = stair
        .values
        .chunks(per_block)
        .map(|chunk| chunk.iter().sum::<f64>() / per_block as f64)
        .collect();
    let coarse = Stair {
        values: &blocks,
        step_s: per_block as f64 * stair.step_s,
    };
    let rough_s = best(
        record,
        &coarse,
        near_s - reach_s..=near_s + reach_s,
        0.5 * coarse.step_s,
    );
    let around_s = FINE_BLOCKS * coarse.step_s;
    best(
        record,
        stair,
        rough_s - around_s..=rough_s + around_s,
        record.interval_s,
    )
}

/// Returns the place of least squares with any gain: of the greatest correlation over the record's
/// own size there. Without that size, a part of a stair is drawn to wherever more flows.
fn best(record: &Sums, stair: &Stair<'_>, range_s: RangeInclusive<f64>, by_s: f64) -> f64 {
    let (from_s, to_s) = range_s.into_inner();
    let count = ((to_s - from_s) / by_s).ceil().max(0.0) as usize;
    let places = (0..=count).map(|k| from_s + k as f64 * by_s);
    let score = |start_s: f64| -> f64 {
        let at = |k: usize| {
            record.mean(
                start_s + k as f64 * stair.step_s,
                start_s + (k + 1) as f64 * stair.step_s,
            )
        };
        let means = stair
            .values
            .iter()
            .enumerate()
            .map(|(k, value)| (value, at(k).map_or(0.0, |mean| mean.0)));
        let (both, own) = means.fold((0.0, 0.0), |(both, own), (value, mean)| {
            (both + value * mean, own + mean * mean)
        });
        if own > 0.0 { both / own.sqrt() } else { 0.0 }
    };
    places
        .map(|start_s| (start_s, score(start_s)))
        .max_by(|a, b| a.1.total_cmp(&b.1))
        .map_or(from_s, |found| found.0)
}

/// Returns the rows of a stair: one per step, and while a current stays constant, each longer than
/// the one before by `growth` of the time since it began, up to `longest` steps. The last before a
/// change is a single step, so that the change lies between two rows that are a step apart.
pub fn chunks(values: &[f64], growth: f64, longest: usize) -> Vec<Chunk> {
    let mut chunks = Vec::new();
    let mut start = 0;
    while start < values.len() {
        let end = start
            + values[start..]
                .iter()
                .take_while(|value| **value == values[start])
                .count();
        let mut from = start;
        while from < end {
            let length = ((growth * (from - start) as f64) as usize).clamp(1, longest.max(1));
            let to = if from + length >= end {
                (end - 1).max(from + 1)
            } else {
                from + length
            };
            chunks.push(Chunk { from, to });
            from = to;
        }
        start = end;
    }
    chunks
}

#[cfg(test)]
mod tests {
    use super::*;
    use analysis_numeric::Rng;

    /// Returns a stair of random steps, and a record of it that begins at `start_s`, with noise.
    fn record(count: usize, (step_s, start_s, noise): (f64, f64, f64)) -> (Vec<f64>, Sums) {
        let mut rng = Rng::new(7);
        let values: Vec<f64> = (0..count).map(|_| 10.0 * (rng.uniform() - 0.5)).collect();
        let interval_s = step_s / 8.0;
        let samples = ((start_s + count as f64 * step_s + 1.0) / interval_s) as usize;
        let at = |k: usize| {
            let step = (k as f64 * interval_s - start_s) / step_s;
            if step < 0.0 {
                0.0
            } else {
                values.get(step as usize).copied().unwrap_or(0.0)
            }
        };
        let noisy: Vec<f64> = (0..samples)
            .map(|k| at(k) + noise * (rng.uniform() - 0.5))
            .collect();
        (values, Sums::of(noisy.into_iter(), interval_s))
    }

    #[test]
    fn a_stair_is_found_where_it_begins_however_long_it_is() {
        for count in [50, 500, 6000] {
            let (values, sums) = record(count, (2.0e-3, 0.6371, 2.0));
            let found_s = begins(
                &sums,
                &Stair {
                    values: &values,
                    step_s: 2.0e-3,
                },
                Around {
                    near_s: 0.5,
                    reach_s: 0.3,
                },
            );
            assert!((found_s - 0.6371).abs() <= 2.6e-4, "{count}: {found_s}");
        }
    }

    #[test]
    fn a_part_of_a_smooth_stair_is_found_between_its_neighbours() {
        let (step_s, start_s, count) = (2.0e-3, 0.5, 1000);
        let interval_s = step_s / 8.0;
        for phase in [0.0, 0.7, 1.9] {
            let value =
                |step: usize| (std::f64::consts::TAU * 1.0 * step_s * step as f64 + phase).sin();
            let values: Vec<f64> = (0..count).map(value).collect();
            let at = |k: usize| {
                let step = (k as f64 * interval_s - start_s + 1.0e-9) / step_s;
                if step < 0.0 {
                    0.0
                } else {
                    0.98 * values.get(step as usize).copied().unwrap_or(0.0)
                }
            };
            let sums = Sums::of((0..12_000).map(at), interval_s);
            for part in [0..500, 500..1000, 250..700] {
                let truth_s = start_s + part.start as f64 * step_s;
                let found_s = begins(
                    &sums,
                    &Stair {
                        values: &values[part.clone()],
                        step_s,
                    },
                    Around {
                        near_s: truth_s + 1.3e-3,
                        reach_s: 2.0 * step_s,
                    },
                );
                assert!(
                    (found_s - truth_s).abs() <= 1.01 * interval_s,
                    "{part:?}: {found_s} for {truth_s}"
                );
            }
        }
    }

    #[test]
    fn means_are_of_the_samples_between_two_times() {
        let sums = Sums::of([1.0, 2.0, 3.0, 4.0].into_iter(), 0.1);
        assert_eq!(sums.mean(0.05, 0.25), Some((2.5, 2)));
        assert_eq!(
            (sums.mean(0.3, 9.0), sums.mean(0.31, 9.0)),
            (Some((4.0, 1)), None)
        );
    }

    #[test]
    fn rows_grow_while_the_current_stays_and_begin_anew_with_a_step() {
        let values = [vec![0.0; 10], vec![1.0], vec![2.0; 7]].concat();
        let lengths: Vec<usize> = chunks(&values, 1.0, 4)
            .iter()
            .map(|chunk| chunk.to - chunk.from)
            .collect();
        assert_eq!(lengths, [1, 1, 2, 4, 1, 1, 1, 1, 1, 2, 2, 1]);
    }
}
