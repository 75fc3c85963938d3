//! Where the state of an instrument is kept: in a folder that follows from its address alone, whatever bench file names it. Two bench files that share
//! an instrument share that folder, and with it lock and latch.
//!
//! An instrument that can be reached in two ways, over LAN and over USB, is two to this program.

use std::{
    fs,
    net::{IpAddr, ToSocketAddrs},
    path::PathBuf,
};

use instruments::transport::Address;

use super::StateError;
use crate::{config, hash};

/// Names the folder of all instruments; several accounts that run the same bench name one that all may write.
pub const VARIABLE: &str = "EIS_BENCH_STATE";

/// The folders of a bench's instruments, sorted, each once.
///
/// Mocks on this machine are no more than their bench file says: their ports are given to others when they have ended, and so their folders lie
/// with the rest of the bench's state.
///
/// # Errors
/// [`StateError::Nowhere`].
pub(super) fn places(bench: &config::Bench) -> Result<Vec<PathBuf>, StateError> {
    let root = if bench.is_mocked() { bench.state_folder.clone() } else { root()? }.join("instruments");
    let addressed = bench.instruments.addressed();
    let mut places: Vec<PathBuf> =
        addressed.iter().flat_map(|(_, instrument)| keys(&instrument.address)).map(|key| root.join(folder(&key))).collect();
    places.sort_unstable();
    places.dedup();
    Ok(places)
}

fn root() -> Result<PathBuf, StateError> {
    let variable = |name: &str| std::env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from);
    let own = || Some(variable("XDG_STATE_HOME").or_else(|| Some(variable("HOME")?.join(".local/state")))?.join("eis-bench"));
    variable(VARIABLE).or_else(own).ok_or(StateError::Nowhere)
}

/// What an address means: the name as it is typed, and what it stands for at present. One in common is enough.
fn keys(address: &Address) -> Vec<String> {
    match address {
        Address::Tcp { host, port } => {
            let host = host.trim_matches(['[', ']', '.']).to_ascii_lowercase();
            let found = match host.parse::<IpAddr>() {
                Ok(ip) => vec![ip],
                Err(_) => (host.as_str(), *port).to_socket_addrs().map_or_else(|_| Vec::new(), |found| found.map(|at| at.ip()).collect()),
            };
            let here = found.iter().any(|ip| ip.to_canonical().is_loopback());
            let numbers = found.iter().map(|ip| if here { "localhost".to_owned() } else { ip.to_canonical().to_string() });
            let name = host.parse::<IpAddr>().is_err().then_some(host.clone());
            numbers.chain(name).map(|host| format!("tcp {host} {port}")).collect()
        }
        // A name below /dev/serial stays when the cable is plugged in elsewhere, and stands for one that does not.
        Address::Serial(settings) => {
            let stands_for = fs::canonicalize(&settings.path).ok().map(|path| path.display().to_string());
            std::iter::once(settings.path.clone()).chain(stands_for).map(|path| format!("serial {path}")).collect()
        }
        Address::Memory { .. } => Vec::new(),
    }
}

/// A name that a person recognises and that no other key has.
fn folder(key: &str) -> String {
    let plain: String = key.chars().map(|c| if c.is_ascii_alphanumeric() || matches!(c, '.' | '-') { c } else { '_' }).collect();
    format!("{plain}-{}", hash::sha256(key).get(..8).unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(text: &str) -> Vec<String> {
        keys(&text.parse().unwrap())
    }

    #[test]
    fn one_instrument_has_one_key_however_its_address_is_written() {
        for (one, other) in [
            ("tcp://10.1.2.3:5025", "tcp://[::ffff:10.1.2.3]:5025"),
            ("tcp://127.0.0.1:5025", "tcp://localhost:5025"),
            ("tcp://[::1]:5025", "tcp://127.0.0.1:5025"),
            ("tcp://[2001:DB8:0:0::1]:5025", "tcp://[2001:db8::1]:5025"),
            ("tcp://Scope.Invalid:5025", "tcp://scope.invalid.:5025"),
            ("serial:/dev/ttyUSB0?baud=4800", "serial:/dev/ttyUSB0"),
        ] {
            assert!(of(one).iter().any(|key| of(other).contains(key)), "{:?} {:?}", of(one), of(other));
        }
        for (one, other) in [("tcp://10.1.2.3:5025", "tcp://10.1.2.3:5026"), ("tcp://10.1.2.3:5025", "tcp://10.1.2.4:5025")] {
            assert!(!of(one).iter().any(|key| of(other).contains(key)), "{one} {other}");
        }
    }

    #[test]
    fn a_serial_line_is_known_by_the_device_behind_its_name() {
        let folder = tempfile::tempdir().unwrap();
        let (device, link) = (folder.path().join("ttyUSB7"), folder.path().join("by-id"));
        fs::write(&device, "").unwrap();
        std::os::unix::fs::symlink(&device, &link).unwrap();
        let key = |path: &std::path::Path| of(&format!("serial:{}", path.display()));
        assert!(key(&link).iter().any(|name| key(&device).contains(name)), "{:?} {:?}", key(&link), key(&device));
    }
}
