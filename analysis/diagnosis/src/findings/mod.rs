//! Findings on the data as cyclers and loggers write them, before any physics. A finding refuses
//! nothing: it says what is odd, where, how sure that is, and what it does to the diagnosis. What
//! cannot be used at all is the gate's.
//!
//! A detector compares the data with themselves, with what is stated of them, and by shape and size
//! with the base model.

mod finding;
mod leakage;
mod resolution;
mod rest;
mod rows;
mod scale;
mod scene;
mod stamps;

use crate::data::DataSet;
use crate::gate::{Expected, Inspection, Reason, Subject};
use crate::prepare::BaseModel;

pub use finding::{Finding, FindingKind};
use scene::Scene;

/// One detector over the runs that the gate let pass.
type Detector = fn(&Scene<'_>) -> Vec<Finding>;

const DETECTORS: [Detector; 8] = [
    leakage::find,
    rest::find,
    rows::missing,
    rows::repeated,
    stamps::rounded,
    stamps::slow,
    resolution::find,
    scale::find,
];

/// The findings on a data set; runs that the gate refused are left out.
pub fn findings(
    set: &DataSet,
    expected: &Expected,
    model: &BaseModel,
    refused: &[Reason],
) -> Vec<Finding> {
    let is_refused = |name: &String| refused.iter().any(|reason| reason.runs.contains(name));
    let runs = set
        .runs
        .iter()
        .zip(&expected.runs)
        .filter(|(run, _)| !is_refused(&run.name))
        .map(|(run, prediction)| Subject { run, prediction });
    let scene = Scene {
        at: Inspection {
            set,
            expected,
            runs: runs.collect(),
        },
        model,
    };
    DETECTORS.iter().flat_map(|find| find(&scene)).collect()
}

#[cfg(test)]
mod tests;
