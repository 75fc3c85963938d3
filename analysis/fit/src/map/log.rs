//! A log with the state of its cell at each sample.

use super::options::{MapFitError, MapLog};
use crate::loads::{CUT_S, Counted, drawn_by_counter};
use analysis_model::{map::TEMPERATURES_DEGC, ocv::OcvCurve};
use analysis_signal::series::Role;
use std::{borrow::Cow, ops::Range};

/// Current below which a cell is at rest, as a part of the capacity per hour.
const REST_C_RATE: f64 = 0.01;
/// Rows of a log at most.
const MOST_ROWS: usize = 6000;
/// SOC beyond which counted charge is wrong.
const SOC_BEYOND: (f64, f64) = (-0.1, 1.1);
/// Difference of the voltages before and after a gap at rest within which nothing has happened, V.
const SAME_REST_V: f64 = 0.005;
/// Charge that a counter may move within a rest, as a part of the capacity.
const SAME_CHARGE: f64 = 1e-4;

/// A log with its state at each sample.
#[derive(Debug, Clone)]
pub(super) struct Log {
    pub(super) name: String,
    pub(super) role: Role,
    pub(super) samples: Samples,
    /// First samples of its parts. Between two parts an unknown time passes under an unknown
    /// current, so that the branches of each part begin at rest.
    begins: Vec<usize>,
    pub(super) temperature_measured: bool,
    /// Remarks on its charge.
    pub(super) remarks: Vec<String>,
}

/// Columns of a log, of equal length.
#[derive(Debug, Clone)]
pub(super) struct Samples {
    pub(super) time_s: Vec<f64>,
    pub(super) current_a: Vec<f64>,
    pub(super) voltage_v: Vec<f64>,
    pub(super) temperature_degc: Vec<f64>,
    pub(super) soc: Vec<f64>,
    /// OCV of the curve, V.
    pub(super) ocv_v: Vec<f64>,
}

impl Log {
    pub(super) fn new(log: &MapLog, ocv: &OcvCurve) -> Result<Self, MapFitError> {
        let series = &log.series;
        let name = series.name.clone();
        series
            .validate()
            .map_err(|error| MapFitError::Series(format!("{name}: {error}")))?;
        if !series.current_a.iter().any(|i| i.abs() > 1e-3) {
            return Err(MapFitError::NoCurrent { log: name });
        }
        let measured = series.temperature_degc.as_deref().and_then(filled);
        let temperature_measured = measured.is_some();
        let temperature_degc = match (measured, log.temperature_degc) {
            (Some(column), _) => column,
            (None, Some(degc)) => vec![degc; series.len()],
            (None, None) => return Err(MapFitError::Temperature { log: name }),
        };
        check_temperatures(&name, &temperature_degc)?;
        let Counts {
            soc,
            begins,
            remarks,
        } = counted(log, ocv)?;
        Ok(Self {
            role: log.role,
            samples: Samples {
                ocv_v: soc.iter().map(|z| ocv.voltage_v(*z)).collect(),
                time_s: series.time_s.clone(),
                current_a: series.current_a.clone(),
                voltage_v: series.voltage_v.clone(),
                temperature_degc,
                soc,
            },
            begins,
            remarks,
            temperature_measured,
            name,
        })
    }

    pub(super) fn len(&self) -> usize {
        self.samples.time_s.len()
    }

    /// Distance of the samples that become rows.
    pub(super) fn every(&self) -> usize {
        self.len().div_ceil(MOST_ROWS)
    }

    /// Number of rows.
    pub(super) fn rows(&self) -> usize {
        self.len().div_ceil(self.every())
    }

    pub(super) fn mean_degc(&self) -> f64 {
        self.samples.temperature_degc.iter().sum::<f64>() / self.len() as f64
    }

    /// Power that the overpotential turns into heat at a sample, W.
    pub(super) fn heat_w(&self, k: usize) -> f64 {
        self.samples.current_a[k] * (self.samples.ocv_v[k] - self.samples.voltage_v[k])
    }

    /// Samples of each part.
    pub(super) fn parts(&self) -> impl Iterator<Item = Range<usize>> {
        let ends = self.begins[1..].iter().copied().chain([self.len()]);
        self.begins.iter().copied().zip(ends).map(|(a, b)| a..b)
    }

    /// Returns whether a part begins at a sample.
    pub(super) fn begins_at(&self, k: usize) -> bool {
        self.begins.binary_search(&k).is_ok()
    }

    /// Distance of two samples, s, the median.
    pub(super) fn step_s(&self) -> f64 {
        let mut steps: Vec<f64> = self
            .samples
            .time_s
            .windows(2)
            .map(|w| w[1] - w[0])
            .collect();
        let middle = steps.len() / 2;
        *steps.select_nth_unstable_by(middle, f64::total_cmp).1
    }

    /// Longest part, s.
    pub(super) fn longest_s(&self) -> f64 {
        let time_s = &self.samples.time_s;
        let durations = self
            .parts()
            .map(|part| time_s[part.end - 1] - time_s[part.start]);
        durations.fold(0.0, f64::max)
    }

