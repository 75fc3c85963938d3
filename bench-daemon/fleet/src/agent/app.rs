//! State that all requests to the agent share.

use std::sync::{Arc, OnceLock};

use axum::http::StatusCode;
use bench_http::Rate;
use instruments_link::clock::Clock;

use super::{refusal::Refusal, server::BenchServer};
use crate::{client::Client, fleet::Fleet, settings::FleetSettings};

/// Sustained rate of requests of one peer per second, and size of a burst.
const REQUESTS: (f64, f64) = (50.0, 200.0);

/// State that all requests to the agent share.
pub(crate) struct AppState {
    /// The server of the benches.
    pub(crate) server: Arc<BenchServer>,
    /// The fleet.
    pub(crate) settings: FleetSettings,
    /// The membership, once the server has answered.
    pub(crate) joined: OnceLock<Joined>,
    /// Real time.
    pub(crate) clock: Clock,
    /// Requests by peer.
    pub(crate) rate: Rate,
    /// The agent listens on this machine only.
    pub(crate) is_local: bool,
}

/// The membership of the benches of the server.
pub(crate) struct Joined {
    /// The fleet.
    pub(crate) fleet: Arc<Fleet>,
    /// Names of the benches.
    pub(crate) benches: Vec<String>,
}

/// State that is passed to every handler.
pub(crate) type App = Arc<AppState>;

impl AppState {
    /// An agent that has not joined yet.
    pub(crate) fn new(
        server: Arc<BenchServer>,
        settings: FleetSettings,
        clock: Clock,
        is_local: bool,
    ) -> App {
        let (per_s, burst) = REQUESTS;
        Arc::new(Self {
            server,
            settings,
            joined: OnceLock::new(),
            clock,
            rate: Rate::new(per_s, burst),
            is_local,
        })
    }

    /// Returns the membership.
    ///
    /// # Errors
    /// The server has not answered since the agent was started.
    pub(crate) fn joined(&self) -> Result<&Joined, Refusal> {
        self.joined.get().ok_or_else(|| {
            let message = format!("the server {} has not answered yet", self.server.url());
            Refusal::of(StatusCode::SERVICE_UNAVAILABLE, message)
        })
    }

    /// Returns the fleet.
    ///
    /// # Errors
    /// As [`Self::joined`].
    pub(crate) fn fleet(&self) -> Result<&Arc<Fleet>, Refusal> {
        Ok(&self.joined()?.fleet)
    }

    /// Returns a client of the fleet.
    ///
    /// # Errors
    /// The broker has not been reachable since the start; as [`Self::joined`].
    pub(crate) fn client(&self) -> Result<Client, Refusal> {
        Ok(self.fleet()?.client()?)
    }

    /// Returns a user's name in the form that other sites show.
    pub(crate) fn by(&self, name: &str) -> String {
        format!("{name}@{}", self.settings.site)
    }
}
