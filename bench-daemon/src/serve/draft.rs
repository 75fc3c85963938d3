//! Drafts of experiments: what a text would do on a bench, or the field that is not as expected.
//! Touches nothing.

use std::path::Path;

use serde::Serialize;
use utoipa::ToSchema;

use super::{
    settings::Settings,
    submission::{ExperimentRequest, Refused, Submission},
};
use crate::{config::ConfigError, procedure};

/// A field that is not as expected.
#[derive(Debug, PartialEq, Serialize, ToSchema)]
pub struct Mistake {
    /// The field, from the top, such as `eis.amplitude`; items of a list by their number, from 1.
    /// Empty where it is about the whole.
    field: String,
    /// Expected and found.
    message: String,
    /// Line of the text, from 1.
    line: Option<usize>,
}

/// Demand of a plan beside a limit of the cell.
#[derive(Debug, PartialEq, Serialize, ToSchema)]
pub struct Margin {
    /// The quantity.
    quantity: &'static str,
    /// Its unit.
    unit: &'static str,
    /// Least that the plan asks for.
    planned_least: f64,
    /// Greatest that the plan asks for.
    planned_greatest: f64,
    /// The lower limit.
    least: f64,
    /// The upper limit.
    greatest: f64,
    /// The smaller distance of both.
    margin: f64,
}

/// From the least to the greatest value.
type Range = std::ops::RangeInclusive<f64>;

impl Margin {
    fn of(quantity: &'static str, unit: &'static str, planned: &Range, limits: &Range) -> Self {
        Self {
            quantity,
            unit,
            planned_least: *planned.start(),
            planned_greatest: *planned.end(),
            least: *limits.start(),
            greatest: *limits.end(),
            margin: (planned.start() - limits.start()).min(limits.end() - planned.end()),
        }
    }
}

/// A draft on a bench.
///
/// # Errors
/// The first mistake.
pub fn submission(
    settings: &Settings,
    text: &str,
    bench: Option<&str>,
) -> Result<Submission, Mistake> {
    let request = ExperimentRequest {
        name: "submitted",
        text: Some(text),
        bench,
    };
    Submission::new(settings, request).map_err(Mistake::from)
}

impl From<Refused> for Mistake {
    fn from(refused: Refused) -> Self {
        match refused {
            Refused::Mistake(error) => Self::from(error),
            other => Self::whole(other.to_string()),
        }
    }
}

/// The key of an experiment that names a file in this folder.
fn key_of(path: &Path) -> Option<&'static str> {
    match path.parent()?.file_name()?.to_str()? {
        "cells" => Some("cell"),
        "benches" => Some("bench"),
        _ => None,
    }
}

impl From<ConfigError> for Mistake {
    fn from(error: ConfigError) -> Self {
        match &error {
            // In a file that the draft names: told whole, at the key that names it.
            ConfigError::Field { path, .. } if key_of(path).is_some() => Self {
                field: key_of(path).unwrap_or_default().to_owned(),
                message: error.to_string(),
                line: None,
            },
            ConfigError::Field {
                line,
                field,
                reason,
                ..
            } => Self {
                field: field.clone(),
                message: reason.clone(),
                line: Some(*line),
            },
            other => Self::whole(other.to_string()),
        }
    }
}

impl Mistake {
    /// About the whole text.
    pub fn whole(message: String) -> Self {
        Self {
            field: String::new(),
            message,
            line: None,
        }
    }

    /// In one line.
    pub fn in_words(&self) -> String {
        match (self.field.as_str(), self.line) {
            ("", _) => self.message.clone(),
            (field, Some(line)) => format!("line {line}, {field}: {}", self.message),
            (field, None) => format!("{field}: {}", self.message),
        }
    }
}

/// Demands of the plan of a submission beside the limits of its cell.
pub fn margins(submission: &Submission) -> Vec<Margin> {
    let extent = procedure::plan(&submission.experiment).extent();
    let limits = &submission.experiment.cell.limits;
    let mut margins = Vec::new();
    if (extent.discharge_a, extent.charge_a) != (0.0, 0.0) {
        let planned = -extent.discharge_a..=extent.charge_a;
        let limits = -limits.discharge_a..=limits.charge_a;
        margins.push(Margin::of("Current", "A", &planned, &limits));
    }
    if let Some((least, greatest)) = extent.voltage_v {
        let limits = limits.min_v..=limits.max_v;
        margins.push(Margin::of(
            "Cell voltage",
            "V",
            &(least..=greatest),
            &limits,
        ));
    }
    if let Some((least, greatest)) = extent.temperature_c {
        let limits = limits.min_c..=limits.max_c;
        margins.push(Margin::of(
            "Cell temperature",
            "°C",
            &(least..=greatest),
            &limits,
        ));
    }
    margins
}
