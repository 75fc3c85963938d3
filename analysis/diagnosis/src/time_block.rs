//! A record prepared for comparison: its edges, its current without the logger's noise, and its
//! bins. A bin is a group of samples that are averaged to one row.

use super::data::TimeRecord;
use super::windows::Windows;
use crate::thresholds::{
    BIN_GROWTH, BIN_WIDEST_PART, BIN_WIDTH_PART, CODE_BORDER_FACTOR, EDGE_SAMPLES, EDGE_SIGMAS,
    EDGE_STEP_PART, MOST_BINS, STEADY_CURRENT_SIGMAS,
};
use analysis_effects::augmented::{Between, Grid};

/// A record with its grid and bins.
#[derive(Debug, Clone)]
pub(super) struct TimeBlock {
    pub(super) time_s: Vec<f64>,
    pub(super) current_a: Vec<f64>,
    /// The same without the noise of the logger, see [`driven`].
    pub(super) driven_a: Vec<f64>,
    pub(super) voltage_v: Vec<f64>,
    pub(super) linear: bool,
    pub(super) level_sigma_v: f64,
    /// Errors of the current beside the bench's, A at every sample.
    pub(super) current_errors_a: Vec<Vec<f64>>,
    /// Of the samples, or of the instants in their windows.
    pub(super) grid: Grid,
    /// Windows over which the samples are averaged, if they are means.
    pub(super) windows: Option<Windows>,
    pub(super) bins: Vec<Bin>,
    /// First samples of stretches between edges.
    pub(super) edges: Vec<usize>,
}

/// Consecutive samples that make one row.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Bin {
    pub(super) from: usize,
    pub(super) to: usize,
    /// Mean time, s.
    pub(super) time_s: f64,
    /// Time since the last edge, s.
    pub(super) since_edge_s: f64,
    /// Mean current without the logger's noise, A.
    pub(super) current_a: f64,
    /// Charge drawn since the start of the record, C.
    pub(super) charge_coulomb: f64,
    /// Current that flowed last, A: the sign of a rest is that of the pulse before it.
    pub(super) last_current_a: f64,
    /// Variance of the mean by the samples' stated noise, V²; 0 where none is stated.
    pub(super) stated_v2: f64,
}

impl TimeBlock {
    pub(super) fn new(record: &TimeRecord, jitter_a: f64) -> Self {
        let s = &record.series;
        let start_s = s.time_s[0];
        let time_s: Vec<f64> = s.time_s.iter().map(|t| t - start_s).collect();
        let linear = record.between == Between::Linear;
        let edges = edges(&s.current_a, jitter_a);
        // Rows that are means have less noise than the bench's samples, by a factor that is not
        // recorded.
        let sampled = record.sigma_v.is_none() && record.averaged_s.is_none();
        let driven_a = driven(&s.current_a, &edges, if sampled { jitter_a } else { 0.0 });
        let windows = record
            .averaged_s
            .as_ref()
            .filter(|_| linear)
            .map(|averaged_s| Windows::new(&time_s, &edges, averaged_s, start_s));
        let grid = Grid::new(
            windows.as_ref().map_or(&time_s, |windows| &windows.time_s),
            record.between,
        );
        let mut block = Self {
            time_s,
            current_a: s.current_a.clone(),
            driven_a,
            voltage_v: s.voltage_v.clone(),
            linear,
            level_sigma_v: record.level_sigma_v,
            current_errors_a: record.current_errors_a.clone(),
            grid,
            windows,
            bins: Vec::new(),
            edges,
        };
        block.bins = block.all_bins();
        if let Some(sigma_v) = &record.sigma_v {
            let count = |b: &Bin| (b.to - b.from) as f64;
            block.bins.iter_mut().for_each(|b| {
                b.stated_v2 =
                    sigma_v[b.from..b.to].iter().map(|s| s * s).sum::<f64>() / count(b).powi(2);
            });
        }
        let compared = block
            .time_s
            .partition_point(|t| *t < record.compared_from_s - start_s);
        block.bins.retain(|b| b.from >= compared);
        block
    }

