//! Diagnosis of a model against measurements, for a user whose simulation and measurement disagree:
//! where they disagree, which effect is missing, and whether adding it closes the gap.

mod accept;
mod additions;
mod attempts;
mod block;
mod charge;
mod codes;
mod compose;
mod consistency;
mod current_filter;
mod current_noise_propagation;
mod data;
mod diagnose;
mod distinguish;
mod edges;
mod estimate;
mod exchange;
mod experiment;
pub mod findings;
mod gap;
pub mod gate;
mod given;
mod guards;
mod held_out;
mod identity;
mod inconsistency;
mod intermittent;
mod intervals;
mod judge;
mod localise;
mod mechanisms;
mod median;
mod noise;
mod options;
pub mod oracle;
mod outcome;
mod periodic;
mod predictive;
mod prepare;
mod problem;
mod progress;
mod propose;
mod repeat_mean;
pub mod report;
mod rivals;
mod search;
mod select;
mod shared;
mod shares;
mod simpler;
mod stepped;
mod structure;
pub mod thresholds;
mod time_block;
mod together;
mod whitening;
mod widened;
mod windows;

pub use analysis_signal::history::BenchHistory;
pub use block::DataSetError;
pub use data::{
    DataSet, Fixture, Harmonic, Role, Run, RunData, Start, Sweep, SweepPoint, TimeRecord,
    assumed_history,
};
pub use diagnose::Outcome;
pub use distinguish::distinguish;
pub use experiment::{BenchLimits, Planned, PlannedRun, Playable};
pub use findings::{Finding, FindingKind};
pub use gap::{held_out_error, rms_mv};
pub use gate::diagnose;
pub use given::ByHand;
pub use options::DiagnosisOptions;
pub use outcome::{
    Block, ByHandGap, Candidate, Curves, DIAGNOSIS_SCHEMA, DIAGNOSIS_SCHEMA_VERSION, Diagnosis,
    Evidence, FittedParameter, Gap, NamedEffect, NextExperiment, NoiseReport, NoiseTerm,
    PREDICTION_ONLY, Predictive, PredictiveTerm, Quality, Rival, RunCurves, Share, SpectrumGap,
    Verdict,
};
pub use prepare::BaseModel;
pub use progress::Progress;

#[cfg(test)]
mod tests;
