//! The discrepancy workflow: where do simulation and measurement disagree, what is missing, does adding it close the gap.

mod data;
mod outcome;
pub mod report;

pub use data::{BenchHistory, DataSet, Fixture, Role, Run, RunData, Start, Sweep, SweepPoint, TimeRecord};
pub use outcome::{
    Block, Candidate, Curves, DIAGNOSIS_SCHEMA, DIAGNOSIS_SCHEMA_VERSION, Diagnosis, Evidence, FittedParameter, Gap, NamedEffect,
    NextExperiment, NoiseReport, NoiseTerm, Quality, Rival, RunCurves, SpectrumGap, Verdict,
};
