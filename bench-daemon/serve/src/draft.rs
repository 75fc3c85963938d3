//! Drafts of files: the plan of an experiment on a bench, or the field that is not as expected,
//! and the keys in which two texts differ. Changes nothing.

use std::path::{Path, PathBuf};

use serde::Serialize;
use toml::Value;
use utoipa::ToSchema;

use instruments::units::Amps;

use super::{
    settings::Settings,
    shelf::{self, FileKind},
    submission::{ExperimentRequest, Refused, Submission},
};
use bench_plan::{
    config::{ConfigError, Fence, Source, resolve_bench, resolve_cell},
    procedure,
};

/// An invalid field.
#[derive(Debug, PartialEq, Serialize, ToSchema)]
pub struct Mistake {
    /// Path of the field, such as `eis.amplitude`. Items of a list are counted from 1. Empty for
    /// the whole text.
    field: String,
    /// What was expected and what was found.
    message: String,
    /// Line of the text, from 1.
    line: Option<usize>,
}

/// Requirement of a plan and the corresponding limit of the cell.
#[derive(Debug, PartialEq, Serialize, ToSchema)]
pub struct Margin {
    /// The quantity.
    quantity: &'static str,
    /// Its unit.
    unit: &'static str,
    /// Least planned value.
    planned_least: f64,
    /// Greatest planned value.
    planned_greatest: f64,
    /// The lower limit.
    least: f64,
    /// The upper limit.
    greatest: f64,
    /// The smaller of the two distances to the limits.
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

/// Checks whether a text may replace a file.
///
/// # Errors
/// The first mistake.
pub fn check(settings: &Settings, kind: FileKind, name: &str, text: &str) -> Result<(), Mistake> {
    match kind {
        FileKind::Experiments => {
            // Uses the bench that the experiment names if it belongs to this server, otherwise
            // the first one.
            let first = settings.benches.first().map(|bench| bench.name.as_str());
            submission(settings, text, None)
                .or_else(|_| submission(settings, text, first))
                .map(|_| ())
        }
        FileKind::Cells => check_cell(settings, name, text),
        FileKind::Benches => check_bench(settings, name, text),
    }
}

/// Treats a text as a file at a path. Files that it names are read in the configuration folder,
/// and in `also`.
fn fenced(
    settings: &Settings,
    path: &Path,
    text: &str,
    also: Vec<PathBuf>,
) -> Result<Source, Mistake> {
    let instead = shelf::changed(settings).map_err(|error| Mistake::whole(error.to_string()))?;
    let fence = Fence {
        below: settings.configs.clone(),
        also,
        instead,
    };
    Ok(Source::fenced(path, text.to_owned(), &fence.into()))
}

fn check_cell(settings: &Settings, name: &str, text: &str) -> Result<(), Mistake> {
    let folder = settings.configs.join(FileKind::Cells.folder());
    let path = folder.join(format!("{name}.toml"));
    let source = fenced(settings, &path, text, Vec::new())?;
    resolve_cell(&source)
        .map(|_| ())
        .map_err(|error| Mistake::within(&path, error))
}

fn check_bench(settings: &Settings, name: &str, text: &str) -> Result<(), Mistake> {
    let bench = settings.bench(name).ok_or_else(|| {
        Mistake::whole(format!("expected a bench of this server, found {name:?}"))
    })?;
    let scenario = bench.simulation.iter().map(|section| &section.scenario);
    let also = scenario.chain([&bench.path]).cloned().collect();
    let source = fenced(settings, &bench.path, text, also)?;
    let within = |error| Mistake::within(&bench.path, error);
    let proposed = resolve_bench(&source).map_err(within)?;
    if proposed.name != bench.name {
        let reason = format!(
            "expected {:?}, the name of this bench, found {:?}",
            bench.name, proposed.name
        );
        return Err(within(source.complain("name", reason)));
    }
    if let Some(simulation) = &proposed.simulation {
        source
            .open(&simulation.scenario)
            .map_err(|error| within(source.complain("simulation.scenario", error.to_string())))?;
    }
    Ok(())
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
            // The mistake is in a file that the draft names: it is reported in full, at the key
            // that names the file.
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
    /// Converts a mistake in the text at a path. A mistake in a file that the text names is
    /// reported in full.
    fn within(own: &Path, error: ConfigError) -> Self {
        match error {
            ConfigError::Field {
                path,
                line,
                field,
                reason,
            } if path == own => Self {
                field,
                message: reason,
                line: Some(line),
            },
            other => Self::whole(other.to_string()),
        }
    }

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

/// Returns the demands of the plan of a submission, with the limits of its cell.
pub fn margins(submission: &Submission) -> Vec<Margin> {
    let extent = procedure::plan(&submission.experiment).extent();
    let limits = &submission.experiment.cell.limits;
    let mut margins = Vec::new();
    if (extent.discharge_a, extent.charge_a) != (Amps(0.0), Amps(0.0)) {
        let planned = (-extent.discharge_a).value()..=extent.charge_a.value();
        let limits = (-limits.discharge_a).value()..=limits.charge_a.value();
        margins.push(Margin::of("Current", "A", &planned, &limits));
    }
    if let Some((least, greatest)) = extent.voltage_v {
        let limits = limits.min_v.value()..=limits.max_v.value();
        margins.push(Margin::of(
            "Cell voltage",
            "V",
            &(least.value()..=greatest.value()),
            &limits,
        ));
    }
    if let Some((least, greatest)) = extent.temperature_degc {
        let limits = limits.min_degc.value()..=limits.max_degc.value();
        margins.push(Margin::of(
            "Cell temperature",
            "°C",
            &(least.value()..=greatest.value()),
            &limits,
        ));
    }
    margins
}

/// A key whose value differs between two texts.
#[derive(Debug, PartialEq, Eq, Serialize, ToSchema)]
pub struct KeyChange {
    /// The key, from the top level, such as `wiring.command_trim`. Tables of a list are counted
    /// from 1.
    pub key: String,
    /// Its value before, TOML; null if the key was absent.
    pub was: Option<String>,
    /// Its value afterwards, TOML; null if the key was removed.
    pub now: Option<String>,
}

/// Returns the keys in which two texts differ, or `None` if one of them is not valid TOML.
pub fn key_changes(was: &str, now: &str) -> Option<Vec<KeyChange>> {
    let table = |text| toml::from_str(text).ok().map(Value::Table);
    let (was, now) = (table(was)?, table(now)?);
    let mut found = Vec::new();
    compare("", Some(&was), Some(&now), &mut found);
    Some(found)
}

fn compare(key: &str, was: Option<&Value>, now: Option<&Value>, found: &mut Vec<KeyChange>) {
    if was == now {
        return;
    }
    let both = parts(was).zip(parts(now));
    let Some((old, new)) = both.filter(|(old, new)| !(old.is_empty() && new.is_empty())) else {
        let text = |value: Option<&Value>| value.map(ToString::to_string);
        found.push(KeyChange {
            key: key.to_owned(),
            was: text(was),
            now: text(now),
        });
        return;
    };
    let added = new.iter().filter(|(name, _)| of(&old, name).is_none());
    for (name, _) in old.iter().chain(added) {
        let inner = if key.is_empty() {
            name.clone()
        } else {
            format!("{key}.{name}")
        };
        compare(&inner, of(&old, name), of(&new, name), found);
    }
}

/// Returns the values of a table, or of a list of tables, by name. Returns an empty list for a
/// missing value and `None` for a value of any other type.
fn parts(value: Option<&Value>) -> Option<Parts<'_>> {
    match value {
        None => Some(Vec::new()),
        Some(Value::Table(table)) => {
            let part = |(name, value): (&String, _)| (name.clone(), value);
            Some(table.iter().map(part).collect())
        }
        Some(Value::Array(all)) if !all.is_empty() && all.iter().all(Value::is_table) => {
            let part = |(place, value): (usize, _)| ((place + 1).to_string(), value);
            Some(all.iter().enumerate().map(part).collect())
        }
        Some(_) => None,
    }
}

type Parts<'a> = Vec<(String, &'a Value)>;

