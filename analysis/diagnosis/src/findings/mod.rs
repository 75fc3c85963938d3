//! Findings on the data as cyclers and loggers write them, before any physics. A finding refuses
//! nothing: it states the anomaly, its location, its certainty, and its effect on the diagnosis.
//! The gate handles unusable data.
//!
//! A detector compares the data with themselves, with their stated properties, and by shape and
//! size with the base model.

mod current;
mod finding;
mod leakage;
pub(crate) mod resolution;
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

/// One detector over the runs that passed the gate.
type Detector = fn(&Scene<'_>) -> Vec<Finding>;

const DETECTORS: [Detector; 6] = [
    current::find,
    leakage::find,
    rest::find,
    stamps::slow,
    stamps::unseen,
    resolution::find,
];

/// Detectors over all runs: their findings may explain why the gate refused a run.
const OF_ALL: [Detector; 3] = [rows::missing, rows::repeated, stamps::rounded];

/// A data set with the expectation of the model: as it was written and, if the logger has filtered
/// its current, with the correction.
pub(crate) struct Inspected<'a> {
    set: &'a DataSet,
    model: &'a BaseModel,
    pub(crate) expected: Expected,
    pub(crate) corrected: Option<(DataSet, Expected)>,
}

impl<'a> Inspected<'a> {
    pub(crate) fn new(set: &'a DataSet, model: &'a BaseModel) -> Self {
        let expected = Expected::new(set, model);
        let corrected = expected.filter.as_ref().map(|filter| {
            let set = filter.corrected(set);
            let expected = Expected::without_filter(&set, model);
            (set, expected)
        });
        Self {
            set,
            model,
            expected,
            corrected,
        }
    }

    /// Returns the records whose current changes faster than it is logged.
    pub(crate) fn unseen(&self) -> Vec<String> {
        let scene = Scene {
            at: inspection(self.set, &self.expected, &[]),
            model: self.model,
        };
        let found = stamps::unseen(&scene);
        found.into_iter().flat_map(|finding| finding.runs).collect()
    }

    /// Returns the findings; of runs that the gate refused, only those of their rows and stamps.
    pub(crate) fn findings(&self, refused: &[Reason]) -> Vec<Finding> {
        let scene = |set, expected, refused| Scene {
            at: inspection(set, expected, refused),
            model: self.model,
        };
        let raw = scene(self.set, &self.expected, refused);
        let mut found: Vec<Finding> = DETECTORS.iter().flat_map(|find| find(&raw)).collect();
        let all = scene(self.set, &self.expected, &[]);
        found.extend(OF_ALL.iter().flat_map(|find| find(&all)));
        // A delayed current resembles a cell of another size.
        found.extend(match &self.corrected {
            Some((set, expected)) => scale::find(&scene(set, expected, refused)),
            None => scale::find(&raw),
        });
        found
    }
}

/// Returns the findings on a data set and the report of the gate, without a diagnosis.
pub fn inspect(set: &DataSet, model: &BaseModel) -> (GateReport, Vec<Finding>) {
    let inspected = Inspected::new(set, model);
    let report = gate(set, &inspected.expected);
    let found = inspected.findings(&report.invalid);
    (report, found)
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
