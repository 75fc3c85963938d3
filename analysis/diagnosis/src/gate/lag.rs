//! A logged current that lags behind the voltage.
//!
//! A first-order lag τ of the current equals a lag of the voltage predicted from it, because both
//! pass through the same linear cell: the measured voltage, delayed by τ, then fits the prediction.
//! The τ that fits best is the lag. A lag common to all records is the catalogue's
//! `current_smoothing` and passes; a record that lags more than its repeats is damaged.

use super::super::data::TimeRecord;
use super::{Check, Findings, Inspection, Subject};
use crate::median::median;
use crate::thresholds::{
    LAG_LEAST_MISSED, LAG_LEFT_PART, LAG_TIMES_OTHERS, LAG_TRIED_S, LAG_TRIES, LAG_UNEXPLAINED_PART,
};
use analysis_effects::augmented::Between;

pub(super) fn check(at: &Inspection<'_>) -> Findings {
    let mut found = Findings::default();
    let lags: Vec<(&Subject<'_>, f64, f64)> = at
        .runs
        .iter()
        .filter_map(|subject| {
            let (record, expected_v) = subject.record()?;
            Some((
                subject,
                lag_s(record, expected_v, at.sample_noise_v(record)),
                record.interval_s(),
            ))
        })
        .collect();
    let mut shared: Vec<f64> = Vec::new();
    for (k, (subject, lag_s, interval_s)) in lags.iter().enumerate() {
        // Rows further apart than the lag would not show it.
        let others = |same_group: bool, must_show: bool| -> Vec<f64> {
            let like = |(j, other): &(usize, &(&Subject<'_>, f64, f64))| {
                *j != k
                    && (!same_group || other.0.run.repeat_group == subject.run.repeat_group)
                    && (!must_show || other.1 > 0.0 || other.2 <= *lag_s)
            };
            lags.iter()
                .enumerate()
                .filter(like)
                .map(|(_, other)| other.1)
                .collect()
        };
        let like = [(true, true), (false, true), (false, false)]
            .into_iter()
            .map(|(same_group, must_show)| others(same_group, must_show))
            .find(|lags| !lags.is_empty())
            .unwrap_or_default();
        let alone = !like.is_empty()
            && !shares_filter(at, subject)
            && *lag_s > (LAG_TIMES_OTHERS * median(like)).max(*interval_s);
        if alone {
            let lagging: Vec<f64> = others(false, false)
                .into_iter()
                .filter(|lag_s| *lag_s > 0.0)
                .collect();
            let of_others = if lagging.is_empty() {
                "the other records' does not".to_owned()
            } else {
                format!(
                    "that of {} other records by {:.2} s in the middle",
                    lagging.len(),
                    median(lagging)
                )
            };
            let text =
                format!("its logged current lags by {lag_s:.2} s behind the voltage, {of_others}");
            found.add(Check::CurrentLags, subject.run, text);
        } else if *lag_s > 0.0 {
            shared.push(*lag_s);
        }
    }
    if !shared.is_empty() {
        found.notes.push(format!(
            "the logged current of {} records lags behind the voltage, by {:.3} s in the middle",
            shared.len(),
            median(shared)
        ));
    }
    found
}

/// Returns whether the record's lag is the filter that the logger puts on all.
fn shares_filter(at: &Inspection<'_>, subject: &Subject<'_>) -> bool {
    let filter = at.expected.filter.as_ref();
    filter.is_some_and(|filter| filter.holds(&subject.run.name))
}

/// Returns the lag that explains most of the prediction's error, s; zero if no lag explains much.
fn lag_s(record: &TimeRecord, expected_v: &[f64], noise_v: f64) -> f64 {
    let (now, _) = squares(&record.series.voltage_v, expected_v);
    let floor = noise_v * noise_v * expected_v.len() as f64;
    let ((low, high), count) = (LAG_TRIED_S, LAG_TRIES);
    let tried = (0..count).map(|k| low * (high / low).powf(k as f64 / (count - 1) as f64));
    let best = tried
        .map(|tau_s| (tau_s, squares(&delayed(record, tau_s), expected_v)))
        .min_by(|a, b| a.1.0.total_cmp(&b.1.0));
    match best {
        Some((tau_s, (left, whole)))
            if now > LAG_LEAST_MISSED * floor
                && left < LAG_LEFT_PART * now
                && left < LAG_UNEXPLAINED_PART * whole =>
        {
            tau_s
        }
        _ => 0.0,
    }
}

/// Returns the voltage through a first-order low-pass, V.
fn delayed(record: &TimeRecord, tau_s: f64) -> Vec<f64> {
    let (t, v) = (&record.series.time_s, &record.series.voltage_v);
    let mut state = v[0];
    let mut all = Vec::with_capacity(v.len());
    all.push(state);
    for k in 1..v.len() {
        let x = (t[k] - t[k - 1]) / tau_s;
        let decay = (-x).exp();
        state = match record.between {
            Between::Hold => decay * state + (1.0 - decay) * v[k - 1],
            Between::Linear => {
                let slope = (v[k] - v[k - 1]) / x;
                // The answer to a ramp lags by one τ.
                v[k] - slope + decay * (state - v[k - 1] + slope)
            }
        };
        all.push(state);
    }
    all
}

/// Returns the residual squares of the fit a + b·expected, because level and resistance may differ,
/// and the squares of the voltage about its mean.
fn squares(voltage_v: &[f64], expected_v: &[f64]) -> (f64, f64) {
    let n = voltage_v.len() as f64;
    let mean = |all: &[f64]| all.iter().sum::<f64>() / n;
    let (mv, me) = (mean(voltage_v), mean(expected_v));
    let pairs = || {
        voltage_v
            .iter()
            .zip(expected_v)
            .map(|(v, e)| (v - mv, e - me))
    };
    let (vv, ve, ee) = pairs().fold((0.0, 0.0, 0.0), |(a, b, c), (v, e)| {
        (a + v * v, b + v * e, c + e * e)
    });
    (
        if ee > 0.0 {
            (vv - ve * ve / ee).max(0.0)
        } else {
            vv
        },
        vv,
    )
}