    /// Returns the current of the log `lag_s` before each sample, A: that of the voltage, if the
    /// recorder reads the voltage before the current.
    pub(super) fn lagged_a(&self, lag_s: f64) -> Cow<'_, [f64]> {
        let (time_s, current_a) = (&self.samples.time_s, &self.samples.current_a);
        if lag_s == 0.0 {
            return Cow::Borrowed(current_a);
        }
        let last = time_s.len() - 1;
        let at = |t: f64| {
            let high = time_s.partition_point(|time| *time < t).clamp(1, last);
            let step_s = time_s[high] - time_s[high - 1];
            let share = ((t - time_s[high - 1]) / step_s).clamp(0.0, 1.0);
            current_a[high - 1] + share * (current_a[high] - current_a[high - 1])
        };
        time_s.iter().map(|t| at(t - lag_s)).collect()
    }

    /// Returns the current of the first sample if it flows there, A.
    pub(super) fn current_at_start_a(&self, capacity_ah: f64) -> Option<f64> {
        let current_a = self.samples.current_a[0];
        (current_a.abs() > REST_C_RATE * capacity_ah).then_some(current_a)
    }
}

/// Checks that a cell can have these temperatures.
pub(super) fn check_temperatures(name: &str, list: &[f64]) -> Result<(), MapFitError> {
    let wrong = list.iter().find(|t| !TEMPERATURES_DEGC.contains(*t));
    let Some(met) = wrong else { return Ok(()) };
    let kelvin = (200.0..400.0).contains(met);
    let hint = if kelvin {
        ": is the column in kelvin?"
    } else {
        ""
    };
    Err(MapFitError::NoCell {
        log: name.to_owned(),
        met: *met,
        hint,
    })
}

/// Temperatures with the last one known in place of a missing one; `None` if all are missing.
fn filled(column: &[f64]) -> Option<Vec<f64>> {
    let mut last = *column.iter().find(|t| t.is_finite())?;
    let known = column.iter().map(|t| {
        if t.is_finite() {
            last = *t;
        }
        last
    });
    Some(known.collect())
}

/// Result of counting the charge.
pub(super) struct Counts {
    pub(super) soc: Vec<f64>,
    pub(super) begins: Vec<usize>,
    remarks: Vec<String>,
}

/// Finds the SOC at each sample, and the samples at which a part begins.
///
/// The charge is that of the log's counter, if it has one that follows the current. Otherwise it is
/// counted, and the curve gives it again at the rest after each gap.
pub(super) fn counted(log: &MapLog, ocv: &OcvCurve) -> Result<Counts, MapFitError> {
    let series = &log.series;
    let name = || series.name.clone();
    let at_rest = |k: usize| series.current_a[k].abs() <= REST_C_RATE * ocv.capacity_ah;
    let of_rest = |k: usize| {
        let met_v = series.voltage_v[k];
        ocv.soc_at(met_v).ok_or_else(|| MapFitError::RestVoltage {
            log: name(),
            time_s: series.time_s[k],
            met_v,
            low_v: ocv.ocv_v[0],
            high_v: ocv.ocv_v[ocv.ocv_v.len() - 1],
        })
    };
    let start = match log.soc_start {
        Some(soc) => soc,
        None if !at_rest(0) => {
            let current_a = series.current_a[0];
            return Err(MapFitError::Start {
                log: name(),
                current_a,
            });
        }
        None => of_rest(0)?,
    };
    let counter = log
        .net_ah
        .as_deref()
        .map(|net_ah| drawn_by_counter(series, net_ah));
    let (drawn_ah, has_counter, counter_refusal) = match counter {
        Some(Ok(drawn_ah)) => (drawn_ah, true, None),
        Some(Err(reason)) => (Counted::of(series).charge_ah, false, Some(reason)),
        None => (Counted::of(series).charge_ah, false, None),
    };
    let (mut soc, mut begins) = (Vec::with_capacity(series.len()), vec![0]);
    let (mut from, mut from_ah, mut anchors) = (start, drawn_ah[0], 0_usize);
    for k in 0..series.len() {
        if k > 0 && series.time_s[k] - series.time_s[k - 1] > CUT_S {
            let drawn = (drawn_ah[k] - drawn_ah[k - 1]).abs();
            let same_v = (series.voltage_v[k] - series.voltage_v[k - 1]).abs() < SAME_REST_V;
            let rests = at_rest(k - 1) && at_rest(k);
            // A rest is one part. In any other gap, charge may have moved.
            let is_rest = rests
                && if has_counter {
                    drawn < SAME_CHARGE * ocv.capacity_ah
                } else {
                    same_v
                };
            if !is_rest {
                begins.push(k);
            }
            if !is_rest && !has_counter {
                if !at_rest(k) {
                    let time_s = series.time_s[k];
                    return Err(MapFitError::Gap {
                        log: name(),
                        time_s,
                    });
                }
                (from, from_ah) = (of_rest(k)?, drawn_ah[k]);
                anchors += 1;
            }
        }
        let met = from - (drawn_ah[k] - from_ah) / ocv.capacity_ah;
        if !(SOC_BEYOND.0..=SOC_BEYOND.1).contains(&met) {
            let capacity_ah = ocv.capacity_ah;
            return Err(MapFitError::Charge {
                log: name(),
                met,
                capacity_ah,
                start: from,
            });
        }
        soc.push(met);
    }
    let mut remarks: Vec<String> = counter_refusal.into_iter().collect();
    if anchors > 0 {
        remarks.push(format!(
            "its charge starts again from the voltage at rest after {anchors} gaps"
        ));
    }
    Ok(Counts {
        soc,
        begins,
        remarks,
    })
}