fn of<'a>(parts: &Parts<'a>, name: &str) -> Option<&'a Value> {
    let found = parts.iter().find(|(one, _)| one == name);
    found.map(|(_, value)| *value)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn change(key: &str, was: Option<&str>, now: Option<&str>) -> KeyChange {
        KeyChange {
            key: key.to_owned(),
            was: was.map(str::to_owned),
            now: now.map(str::to_owned),
        }
    }

    #[test]
    fn keys_that_differ_are_reported_with_both_values() {
        let was = "name = \"a\"\n[w]\ntrim = 1.0\nscale = [1, 2]\n[[x]]\nn = 1\n[old]\nk = 2\n";
        let now = "# said anew\nname = \"a\"\n[w]\nscale = [1, 3]\ntrim = 1.0\n[[x]]\nn = 1\n\
                   [[x]]\nn = true\n[new]\n";
        assert_eq!(
            key_changes(was, now).unwrap(),
            [
                change("w.scale", Some("[1, 2]"), Some("[1, 3]")),
                change("x.2.n", None, Some("true")),
                change("old.k", Some("2"), None),
                change("new", None, Some("{}")),
            ]
        );
        assert_eq!(key_changes(was, was), Some(Vec::new()));
        assert_eq!(key_changes(was, "name = "), None);
    }
}
