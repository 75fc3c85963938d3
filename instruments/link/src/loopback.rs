//! Decides whether a host is this machine. It queries no name server: a caller with a name first
//! resolves it to an address.

use std::net::IpAddr;

/// A number of the loopback interface, also an IPv4 number in the form of IPv6.
pub fn is_loopback(ip: IpAddr) -> bool {
    ip.to_canonical().is_loopback()
}

/// Checks a host as typed in an address or a URL; an IPv6 number may have brackets.
pub fn names_loopback(host: &str) -> bool {
    let host = host
        .strip_prefix('[')
        .and_then(|host| host.strip_suffix(']'))
        .unwrap_or(host);
    host.eq_ignore_ascii_case("localhost") || host.parse().is_ok_and(is_loopback)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_this_machine_is_this_machine() {
        for host in [
            "localhost",
            "LocalHost",
            "127.0.0.1",
            "127.8.0.9",
            "::1",
            "[::1]",
            "::ffff:127.0.0.1",
        ] {
            assert!(names_loopback(host), "{host}");
        }
        for host in [
            "",
            "[]",
            "[::1",
            "localhost.lab",
            "127.0.0.1.lab",
            "128.0.0.1",
            "10.0.0.1",
            "::ffff:10.0.0.1",
            "::2",
        ] {
            assert!(!names_loopback(host), "{host}");
        }
    }
}
