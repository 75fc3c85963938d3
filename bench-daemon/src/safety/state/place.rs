//! Where the state of an instrument is kept: in a folder that follows from its address alone,
//! whatever bench file names it. Two bench files that share an instrument share that folder, and
//! with it lock and latch.

use std::path::PathBuf;

use super::{StateError, VARIABLE};
use crate::{config, support::addresses::keys, support::hash};

/// The folders of a bench's instruments, sorted, each once.
///
/// Mocks on this machine are no more than their bench file says: their ports are given to others
/// when they have ended, and so their folders lie with the rest of the bench's state.
///
/// # Errors
/// [`StateError::Nowhere`].
pub(super) fn places(bench: &config::Bench) -> Result<Vec<PathBuf>, StateError> {
    let root = if bench.is_mocked() {
        bench.state_folder.clone()
    } else {
        root()?
    }
    .join("instruments");
    let addressed = bench.instruments.addressed();
    let mut places: Vec<PathBuf> = addressed
        .iter()
        .flat_map(|(_, instrument)| keys(&instrument.address))
        .map(|key| root.join(folder(&key)))
        .collect();
    places.sort_unstable();
    places.dedup();
    Ok(places)
}

fn root() -> Result<PathBuf, StateError> {
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
