//! Where the state of an instrument is kept: in a folder that follows from its address alone,
//! whatever bench file names it. Two bench files that share an instrument share that folder, and
//! with it lock and latch.

use std::path::PathBuf;

use instruments::transport::Address;

use super::{StateError, VARIABLE};
use crate::{config, support::addresses::keys, support::hash};

/// The folders of one instrument, one for each name that its address has.
pub(super) struct InstrumentPlace {
    pub(super) role: &'static str,
    pub(super) address: Address,
    pub(super) folders: Vec<PathBuf>,
}

/// The folders of each instrument of a bench.
///
/// Mocks on this machine are no more than their bench file says: their ports are given to others
/// when they have ended, and so their folders lie with the rest of the bench's state.
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

/// Folder of the state of all instruments of this machine.
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

/// A name that a person recognises and that no other key has.
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
