//! Addresses of a collector, from the server's file or from the standard environment.

use std::process::Command;

use instruments::loopback::names_loopback;

/// Standard variables; a run inherits those of its server.
const ENDPOINT_VARIABLE: &str = "OTEL_EXPORTER_OTLP_ENDPOINT";
const TRACES_VARIABLE: &str = "OTEL_EXPORTER_OTLP_TRACES_ENDPOINT";
const METRICS_VARIABLE: &str = "OTEL_EXPORTER_OTLP_METRICS_ENDPOINT";
const PROTOCOL_VARIABLE: &str = "OTEL_EXPORTER_OTLP_PROTOCOL";
const DISABLED_VARIABLE: &str = "OTEL_SDK_DISABLED";

/// The only protocol that is spoken.
const PROTOCOL: &str = "http/protobuf";

/// Addresses to which traces and metrics are posted; `None` for a signal that is off.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Endpoints {
    /// Address of the traces.
    pub traces: Option<String>,
    /// Address of the metrics.
    pub metrics: Option<String>,
}

impl Endpoints {
    /// Addresses of one collector, below its base address.
    ///
    /// # Errors
    /// An address that is refused by [`check_address`], in words.
    pub fn of_base(base: &str) -> Result<Self, String> {
        check_address(base)?;
        let below = |signal: &str| format!("{}/v1/{signal}", base.trim_end_matches('/'));
        Ok(Self {
            traces: Some(below("traces")),
            metrics: Some(below("metrics")),
        })
    }

    /// Returns the addresses that the environment names; they are absent if it names none.
    ///
    /// # Errors
    /// A variable whose value cannot be used, with its name.
    pub fn from_environment() -> Result<Self, String> {
        Self::from_variables(&|name| std::env::var(name).ok())
    }

    /// Returns whether all signals are off.
    pub fn is_empty(&self) -> bool {
        self.traces.is_none() && self.metrics.is_none()
    }

    fn from_variables(variable: &dyn Fn(&str) -> Option<String>) -> Result<Self, String> {
        let set = |name: &str| variable(name).filter(|value| !value.is_empty());
        let checked = |name: &str| match set(name) {
            Some(address) => check_address(&address)
                .map(|()| Some(address))
                .map_err(|error| format!("{name}: {error}")),
            None => Ok(None),
        };
        let base = checked(ENDPOINT_VARIABLE)?;
        let base = base.as_deref().map(Self::of_base).transpose()?;
        let base = base.unwrap_or_default();
        let found = Self {
            traces: checked(TRACES_VARIABLE)?.or(base.traces),
            metrics: checked(METRICS_VARIABLE)?.or(base.metrics),
        };
        match set(PROTOCOL_VARIABLE) {
            Some(protocol) if protocol != PROTOCOL && !found.is_empty() => Err(format!(
                "{PROTOCOL_VARIABLE}: expected {PROTOCOL}, found {protocol:?}"
            )),
            _ => Ok(found),
        }
    }
}

/// Passes the address of a collector to a process, instead of the one in the environment.
pub fn hand_over(base: &str, command: &mut Command) {
    command
        .env(ENDPOINT_VARIABLE, base)
        .env_remove(TRACES_VARIABLE)
        .env_remove(METRICS_VARIABLE)
        .env_remove(PROTOCOL_VARIABLE);
}

/// Returns whether the environment switches telemetry off, which overrides any other setting.
pub fn is_disabled() -> bool {
    std::env::var(DISABLED_VARIABLE).is_ok_and(|value| value.eq_ignore_ascii_case("true"))
}

/// Refuses an address that is not `https://…`, or `http://` on this machine: telemetry contains
/// names of cells and of users' experiments.
///
/// # Errors
/// In words: expected and found.
pub fn check_address(address: &str) -> Result<(), String> {
    let (scheme, rest) = address.split_once("://").unwrap_or(("", address));
    let host = rest.split(['/', '?', '#']).next().unwrap_or_default();
    let name = host.rsplit_once(':').map_or(host, |(name, _)| name);
    let allowed = scheme == "https" || (scheme == "http" && names_loopback(name));
    if !allowed || name.is_empty() || host.contains('@') {
        return Err(format!(
            "expected an address https://HOST/PATH, or http:// on this machine, found {address:?}"
        ));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn from(variables: &[(&str, &str)]) -> Result<Endpoints, String> {
        Endpoints::from_variables(&|name| {
            let found = variables.iter().find(|(known, _)| *known == name);
            found.map(|(_, value)| (*value).to_owned())
        })
    }

    #[test]
    fn nothing_is_sent_unless_it_is_asked_for() {
        assert!(from(&[]).unwrap().is_empty());
        assert!(from(&[(ENDPOINT_VARIABLE, "")]).unwrap().is_empty());
        assert!(from(&[(PROTOCOL_VARIABLE, "grpc")]).unwrap().is_empty());
    }

    #[test]
    fn one_address_serves_both_signals_and_an_own_one_wins() {
        let found = from(&[
            (ENDPOINT_VARIABLE, "http://127.0.0.1:4318/"),
            (METRICS_VARIABLE, "https://metrics.example/push"),
        ])
        .unwrap();
        assert_eq!(
            (found.traces.as_deref(), found.metrics.as_deref()),
            (
                Some("http://127.0.0.1:4318/v1/traces"),
                Some("https://metrics.example/push")
            )
        );
    }

    #[test]
    fn what_cannot_be_used_is_named() {
        for (variable, value) in [
            (ENDPOINT_VARIABLE, "http://collector.example:4318"),
            (TRACES_VARIABLE, "127.0.0.1:4318"),
            (METRICS_VARIABLE, "https://user:word@collector.example"),
        ] {
            let error = from(&[(variable, value)]).unwrap_err();
            assert!(
                error.starts_with(variable) && error.contains(value),
                "{error}"
            );
        }
        let address = (ENDPOINT_VARIABLE, "http://localhost:4318");
        let error = from(&[address, (PROTOCOL_VARIABLE, "grpc")]).unwrap_err();
        assert_eq!(
            error,
            "OTEL_EXPORTER_OTLP_PROTOCOL: expected http/protobuf, found \"grpc\""
        );
    }
}
