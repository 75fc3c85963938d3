//! Checks whether a data set can be used, before any physics: damaged files, wrong units and signs,
//! clipping, a logged current that lags, spectra that violate the Kramers–Kronig relations,
//! exchanged runs, repeats that do not repeat.
//!
//! A check fires only on what no effect of cell or bench can do: it compares with the base model by
//! powers of ten, by sign and by shape, never by its goodness of fit. What all records share is an
//! effect and passes; what one of them does alone is damage.

mod clip;
mod current;
mod expected;
mod inspection;
mod lag;
mod refusal;
mod repeats;
mod spectrum;
mod structure;
mod swapped;
mod units;

use super::data::DataSet;
use serde::Serialize;

pub use expected::{Expected, Prediction};
use inspection::Findings;
pub use inspection::{Check, Reason};
pub(crate) use inspection::{Inspection, Subject};
pub use refusal::diagnose;

/// Report of the gate.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize)]
pub struct GateReport {
    /// Why the data cannot be used; empty if they can.
    pub invalid: Vec<Reason>,
    /// Remarks that do not refuse the data.
    pub notes: Vec<String>,
}

/// One check over the runs that passed those before it.
type CheckFn = fn(&Inspection<'_>) -> Findings;

/// A lagging current differs from that of its repeats, and a clipped or foreign voltage may look
/// delayed: the narrower check comes first.
const CHECKS: [CheckFn; 10] = [
    structure::check,
    units::check,
    spectrum::check,
    clip::check,
    swapped::by_content,
    lag::check,
    swapped::by_current,
    repeats::truncated,
    repeats::clock,
    repeats::check,
];

/// Checks a data set against the expectation of the base model.
///
/// A run that fails one check skips the others: it would fail for the same cause under another
/// name.
pub fn gate(set: &DataSet, expected: &Expected) -> GateReport {
    run(set, expected, &CHECKS)
}

/// Returns the gate of some checks.
fn run(set: &DataSet, expected: &Expected, checks: &[CheckFn]) -> GateReport {
    let mut report = GateReport::default();
    for check in checks {
        let bad = |name: &String| {
            report
                .invalid
                .iter()
                .any(|reason| reason.runs.contains(name))
        };
        let runs = set
            .runs
            .iter()
            .zip(&expected.runs)
            .filter(|(run, _)| !bad(&run.name))
            .map(|(run, prediction)| Subject { run, prediction });
        let found = check(&Inspection {
            set,
            expected,
            runs: runs.collect(),
        });
        report.invalid.extend(found.invalid);
        report.notes.extend(found.notes);
    }
    report
}

#[cfg(test)]
pub(super) mod tests;
