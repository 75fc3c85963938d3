//! Where the state of an instrument is kept: in a folder that follows from its address alone, whatever bench file names it. Two bench files that share
//! an instrument share that folder, and with it lock and latch.
//!
//! An instrument that can be reached in two ways, over LAN and over USB, is two to this program.

use std::{
    fs,
    net::{IpAddr, ToSocketAddrs},
    path::PathBuf,
};

use instruments::transport::{Adapter, Address, Socket, Vxi11Port};

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
        Address::Tcp(socket) => hosts(socket).map(|host| format!("tcp {host} {}", socket.port)).collect(),
        Address::HiSlip { socket, device } => hosts(socket).map(|host| format!("hislip {host} {} {device}", socket.port)).collect(),
        Address::Vxi11 { host, port, device } => {
            let (Vxi11Port::Fixed(number) | Vxi11Port::Mapped(number)) = *port;
            hosts(&Socket { host: host.clone(), port: number }).map(|host| format!("vxi11 {host} {number} {device}")).collect()
        }
        Address::Gpib { adapter: Adapter::Tcp(socket), address } => {
            hosts(socket).map(|host| format!("gpib {host} {} {address}", socket.port)).collect()
        }
        Address::Gpib { adapter: Adapter::Serial(settings), address } => {
            paths(&settings.path).map(|path| format!("gpib {path} {address}")).collect()
        }
        Address::Serial(settings) => paths(&settings.path).map(|path| format!("serial {path}")).collect(),
        Address::UsbTmc { path } => paths(path).map(|path| format!("usbtmc {path}")).collect(),
        Address::Memory { .. } => Vec::new(),
    }
}

/// A host's name and its numbers.
fn hosts(Socket { host, port }: &Socket) -> impl Iterator<Item = String> {
    let host = host.trim_matches(['[', ']', '.']).to_ascii_lowercase();
    let number = host.parse::<IpAddr>().ok();
    let found = match number {
        Some(ip) => vec![ip],
        None => (host.as_str(), *port).to_socket_addrs().map_or_else(|_| Vec::new(), |found| found.map(|at| at.ip()).collect()),
    };
    let here = found.iter().any(|ip| ip.to_canonical().is_loopback());
    let name = number.is_none().then_some(host);
    found.into_iter().map(move |ip| if here { "localhost".to_owned() } else { ip.to_canonical().to_string() }).chain(name)
}

/// A device's file and what it stands for: a name below /dev/serial stays when the cable is plugged in elsewhere, and stands for one that does not.
fn paths(path: &str) -> impl Iterator<Item = String> {
    let stands_for = fs::canonicalize(path).ok().map(|path| path.display().to_string());
    std::iter::once(path.to_owned()).chain(stands_for)
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
            ("vxi11:10.1.2.3", "vxi11:[::ffff:10.1.2.3]/inst0?portmapper=111"),
            ("hislip:10.1.2.3:4880/hislip0", "hislip:10.1.2.3"),
            ("gpib:serial:/dev/ttyUSB0/7?baud=115200", "gpib:serial:/dev/ttyUSB0/7"),
        ] {
            assert!(of(one).iter().any(|key| of(other).contains(key)), "{:?} {:?}", of(one), of(other));
        }
        for (one, other) in [
            ("tcp://10.1.2.3:5025", "tcp://10.1.2.3:5026"),
            ("tcp://10.1.2.3:5025", "tcp://10.1.2.4:5025"),
            ("gpib:tcp:10.1.2.3:1234/7", "gpib:tcp:10.1.2.3:1234/8"),
            ("usbtmc:/dev/usbtmc0", "usbtmc:/dev/usbtmc1"),
        ] {
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
