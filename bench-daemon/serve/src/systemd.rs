//! Notifies systemd over the datagram socket in `NOTIFY_SOCKET` (sd_notify(3)): ready, alive,
//! stopping. Without the socket it sends nothing.

use std::os::{
    linux::net::SocketAddrExt,
    unix::net::{SocketAddr, UnixDatagram},
};

/// The line to systemd.
#[derive(Debug)]
pub struct Notify {
    to: Option<(UnixDatagram, SocketAddr)>,
    /// So often it wants to hear that the server lives, s.
    pub watchdog_s: Option<f64>,
}

impl Notify {
    /// As the environment says.
    pub fn from_environment() -> Self {
        let to = std::env::var("NOTIFY_SOCKET").ok().and_then(|path| {
            let address = match path.strip_prefix('@') {
                Some(name) => SocketAddr::from_abstract_name(name),
                None => SocketAddr::from_pathname(&path),
            };
            Some((UnixDatagram::unbound().ok()?, address.ok()?))
        });
        let mine = std::env::var("WATCHDOG_PID")
            .ok()
            .is_none_or(|pid| pid == std::process::id().to_string());
        let microseconds = std::env::var("WATCHDOG_USEC")
            .ok()
            .and_then(|text| text.parse::<f64>().ok());
        // Twice as often as it asks for.
        Self {
            watchdog_s: microseconds
                .filter(|_| mine && to.is_some())
                .map(|microseconds| 0.5e-6 * microseconds),
            to,
        }
    }

    /// Sends a message, such as `READY=1`. Does not wait for a receiver.
    pub fn say(&self, text: &str) {
        if let Some((socket, address)) = &self.to {
            let _ = socket.send_to_addr(text.as_bytes(), address);
        }
    }
}