    /// Bins of all samples, those that are not compared among them.
    fn all_bins(&self) -> Vec<Bin> {
        let Self {
            time_s,
            current_a,
            driven_a,
            edges,
            ..
        } = self;
        let mut ratio = BIN_WIDTH_PART;
        let mut cuts = cuts(time_s, edges, ratio);
        while cuts.len() > MOST_BINS + 1 && ratio < BIN_WIDEST_PART {
            ratio *= BIN_GROWTH;
            cuts = self::cuts(time_s, edges, ratio);
        }
        // More edges than bins: neighbours are merged.
        while cuts.len() > MOST_BINS + 1 {
            let last = cuts[cuts.len() - 1];
            cuts = cuts
                .iter()
                .copied()
                .step_by(2)
                .filter(|k| *k != last)
                .chain([last])
                .collect();
        }
        let mut charge_coulomb = vec![0.0; time_s.len()];
        for k in 1..time_s.len() {
            charge_coulomb[k] = charge_coulomb[k - 1]
                + 0.5 * (current_a[k] + current_a[k - 1]) * (time_s[k] - time_s[k - 1]);
        }
        let greatest = current_a.iter().fold(0.0f64, |m, i| m.max(i.abs()));
        let mut last_current_a = 0.0;
        cuts.windows(2)
            .map(|w| {
                let (from, to) = (w[0], w[1]);
                let mean = |v: &[f64]| v[from..to].iter().sum::<f64>() / (to - from) as f64;
                let edge = edges[edges.partition_point(|e| *e <= from).saturating_sub(1)];
                let current = mean(driven_a);
                if current.abs() > EDGE_STEP_PART * greatest {
                    last_current_a = current;
                }
                let time = mean(time_s);
                Bin {
                    from,
                    to,
                    time_s: time,
                    since_edge_s: time - time_s[edge],
                    current_a: current,
                    charge_coulomb: mean(&charge_coulomb),
                    last_current_a,
                    stated_v2: 0.0,
                }
            })
            .collect()
    }

    /// Samples that are compared.
    pub(super) fn compared(&self) -> std::ops::Range<usize> {
        self.bins.first().map_or(0, |b| b.from)..self.time_s.len()
    }

    /// Means over the bins.
    pub(super) fn average(&self, values: &[f64]) -> Vec<f64> {
        let mut rows = Vec::with_capacity(self.bins.len());
        self.average_into(values, &mut rows);
        rows
    }

    pub(super) fn average_into(&self, values: &[f64], rows: &mut Vec<f64>) {
        rows.extend(
            self.bins
                .iter()
                .map(|b| values[b.from..b.to].iter().sum::<f64>() / (b.to - b.from) as f64),
        );
    }
}

/// Returns the first samples after each change of the current above the noise, including the first
/// sample of all.
fn edges(current_a: &[f64], jitter_a: f64) -> Vec<usize> {
    let greatest = current_a.iter().fold(0.0f64, |m, i| m.max(i.abs()));
    let least = (EDGE_STEP_PART * greatest).max(EDGE_SIGMAS * jitter_a);
    let changes = (1..current_a.len()).filter(|k| (current_a[*k] - current_a[k - 1]).abs() > least);
    std::iter::once(0).chain(changes).collect()
}

/// Returns the current without noise: constant if it stays between two edges and differs from its
/// mean by no more than white noise does. Samples directly after an edge keep their logged values,
/// because they show a smoothed channel.
fn driven(current_a: &[f64], edges: &[usize], jitter_a: f64) -> Vec<f64> {
    let mut driven_a = current_a.to_vec();
    let ends = edges.iter().skip(1).copied().chain([current_a.len()]);
    for (from, to) in edges.iter().copied().zip(ends) {
        let from = if from > 0 {
            (from + EDGE_SAMPLES).min(to)
        } else {
            from
        };
        let stretch = &mut driven_a[from..to];
        let n = stretch.len().max(1) as f64;
        let mean = stretch.iter().sum::<f64>() / n;
        let variance = stretch.iter().map(|i| (i - mean).powi(2)).sum::<f64>() / n;
        // Successive samples of white noise differ by twice its variance, what settles differs by
        // less.
        let by_steps = stretch
            .windows(2)
            .map(|w| 0.5 * (w[1] - w[0]).powi(2))
            .sum::<f64>()
            / (n - 1.0).max(1.0);
        let scatter = STEADY_CURRENT_SIGMAS / n.sqrt();
        let white = variance <= by_steps * (1.0 + scatter);
        if white
            && variance
                <= CODE_BORDER_FACTOR * 0.5 * jitter_a * jitter_a * (1.0 + 2f64.sqrt() * scatter)
        {
            stretch.fill(mean);
        }
    }
    driven_a
}

/// Starts of the bins, and the end of the last.
fn cuts(time_s: &[f64], edges: &[usize], ratio: f64) -> Vec<usize> {
    let mut cuts = Vec::new();
    for (n, edge) in edges.iter().enumerate() {
        let end = edges.get(n + 1).copied().unwrap_or(time_s.len());
        let mut k = *edge;
        while k < end {
            cuts.push(k);
            let width_s = ratio * (time_s[k] - time_s[*edge]);
            let begin_s = time_s[k];
            k += 1;
            while k < end && time_s[k] - begin_s < width_s {
                k += 1;
            }
        }
    }
    cuts.push(time_s.len());
    cuts
}
