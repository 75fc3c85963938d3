//! Proposes the runs of a data set from logs and spectra of a cycler: finds rests, pulses,
//! discharges and drive cycles, detects repeats, and splits the runs. It reads and writes no
//! files; `eis-bench dataset init` does.

mod agreement;
mod load;
mod missing;
mod noise;
mod rest;
mod runs;
mod segment;
mod start;
mod state;
mod text;
mod thresholds;

pub use agreement::{LogFacts, contradictions, fits_current};
pub use load::{Base, Kind, KnownSoc, Load, LogSearch, SocFrom, loads};
pub use missing::{Missing, missing};
pub use noise::{Estimate, estimate};
pub use rest::Rest;
pub use runs::{
    FoundLog, FoundSpectrum, Place, ProposedRun, TestTemperature, check_spectra, propose,
};
pub use start::{Branch, StartModel, rest_curve, start_model};
pub use state::{ChargeKnown, count_charge};
pub use text::{Named, OwnFiles, Proposal, dataset_text};

#[cfg(test)]
mod step_tests;
#[cfg(test)]
mod tests;
