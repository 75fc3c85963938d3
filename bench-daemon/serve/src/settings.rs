//! Settings of a server from its file: its address, what it serves, and its limits. They are
//! resolved once; every error names file, line and field.

use std::{
    net::SocketAddr,
    path::{Path, PathBuf},
    process::Command,
};

use instruments::loopback::names_loopback;
use jiff::civil::Time;
use serde::Deserialize;

use super::targets::{Email, Encryption, Targets};
use bench_evaluate::support::telemetry::{
    DETAIL_VARIABLE, EXCHANGES, WITHOUT_OTLP,
    endpoint::{self, check_address},
};
use bench_plan::{
    config::{
        self, ConfigError, Source, load_bench,
        quantity::{Duration, Quantity},
        schema::Kind,
    },
    support::confined_path::plain,
};

/// File of a server as it is typed.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Raw {
    /// Address and port, such as `127.0.0.1:7420`. Beyond this machine it needs `[tls]`.
    listen: String,
    /// Path of the only folder that the server writes to, from the folder of this file.
    data: String,
    /// Path of an existing folder; experiments are `experiments/NAME.toml` in it.
    configs: String,
    /// Paths of the bench files, from the folder of this file; the names of the benches must
    /// differ.
    benches: Vec<String>,
    /// Interval at which the outputs of idle benches are read, 10 s to 600 s. Each reading
    /// connects, asks and disconnects; it can collide with other programs on the same instruments.
    /// Left out: they are read only on request.
    read_idle: Option<Quantity<Duration>>,
    /// Certificate and key. Left out: the server listens on this machine only.
    tls: Option<RawTls>,
    /// Reverse proxy in front of the server, which encrypts and may authenticate users.
    proxy: Option<RawProxy>,
    /// Notices to people who do not watch the page.
    #[serde(default)]
    notify: RawNotify,
    /// Limits of the server.
    #[serde(default)]
    limits: RawLimits,
    /// Procedure of a stop.
    #[serde(default)]
    stop: RawStop,
    /// Traces and metrics for a collector.
    #[serde(default)]
    telemetry: RawTelemetry,
}

/// Traces and metrics over OTLP.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct RawTelemetry {
    /// Base address of a collector that takes OTLP over HTTP, such as `http://127.0.0.1:4318`:
    /// `https://…`, or `http://` on this machine; refused by a program that is built without the feature
    /// `otlp`. Left out: that of `OTEL_EXPORTER_OTLP_ENDPOINT`, or none.
    otlp: Option<String>,
    /// Whether each message to an instrument has its own span; a run has thousands.
    #[serde(default)]
    exchanges: bool,
}

/// Encryption of the connections.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct RawTls {
    /// Path of the certificate chain, PEM.
    certificate: String,
    /// Path of the private key, PEM.
    key: String,
}

/// A reverse proxy in front of a server.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct RawProxy {
    /// Name under which browsers reach the proxy over TLS, such as `bench.lab.example`, with its
    /// port if it is not 443. Requests for this host are answered in addition to those for this
    /// machine.
    host: String,
}

/// Notices of trips, of benches that are not verified off, and of ends of runs.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct RawNotify {
    /// Address to which each notice is posted as JSON: `https://…`, or `http://` on this machine.
    webhook: Option<String>,
    /// Local time, such as `22:00-06:00`, in which notices of ended runs are held back and sent
    /// together at its end. Notices of trips are always sent at once. Left out: none.
    quiet: Option<String>,
    /// Each notice as an e-mail.
    email: Option<RawEmail>,
}

/// E-mail by SMTP.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct RawEmail {
    /// Host and port of the mail server, such as `smtp.lab.example:465`.
    server: String,
    /// Encryption of the connection; `none` to this machine only.
    #[serde(default = "tls")]
    encryption: Encryption,
    /// User at the mail server. Left out: the server requires none.
    user: Option<String>,
    /// Path of a file that holds the password, from the folder of this file.
    password_file: Option<String>,
    /// Address of the sender.
    from: String,
    /// Addresses of the receivers, at least one.
    to: Vec<String>,
}

fn tls() -> Encryption {
    Encryption::Tls
}

