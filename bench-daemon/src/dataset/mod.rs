//! Data sets: a folder with `dataset.toml`, or a run folder of this program, as a diagnosis wants them; and the way back.
//!
//! `dataset.toml` holds `name`, perhaps `[bench]` (the fields of [`BenchHistory`](analysis::diagnosis::BenchHistory)), perhaps `[calibration]` (the fields of
//! [`CommonError`]: what the correction leaves in all spectra alike, if their σ are without it), and per run a `[[runs]]`:
//!
//! | field | meaning | default |
//! |---|---|---|
//! | `file`, `kind` | file beside `dataset.toml`; `eis` or `time` | |
//! | `name` | unique name | the file's, without extension |
//! | `fixture`, `cell`, `fixture_ohm` | `cell` with its name, or `shunt` or `fake_cell` with its resistance | `cell`, named `cell` |
//! | `temperature_c` | at the start | the file's first |
//! | `soc` or `ocv_v` | state at the start, one of both; a control has none | |
//! | `repeat_group` | runs of one group repeat each other | the name |
//! | `order`, `start_s` | place and time in the campaign | as listed; when the run before ends |
//! | `role` | `train` or `held_out` | `train` |
//! | `current_positive` | `charge` or `discharge`, of the file and of `bias_a` | as the format counts; BDF: `charge` |
//! | `current_between_samples` | `hold` or `linear` | `linear` |
//! | `from_s`, `to_s` | part of a long record, in its own time; begins at rest | all |
//! | `compare_from_s` | samples before it, in the file's time, are played but not compared: for a record that begins under current | all are |
//! | `level_sigma_v` | how badly the open-circuit voltage at the start is known, V; gaps are then taken about their mean | 0 |
//! | `from_hz`, `to_hz` | part of a sweep | all |
//! | `bias_a`, `amplitude_a` | direct current and amplitude of a sweep | as the file tells, else 0 and unknown |
//! | `below_ohm`, `below_h` | resistance (Ω) and inductance (H) between the lower tap and the ground of the channels, where each tap has a channel of its own | 0 |
//! | `elapsed_s` | time of each of the sweep's points since its start, s, in the order of frequencies | unknown |
//! | `spectrum` | which one, where the file holds several; else the one at `bias_a` | |
//!
//! A mistake in `dataset.toml` is an error. A file that is there but damaged is a [`DataSetProblem`]: the diagnosis then ends as invalid, with the reason.

mod files;
mod raw;
mod resolve;
mod run_folder;
mod write;

use std::path::Path;

use analysis::{calibration::CommonError, diagnosis::DataSet};

use crate::config::ConfigError;

pub use files::DataSetProblem;
pub use write::write_dataset;

/// Name of the file that makes a folder a data set.
pub const DATASET_FILE: &str = "dataset.toml";

/// A data set as far as its files could be read.
#[derive(Debug)]
pub struct Loaded {
    /// The runs that could be read.
    pub set: DataSet,
    /// The runs that could not.
    pub problems: Vec<DataSetProblem>,
    /// What had to be assumed.
    pub notes: Vec<String>,
}

/// Reads a data set: a `dataset.toml`, the folder that holds one, or a run folder.
///
/// # Errors
/// [`ConfigError`] with file, line and field for what is not as expected, and for a file that is not there.
pub fn read_dataset(path: &Path) -> Result<Loaded, ConfigError> {
    read_after(path, None)
}

/// As [`read_dataset`]; `known` is what an inherited correction leaves, which a run that measured no controls cannot tell.
///
/// # Errors
/// As [`read_dataset`].
pub(crate) fn read_after(path: &Path, known: Option<CommonError>) -> Result<Loaded, ConfigError> {
    if path.is_file() {
        return resolve::read(path);
    }
    let listed = path.join(DATASET_FILE);
    if listed.is_file() {
        return resolve::read(&listed);
    }
    run_folder::read(path, known)
}

#[cfg(test)]
mod tests;
