//! Decides which addresses refer to the same instrument, so that two bench files share its lock.
//!
//! Instruments behind one GPIB adapter count as one, because an adapter accepts one connection. A
//! network instrument is one, whether it is reached by VXI-11, HiSLIP or the corresponding raw
//! socket. An instrument that is reached over LAN and over USB counts as two.

use std::{
    fs,
    net::{IpAddr, ToSocketAddrs},
};

use instruments::{
    loopback::is_loopback,
    transport::{Adapter, Address, Socket, Vxi11Port, usb_file},
};

/// Ports at which instruments offer their raw socket beside VXI-11 and HiSLIP.
const RAW_PORTS: [u16; 2] = [5025, 5555];

/// Returns whether two addresses refer to the same instrument, or to the same adapter, at
/// present.
pub fn meet(one: &Address, other: &Address) -> bool {
    let known = keys(one);
    keys(other).iter().any(|key| known.contains(key))
}

/// Returns the names of an address: as typed, and as it resolves at present. One common name is
/// enough.
pub fn keys(address: &Address) -> Vec<String> {
    match address {
        Address::Tcp(socket) => tcp(socket),
        // A device that is reached by its name on the network is one instrument, at whichever port;
        // a raw socket may be one of many of a port server.
        Address::Vxi11 { host, port, .. } => {
            let port = match port {
                Vxi11Port::Mapped(port) | Vxi11Port::Fixed(port) => *port,
            };
            named(host, port)
        }
        Address::HiSlip { socket, .. } => named(&socket.host, socket.port),
        Address::Serial(settings) => file("serial", &settings.path),
        // A name of a device and its present file are one instrument.
        Address::UsbTmc { path } => {
            let mut names = file("usbtmc", path);
            names.extend(
                usb_file(path)
                    .iter()
                    .flat_map(|at| file("usbtmc", &at.display().to_string())),
            );
            names
        }
        // It addresses one instrument at a time, the one that was set last, so a process that
        // uses one of its instruments needs the whole adapter.
        Address::Gpib { adapter, .. } => match adapter {
            Adapter::Tcp(socket) => tcp(socket),
            Adapter::Serial(settings) => file("serial", &settings.path),
        },
        Address::Memory { .. } => Vec::new(),
    }
}

fn tcp(Socket { host, port }: &Socket) -> Vec<String> {
    hosts(host, *port)
        .into_iter()
        .map(|host| format!("tcp {host} {port}"))
        .collect()
}

/// Mocks share the loopback address, where the port distinguishes them.
fn named(host: &str, port: u16) -> Vec<String> {
    let hosts = hosts(host, port);
    if hosts.iter().any(|host| host == HERE) {
        return tcp(&Socket {
            host: host.to_owned(),
            port,
        });
    }
    let raw = hosts
        .iter()
        .flat_map(|host| RAW_PORTS.map(|port| format!("tcp {host} {port}")));
    raw.chain(hosts.iter().map(|host| format!("lan {host}")))
        .collect()
}

const HERE: &str = "localhost";

/// A host's name, and its numbers at present.
fn hosts(host: &str, port: u16) -> Vec<String> {
    let host = host.trim_matches(['[', ']', '.']).to_ascii_lowercase();
    let found = match host.parse::<IpAddr>() {
        Ok(ip) => vec![ip],
        Err(_) => (host.as_str(), port)
            .to_socket_addrs()
            .map_or_else(|_| Vec::new(), |found| found.map(|at| at.ip()).collect()),
    };
    let here = found.iter().copied().any(is_loopback);
    let numbers = found.iter().map(|ip| {
        if here {
            HERE.to_owned()
        } else {
            ip.to_canonical().to_string()
        }
    });
    let name = host.parse::<IpAddr>().is_err().then(|| host.clone());
    numbers.chain(name).collect()
}

/// A name below /dev/serial stays when the cable is plugged in elsewhere, and stands for one that
/// does not.
fn file(kind: &str, path: &str) -> Vec<String> {
    let stands_for = fs::canonicalize(path)
        .ok()
        .map(|path| path.display().to_string());
    std::iter::once(path.to_owned())
        .chain(stands_for)
        .map(|path| format!("{kind} {path}"))
        .collect()
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
            ("tcp://10.1.2.3:5025", "vxi11:10.1.2.3/inst0"),
            ("vxi11:10.1.2.3:4711/inst0", "vxi11:10.1.2.3/inst0"),
            ("hislip:10.1.2.3/hislip0", "vxi11:10.1.2.3/inst0"),
            (
                "gpib:serial:/dev/ttyUSB0/6?baud=9600",
                "gpib:serial:/dev/ttyUSB0/6",
            ),
            ("gpib:tcp:10.1.2.3:1234/6", "gpib:tcp:10.1.2.3:1234/7"),
            ("gpib:tcp:localhost:1234/6", "gpib:tcp:127.0.0.1:1234/7"),
            ("gpib:serial:/dev/ttyUSB0/6", "gpib:serial:/dev/ttyUSB0/7"),
        ] {
            assert!(
                meet(&one.parse().unwrap(), &other.parse().unwrap()),
                "{:?} {:?}",
                of(one),
                of(other)
            );
        }
        for (one, other) in [
            ("tcp://10.1.2.3:5025", "tcp://10.1.2.3:5026"),
            ("tcp://10.1.2.3:5025", "tcp://10.1.2.4:5025"),
            ("vxi11:10.1.2.3/inst0", "vxi11:10.1.2.4/inst0"),
            ("vxi11:127.0.0.1:4711/inst0", "vxi11:127.0.0.1:4712/inst0"),
            ("gpib:tcp:10.1.2.3:1234/6", "gpib:tcp:10.1.2.4:1234/6"),
        ] {
            assert!(
                !meet(&one.parse().unwrap(), &other.parse().unwrap()),
                "{one} {other}"
            );
        }
    }

    #[test]
    fn a_serial_line_is_known_by_the_device_behind_its_name() {
        let folder = tempfile::tempdir().unwrap();
        let (device, link) = (folder.path().join("ttyUSB7"), folder.path().join("by-id"));
        fs::write(&device, "").unwrap();
        std::os::unix::fs::symlink(&device, &link).unwrap();
        let key = |path: &std::path::Path| of(&format!("serial:{}", path.display()));
        assert!(
            key(&link).iter().any(|name| key(&device).contains(name)),
            "{:?} {:?}",
            key(&link),
            key(&device)
        );
    }
}
