//! Thins out records of direct currents with a few steps: finds the steps, and averages the four
//! channels over windows that are short after a step and long later.
//!
//! A step is placed where the cumulative sum of C2 − C1 (the voltage over the current shunt) minus
//! its mean is farthest from zero within a window around the command: the least-squares place of
//! one step in noise. Two rows enclose it as closely as the samples allow, so that a current
//! interpolated linearly between rows steps at the right place. No row averages samples from both
//! sides of a step.

use crate::dataset::Capture;

/// Options of the means.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Thinning {
    /// A current that steps has settled after this time, s.
    pub settle_s: f64,
    /// The first mean after a step begins this late and is as long, s.
    pub first_s: f64,
    /// Each further mean lasts this share of the time since the step …
    pub growth: f64,
    /// … and this long at most, s.
    pub longest_s: f64,
}

/// Window in which a step is searched: the earliest and the latest time in the frame, s.
pub type Window = (f64, f64);

/// A frame, thinned out.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Thinned {
    /// Means, by rising time.
    pub means: Vec<Mean>,
    /// Times of the steps in the frame, s: between the last sample before and the first after.
    pub steps_s: Vec<f64>,
    /// Scatter of one sample of C2 − C1, V rms.
    pub sigma_shunt_v: f64,
    /// Scatter of one sample of C4 − C3, V rms.
    pub sigma_jig_v: f64,
}

/// Mean of the four channels over some samples.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mean {
    /// Time in the frame that it stands for, s.
    pub time_s: f64,
    /// Channels 1…4, V.
    pub volts: [f64; 4],
    /// Number of samples.
    pub samples: usize,
    /// Start and end of the stretch that they cover, s.
    pub averaged_s: (f64, f64),
}

/// Maximum number of samples before a step that one row averages.
const BEFORE: usize = 100;
/// Part of a step by which a sample may lie beyond both of its levels.
const BEYOND: f64 = 0.5;

/// Thins out a frame; `windows` give the places of the commanded steps, in order and without
/// overlap.
///
/// # Examples
/// ```
/// use analysis_files::dataset::{Capture, CaptureMeta, ChannelMeta};
/// use analysis_signal::sine::CodeScale;
/// use analysis_files::thinning::{Thinning, thin};
///
/// // 1 s at 1000 samples per second; codes are millivolts. The current starts after 0.5 s: the
/// // shunt shows 100 mV then, the cell falls from 3700 mV by 50 mV.
/// let scale = CodeScale {
///     volts_per_code: 1e-3,
///     offset_v: 0.0,
///     code_min: -32768,
///     code_max: 32767,
///     code_step: 1,
/// };
/// let channel = |before: i16, after: i16| [vec![before; 500], vec![after; 500]].concat();
/// let capture = Capture {
///     meta: CaptureMeta {
///         label: "cell".to_owned(),
///         freq_hz: 0.0,
///         interval_s: 1e-3,
///         start_s: 0.0,
///         channels: [ChannelMeta { scale, volts_per_div: 1.0 }; 4],
///     },
///     codes: [channel(0, 0), channel(0, 100), channel(0, 100), channel(3700, 3750)],
/// };
/// let thinning = Thinning {
///     settle_s: 0.0,
///     first_s: 0.01,
///     growth: 0.2,
///     longest_s: 0.1,
/// };
/// // The step was commanded between 0.4 and 0.6 s.
/// let thinned = thin(&capture, &[(0.4, 0.6)], &thinning);
/// assert!((thinned.steps_s[0] - 0.5).abs() < 1e-3);
/// let last = thinned.means.last().map(|mean| mean.volts[1]);
/// assert!(last.is_some_and(|v| (v - 0.1).abs() < 1e-9));
/// ```
pub fn thin(capture: &Capture, windows: &[Window], thinning: &Thinning) -> Thinned {
    let count = capture.codes.iter().map(Vec::len).min().unwrap_or(0);
    let interval_s = capture.meta.interval_s;
    let frame = Frame {
        capture,
        interval_s,
    };
    let steps: Vec<usize> = windows
        .iter()
        .filter_map(|window| frame.step(window, count))
        .collect();
    let mut means = Vec::new();
    let mut start = 0;
    for (index, &end) in steps.iter().chain([&count]).enumerate() {
        let beside = Steps {
            after: index > 0,
            before: index < steps.len(),
        };
        frame.level(start..end, beside, thinning, &mut means);
        start = end;
    }
    let (sigma_shunt_v, sigma_jig_v) = (
        frame.scatter(SHUNT, &steps, count),
        frame.scatter(JIG, &steps, count),
    );
    let steps_s = steps
        .iter()
        .map(|step| (*step as f64 - 0.5) * interval_s)
        .collect();
    Thinned {
        means,
        steps_s,
        sigma_shunt_v,
        sigma_jig_v,
    }
}

