//! The file of an agent, `fleet.toml`: the fleet that the benches of a server belong to.

use std::{
    net::SocketAddr,
    os::unix::fs::PermissionsExt,
    path::{Path, PathBuf},
};

use instruments_link::loopback::names_loopback;
use serde::Deserialize;

use crate::{
    failure::Failure,
    job::{LONGEST_NAME, is_plain},
    quantity::typed_duration_s,
    settings::{Credentials, FleetSettings},
};

/// File of an agent.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct RawAgent {
    /// Name of the fleet: letters, digits, `-` and `_`.
    name: String,
    /// Site of the benches: letters, digits, `-` and `_`. Site and bench name a bench in the fleet.
    site: String,
    /// Address of the NATS server: `tls://HOST:PORT`, or `nats://HOST:PORT` on this machine.
    /// Left out: `nats://127.0.0.1:4222`.
    server: Option<String>,
    /// Path of a file with mode 0600 that holds what the NATS server asks for: a credentials file of
    /// NATS, the seed of an nkey, `USER:PASSWORD` or a token. Left out: nothing.
    credentials: Option<String>,
    /// Path of certificates that the NATS server's is checked against, PEM. Left out: those of the
    /// system.
    ca: Option<String>,
    /// Time after which an abandoned claim is taken back, and a bench that is not heard counts as
    /// silent, 2 s to 600 s. Left out: 30 s.
    lease: Option<String>,
    /// Path of the only folder that the agent writes to, from the folder of this file.
    data: String,
    /// Address and port of the page and the API, such as `127.0.0.1:7430`. Beyond this machine it needs
    /// `[tls]`.
    listen: String,
    /// Address of the server of the benches: `http://HOST:PORT` on this machine, or
    /// `https://HOST:PORT`. Left out: `http://127.0.0.1:7420`.
    bench_server: Option<String>,
    /// Path of a file with mode 0600 that holds a token of that server with the scopes `read`,
    /// `operate`, `energise` and `fleet`. Left out: none, for a server without tokens.
    token_file: Option<String>,
    /// Path of certificates that the server's is checked against, PEM. Left out: those of the public
    /// authorities.
    bench_ca: Option<String>,
    /// Certificate and key. Left out: the agent listens on this machine only.
    tls: Option<RawTls>,
}

/// Encryption of the connections to the page and the API.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct RawTls {
    /// Path of the certificate chain, PEM.
    certificate: String,
    /// Path of the private key, PEM.
    key: String,
}

/// Checked settings of an agent.
#[derive(Debug, Clone)]
pub struct AgentFile {
    /// The fleet.
    pub settings: FleetSettings,
    /// The server of the benches.
    pub bench_server: BenchServerAddress,
    /// The only folder that it writes to.
    pub data: PathBuf,
    /// Address of its socket.
    pub listen: SocketAddr,
    /// Certificate chain and key, PEM.
    pub tls: Option<CertificateFiles>,
}

/// Connection to the server of the benches.
#[derive(Debug, Clone)]
pub struct BenchServerAddress {
    /// `http://HOST:PORT` or `https://HOST:PORT`.
    pub url: String,
    /// File with a token.
    pub token_file: Option<PathBuf>,
    /// Certificates that verify its certificate.
    pub ca: Option<PathBuf>,
}

/// Files of a certificate.
#[derive(Debug, Clone)]
pub struct CertificateFiles {
    /// Certificate chain, PEM.
    pub certificate: PathBuf,
    /// Private key, PEM.
    pub key: PathBuf,
}

/// Address of a NATS server that is started with its defaults on this machine.
pub const DEFAULT_SERVER: &str = "nats://127.0.0.1:4222";
/// Address of a server of benches as in `configs/serve.toml`.
const DEFAULT_BENCH_SERVER: &str = "http://127.0.0.1:7420";
/// Heartbeats are sent three times within the lease. The lease is long enough that a restart does
/// not move work, and short compared with the minutes of a run.
const LEASE_S: f64 = 30.0;

/// A file that is being read, for error messages.
struct Typed<'a> {
    path: &'a Path,
    text: String,
}

