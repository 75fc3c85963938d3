//! Currents of two records compared over the time that they share.

use super::super::data::TimeRecord;
use analysis_effects::augmented::Between;

/// Returns the root mean square of the difference over the time that both records cover, as a
/// fraction of the larger one's, or `None` if less than `least_a` flows in either, A: the readings
/// of a channel without a current are noise, and always differ.
pub(super) fn difference(a: &TimeRecord, b: &TimeRecord, least_a: f64) -> Option<f64> {
    let (t, ia) = (&a.series.time_s, &a.series.current_a);
    let end_s = b.series.time_s.last().copied()?;
    let (mut apart, mut of_a, mut of_b, mut from, mut span_s) = (0.0, 0.0, 0.0, 0, 0.0);
    for k in 0..t.len().saturating_sub(1) {
        let middle_s = 0.5 * (t[k] + t[k + 1]);
        if middle_s > end_s {
            break;
        }
        let step_s = t[k + 1] - t[k];
        span_s += step_s;
        let here = if a.between == Between::Hold {
            ia[k]
        } else {
            0.5 * (ia[k] + ia[k + 1])
        };
        let there = at(b, middle_s, &mut from);
        apart += step_s * (here - there).powi(2);
        of_a += step_s * here * here;
        of_b += step_s * there * there;
    }
    let size = of_a.max(of_b);
    (size > least_a * least_a * span_s).then(|| (apart / size).sqrt())
}

/// Returns the current at a time not before the last requested one.
fn at(record: &TimeRecord, time_s: f64, from: &mut usize) -> f64 {
    let (t, i) = (&record.series.time_s, &record.series.current_a);
    while *from + 2 < t.len() && t[*from + 1] <= time_s {
        *from += 1;
    }
    let k = *from;
    match record.between {
        Between::Hold => i[k],
        Between::Linear => {
            i[k] + (i[k + 1] - i[k]) * ((time_s - t[k]) / (t[k + 1] - t[k])).clamp(0.0, 1.0)
        }
    }
}
