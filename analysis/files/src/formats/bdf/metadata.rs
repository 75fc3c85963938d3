//! Metadata beside a file of BDF: `x.bdf.metadata.json` beside `x.bdf.csv` and `x.bdf.parquet`;
//! `x.bdf.csv.metadata.json`, as `batterydf` 0.1.0 writes it, is read too.
//!
//! The section `battinfo_dataset` describes the data set and its columns. Other data of a spectrum
//! (its name and its origin) are stored in the free section `extras`, under the name of the
//! project.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};

use super::super::FileSpectra;
use super::super::error::FormatError;
use super::spectrum::{Further, further, is_standard};
use analysis_signal::spectrum::{OcvSlope, Origin, SourcedSpectrum};

/// Section that describes the data set.
const DATASET: &str = "battinfo_dataset";
/// Free section.
const EXTRAS: &str = "extras";
/// The project's part of it.
const OWN: &str = "eis_bench";
/// Mark of BDF in the names of files.
const MARK: &str = ".bdf";

/// Metadata of a file.
#[derive(Debug, Clone, PartialEq)]
pub struct BdfMetadata {
    /// The file that holds them.
    pub file: PathBuf,
    /// The sections.
    pub sections: Map<String, Value>,
}

/// The project's own metadata of a spectrum.
#[derive(Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Own {
    #[serde(default, skip_serializing_if = "Option::is_none")]
    name: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    fixture: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    cell: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    repeat: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    bias_a: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    curve: Option<String>,
    /// Slope of the open-circuit voltage whose contribution was subtracted from the points.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    less: Option<OcvSlope>,
}

/// Returns the path of the metadata file of a BDF file.
pub fn bdf_metadata_path(path: &Path) -> PathBuf {
    path.with_extension("metadata.json")
}

/// Returns whether a file has a BDF name: `x.bdf`, `x.bdf.csv`.
fn is_named(path: &Path) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let name = name.to_lowercase();
    name.ends_with(MARK) || name.contains(&format!("{MARK}."))
}

/// Reads the metadata beside a BDF file; returns `None` if there are none.
///
/// # Errors
/// [`FormatError::Read`]; [`FormatError::Decode`] for a file that is not a JSON object of sections.
pub fn read_bdf_metadata(path: &Path) -> Result<Option<BdfMetadata>, FormatError> {
    if !is_named(path) {
        return Ok(None);
    }
    let whole = path.file_name().unwrap_or_default().to_string_lossy();
    let older = path.with_file_name(format!("{whole}.metadata.json"));
    let found = [bdf_metadata_path(path), older];
    let Some(file) = found.into_iter().find(|file| file.is_file()) else {
        return Ok(None);
    };
    let bytes = std::fs::read(&file).map_err(|source| FormatError::Read {
        file: file.clone(),
        source,
    })?;
    let read: Value =
        serde_json::from_slice(&bytes).map_err(|error| refused(&file, &error.to_string()))?;
    let Value::Object(sections) = read else {
        return Err(refused(&file, "expected an object of sections"));
    };
    let dataset = sections.get(DATASET);
    let objects = [
        (DATASET, dataset),
        (
            "battinfo_dataset.dataset",
            dataset.and_then(|one| one.get("dataset")),
        ),
        (EXTRAS, sections.get(EXTRAS)),
    ];
    for (place, met) in objects {
        if met.is_some_and(|met| !met.is_object() && !met.is_null()) {
            let reason = format!("expected an object as {place}");
            return Err(refused(&file, &reason));
        }
    }
    Ok(Some(BdfMetadata { file, sections }))
}

fn refused(file: &Path, reason: &str) -> FormatError {
    FormatError::Decode {
        file: file.to_owned(),
        kind: "metadata of BDF (JSON)",
        reason: reason.to_owned(),
    }
}

