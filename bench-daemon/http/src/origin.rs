//! Restricts browsers: pages of other origins must not speak with a program through them.

use axum::http::{HeaderMap, HeaderValue, StatusCode, Uri, header};
use instruments_link::loopback::names_loopback;

use crate::Refusal;

/// Forbids content from other origins, inline scripts and frames.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; \
    connect-src 'self'; img-src 'self' data:; form-action 'none'; base-uri 'none'; \
    frame-ancestors 'none'";

/// Adds the headers that restrict browsers to an answer. A header that it has stays.
pub fn restrict(headers: &mut HeaderMap) {
    let fixed = [
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::REFERRER_POLICY, "no-referrer"),
        (header::CONTENT_SECURITY_POLICY, POLICY),
        (header::CACHE_CONTROL, "no-store"),
    ];
    for (name, value) in fixed {
        headers
            .entry(name)
            .or_insert(HeaderValue::from_static(value));
    }
}

/// Hosts under which a program is reached.
#[derive(Debug, Clone, Copy)]
pub struct Hosts<'a> {
    /// The program listens on this machine only.
    pub is_local: bool,
    /// Host of a reverse proxy before it.
    pub proxy: Option<&'a str>,
}

impl Hosts<'_> {
    /// Refuses requests of foreign pages in a browser, both under another host name (DNS
    /// rebinding) and from another origin.
    ///
    /// # Errors
    /// The host or the origin is another one.
    pub fn admit(self, headers: &HeaderMap, uri: &Uri) -> Result<(), Refusal> {
        let text = |name| headers.get(name).and_then(|value| value.to_str().ok());
        let host = text(header::HOST)
            .or_else(|| uri.authority().map(|authority| authority.as_str()))
            .unwrap_or_default();
        let name = host
            .rsplit_once(':')
            .filter(|(_, port)| port.chars().all(|c| c.is_ascii_digit()))
            .map_or(host, |(name, _)| name);
        if self.is_local && !names_loopback(name) && self.proxy != Some(host) {
            let message =
                format!("expected the host localhost, 127.0.0.1 or [::1], found {host:?}");
            return Err(Refusal::new(StatusCode::FORBIDDEN, "other_host", message));
        }
        let Some(origin) = text(header::ORIGIN) else {
            return Ok(());
        };
        match origin.split_once("://") {
            Some((_, origin)) if origin == host => Ok(()),
            _ => {
                let message = format!("expected a page of this address, found one of {origin:?}");
                Err(Refusal::new(StatusCode::FORBIDDEN, "other_origin", message))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_this_host_and_its_own_pages_are_heard() {
        let check = |host: &str, origin: Option<&str>, is_local| {
            let mut headers = HeaderMap::new();
            headers.insert(header::HOST, host.parse().unwrap());
            if let Some(origin) = origin {
                headers.insert(header::ORIGIN, origin.parse().unwrap());
            }
            let hosts = Hosts {
                is_local,
                proxy: Some("proxy.example"),
            };
            hosts.admit(&headers, &Uri::from_static("/")).is_ok()
        };
        for host in [
            "localhost",
            "localhost:7420",
            "127.0.0.1:7420",
            "127.0.0.9",
            "[::1]:7420",
            "[::1]",
        ] {
            assert!(check(host, None, true), "{host}");
            assert!(check(host, Some(&format!("http://{host}")), true), "{host}");
        }
        assert!(check("proxy.example", Some("https://proxy.example"), true));
        assert!(!check("proxy.example", Some("https://evil.example"), true));
        for host in [
            "evil.example",
            "proxy.example:1",
            "evil.example:7420",
            "127.0.0.1.evil.example",
            "10.0.0.1",
            "",
            "localhost.evil.example",
        ] {
            assert!(!check(host, None, true), "{host}");
        }
        assert!(
            check("bench.lab:7420", None, false)
                && check("bench.lab:7420", Some("https://bench.lab:7420"), false)
        );
        for origin in [
            "null",
            "https://evil.example",
            "http://localhost:1",
            "https://bench.lab",
        ] {
            assert!(!check("bench.lab:7420", Some(origin), false), "{origin}");
        }
    }
}
