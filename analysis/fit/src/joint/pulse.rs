//! Pulses of current in a time series: where they begin and end.

use analysis_signal::series::TimeSeries;
use std::ops::Range;

/// Conditions for a pulse.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PulseOptions {
    /// Smallest step of the current from sample to sample, A; `None` for a tenth of the largest
    /// current.
    pub step_a: Option<f64>,
    /// Shortest and longest pulse, s.
    pub length_s: (f64, f64),
    /// Steady current that must precede, s.
    pub before_s: f64,
    /// Steady current that must follow, s.
    pub after_s: f64,
}

impl Default for PulseOptions {
    /// 1 s to 60 s, half a minute of steady current before and after.
    fn default() -> Self {
        Self {
            step_a: None,
            length_s: (1.0, 60.0),
            before_s: 30.0,
            after_s: 30.0,
        }
    }
}

/// A step of the current from one steady value to another and on to a third.
#[derive(Debug, Clone, PartialEq)]
pub struct Pulse {
    /// Samples of the steady current before, back to the edge before it.
    pub before: Range<usize>,
    /// Samples of the pulse.
    pub during: Range<usize>,
    /// Samples of the steady current after, up to the next edge.
    pub after: Range<usize>,
    /// Mean currents before, during and after, A, discharge positive.
    pub current_a: [f64; 3],
    /// Last sample before and first sample after each of both edges, s: the edge is somewhere
    /// between.
    pub edges_s: [(f64, f64); 2],
}

impl Pulse {
    /// Step of the current at the first edge, A.
    pub fn step_a(&self) -> f64 {
        self.current_a[1] - self.current_a[0]
    }

    /// Time from which the pulse is counted: the last sample before the edge, s. A cycler sets the
    /// current right after it has read that sample.
    pub fn start_s(&self) -> f64 {
        self.edges_s[0].0
    }
}

/// Maximum interval between the samples next to an edge, s: the shortest pulse that counts
/// ([`PulseOptions::default`]). In a slower record a pulse looks like a change of the load, and the
/// series resistance cannot be separated from the fast branches, which answer within that time.
pub const SLOWEST_EDGE_S: f64 = 1.0;

impl Pulse {
    /// Longest time between neighbouring samples from before to after an edge, s.
    pub fn sampling_s(&self, series: &TimeSeries) -> f64 {
        let edges = [
            (self.before.end, self.during.start),
            (self.during.end, self.after.start),
        ];
        let gaps = edges
            .into_iter()
            .flat_map(|(last, first)| series.time_s[last - 1..=first].windows(2));
        gaps.map(|pair| pair[1] - pair[0]).fold(0.0, f64::max)
    }

    /// The record shows its edges; a file's times may be rounded.
    pub fn is_seen(&self, series: &TimeSeries) -> bool {
        self.sampling_s(series) <= SLOWEST_EDGE_S * (1.0 + 1e-6)
    }
}

/// Finds the pulses of a series, in their order. Pulses without enough steady current around them
/// are left out.
pub fn find_pulses(series: &TimeSeries, options: &PulseOptions) -> Vec<Pulse> {
    let largest = series.current_a.iter().fold(0.0f64, |m, i| m.max(i.abs()));
    let step = options
        .step_a
        .unwrap_or(0.1 * largest)
        .max(f64::MIN_POSITIVE);
    let segments = segments(series, step);
    let time = &series.time_s;
    let mean =
        |r: &Range<usize>| r.clone().map(|k| series.current_a[k]).sum::<f64>() / r.len() as f64;
    let length = |r: &Range<usize>| time[r.end - 1] - time[r.start];
    let fits = |w: &&[Range<usize>]| {
        let during = time[w[2].start] - time[w[0].end - 1];
        (options.length_s.0..=options.length_s.1).contains(&during)
            && length(&w[0]) >= options.before_s
            && length(&w[2]) >= options.after_s
    };
    let pulse = |w: &[Range<usize>]| Pulse {
        before: w[0].clone(),
        during: w[1].clone(),
        after: w[2].clone(),
        current_a: [mean(&w[0]), mean(&w[1]), mean(&w[2])],
        edges_s: [
            (time[w[0].end - 1], time[w[1].start]),
            (time[w[1].end - 1], time[w[2].start]),
        ],
    };
    segments.windows(3).filter(fits).map(pulse).collect()
}

/// Stretches of steady current. A sample caught on the slope of an edge belongs to none.
fn segments(series: &TimeSeries, step: f64) -> Vec<Range<usize>> {
    let jumps = |k: usize| {
        k > 0 && k < series.len() && (series.current_a[k] - series.current_a[k - 1]).abs() > step
    };
    let mut found = Vec::new();
    let mut start = 0;
    for k in 1..=series.len() {
        if k == series.len() || jumps(k) {
            let on_slope = k - start == 1 && jumps(start) && jumps(k);
            if !on_slope {
                found.push(start..k);
            }
            start = k;
        }
    }
    found
}
