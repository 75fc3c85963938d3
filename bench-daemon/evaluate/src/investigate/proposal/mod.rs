//! Proposes the runs of a data set from logs and spectra of a cycler: takes the loads that
//! `analysis::loads` finds, detects repeats, and splits the runs. It reads and writes no
//! files; `eis-bench dataset init` does.

mod agreement;
mod missing;
mod runs;
mod start;
mod text;
mod thresholds;

pub use analysis::loads::{
    Base, ChargeKnown, Estimate, Kind, KnownSoc, Load, LogSearch, Rest, SocFrom, count_charge,
    estimate, loads,
};

pub use agreement::{LogFacts, contradictions, fits_current};
pub use missing::{Missing, missing};
pub use runs::{
    FoundLog, FoundSpectrum, Place, ProposedRun, TestTemperature, check_spectra, propose,
};
pub use start::{Branch, StartModel, rest_curve, start_model};
pub use text::{Named, OwnFiles, Proposal, dataset_text};

#[cfg(test)]
mod step_tests;
#[cfg(test)]
mod tests;