impl BdfMetadata {
    /// Returns the sections with content that the project does not read.
    pub fn unread(&self) -> Vec<&str> {
        let says_more = |(name, section): &(&String, &Value)| match name.as_str() {
            DATASET => {
                let dataset = section.get("dataset").and_then(Value::as_object);
                let read = |key: &String| matches!(key.as_str(), "name" | "variable_measured");
                dataset.is_some_and(|dataset| !dataset.keys().all(read))
            }
            EXTRAS => {
                let extras = section.as_object();
                extras.is_some_and(|extras| extras.keys().any(|key| key != OWN))
            }
            _ => true,
        };
        let more = self.sections.iter().filter(says_more);
        more.map(|(name, _)| name.as_str()).collect()
    }

    fn own(&self) -> Option<&Value> {
        self.sections.get(EXTRAS)?.get(OWN)
    }
}

/// Adds the metadata of a BDF file to its spectra.
///
/// # Errors
/// As [`read_bdf_metadata`], and if the project's section is malformed.
pub(in crate::formats) fn attach(path: &Path, read: &mut FileSpectra) -> Result<(), FormatError> {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    for one in &mut read.spectra {
        let name = &mut one.spectrum.name;
        if let Some(plain) = name.strip_suffix(MARK).filter(|_| *name == stem) {
            *name = plain.to_owned();
        }
    }
    let metadata = read_bdf_metadata(path)?;
    let own = metadata
        .as_ref()
        .and_then(|one| Some((&one.file, one.own()?)));
    let (Some((file, own)), [only]) = (own, read.spectra.as_mut_slice()) else {
        return Ok(());
    };
    let own: Own = serde_json::from_value(own.clone())
        .map_err(|error| refused(file, &format!("{EXTRAS}.{OWN}: {error}")))?;
    let Own {
        name,
        fixture,
        cell,
        repeat,
        bias_a,
        curve,
        less,
    } = own;
    if let Some(name) = name {
        only.spectrum.name = name;
    }
    only.spectrum.less = less;
    only.origin = Origin {
        fixture,
        cell,
        repeat,
        bias_a,
        curve,
    };
    Ok(())
}

/// Returns the metadata of a spectrum as JSON, merged with the metadata of its source. Descriptions
/// of columns that are not written are left out, because BDF refuses them.
pub fn bdf_metadata_text(sourced: &SourcedSpectrum, source: Option<&BdfMetadata>) -> String {
    let SourcedSpectrum {
        origin, spectrum, ..
    } = sourced;
    let mut sections = source.map_or_else(Map::new, |source| source.sections.clone());
    let mut section = take(&mut sections, DATASET);
    let mut dataset = take(&mut section, "dataset");
    dataset
        .entry("name")
        .or_insert_with(|| json!(spectrum.name));
    let mut described = match dataset.remove("variable_measured") {
        Some(Value::Array(described)) => described,
        _ => Vec::new(),
    };
    described.retain(|one| one["name"].as_str().is_some_and(is_standard));
    let further = further(sourced).into_iter().map(
        |Further { name, unit, doc }| json!({"name": name, "unit_text": unit, "description": doc}),
    );
    described.extend(further);
    if !described.is_empty() {
        dataset.insert("variable_measured".to_owned(), Value::Array(described));
    }
    section.insert("dataset".to_owned(), Value::Object(dataset));
    sections.insert(DATASET.to_owned(), Value::Object(section));
    let own = Own {
        name: Some(spectrum.name.clone()),
        fixture: origin.fixture.clone(),
        cell: origin.cell.clone(),
        repeat: origin.repeat.clone(),
        bias_a: origin.bias_a,
        curve: origin.curve.clone(),
        less: spectrum.less,
    };
    let mut extras = take(&mut sections, EXTRAS);
    extras.insert(OWN.to_owned(), json!(own));
    sections.insert(EXTRAS.to_owned(), Value::Object(extras));
    // A tree of texts and finite numbers can always be serialised as JSON.
    serde_json::to_string_pretty(&sections).unwrap_or_default() + "\n"
}

/// Removes an object from another one and returns it; returns an empty object if there is none.
fn take(of: &mut Map<String, Value>, name: &str) -> Map<String, Value> {
    match of.remove(name) {
        Some(Value::Object(map)) => map,
        _ => Map::new(),
    }
}