impl Typed<'_> {
    /// Returns an error that names file, line and field.
    fn complain(&self, field: &str, reason: &str) -> Failure {
        let is_key = |line: &&str| {
            let rest = line.trim_start().strip_prefix(field);
            rest.is_some_and(|rest| rest.trim_start().starts_with('='))
        };
        let line = self.text.lines().position(|line| is_key(&line));
        let line = line.map_or_else(String::new, |at| format!(":{}", at + 1));
        Failure::Usage(format!("{}{line}: {field}: {reason}", self.path.display()))
    }

    fn parse(&self) -> Result<RawAgent, Failure> {
        toml::from_str(&self.text).map_err(|error| {
            let before = error.span().and_then(|span| self.text.get(..span.start));
            let line = before.map_or(1, |before| before.matches('\n').count() + 1);
            let (path, message) = (self.path.display(), error.message());
            Failure::Usage(format!("{path}:{line}: {message}"))
        })
    }

    /// Resolves a path relative to the folder of the file.
    fn relative(&self, text: &str) -> PathBuf {
        let path = self.path.parent().unwrap_or(self.path).join(text);
        std::path::absolute(&path).unwrap_or(path)
    }
}

impl AgentFile {
    /// Reads the file of an agent.
    ///
    /// # Errors
    /// The first error, with file, line and field.
    pub fn load(path: &Path) -> Result<Self, Failure> {
        let text = read(path)?;
        let typed = Typed { path, text };
        let raw = typed.parse()?;
        let listen: SocketAddr = raw.listen.parse().map_err(|_| {
            let found = &raw.listen;
            let expected = "an address and a port, such as 127.0.0.1:7430";
            typed.complain("listen", &format!("expected {expected}, found {found:?}"))
        })?;
        let tls = raw.tls.as_ref().map(|tls| CertificateFiles {
            certificate: typed.relative(&tls.certificate),
            key: typed.relative(&tls.key),
        });
        if !listen.ip().is_loopback() && tls.is_none() {
            let reason = format!(
                "expected a section [tls] with certificate and key to listen beyond this machine \
                (on {listen}), found none"
            );
            return Err(typed.complain("listen", &reason));
        }
        Ok(Self {
            bench_server: bench_server(&typed, &raw)?,
            settings: settings(&typed, &raw)?,
            data: typed.relative(&raw.data),
            listen,
            tls,
        })
    }
}

fn bench_server(typed: &Typed<'_>, raw: &RawAgent) -> Result<BenchServerAddress, Failure> {
    let path = |text: &String| typed.relative(text);
    let url = raw.bench_server.as_deref().unwrap_or(DEFAULT_BENCH_SERVER);
    check_bench_server(url).map_err(|reason| typed.complain("bench_server", &reason))?;
    Ok(BenchServerAddress {
        url: url.trim_end_matches('/').to_owned(),
        token_file: raw.token_file.as_ref().map(path),
        ca: raw.bench_ca.as_ref().map(path),
    })
}

fn settings(typed: &Typed<'_>, raw: &RawAgent) -> Result<FleetSettings, Failure> {
    for (field, name) in [("name", &raw.name), ("site", &raw.site)] {
        check_name(name).map_err(|reason| typed.complain(field, &reason))?;
    }
    let server = raw.server.as_deref().unwrap_or(DEFAULT_SERVER);
    check_server(server).map_err(|reason| typed.complain("server", &reason))?;
    let lease_s = raw.lease.as_deref().map_or(Ok(LEASE_S), typed_duration_s);
    let lease_s = lease_s.map_err(|reason| typed.complain("lease", &reason))?;
    if !(2.0..=600.0).contains(&lease_s) {
        let reason = format!("expected 2 s to 600 s, found {lease_s} s");
        return Err(typed.complain("lease", &reason));
    }
    let credentials = raw.credentials.as_ref().map(|text| typed.relative(text));
    Ok(FleetSettings {
        fleet: raw.name.clone(),
        site: raw.site.clone(),
        server: server.to_owned(),
        credentials: credentials.as_deref().map(credentials_of).transpose()?,
        ca: raw.ca.as_ref().map(|text| typed.relative(text)),
        lease_s,
    })
}

/// Returns the settings of a client without a file.
///
/// # Errors
/// A name, an address or a file with credentials is invalid.
pub fn of_client(
    name: &str,
    server: &str,
    credentials: Option<&Path>,
) -> Result<FleetSettings, Failure> {
    check_name(name).map_err(|reason| Failure::Usage(format!("--fleet: {reason}")))?;
    check_server(server).map_err(|reason| Failure::Usage(format!("--server: {reason}")))?;
    Ok(FleetSettings {
        fleet: name.to_owned(),
        site: "client".to_owned(),
        server: server.to_owned(),
        credentials: credentials.map(credentials_of).transpose()?,
        ca: None,
        lease_s: LEASE_S,
    })
}

