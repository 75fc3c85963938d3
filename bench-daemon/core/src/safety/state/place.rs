//! Where the state of an instrument is kept: in a folder that is derived from its address alone,
//! independently of the bench file. Two bench files that share an instrument share that folder,
//! and therefore its lock and latch.

use std::path::PathBuf;

use instruments::transport::Address;

use super::{StateError, VARIABLE};
use bench_plan::{
    config,
    support::{addresses::keys, hash},
};

/// The folders of one instrument, one for each name that its address has.
pub(super) struct InstrumentPlace {
    pub(super) role: &'static str,
    pub(super) address: Address,
    pub(super) folders: Vec<PathBuf>,
}

/// Returns the folders of each instrument of a bench.
///
/// Mocks on this machine are valid only for their bench file: after they have ended, their ports
/// are given to other programs. Their folders are therefore kept with the state of the bench.
///
/// # Errors
/// [`StateError::Nowhere`].
pub(super) fn places(bench: &config::Bench) -> Result<Vec<InstrumentPlace>, StateError> {
    let root = if bench.is_mocked() {
        bench.state_folder.clone()
    } else {
        root()?
    }
    .join("instruments");
    let addressed = bench.instruments.addressed().into_iter();
    let places = addressed.map(|(role, instrument)| InstrumentPlace {
        role,
        address: instrument.address.clone(),
        folders: keys(&instrument.address)
            .iter()
            .map(|key| root.join(folder(key)))
            .collect(),
    });
    Ok(places.collect())
}

/// Returns the folder that holds the state of all instruments of this machine.
///
/// # Errors
/// [`StateError::Nowhere`].
pub(super) fn root() -> Result<PathBuf, StateError> {
    let variable = |name: &str| {
        std::env::var_os(name)
            .filter(|value| !value.is_empty())
            .map(PathBuf::from)
    };
    let own = || {
        Some(
            variable("XDG_STATE_HOME")
                .or_else(|| Some(variable("HOME")?.join(".local/state")))?
                .join("eis-bench"),
        )
    };
    variable(VARIABLE).or_else(own).ok_or(StateError::Nowhere)
}

/// Returns a folder name that a person recognises and that is unique for each key.
fn folder(key: &str) -> String {
    let plain: String = key
        .chars()
        .map(|c| {
            if c.is_ascii_alphanumeric() || matches!(c, '.' | '-') {
                c
            } else {
                '_'
            }
        })
        .collect();
    format!("{plain}-{}", hash::sha256(key).get(..8).unwrap_or_default())
}
