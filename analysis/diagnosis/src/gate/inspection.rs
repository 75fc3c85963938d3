//! Data as the checks of the gate see them, and the result of a check.

use std::fmt;

use serde::Serialize;

use super::{
    super::data::{DataSet, Run, RunData, Sweep, TimeRecord},
    expected::{Expected, Prediction},
};
use crate::median::median;
use crate::thresholds::MEDIAN_STEP_SIGMAS;

/// Kind of fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Check {
    /// A file could not be read in its expected format.
    Unreadable,
    /// No data, too few, or lists of different lengths.
    Empty,
    /// Numbers that are not finite.
    NotFinite,
    /// Times that do not rise, or jump.
    TimesGoBack,
    /// Volts, amperes or ohms in thousandths or thousands.
    Unit,
    /// A current or an imaginary part of the wrong sign.
    Sign,
    /// Flat tops where the voltage must move.
    Clipped,
    /// The logged current follows the voltage late.
    CurrentLags,
    /// Not the spectrum of a linear system at rest.
    KramersKronig,
    /// The content belongs to another run.
    Swapped,
    /// A run that ends before its repeats.
    Truncated,
    /// A run that does not repeat its repeats.
    Repeats,
    /// A current that changes faster than it is logged, in every record.
    CurrentUnseen,
}

/// One reason why data cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Reason {
    /// Kind of fault.
    pub check: Check,
    /// The runs concerned.
    pub runs: Vec<String>,
    /// Text with the numbers.
    pub text: String,
}

impl Reason {
    /// Creates the entry of a run whose file could not be read; `text` gives the reason.
    pub fn unreadable(run: &str, text: &str) -> Self {
        Self {
            check: Check::Unreadable,
            runs: vec![run.to_owned()],
            text: text.to_owned(),
        }
    }
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.runs.join(", "), self.text)
    }
}

/// Findings of one check.
#[derive(Debug, Default)]
pub(super) struct Findings {
    pub(super) invalid: Vec<Reason>,
    pub(super) notes: Vec<String>,
}

impl Findings {
    pub(super) fn add(&mut self, check: Check, run: &Run, text: String) {
        self.invalid.push(Reason {
            check,
            runs: vec![run.name.clone()],
            text,
        });
    }
}

/// A run that has passed so far.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Subject<'a> {
    pub(crate) run: &'a Run,
    pub(crate) prediction: &'a Prediction,
}

impl<'a> Subject<'a> {
    /// Returns the record with its expected voltage, or `None` for a spectrum, or if nothing could
    /// be predicted.
    pub(crate) fn record(&self) -> Option<(&'a TimeRecord, &'a [f64])> {
        match (&self.run.data, self.prediction) {
            (RunData::Time(record), Prediction::Voltage(v, _))
                if v.len() == record.series.len() =>
            {
                Some((record, v))
            }
            _ => None,
        }
    }

    /// Error of the expected open-circuit voltage at this time after the start of a record, V, for
    /// a current reading that is wrong by one ampere.
    pub(super) fn counted_wrong_v(&self, time_s: f64) -> f64 {
        if let Prediction::Voltage(_, per_c_v) = self.prediction {
            per_c_v * time_s
        } else {
            0.0
        }
    }

    /// Returns the sweep with the impedance expected of it.
    pub(crate) fn sweep(&self) -> Option<(&'a Sweep, &'a [num_complex::Complex64])> {
        match (&self.run.data, self.prediction) {
            (RunData::Eis(sweep), Prediction::Impedance(z)) if z.len() == sweep.points.len() => {
                Some((sweep, z))
            }
            _ => None,
        }
    }
}

/// Inputs of a check.
pub(crate) struct Inspection<'a> {
    pub(crate) set: &'a DataSet,
    pub(crate) expected: &'a Expected,
    /// Runs that nothing was found against yet.
    pub(crate) runs: Vec<Subject<'a>>,
}

impl Inspection<'_> {
    /// Returns the standard deviation of one voltage sample, V: from the bench's history and the
    /// stated noise, otherwise the scatter of the record's own steps.
    pub(crate) fn sample_noise_v(&self, record: &TimeRecord) -> f64 {
        if let Some(h) = self.set.history {
            let stated = record
                .sigma_v
                .as_ref()
                .map_or(0.0, |sigma_v| median(sigma_v.clone()));
            return h
                .voltage_noise_v
                .hypot(h.voltage_resolution_v / 12f64.sqrt())
                .hypot(stated);
        }
        let steps: Vec<f64> = record
            .series
            .voltage_v
            .windows(2)
            .map(|w| (w[1] - w[0]).abs())
            .collect();
        median(steps) / MEDIAN_STEP_SIGMAS
    }
}
