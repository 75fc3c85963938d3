//! Current and voltage of a cell over time, as a cycler or the bench recorded them.
//!
//! Here **discharge is positive**; the readers in `formats` turn the sign of their files.
//! Nothing is resampled or smoothed.

use std::ops::Range;

use serde::{Deserialize, Serialize};

/// Purpose of a run.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// To be fitted.
    #[default]
    Train,
    /// To be predicted only.
    HeldOut,
}

/// Current and voltage over time.
#[derive(Debug, Clone, PartialEq)]
pub struct TimeSeries {
    /// Origin of the series: a file name, a run.
    pub name: String,
    /// Time, s, rising from sample to sample.
    pub time_s: Vec<f64>,
    /// Current, A, positive for discharge.
    pub current_a: Vec<f64>,
    /// Voltage of the cell, V.
    pub voltage_v: Vec<f64>,
    /// Temperature of the cell, °C; NaN where it was not measured. `None` if the file has no
    /// temperatures.
    pub temperature_degc: Option<Vec<f64>>,
}

/// Reason why numbers are not a valid time series.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SeriesError {
    /// Lists of different lengths, or less than two samples.
    #[error(
        "time series {name:?}: expected at least 2 samples and as many currents and voltages as \
        times, met {time}, {current} and {voltage}"
    )]
    Lengths {
        /// Name of the series.
        name: String,
        /// Number of times.
        time: usize,
        /// Number of currents.
        current: usize,
        /// Number of voltages.
        voltage: usize,
    },
    /// A sample that cannot be.
    #[error(
        "time series {name:?}, sample {number} (counted from 1): expected {expected}, met {met}"
    )]
    Sample {
        /// Name of the series.
        name: String,
        /// Number of the sample, from 1.
        number: usize,
        /// Allowed values, as text.
        expected: &'static str,
        /// Value found.
        met: f64,
    },
}

impl TimeSeries {
    /// Checks lengths, that times rise and that currents and voltages are finite.
    ///
    /// # Errors
    /// [`SeriesError`] for the first thing that is wrong.
    pub fn validate(&self) -> Result<(), SeriesError> {
        let (time, current, voltage) = (
            self.time_s.len(),
            self.current_a.len(),
            self.voltage_v.len(),
        );
        let temperatures = self.temperature_degc.as_ref().map_or(time, Vec::len);
        if time < 2 || current != time || voltage != time || temperatures != time {
            return Err(SeriesError::Lengths {
                name: self.name.clone(),
                time,
                current,
                voltage,
            });
        }
        let fail = |k: usize, expected, met| {
            Err(SeriesError::Sample {
                name: self.name.clone(),
                number: k + 1,
                expected,
                met,
            })
        };
        for k in 0..time {
            let rises = k == 0 || self.time_s[k] > self.time_s[k - 1];
            if !(self.time_s[k].is_finite() && rises) {
                return fail(k, "times in s that rise", self.time_s[k]);
            }
            if !self.current_a[k].is_finite() {
                return fail(k, "a finite current in A", self.current_a[k]);
            }
            if !self.voltage_v[k].is_finite() {
                return fail(k, "a finite voltage in V", self.voltage_v[k]);
            }
        }
        Ok(())
    }

    /// Returns the number of samples.
    pub fn len(&self) -> usize {
        self.time_s.len()
    }

    /// Returns whether the series has no samples.
    pub fn is_empty(&self) -> bool {
        self.time_s.is_empty()
    }

    /// Returns the charge drawn since the first sample, C, by trapezia.
    pub fn charge_coulomb(&self) -> Vec<f64> {
        let mut sum = 0.0;
        let step = |k: usize| {
            if k > 0 {
                sum += 0.5
                    * (self.current_a[k] + self.current_a[k - 1])
                    * (self.time_s[k] - self.time_s[k - 1]);
            }
            sum
        };
        (0..self.len()).map(step).collect()
    }