/// Reads a text file.
///
/// # Errors
/// The error of the operating system, with the path.
pub fn read(path: &Path) -> Result<String, Failure> {
    let wrong = |error: std::io::Error| Failure::Usage(format!("{}: {error}", path.display()));
    std::fs::read_to_string(path).map_err(wrong)
}

/// Reads a secret.
///
/// # Errors
/// Other accounts may read the file.
pub fn read_private(path: &Path) -> Result<String, Failure> {
    let wrong = |reason: String| Failure::Usage(format!("{}: {reason}", path.display()));
    let found = std::fs::metadata(path).map_err(|error| wrong(error.to_string()))?;
    let mode = found.permissions().mode() & 0o777;
    if mode & 0o077 != 0 {
        return Err(wrong(format!(
            "expected a file that only its owner may read (mode 0600), found mode {mode:04o}"
        )));
    }
    read(path)
}

fn credentials_of(path: &Path) -> Result<Credentials, Failure> {
    let wrong = |reason: String| Failure::Usage(format!("{}: {reason}", path.display()));
    Credentials::read(&read_private(path)?).map_err(wrong)
}

/// Checks a name that is part of a key of the NATS server.
///
/// # Errors
/// Expected and found text.
pub fn check_name(name: &str) -> Result<(), String> {
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
    check_address(server, ["nats", "tls"]).ok_or_else(expected)
}

fn check_bench_server(url: &str) -> Result<(), String> {
    let expected = || {
        format!("expected https://HOST:PORT, or http://HOST:PORT on this machine, found {url:?}")
    };
    check_address(url.trim_end_matches('/'), ["http", "https"]).ok_or_else(expected)
}

/// Checks an address; the clear-text scheme is allowed for this machine only.
fn check_address(address: &str, [clear, encrypted]: [&str; 2]) -> Option<()> {
    let (scheme, rest) = address.split_once("://")?;
    let (host, port) = rest.rsplit_once(':')?;
    let is_safe = scheme == encrypted || (scheme == clear && names_loopback(host));
    let is_host = !host.is_empty() && !host.contains(['@', '/', '?', '#']);
    (is_host && is_safe && port.parse::<u16>().is_ok()).then_some(())
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
        for url in [DEFAULT_BENCH_SERVER, "https://bench.lab.example:7420/"] {
            assert_eq!(check_bench_server(url), Ok(()), "{url}");
        }
        for url in [
            "http://bench.lab.example:7420",
            "https://a/b:7420",
            "http://127.0.0.1",
        ] {
            assert!(check_bench_server(url).is_err(), "{url}");
        }
    }

    #[test]
    fn a_mistake_is_named_with_file_line_and_field() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("fleet.toml");
        let head = "name = \"lab\"\nsite = \"north\"\ndata = \"data\"\n";
        let load_error = |more: &str| {
            std::fs::write(&path, format!("{head}{more}")).unwrap();
            AgentFile::load(&path).unwrap_err().to_string()
        };
        let found = load_error("listen = \"127.0.0.1:0\"\nlease = \"1 s\"\n");
        assert!(
            found.ends_with("fleet.toml:5: lease: expected 2 s to 600 s, found 1 s"),
            "{found}"
        );
        let found = load_error("listen = \"0.0.0.0:7430\"\n");
        assert!(
            found.contains("fleet.toml:4: listen: expected a section [tls]"),
            "{found}"
        );
        let found = load_error("listen = \"127.0.0.1:0\"\nlaese = \"1 s\"\n");
        assert!(
            found.contains("fleet.toml:5: unknown field `laese`"),
            "{found}"
        );
        std::fs::write(&path, format!("{head}listen = \"127.0.0.1:0\"\n")).unwrap();
        let file = AgentFile::load(&path).unwrap();
        assert_eq!(file.bench_server.url, DEFAULT_BENCH_SERVER);
        assert_eq!(file.data, folder.path().join("data"));
    }

    #[test]
    fn a_secret_that_others_may_read_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("secret");
        std::fs::write(&path, "eb_0").unwrap();
        let mode = |mode| {
            std::fs::set_permissions(&path, std::fs::Permissions::from_mode(mode)).unwrap();
            read_private(&path)
        };
        assert_eq!(mode(0o600).unwrap(), "eb_0");
        let message = mode(0o640).unwrap_err().to_string();
        assert!(
            message.ends_with("(mode 0600), found mode 0640"),
            "{message}"
        );
    }
}
