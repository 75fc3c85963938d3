//! Accepts connections for the routes, encrypted if a certificate is configured. It closes the
//! connection of a peer that sends the head of a request too slowly.

use std::{net::SocketAddr, sync::Arc, time::Duration};

use axum::{Router, extract::Request};
use bench_http::acceptor;
use hyper::{body::Incoming, server::conn::http1, service::service_fn};
use hyper_util::{
    rt::{TokioIo, TokioTimer},
    service::TowerToHyperService,
};
use instruments_link::clock::Clock;
use tokio::{
    io::{AsyncRead, AsyncWrite},
    net::{TcpListener, TcpStream},
    sync::Semaphore,
};
use tokio_rustls::TlsAcceptor;

use super::caller::Peer;
use crate::{config::AgentFile, failure::Failure};

/// Maximum number of concurrent connections.
const CONNECTIONS: usize = 512;
/// Maximum size of the head of a request, bytes.
const HEAD_BYTES: usize = 16 * 1024;
/// Timeout of a handshake, and of the head of a request.
const PATIENCE: Duration = Duration::from_secs(10);
/// Pause after a failed accept, s: most likely the process is out of file descriptors.
const PAUSE_S: f64 = 0.1;

/// The socket of the agent.
pub(crate) struct Listener {
    socket: TcpListener,
    tls: Option<TlsAcceptor>,
    address: SocketAddr,
}

impl Listener {
    /// Starts to listen.
    ///
    /// # Errors
    /// The address is in use, or the certificate or key cannot be used.
    pub(crate) async fn bind(file: &AgentFile) -> Result<Self, Failure> {
        let tls = file.tls.as_ref();
        let tls = tls.map(|files| acceptor(&files.certificate, &files.key));
        let tls = tls.transpose().map_err(Failure::Usage)?;
        let socket = TcpListener::bind(file.listen).await.map_err(|error| {
            let listen = file.listen;
            Failure::Usage(format!("cannot listen on {listen}: {error}"))
        })?;
        let address = socket.local_addr()?;
        Ok(Self {
            socket,
            tls,
            address,
        })
    }

    /// Returns the address for a browser.
    pub(crate) fn url(&self) -> String {
        let scheme = if self.tls.is_some() { "https" } else { "http" };
        format!("{scheme}://{}", self.address)
    }

    /// Accepts and serves connections until the task is aborted.
    pub(crate) async fn accept(&self, router: &Router, clock: &Clock) {
        let places = Arc::new(Semaphore::new(CONNECTIONS));
        loop {
            let Ok((socket, peer)) = self.socket.accept().await else {
                clock.sleep_s(PAUSE_S).await;
                continue;
            };
            let Ok(place) = places.clone().try_acquire_owned() else {
                continue;
            };
            let (router, tls, clock) = (router.clone(), self.tls.clone(), clock.clone());
            tokio::spawn(async move {
                let _place = place;
                serve(&clock, router, socket, Peer(peer.ip()), tls).await;
            });
        }
    }
}

async fn serve(
    clock: &Clock,
    router: Router,
    socket: TcpStream,
    peer: Peer,
    tls: Option<TlsAcceptor>,
) {
    let _ = socket.set_nodelay(true);
    match tls {
        None => requests(router, socket, peer).await,
        Some(tls) => {
            if let Ok(Ok(stream)) = clock.deadline(PATIENCE, tls.accept(socket)).await {
                requests(router, stream, peer).await;
            }
        }
    }
}

async fn requests<S>(router: Router, stream: S, peer: Peer)
where
    S: AsyncRead + AsyncWrite + Unpin + Send + 'static,
{
    let service = TowerToHyperService::new(router);
    let service = service_fn(move |mut request: Request<Incoming>| {
        request.extensions_mut().insert(peer);
        hyper::service::Service::call(&service, request)
    });
    // Errors of a single connection are ignored.
    let _ = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(PATIENCE)
        .max_buf_size(HEAD_BYTES)
        .serve_connection(TokioIo::new(stream), service)
        .await;
}