    /// Returns the samples from one time to another, both included, s in the record's own time.
    #[must_use]
    pub fn between(&self, from_s: f64, to_s: f64) -> Self {
        let first = self.time_s.partition_point(|t| *t < from_s);
        let last = self.time_s.partition_point(|t| *t <= to_s).max(first);
        let part = |values: &[f64]| values[first..last].to_vec();
        Self {
            name: self.name.clone(),
            time_s: part(&self.time_s),
            current_a: part(&self.current_a),
            voltage_v: part(&self.voltage_v),
            temperature_degc: self.temperature_degc.as_deref().map(part),
        }
    }

    /// Returns the longest stretch (in charge) in which the current keeps the sign of `direction`
    /// (+1 discharge, −1 charge) and is above a tenth of the largest current of that sign; empty
    /// without such a stretch.
    pub fn longest_stretch(&self, direction: f64) -> Range<usize> {
        let most = self
            .current_a
            .iter()
            .fold(0.0f64, |m, i| m.max(direction * i));
        let charge = self.charge_coulomb();
        let (mut best, mut start) = (0..0, None);
        for k in 0..=self.len() {
            let flows = self
                .current_a
                .get(k)
                .is_some_and(|i| direction * i > 0.1 * most);
            match (flows, start) {
                (true, None) => start = Some(k),
                (false, Some(first)) => {
                    let gain = |r: &Range<usize>| {
                        if r.is_empty() {
                            0.0
                        } else {
                            (charge[r.end - 1] - charge[r.start]).abs()
                        }
                    };
                    if gain(&(first..k)) > gain(&best) {
                        best = first..k;
                    }
                    start = None;
                }
                _ => {}
            }
        }
        best
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn series(current_a: Vec<f64>) -> TimeSeries {
        let n = current_a.len();
        let time_s = (0..n).map(|k| 2.0 * k as f64).collect();
        TimeSeries {
            name: "s".to_owned(),
            time_s,
            current_a,
            voltage_v: vec![3.7; n],
            temperature_degc: None,
        }
    }

    #[test]
    fn a_window_holds_its_ends_and_may_be_empty() {
        let s = series(vec![0.0, 1.0, 2.0, 3.0]);
        assert_eq!(s.between(2.0, 4.0).current_a, [1.0, 2.0]);
        assert_eq!(s.between(f64::NEG_INFINITY, f64::INFINITY), s);
        assert!(s.between(2.5, 3.0).is_empty() && s.between(9.0, 12.0).is_empty());
    }

    #[test]
    fn charge_of_a_ramp_is_its_triangle() {
        // 0, 1, 2, 3 A over 6 s: ½·3 A·6 s.
        assert_eq!(
            series(vec![0.0, 1.0, 2.0, 3.0]).charge_coulomb(),
            [0.0, 1.0, 4.0, 9.0]
        );
    }

    #[test]
    fn the_longest_stretch_is_by_charge_and_of_one_sign() {
        let s = series(vec![
            0.0, 1.0, 1.0, 1.0, 0.0, -3.0, -3.0, 0.0, 2.0, 2.0, 2.0,
        ]);
        assert_eq!(s.longest_stretch(1.0), 8..11);
        assert_eq!(s.longest_stretch(-1.0), 5..7);
        assert!(series(vec![0.0; 3]).longest_stretch(1.0).is_empty());
    }

    #[test]
    fn refuses_what_is_not_a_series() {
        let mut backwards = series(vec![1.0; 3]);
        backwards.time_s[2] = 2.0;
        let mut hole = series(vec![1.0; 3]);
        hole.voltage_v[1] = f64::NAN;
        let mut short = series(vec![1.0; 3]);
        short.voltage_v.pop();
        for (s, text) in [
            (
                backwards,
                "time series \"s\", sample 3 (counted from 1): expected times in s that rise, met \
                2",
            ),
            (
                hole,
                "time series \"s\", sample 2 (counted from 1): expected a finite voltage in V, met \
                NaN",
            ),
            (
                short,
                "time series \"s\": expected at least 2 samples and as many currents and voltages \
                as times, met 3, 3 and 2",
            ),
        ] {
            assert_eq!(s.validate().unwrap_err().to_string(), text);
        }
    }
}
