//! Samples that are means over windows of time. A logger that decimates its record averages over
//! ever longer windows, and the mean of an exponential over a window as long as a fifth of the time
//! since the edge is not its value in the middle: by 0.1 % of a branch's voltage, ten times the
//! noise of a good bench.
//!
//! The model is evaluated at two instants per window, m ± w/(2√3) with m its middle and w its
//! width, and their mean is used: exact for a cubic (Gauss–Legendre). A sample whose time is not in
//! its window, as a logger places the last one before an edge, is an instant too, so that the
//! current keeps its edge.

/// Half the distance of both instants, as a part of a window's width: 1/(2√3).
const APART: f64 = 0.288_675_134_594_812_9;

/// Instants of a record in time and how samples follow from them.
#[derive(Debug, Clone)]
pub(super) struct Windows {
    /// Instants, s, rising.
    pub(super) time_s: Vec<f64>,
    /// The sample whose current flows at each instant: no window contains a step of the current.
    sample: Vec<usize>,
    /// Of each sample its first instant, and whether the next is of its window too.
    first: Vec<(usize, bool)>,
}

impl Windows {
    /// From samples, the first ones after edges of the current, and the windows that samples are
    /// means of; these in the record's own time, which begins at `start_s`.
    pub(super) fn new(
        samples_s: &[f64],
        edges: &[usize],
        averaged_s: &[(f64, f64)],
        start_s: f64,
    ) -> Self {
        let mut windows = Self {
            time_s: Vec::new(),
            sample: Vec::new(),
            first: Vec::new(),
        };
        for (k, (at_s, (from_s, to_s))) in samples_s.iter().zip(averaged_s).enumerate() {
            let (middle_s, half_s) = (0.5 * (from_s + to_s) - start_s, APART * (to_s - from_s));
            let (low_s, high_s) = (middle_s - half_s, middle_s + half_s);
            let begin_s = windows
                .time_s
                .last()
                .copied()
                .unwrap_or(f64::NEG_INFINITY)
                .max(if k > 0 {
                    samples_s[k - 1]
                } else {
                    f64::NEG_INFINITY
                });
            let end_s = samples_s.get(k + 1).copied().unwrap_or(f64::INFINITY);
            // Two rows enclose an edge so that the line between them steps where the current did:
            // the first row after it keeps its position.
            let inside = half_s > 0.0
                && low_s > begin_s
                && high_s < end_s
                && low_s < high_s
                && !edges.contains(&k);
            windows.first.push((windows.time_s.len(), inside));
            if inside {
                windows.add(low_s, k);
                windows.add(high_s, k);
            }
            // An edge of the current lies between samples with unchanged positions.
            if !inside || *at_s > high_s {
                windows.add(*at_s, k);
            }
        }
        windows
    }

    /// An instant of sample `k`.
    fn add(&mut self, at_s: f64, k: usize) {
        self.time_s.push(at_s);
        self.sample.push(k);
    }

    /// Currents of the instants from those of the samples.
    pub(super) fn current(&self, samples_a: &[f64], instants_a: &mut Vec<f64>) {
        instants_a.clear();
        instants_a.extend(self.sample.iter().map(|k| samples_a[*k]));
    }

    /// Samples from voltages of the instants.
    pub(super) fn means(&self, instants_v: &[f64], samples_v: &mut Vec<f64>) {
        samples_v.clear();
        let mean = |(first, two): &(usize, bool)| {
            if *two {
                0.5 * (instants_v[*first] + instants_v[first + 1])
            } else {
                instants_v[*first]
            }
        };
        samples_v.extend(self.first.iter().map(mean));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Windows as a logger makes them: 0.2 of the time since the edge long, one after the other,
    /// the last one standing close before the next edge.
    fn logged() -> (Vec<f64>, Vec<(f64, f64)>) {
        let (mut samples_s, mut averaged_s, mut from_s) = (vec![0.0], vec![(0.0, 0.0)], 0.01);
        while from_s < 20.0 {
            let to_s = 1.2 * from_s;
            samples_s.push(0.5 * (from_s + to_s));
            averaged_s.push((from_s, to_s));
            from_s = to_s;
        }
        samples_s.push(from_s + 0.099);
        averaged_s.push((from_s, from_s + 0.05));
        samples_s.push(from_s + 0.1);
        averaged_s.push((from_s + 0.1, from_s + 0.1));
        (samples_s, averaged_s)
    }

    #[test]
    fn means_of_an_exponential_are_met() {
        let (samples_s, averaged_s) = logged();
        let windows = Windows::new(&samples_s, &[], &averaged_s, 0.0);
        assert!(
            windows.time_s.is_sorted_by(|a, b| a < b),
            "{:?}",
            windows.time_s
        );
        let decay = |t: f64| (-t / 5.0f64).exp();
        let mut samples_v = Vec::new();
        windows.means(
            &windows
                .time_s
                .iter()
                .map(|t| decay(*t))
                .collect::<Vec<f64>>(),
            &mut samples_v,
        );
        assert_eq!(samples_v.len(), samples_s.len());
        let (mut worst, mut middle): (f64, f64) = (0.0, 0.0);
        for ((met, (from_s, to_s)), at_s) in samples_v.iter().zip(&averaged_s).zip(&samples_s) {
            let mean = if to_s > from_s {
                5.0 * (decay(*from_s) - decay(*to_s)) / (to_s - from_s)
            } else {
                decay(*at_s)
            };
            worst = worst.max((met - mean).abs());
            middle = middle.max((decay(*at_s) - mean).abs());
        }
        assert!(
            middle > 5e-4 && worst < 2e-6,
            "at the middle off by {middle}, by two instants {worst}"
        );
    }

    #[test]
    fn the_current_keeps_its_edge() {
        let (samples_s, averaged_s) = logged();
        let windows = Windows::new(&samples_s, &[], &averaged_s, 0.0);
        let last = samples_s.len() - 1;
        let levels: Vec<f64> = (0..=last)
            .map(|k| if k == last { -3.0 } else { 2.0 })
            .collect();
        let mut instants_a = Vec::new();
        windows.current(&levels, &mut instants_a);
        let steps = instants_a
            .iter()
            .zip(&windows.time_s)
            .filter(|(i, _)| **i != 2.0)
            .collect::<Vec<_>>();
        assert_eq!(steps, [(&-3.0, &samples_s[last])]);
    }
}