/// Limits of a server.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct RawLimits {
    /// Longest body of a request, 1024 to 64 000 000 bytes. Left out: 262 144.
    body_bytes: Option<usize>,
    /// Average number of requests per second of one peer, 0.1 to 100 000. Left out: 100.
    requests_per_s: Option<f64>,
    /// Number of requests of one peer at once, 1 to 1 000 000. Left out: 400.
    burst: Option<f64>,
    /// Connections at the same time, 4 to 65 536. Left out: 512.
    connections: Option<usize>,
    /// Time limit of a peer to send the head or the body of a request, or to accept an answer, 0.1
    /// s to 600 s. Left out: 10 s.
    patience: Option<Quantity<Duration>>,
}

/// Procedure of a stop.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct RawStop {
    /// Time that a run has to end itself before it is killed, 0.5 s to 600 s. Left out: 10 s.
    wait: Option<Quantity<Duration>>,
}

/// A server as it is to be.
#[derive(Debug, Clone)]
pub struct Settings {
    /// Its file.
    pub file: PathBuf,
    /// Address of its socket.
    pub listen: SocketAddr,
    /// The only folder that it writes to: queue, runs, tokens, audit trail.
    pub data: PathBuf,
    /// The folder below which experiments, cells and profiles are: `experiments/NAME.toml` in it
    /// can be submitted by name.
    pub configs: PathBuf,
    /// The benches.
    pub benches: Vec<config::Bench>,
    /// Interval at which the outputs of idle benches are read, s.
    pub read_idle_s: Option<f64>,
    /// Certificate chain and key, PEM.
    pub tls: Option<(PathBuf, PathBuf)>,
    /// Name under which browsers reach a reverse proxy in front of it, over TLS.
    pub proxy_host: Option<String>,
    /// Where notices go.
    pub notify: Targets,
    /// Traces and metrics.
    pub telemetry: TelemetrySettings,
    /// Its bounds.
    pub limits: Limits,
    /// Time that a run has to end after a stop request before it is killed, s.
    pub stop_wait_s: f64,
}

/// Traces and metrics of a server and of the runs that it begins.
#[derive(Debug, Clone, Default)]
pub struct TelemetrySettings {
    /// Base address of the collector; `None` if the environment sets it.
    pub otlp: Option<String>,
    /// A span for each message to an instrument.
    pub exchanges: bool,
}

impl TelemetrySettings {
    /// Passes the trace endpoint to the process of a run.
    pub fn hand_over(&self, command: &mut Command) {
        if let Some(base) = &self.otlp {
            endpoint::hand_over(base, command);
        }
        if self.exchanges {
            command.env(DETAIL_VARIABLE, EXCHANGES);
        }
    }
}

/// Bounds of a server.
#[derive(Debug, Clone, Copy)]
pub struct Limits {
    /// Longest body of a request, bytes.
    pub body_bytes: usize,
    /// Requests of one peer per second, in the long run.
    pub requests_per_s: f64,
    /// Requests of one peer at once.
    pub burst: f64,
    /// Maximum number of simultaneous connections.
    pub connections: usize,
    /// Time limit for a peer to send a request head or a body, or to accept a reply, s.
    pub patience_s: f64,
}

