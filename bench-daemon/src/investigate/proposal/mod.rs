//! Proposes the runs of a data set from logs and spectra of a cycler: finds rests, pulses,
//! discharges and drive cycles, detects repeats, and splits the runs. It reads and writes no
//! files; `eis-bench dataset init` does.

mod load;
mod noise;
mod runs;
mod segment;
mod state;
mod text;
mod thresholds;

pub use load::{Kind, Load, LogSearch, Rest, loads};
pub use noise::{Estimate, estimate};
pub use runs::{FoundLog, FoundSpectrum, Place, ProposedRun, check_spectra, propose};
pub use state::{ChargeKnown, count_charge};
pub use text::{Named, dataset_text};

#[cfg(test)]
mod tests;
