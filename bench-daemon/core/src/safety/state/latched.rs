//! Reasons why a bench is latched.

use std::path::{Path, PathBuf};

use instruments::{clock, units::Seconds};
use serde::{Deserialize, Serialize};

use bench_plan::interlock::Trip;

/// Why a bench must not run until a person has cleared the latch.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Latched {
    /// The cause as text.
    pub cause: String,
    /// Quantity that left its limits, if the cause was a reading.
    pub quantity: Option<String>,
    /// Its value.
    pub value: Option<f64>,
    /// Its unit.
    pub unit: Option<String>,
    /// Its limits; an infinite limit is stored as `None`.
    pub limits: Option<(Option<f64>, Option<f64>)>,
    /// Bench time of the run, s.
    pub bench_time_s: Option<Seconds>,
    /// The run folder.
    pub run: Option<PathBuf>,
    /// The step that was being executed.
    pub step: Option<String>,
    /// The process that found the cause: `daemon`, `guardian` or `safe`.
    pub by: String,
    /// When, s since 1970.
    pub unix_s: f64,
}

impl std::fmt::Display for Latched {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.cause)?;
        if let Some(step) = self.step.as_ref().filter(|step| !step.is_empty()) {
            write!(f, " in step \"{step}\"")?;
        }
        self.run
            .as_ref()
            .map_or(Ok(()), |run| write!(f, " of {}", run.display()))
    }
}

impl Latched {
    /// Creates a latch whose cause is not a reading.
    pub fn new(by: &str, cause: &str) -> Self {
        Self {
            cause: cause.to_owned(),
            quantity: None,
            value: None,
            unit: None,
            limits: None,
            bench_time_s: None,
            run: None,
            step: None,
            by: by.to_owned(),
            unix_s: clock::unix_time_s(),
        }
    }

    /// Creates the latch for a trip of the interlock.
    pub fn of_trip(by: &str, trip: &Trip) -> Self {
        let latched = Self::new(by, &format!("interlock: {trip}"));
        match trip {
            Trip::Caused { trip, .. } => Self {
                cause: latched.cause,
                ..Self::of_trip(by, trip)
            },
            Trip::Chiller { time_s, .. }
            | Trip::Bath { time_s, .. }
            | Trip::Thermometer { time_s, .. } => Self {
                bench_time_s: Some(*time_s),
                ..latched
            },
            Trip::Limit {
                what,
                value,
                unit,
                least,
                greatest,
                time_s,
            } => {
                let finite = |value: f64| Some(value).filter(|value| value.is_finite());
                Self {
                    quantity: Some((*what).to_owned()),
                    value: finite(*value),
                    unit: Some((*unit).to_owned()),
                    limits: Some((finite(*least), finite(*greatest))),
                    bench_time_s: Some(*time_s),
                    ..latched
                }
            }
        }
    }

    /// Adds the run and the step.
    #[must_use]
    pub fn during(self, run: &Path, step: &str) -> Self {
        Self {
            run: Some(run.to_owned()),
            step: Some(step.to_owned()),
            ..self
        }
    }
}