impl Settings {
    /// Reads a server's file.
    ///
    /// # Errors
    /// The first mistake, with file, line and field.
    pub fn load(path: &Path) -> Result<Self, ConfigError> {
        let source = Source::read(path)?;
        check_moved_sections(&source)?;
        let raw: Raw = source.parse_as(Kind::Server)?;
        let listen: SocketAddr = raw.listen.parse().map_err(|_| {
            source.complain(
                "listen",
                format!(
                    "expected an address and a port, such as 127.0.0.1:7420, found {:?}",
                    raw.listen
                ),
            )
        })?;
        let tls = raw
            .tls
            .as_ref()
            .map(|tls| (source.relative(&tls.certificate), source.relative(&tls.key)));
        if !listen.ip().is_loopback() && tls.is_none() {
            let reason = format!(
                "expected a section [tls] with certificate and key to listen beyond this machine \
                (on {listen}), found none"
            );
            return Err(source.complain("listen", reason));
        }
        let benches = benches(&source, &raw.benches)?;
        let configs = absolute(source.relative(&raw.configs));
        if !configs.is_dir() {
            return Err(source.complain(
                "configs",
                format!("expected a folder, found none at {}", configs.display()),
            ));
        }
        let within = |field: &str, value: f64, (least, greatest): (f64, f64)| {
            let reason = || format!("expected {least} to {greatest}, found {value}");
            (least..=greatest)
                .contains(&value)
                .then_some(value)
                .ok_or_else(|| source.complain(field, reason()))
        };
        let proxy_host = raw.proxy.map(|proxy| proxy.host);
        if let Some(host) = proxy_host.as_ref().filter(|host| !is_host(host)) {
            let reason = format!("expected a name such as bench.lab.example, found {host:?}");
            return Err(source.complain("proxy.host", reason));
        }
        let limits = &raw.limits;
        let otlp = raw.telemetry.otlp;
        if let Some(reason) = otlp.as_deref().and_then(|base| check_address(base).err()) {
            return Err(source.complain("telemetry.otlp", reason));
        }
        if otlp.is_some() && !cfg!(feature = "otlp") {
            return Err(source.complain("telemetry.otlp", WITHOUT_OTLP.to_owned()));
        }
        Ok(Self {
            file: absolute(path.to_owned()),
            telemetry: TelemetrySettings {
                otlp,
                exchanges: raw.telemetry.exchanges,
            },
            notify: targets(&source, &raw.notify)?,
            proxy_host,
            listen,
            data: absolute(source.relative(&raw.data)),
            configs,
            benches,
            tls,
            limits: Limits {
                body_bytes: within(
                    "limits.body_bytes",
                    limits.body_bytes.unwrap_or(256 * 1024) as f64,
                    (1024.0, 64.0e6),
                )? as usize,
                requests_per_s: within(
                    "limits.requests_per_s",
                    limits.requests_per_s.unwrap_or(100.0),
                    (0.1, 1.0e5),
                )?,
                burst: within("limits.burst", limits.burst.unwrap_or(400.0), (1.0, 1.0e6))?,
                connections: within(
                    "limits.connections",
                    limits.connections.unwrap_or(512) as f64,
                    (4.0, 65_536.0),
                )? as usize,
                patience_s: within(
                    "limits.patience",
                    limits.patience.map_or(10.0, |patience| patience.si),
                    (0.1, 600.0),
                )?,
            },
            read_idle_s: raw
                .read_idle
                .map(|every| within("read_idle", every.si, (10.0, 600.0)))
                .transpose()?,
            stop_wait_s: within(
                "stop.wait",
                raw.stop.wait.map_or(10.0, |wait| wait.si),
                (0.5, 600.0),
            )?,
        })
    }

    /// Returns whether the server is reachable from this machine only: it listens nowhere else,
    /// and no proxy forwards to it.
    pub fn is_of_this_machine(&self) -> bool {
        self.listen.ip().is_loopback() && self.proxy_host.is_none()
    }

    /// Folder of the runs.
    pub fn runs(&self) -> PathBuf {
        self.data.join("runs")
    }

    /// A bench by its name.
    pub fn bench(&self, name: &str) -> Option<&config::Bench> {
        self.benches.iter().find(|bench| bench.name == name)
    }
}

/// Refuses sections that other programs read now: a server that ignored them would stop, in silence, the
/// work that they ask for.
fn check_moved_sections(source: &Source) -> Result<(), ConfigError> {
    let table: Result<toml::Table, _> = source.text().parse();
    let has = |section: &str| {
        let table = table.as_ref();
        table.is_ok_and(|table| table.contains_key(section))
    };
    if has("archive") {
        let reason = "the archive has a file of its own: move this section to `archive.toml`, add \
            `data`, and start `eis-archive follow archive.toml` (docs/archive.md)";
        return Err(source.complain("archive", reason));
    }
    if has("fleet") {
        let reason = "expected no section [fleet]: the program eis-fleet joins the fleet beside this \
            server; move the keys of the section into a file fleet.toml, add `data`, `listen` and \
            `bench_server` there, and start `eis-fleet agent fleet.toml` (docs/fleet.md)";
        return Err(source.complain("fleet", reason));
    }
    Ok(())
}

