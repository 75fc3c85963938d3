//! State that every handler gets.

use std::sync::Arc;

use bench_http::Rate;
use tokio::sync::Semaphore;

use super::super::{Server, imported};

/// Wrong tokens of one peer, and attempts of one without any that are written down, per second in
/// the long run and at once.
const GUESSES: (f64, f64) = (0.5, 20.0);

/// State that every handler gets.
#[derive(Clone)]
pub struct App {
    /// The server.
    pub server: Arc<Server>,
    /// Requests by peer.
    pub rate: Arc<Rate>,
    /// Wrong tokens by peer.
    pub guesses: Arc<Rate>,
    /// Attempts of peers without a token, as far as they are written down.
    pub strangers: Arc<Rate>,
    /// Places for files of spectra that are just being read.
    pub imports: Arc<Semaphore>,
}

impl App {
    /// The handlers' share of a server.
    pub fn of(server: &Arc<Server>) -> Self {
        let limits = server.settings.limits;
        let few = || Arc::new(Rate::new(GUESSES.0, GUESSES.1));
        let rate = Arc::new(Rate::new(limits.requests_per_s, limits.burst));
        Self {
            server: server.clone(),
            rate,
            guesses: few(),
            strangers: few(),
            imports: Arc::new(Semaphore::new(imported::AT_ONCE)),
        }
    }
}