struct Frame<'a> {
    capture: &'a Capture,
    interval_s: f64,
}

/// Two channels whose difference counts.
#[derive(Clone, Copy)]
struct Pair {
    /// Index of the subtracted channel.
    low: usize,
    /// Index of the channel that it is subtracted from.
    high: usize,
}

/// Across the shunt.
const SHUNT: Pair = Pair { low: 0, high: 1 };
/// Across the jig.
const JIG: Pair = Pair { low: 2, high: 3 };

/// Position of a level of the current relative to steps.
#[derive(Clone, Copy)]
struct Steps {
    /// The level comes after a step.
    after: bool,
    /// The level comes before a step.
    before: bool,
}

impl Frame<'_> {
    /// Voltage of a pair of channels, V.
    fn between(&self, pair: Pair, sample: usize) -> f64 {
        let volts = |channel: usize| {
            self.capture.meta.channels[channel]
                .scale
                .volts(self.capture.codes[channel][sample])
        };
        volts(pair.high) - volts(pair.low)
    }

    /// Returns the first sample after the step in a window; `None` if the window has fewer than
    /// three samples.
    fn step(&self, (from_s, to_s): &Window, count: usize) -> Option<usize> {
        let index = |time_s: f64| ((time_s / self.interval_s).max(0.0).round() as usize).min(count);
        let range = index(*from_s)..index(*to_s);
        if range.len() < 3 {
            return None;
        }
        let mean = range.clone().map(|k| self.between(SHUNT, k)).sum::<f64>() / range.len() as f64;
        let mut sum = 0.0;
        let far = range.map(|k| {
            sum += self.between(SHUNT, k) - mean;
            (k + 1, sum.abs())
        });
        far.max_by(|a, b| a.1.total_cmp(&b.1)).map(|(k, _)| k)
    }

    /// Returns the position, in samples, of an ideal step that moves the same charge as the step
    /// first seen in sample `step`: a current that takes time to settle is later by that much.
    fn centre(&self, step: usize, settle: usize) -> f64 {
        let sharp = step as f64 - 0.5;
        let mean = |range: std::ops::Range<usize>| {
            let span = range.len() as f64;
            range.map(|k| self.between(SHUNT, k)).sum::<f64>() / span
        };
        if step <= 2 * settle + 1
            || step + 2 * settle > self.capture.codes[0].len().min(self.capture.codes[1].len())
        {
            return sharp;
        }
        let (before, after) = (
            mean(step - 1 - settle..step - 1),
            mean(step + settle..step + 2 * settle),
        );
        // A sample beyond both levels was taken while the step passed: one of the two channels had
        // seen it, the other, skewed, had not. The current had not moved yet.
        let seen = |k: usize| {
            let part = (self.between(SHUNT, k) - before) / (after - before);
            if (-BEYOND..=1.0 + BEYOND).contains(&part) {
                part
            } else {
                0.0
            }
        };
        let share = (step - settle..step + settle).map(seen).sum::<f64>() / (2 * settle) as f64;
        let centre = (step + settle) as f64 - 0.5 - 2.0 * settle as f64 * share;
        // The noise of a small step must not reverse the order of the rows.
        centre.clamp(sharp - 0.5, sharp + 0.5 * settle as f64)
    }

    /// Means of one level of the current. `after` a step its first samples still move and the next
    /// is a row of its own; `before` a step its last samples are a row that stands close to the
    /// step.
    fn level(
        &self,
        range: std::ops::Range<usize>,
        beside: Steps,
        thinning: &Thinning,
        means: &mut Vec<Mean>,
    ) {
        let Steps { after, before } = beside;
        let samples = |span_s: f64| {
            ((span_s / self.interval_s).round() as usize).clamp(1, range.len().max(1))
        };
        let mut start = range.start;
        let settle = samples(thinning.settle_s);
        if after && range.len() > 2 * settle {
            means.extend(self.mean(start + settle..start + 2 * settle));
            start += samples(thinning.first_s).max(2 * settle);
        }
        let last = if before {
            BEFORE.max(2 * settle).min(range.len() / 4)
        } else {
            0
        };
        let end = range.end - last;
        while start < end {
            let since_s = (start - range.start) as f64 * self.interval_s;
            let wanted = if after {
                (thinning.growth * since_s).max(thinning.first_s)
            } else {
                thinning.longest_s
            };
            let wanted_s = wanted.min(thinning.longest_s);
            // A remainder that is short joins the row before it.
            let stop = Some(start + samples(wanted_s))
                .filter(|stop| stop + samples(0.5 * wanted_s) < end)
                .unwrap_or(end);
            means.extend(self.mean(start..stop));
            start = stop;
        }
        if last > 1 {
            // As far from the step as the row after it. The last sample may already see the step:
            // channels are skewed.
            let row = self.mean(end..range.end - 1);
            let after = range.end as f64 + 1.5 * settle as f64 - 0.5;
            let time_s = (2.0 * self.centre(range.end, settle) - after) * self.interval_s;
            means.extend(row.map(|mean| Mean { time_s, ..mean }));
        }
    }

    fn mean(&self, range: std::ops::Range<usize>) -> Option<Mean> {
        if range.is_empty() || range.end > self.capture.codes[0].len() {
            return None;
        }
        let samples = range.len();
        let of = |channel: usize| {
            let codes = &self.capture.codes[channel][range.clone()];
            let scale = &self.capture.meta.channels[channel].scale;
            let sum: i64 = codes.iter().map(|code| i64::from(*code)).sum();
            sum as f64 / samples as f64 * scale.volts_per_code - scale.offset_v
        };
        let middle = 0.5 * (range.start + range.end - 1) as f64;
        let averaged_s = (
            (range.start as f64 - 0.5) * self.interval_s,
            (range.end as f64 - 0.5) * self.interval_s,
        );
        Some(Mean {
            time_s: middle * self.interval_s,
            volts: [of(0), of(1), of(2), of(3)],
            samples,
            averaged_s,
        })
    }

    /// Scatter of one sample, from the differences of neighbours that no step parts.
    fn scatter(&self, pair: Pair, steps: &[usize], count: usize) -> f64 {
        let calm = |k: &usize| steps.iter().all(|step| k.abs_diff(*step) > 2);
        let (mut sum, mut number) = (0.0, 0.0f64);
        for k in (1..count).filter(calm) {
            sum += (self.between(pair, k) - self.between(pair, k - 1)).powi(2);
            number += 1.0;
        }
        (0.5 * sum / number.max(1.0)).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::{CaptureMeta, ChannelMeta};
    use analysis_numeric::Rng;
    use analysis_signal::sine::CodeScale;

    const INTERVAL_S: f64 = 1.0e-3;
    const THINNING: Thinning = Thinning {
        settle_s: 0.001,
        first_s: 0.002,
        growth: 0.25,
        longest_s: 0.5,
    };

    /// Ten seconds; C2 steps by `volts` at the samples given, C4 by twice as much, and both have
    /// noise of 1 mV.
    fn capture(steps: &[(usize, f64)]) -> Capture {
        let scale = CodeScale {
            volts_per_code: 1.0e-4,
            offset_v: 0.0,
            code_min: i16::MIN,
            code_max: i16::MAX,
            code_step: 1,
        };
        let mut rng = Rng::new(3);
        let level = |k: usize| {
            steps
                .iter()
                .filter(|(step, _)| k >= *step)
                .map(|(_, volts)| volts)
                .sum::<f64>()
        };
        let mut channel = |share: f64, noise_v: f64| -> Vec<i16> {
            (0..10_000)
                .map(|k| {
                    ((share * level(k) + noise_v * 12.0f64.sqrt() * (rng.uniform() - 0.5))
                        / scale.volts_per_code)
                        .round() as i16
                })
                .collect()
        };
        let codes = [
            channel(0.0, 0.0),
            channel(1.0, 1.0e-3),
            channel(0.0, 0.0),
            channel(2.0, 1.0e-3),
        ];
        let meta = ChannelMeta {
            scale,
            volts_per_div: 0.1,
        };
        Capture {
            meta: CaptureMeta {
                label: String::new(),
                freq_hz: 0.0,
                interval_s: INTERVAL_S,
                start_s: 0.0,
                channels: [meta; 4],
            },
            codes,
        }
    }

    #[test]
    fn steps_are_found_and_no_row_mixes_two_levels() {
        let capture = capture(&[(2_000, 0.1), (7_003, -0.25)]);
        let thinned = thin(&capture, &[(1.8, 2.3), (6.9, 7.2)], &THINNING);
        assert_eq!(thinned.steps_s, [1.9995, 7.0025]);
        for mean in &thinned.means {
            let level = if mean.time_s < 1.9995 {
                0.0
            } else if mean.time_s < 7.0025 {
                0.1
            } else {
                -0.15
            };
            let allowed = 5.0e-3 / (mean.samples as f64).sqrt() + 1.0e-5;
            assert!(
                (mean.volts[1] - level).abs() < allowed
                    && (mean.volts[3] - 2.0 * level).abs() < allowed,
                "{mean:?}, level {level}"
            );
        }
        let times: Vec<f64> = thinned.means.iter().map(|mean| mean.time_s).collect();
        assert!(times.is_sorted_by(|a, b| a < b), "{times:?}");
        // Two rows enclose a step within three samples, and the last row before it averages several
        // samples.
        let before = times.partition_point(|time_s| *time_s < 7.0025) - 1;
        assert!(
            times[before + 1] - times[before] < 3.5 * INTERVAL_S,
            "{} {}",
            times[before],
            times[before + 1]
        );
        assert_eq!(
            (
                thinned.means[before].samples,
                thinned.means[before + 1].samples
            ),
            (BEFORE - 1, 1)
        );
        for sigma in [thinned.sigma_shunt_v, thinned.sigma_jig_v] {
            assert!((sigma / 1.0e-3 - 1.0).abs() < 0.05, "{sigma}");
        }
    }

    /// Two channels are read a microsecond apart: a sample within the step shows a current that
    /// never flowed, and must not move the step.
    #[test]
    fn a_sample_taken_in_the_step_does_not_move_it() {
        const STEP: usize = 5_000;
        let centre = |glitch_v: f64| {
            let mut capture = capture(&[(STEP + 1, 0.1)]);
            let glitch = (glitch_v / capture.meta.channels[1].scale.volts_per_code).round() as i16;
            capture.codes[1][STEP] += glitch;
            let means = thin(
                &capture,
                &[(4.9, 5.1)],
                &Thinning {
                    settle_s: 3e-3,
                    first_s: 6e-3,
                    ..THINNING
                },
            )
            .means;
            let after = means
                .iter()
                .position(|mean| mean.volts[1] > 0.05 && mean.samples < 5)
                .unwrap();
            0.5 * (means[after - 1].time_s + means[after].time_s) / INTERVAL_S
        };
        let still = centre(0.0);
        assert!((still - (STEP as f64 + 0.5)).abs() < 0.2, "{still}");
        for glitch_v in [0.35, -0.25] {
            assert!(
                (centre(glitch_v) - still).abs() < 0.2,
                "{} V: {}",
                glitch_v,
                centre(glitch_v)
            );
        }
    }

    #[test]
    fn rows_grow_with_the_time_since_the_step_and_leave_nothing_out() {
        let thinned = thin(&capture(&[(1_000, 0.2)]), &[(0.8, 1.2)], &THINNING);
        let after: Vec<usize> = thinned
            .means
            .iter()
            .filter(|mean| mean.time_s > 1.0)
            .map(|mean| mean.samples)
            .collect();
        assert_eq!(after[0..3], [1, 2, 2]);
        assert!(
            after[..after.len() - 1].is_sorted() && after.iter().all(|samples| *samples <= 751),
            "{after:?}"
        );
        // All but the moving sample and the one that stands alone, which lie within the first two
        // milliseconds.
        assert_eq!(after.iter().sum::<usize>(), 9_000 - 2 + 1);
        assert_eq!(
            thin(&capture(&[]), &[], &THINNING).steps_s,
            Vec::<f64>::new()
        );
    }
}
