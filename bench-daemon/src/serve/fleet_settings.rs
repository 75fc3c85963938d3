//! The section `[fleet]` of a server's file.

use std::{os::unix::fs::PermissionsExt, path::PathBuf};

use bench_fleet::{
    Credentials, FleetSettings,
    job::{LONGEST_NAME, is_plain},
};
use serde::Deserialize;

use crate::{
    config::{
        self, ConfigError, Source,
        quantity::{Duration, Quantity},
    },
    safety::failure::Failure,
    support::loopback::names_loopback,
};

/// A fleet of benches on a NATS server with JetStream.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RawFleet {
    /// Name of the fleet: letters, digits, `-` and `_`.
    name: String,
    /// Site of this server's benches: letters, digits, `-` and `_`. Site and bench name a bench in
    /// the fleet.
    site: String,
    /// Address of the NATS server: `tls://HOST:PORT`, or `nats://HOST:PORT` on this machine.
    /// Left out: `nats://127.0.0.1:4222`.
    server: Option<String>,
    /// Path of a file, mode 0600, with what the NATS server asks for: a credentials file of NATS, the
    /// seed of an nkey, `USER:PASSWORD` or a token. Left out: nothing.
    credentials: Option<String>,
    /// Path of certificates that the NATS server's is checked against, PEM. Left out: those of the
    /// system.
    ca: Option<String>,
    /// Time after which a claim that nobody goes on with is taken back, and a bench that is not heard
    /// counts as silent, 2 s to 600 s. Left out: 30 s.
    lease: Option<Quantity<Duration>>,
}

/// How a server belongs to a fleet.
#[derive(Debug, Clone)]
pub struct FleetSection {
    /// Name of the fleet.
    pub name: String,
    /// Site of the benches.
    pub site: String,
    /// Address of the NATS server.
    pub server: String,
    /// File with what it asks for.
    pub credentials: Option<PathBuf>,
    /// Certificates that its own is checked against.
    pub ca: Option<PathBuf>,
    /// Time after which an unchanged claim is revoked, s.
    pub lease_s: f64,
}

/// Address of a server that is started with its defaults on this machine.
pub const DEFAULT_SERVER: &str = "nats://127.0.0.1:4222";
/// Heartbeats are sent three times within the lease. The lease is long enough that a server
/// restart does not move work, and short compared with the minutes of a run.
const LEASE_S: f64 = 30.0;

impl FleetSection {
    pub(super) fn resolve(
        source: &Source,
        raw: RawFleet,
        benches: &[config::Bench],
    ) -> Result<Self, ConfigError> {
        let own = [("fleet.name", &raw.name), ("fleet.site", &raw.site)];
        let benches = benches.iter().map(|bench| ("benches", &bench.name));
        for (field, name) in own.into_iter().chain(benches) {
            check_name(name).map_err(|reason| source.complain(field, reason))?;
        }
        let server = raw.server.unwrap_or_else(|| DEFAULT_SERVER.to_owned());
        check_server(&server).map_err(|reason| source.complain("fleet.server", reason))?;
        let lease_s = raw.lease.map_or(LEASE_S, |lease| lease.si);
        if !(2.0..=600.0).contains(&lease_s) {
            let reason = format!("expected 2 to 600, found {lease_s}");
            return Err(source.complain("fleet.lease", reason));
        }
        let path = |text: &String| source.relative(text);
        Ok(Self {
            name: raw.name,
            site: raw.site,
            server,
            credentials: raw.credentials.as_ref().map(path),
            ca: raw.ca.as_ref().map(path),
            lease_s,
        })
    }

    /// Returns the fleet settings of a client that has no server file.
    ///
    /// # Errors
    /// An address or a name that is not as expected.
    pub fn of_client(name: &str, server: &str) -> Result<Self, Failure> {
        check_name(name).map_err(|reason| Failure::Usage(format!("--fleet: {reason}")))?;
        check_server(server).map_err(|reason| Failure::Usage(format!("--server: {reason}")))?;
        Ok(Self {
            name: name.to_owned(),
            site: "client".to_owned(),
            server: server.to_owned(),
            credentials: None,
            ca: None,
            lease_s: LEASE_S,
        })
    }

    /// Reads the file with the credentials for the NATS server.
    ///
    /// # Errors
    /// A file that others may read, or that is not as expected.
    pub fn open(&self) -> Result<FleetSettings, Failure> {
        Ok(FleetSettings {
            fleet: self.name.clone(),
            site: self.site.clone(),
            server: self.server.clone(),
            credentials: self.credentials.as_ref().map(read_private).transpose()?,
            ca: self.ca.clone(),
            lease_s: self.lease_s,
        })
    }
}

fn read_private(path: &PathBuf) -> Result<Credentials, Failure> {
    let wrong =
        |error: &dyn std::fmt::Display| Failure::Usage(format!("{}: {error}", path.display()));
    let mode = std::fs::metadata(path).map_err(|error| wrong(&error))?;
    let mode = mode.permissions().mode() & 0o777;
    if mode & 0o077 != 0 {
        return Err(wrong(&format!(
            "expected a file that only its owner may read (mode 0600), found mode {mode:04o}"
        )));
    }
    let text = std::fs::read_to_string(path).map_err(|error| wrong(&error))?;
    Credentials::read(&text).map_err(|error| wrong(&error))
}

/// A name that is a part of a key at the NATS server.
fn check_name(name: &str) -> Result<(), String> {
    let expected = || {
        format!(
            "expected 1 to {LONGEST_NAME} letters, digits, `-` and `_` in a fleet, found {name:?}"
        )
    };
    is_plain(name).then_some(()).ok_or_else(expected)
}

/// Refuses clear-text connections to another machine, because a job is an experiment that lets
/// current flow.
fn check_server(server: &str) -> Result<(), String> {
    let expected = || {
        format!("expected tls://HOST:PORT, or nats://HOST:PORT on this machine, found {server:?}")
    };
    let (scheme, rest) = server.split_once("://").ok_or_else(expected)?;
    let (host, port) = rest.rsplit_once(':').ok_or_else(expected)?;
    let is_port = port.parse::<u16>().is_ok();
    let is_safe = scheme == "tls" || (scheme == "nats" && names_loopback(host));
    if host.is_empty() || host.contains('@') || !is_port || !is_safe {
        return Err(expected());
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_that_no_key_can_hold_is_refused() {
        assert_eq!(check_name("hall-3_b"), Ok(()));
        let long = "b".repeat(LONGEST_NAME + 1);
        for name in ["", "a.b", "a/b", "a b", long.as_str()] {
            assert!(check_name(name).is_err(), "{name:?}");
        }
    }

    #[test]
    fn nothing_goes_to_another_machine_in_clear_text() {
        for server in [
            DEFAULT_SERVER,
            "tls://nats.lab.example:4222",
            "nats://[::1]:1",
        ] {
            assert_eq!(check_server(server), Ok(()), "{server}");
        }
        for server in [
            "nats://nats.lab.example:4222",
            "tls://nats.lab.example",
            "tls://user:word@nats.lab.example:4222",
            "127.0.0.1:4222",
            "http://127.0.0.1:4222",
            "tls://:4222",
        ] {
            assert!(check_server(server).is_err(), "{server}");
        }
    }
}