/// Where notices go, checked.
fn targets(source: &Source, raw: &RawNotify) -> Result<Targets, ConfigError> {
    if let Some(address) = &raw.webhook {
        check_address(address).map_err(|reason| source.complain("notify.webhook", reason))?;
    }
    let quiet = raw.quiet.as_deref().map(|text| {
        let time = |text: &str| Time::strptime("%H:%M", text.trim()).ok();
        let (from, to) = text.split_once('-')?;
        Some((time(from)?, time(to)?))
    });
    if quiet == Some(None) {
        let reason = format!(
            "expected two local times such as 22:00-06:00, found {:?}",
            raw.quiet.as_deref().unwrap_or_default()
        );
        return Err(source.complain("notify.quiet", reason));
    }
    Ok(Targets {
        webhook: raw.webhook.clone(),
        email: raw
            .email
            .as_ref()
            .map(|raw| email(source, raw))
            .transpose()?,
        quiet: quiet.flatten(),
    })
}

fn email(source: &Source, raw: &RawEmail) -> Result<Email, ConfigError> {
    let complain =
        |key: &str, reason: String| source.complain(&format!("notify.email.{key}"), reason);
    let server = raw
        .server
        .rsplit_once(':')
        .and_then(|(host, port)| Some((host, port.parse().ok()?)));
    let (host, port) = server.filter(|(host, _)| is_host(host)).ok_or_else(|| {
        let reason = format!(
            "expected a host and a port such as smtp.lab.example:465, found {:?}",
            raw.server
        );
        complain("server", reason)
    })?;
    if raw.encryption == Encryption::None && !names_loopback(host) {
        let reason =
            format!("expected `tls` or `starttls` to another machine ({host}), found `none`");
        return Err(complain("encryption", reason));
    }
    let mailbox = |key: &str, text: &String| {
        text.parse().map_err(|error| {
            complain(
                key,
                format!("expected an address such as bench@lab.example, found {text:?}: {error}"),
            )
        })
    };
    if raw.to.is_empty() {
        return Err(complain(
            "to",
            "expected at least one address, found none".to_owned(),
        ));
    }
    Ok(Email {
        host: host.to_owned(),
        port,
        encryption: raw.encryption,
        user: raw.user.clone(),
        password_file: raw
            .password_file
            .as_ref()
            .map(|path| absolute(source.relative(path))),
        from: mailbox("from", &raw.from)?,
        to: raw
            .to
            .iter()
            .map(|text| mailbox("to", text))
            .collect::<Result<_, _>>()?,
    })
}

/// Letters, digits, dots and dashes, and a port.
fn is_host(text: &str) -> bool {
    let (name, port) = text.split_once(':').unwrap_or((text, "443"));
    let part = |part: &str| {
        !part.is_empty() && part.chars().all(|c| c.is_ascii_alphanumeric() || c == '-')
    };
    name.split('.').all(part) && port.parse::<u16>().is_ok()
}

fn benches(source: &Source, paths: &[String]) -> Result<Vec<config::Bench>, ConfigError> {
    let mut found: Vec<config::Bench> = Vec::new();
    for (index, path) in paths.iter().enumerate() {
        let field = format!("benches.{}", index + 1);
        let (bench, _) = load_bench(&absolute(source.relative(path)))
            .map_err(|error| source.complain(&field, error.to_string()))?;
        if !plain(&bench.name) {
            return Err(source.complain(
                &field,
                format!(
                    "expected a name of letters, digits, `-` and `_`, found {:?}",
                    bench.name
                ),
            ));
        }
        if found.iter().any(|known| known.name == bench.name) {
            return Err(source.complain(
                &field,
                format!(
                    "expected a bench of another name, found a second {:?}",
                    bench.name
                ),
            ));
        }
        found.push(bench);
    }
    if found.is_empty() {
        return Err(source.complain("benches", "expected at least one bench file"));
    }
    Ok(found)
}

/// Returns the absolute path, so that processes started from here, and later ones, use the same
/// file.
fn absolute(path: PathBuf) -> PathBuf {
    std::path::absolute(&path).unwrap_or(path)
}
