//! Findings on the data as cyclers and loggers write them, before any physics. A finding refuses
//! nothing: it says what is odd, where, how sure that is, and what it does to the diagnosis. What
//! cannot be used at all is the gate's.
//!
//! A detector compares the data with themselves, with what is stated of them, and by shape and size
//! with the base model.

mod current;
mod finding;
mod leakage;
mod resolution;
mod rest;
mod rows;
mod scale;
mod scene;
mod stamps;

use crate::data::DataSet;
use crate::gate::{Expected, GateReport, Inspection, Reason, Subject, gate};
use crate::prepare::BaseModel;

pub use finding::{Finding, FindingKind};
use scene::Scene;

/// One detector over the runs that the gate let pass.
type Detector = fn(&Scene<'_>) -> Vec<Finding>;

const DETECTORS: [Detector; 5] = [
    current::find,
    leakage::find,
    rest::find,
    stamps::slow,
    resolution::find,
];

/// Detectors over all runs: what they find may be why the gate refused one.
const OF_ALL: [Detector; 3] = [rows::missing, rows::repeated, stamps::rounded];

/// A data set that is told of.
#[derive(Debug, Clone, Copy)]
pub struct Told<'a> {
    /// As it was written.
    pub set: &'a DataSet,
    /// What the model expects of it.
    pub expected: &'a Expected,
    /// As it is where corrections apply, and what the model expects of that.
    pub corrected: Option<(&'a DataSet, &'a Expected)>,
}

/// The findings on a data set and what the gate says of it, without a diagnosis.
pub fn inspect(set: &DataSet, model: &BaseModel) -> (GateReport, Vec<Finding>) {
    let expected = Expected::new(set, model);
    let report = gate(set, &expected);
    let corrected = expected.filter.as_ref().map(|f| f.corrected(set));
    let of_corrected = corrected.as_ref().map(|set| Expected::new(set, model));
    let told = Told {
        set,
        expected: &expected,
        corrected: corrected.as_ref().zip(of_corrected.as_ref()),
    };
    let found = findings(told, model, &report.invalid);
    (report, found)
}

/// The findings on a data set; of runs that the gate refused, only what their rows and stamps tell.
pub fn findings(told: Told<'_>, model: &BaseModel, refused: &[Reason]) -> Vec<Finding> {
    let scene = |set, expected| Scene {
        at: inspection(set, expected, refused),
        model,
    };
    let raw = scene(told.set, told.expected);
    let mut found: Vec<Finding> = DETECTORS.iter().flat_map(|find| find(&raw)).collect();
    let all = Scene {
        at: inspection(told.set, told.expected, &[]),
        model,
    };
    found.extend(OF_ALL.iter().flat_map(|find| find(&all)));
    // A current that comes late looks like a cell of another size.
    found.extend(match told.corrected {
        Some((set, expected)) => scale::find(&scene(set, expected)),
        None => scale::find(&raw),
    });
    found
}

fn inspection<'a>(set: &'a DataSet, expected: &'a Expected, refused: &[Reason]) -> Inspection<'a> {
    let is_refused = |name: &String| refused.iter().any(|reason| reason.runs.contains(name));
    let runs = set
        .runs
        .iter()
        .zip(&expected.runs)
        .filter(|(run, _)| !is_refused(&run.name))
        .map(|(run, prediction)| Subject { run, prediction });
    Inspection {
        set,
        expected,
        runs: runs.collect(),
    }
}

#[cfg(test)]
mod tests;
