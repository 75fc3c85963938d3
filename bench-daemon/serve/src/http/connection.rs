//! Accepts connections for the routes: a limited number at once, encrypted if a certificate is
//! configured. Slow clients are dropped, whether they are slow to send a request head or to read
//! the reply.

use std::{
    collections::{HashMap, VecDeque},
    convert::Infallible,
    future::Future,
    io,
    net::{IpAddr, SocketAddr},
    pin::Pin,
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    task::{Context, Poll, ready},
    time::Duration,
};

use axum::{
    Router,
    extract::Request,
    http::{HeaderValue, StatusCode, header},
    response::IntoResponse,
};
use bench_http::{Problem, Refusal, acceptor, code_of};
use hyper::{body::Incoming, server::conn::http1, service::service_fn};
use hyper_util::{
    rt::{TokioIo, TokioTimer},
    service::TowerToHyperService,
};
use instruments::clock::Clock;
use nix::sys::resource::{Resource, getrlimit};
use tokio::{
    io::{AsyncRead, AsyncWrite, ReadBuf},
    net::{TcpListener, TcpStream},
    task::AbortHandle,
};
use tokio_rustls::TlsAcceptor;

use super::{App, caller::Peer, guard::is_stop, router};
use crate::Server;
use bench_core::safety::failure::Failure;

/// Longest head of a request, bytes.
const HEAD_BYTES: usize = 16 * 1024;
/// The silent of one peer have this part of all places.
const PEER_SHARE: usize = 2;
/// One peer, which may be a whole laboratory behind a proxy, can hold all places of active
/// connections except this fraction.
const OTHERS_SHARE: usize = 4;
/// A silent connection is not closed before this time, s, unless `FLOOD` times as many
/// connections as there are places arrive within it, or as many as the system has files for. That
/// is treated as a flood.
const GRACE_S: f64 = 1.0;
const FLOOD: usize = 16;
/// Open files that no connection may take: a stop above all needs some, for it starts `eis-bench
/// safe` and reads what that says.
const RESERVED: usize = 128;
/// Number of connections that are closed if no file is free for another one, and the pause before
/// the next attempt, s. New connections wait behind earlier ones.
const AT_ONCE: usize = 8;
const FULL_S: f64 = 0.001;
/// Pause after a socket that could not be accepted, s: out of files, most likely.
const BREATH_S: f64 = 0.1;

/// The socket and the settings of a listening server.
pub struct Listener {
    socket: TcpListener,
    tls: Option<TlsAcceptor>,
    address: SocketAddr,
}

impl Listener {
    /// Starts to listen.
    ///
    /// # Errors
    /// An address that is in use; a certificate or key that cannot be used.
    pub async fn bind(server: &Server) -> Result<Self, Failure> {
        let listen = server.settings.listen;
        let tls = server
            .settings
            .tls
            .as_ref()
            .map(|(certificate, key)| acceptor(certificate, key))
            .transpose()
            .map_err(Failure::Usage)?;
        let socket = TcpListener::bind(listen).await.map_err(|error| {
            let hint = if error.kind() == std::io::ErrorKind::AddrInUse {
                "; another program listens there: give another `listen` in the server's file"
            } else {
                ""
            };
            Failure::Usage(format!("cannot listen on {listen}: {error}{hint}"))
        })?;
        let address = socket.local_addr()?;
        Ok(Self {
            socket,
            tls,
            address,
        })
    }

    /// Returns the address for a browser.
    pub fn url(&self) -> String {
        format!(
            "{}://{}",
            if self.tls.is_some() { "https" } else { "http" },
            self.address
        )
    }

    /// Accepts and serves connections forever.
    pub async fn accept(&self, server: &Arc<Server>) {
        let app = App::of(server);
        let router = router(&app);
        let bounds = Bounds::of_system(server.settings.limits.connections);
        let mut places = Places {
            silent: VecDeque::new(),
            active: ActivePlaces::of(bounds.active),
        };
        let server_clock = server.clock.clone();
        loop {
            while server.counts.connections.load(Ordering::Relaxed) >= bounds.all as u64 {
                (0..AT_ONCE).for_each(|_| places.let_one_go());
                server.clock.sleep_s(FULL_S).await;
            }
            let Ok((socket, peer)) = self.socket.accept().await else {
                places.let_one_go();
                server.clock.sleep_s(BREATH_S).await;
                continue;
            };
            let asked = Arc::new(AtomicBool::new(false));
            let place = Place {
                asked: asked.clone(),
                active: places.active.clone(),
                peer: peer.ip(),
                held: None,
            };
            let (server, router, tls) = (server.clone(), router.clone(), self.tls.clone());
            // Counted from here on, not from its task's first turn on: that may come late.
            let counted = Counted::new(&server);
            let task = tokio::spawn(async move {
                let _counted = counted;
                serve(&server, router, place, socket, peer, tls).await;
            });
            let (peer, since_s) = (peer.ip(), server_clock.now_s());
            places.enter(
                Waiting {
                    asked,
                    peer,
                    since_s,
                    task: task.abort_handle(),
                },
                &bounds,
            );
        }
    }
}

/// How many connections there may be.
#[derive(Debug, PartialEq, Eq)]
struct Bounds {
    /// Maximum number of connections that have sent a request.
    active: usize,
    /// Maximum number of silent connections for which each may use its full time.
    silent: usize,
    /// Maximum number of silent connections at any time.
    flood: usize,
    /// Maximum number of all connections.
    all: usize,
}

impl Bounds {
    fn of_system(connections: usize) -> Self {
        // If the system does not report its limit, assume the usual default.
        let files = getrlimit(Resource::RLIMIT_NOFILE).map_or(1024, |(files, _)| {
            usize::try_from(files).unwrap_or(usize::MAX)
        });
        let bounds = Self::of(connections, files);
        if bounds.active < connections {
            tracing::warn!(
                "{connections} connections are configured, but {files} open files are granted: \
                there are places for {}",
                bounds.active
            );
        }
        bounds
    }

    fn of(connections: usize, files: usize) -> Self {
        let all = files - RESERVED.min(files / 2);
        let active = connections.min(all / 2);
        let flood = FLOOD.saturating_mul(connections).min(all - active);
        Self {
            active,
            silent: connections.min(flood),
            flood,
            all,
        }
    }
}

/// A connection that has not sent a request yet.
struct Waiting {
    /// Whether it has, meanwhile.
    asked: Arc<AtomicBool>,
    peer: IpAddr,
    /// When it came, s.
    since_s: f64,
    task: AbortHandle,
}

/// Places for connections. A silent connection keeps its place until others need it. The longest
/// silent connection of the same peer is closed first, so that a peer with a request, above all a
/// stop, is always served. No connection is closed within the time that a request head takes, as
/// long as the system has files. A connection that has sent a request stays, as far as places are
/// free.
struct Places {
    /// Connections that have not sent a request yet, in the order of their arrival.
    silent: VecDeque<Waiting>,
    active: ActivePlaces,
}

impl Places {
    /// Closes the longest silent connection of any peer, because no other connection can be
    /// accepted.
    fn let_one_go(&mut self) {
        self.silent.retain(|waiting| {
            !waiting.asked.load(Ordering::Relaxed) && !waiting.task.is_finished()
        });
        if let Some(waiting) = self.silent.pop_front()
            && !waiting.asked.swap(true, Ordering::Relaxed)
        {
            waiting.task.abort();
        }
    }

    fn enter(&mut self, waiting: Waiting, bounds: &Bounds) {
        let (peer, now_s) = (waiting.peer, waiting.since_s);
        let silent = &mut self.silent;
        silent.retain(|waiting| {
            !waiting.asked.load(Ordering::Relaxed) && !waiting.task.is_finished()
        });
        silent.push_back(waiting);
        loop {
            let of_peer = silent.iter().filter(|waiting| waiting.peer == peer).count();
            let longest = if of_peer > bounds.silent / PEER_SHARE {
                silent.iter().position(|waiting| waiting.peer == peer)
            } else {
                None
            };
            let longest = longest.or((silent.len() > bounds.silent).then_some(0));
            let old = |at: &usize| {
                silent
                    .get(*at)
                    .is_some_and(|waiting| now_s - waiting.since_s > GRACE_S)
                    || silent.len() > bounds.flood
            };
            let Some(waiting) = longest.filter(old).and_then(|at| silent.remove(at)) else {
                return;
            };
            // A connection whose request arrives at this moment is not closed.
            if !waiting.asked.swap(true, Ordering::Relaxed) {
                waiting.task.abort();
            }
        }
    }
}

/// Places of connections that have sent a request, by peer. A quarter of them is reserved for
/// peers other than the one that holds the most.
#[derive(Clone)]
struct ActivePlaces {
    most: usize,
    held: Arc<Mutex<HashMap<IpAddr, usize>>>,
}

impl ActivePlaces {
    fn of(most: usize) -> Self {
        Self {
            most,
            held: Arc::default(),
        }
    }

    fn take(&self, peer: IpAddr) -> Option<Held> {
        let mut held = self.held.lock().unwrap_or_else(PoisonError::into_inner);
        let own = held.get(&peer).copied().unwrap_or(0);
        if own >= self.most - self.most / OTHERS_SHARE || held.values().sum::<usize>() >= self.most
        {
            return None;
        }
        held.insert(peer, own + 1);
        Some(Held {
            active: self.clone(),
            peer,
        })
    }
}

/// A place that is free again with its connection's end.
struct Held {
    active: ActivePlaces,
    peer: IpAddr,
}

impl Drop for Held {
    fn drop(&mut self) {
        let mut held = self
            .active
            .held
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        if let Some(own) = held.get_mut(&self.peer) {
            *own -= 1;
            if *own == 0 {
                held.remove(&self.peer);
            }
        }
    }
}

/// The place of one connection.
struct Place {
    asked: Arc<AtomicBool>,
    active: ActivePlaces,
    peer: IpAddr,
    held: Option<Held>,
}

impl Place {
    /// Marks the connection as active once it has sent a request. Returns whether a place is
    /// free.
    fn activate(&mut self) -> bool {
        self.asked.store(true, Ordering::Relaxed);
        if self.held.is_none() {
            self.held = self.active.take(self.peer);
        }
        self.held.is_some()
    }
}

/// A connection that is counted for the metrics as long as it lives, however it ends.
struct Counted(Arc<Server>);

impl Counted {
    fn new(server: &Arc<Server>) -> Self {
        server.counts.connections.fetch_add(1, Ordering::Relaxed);
        Self(server.clone())
    }
}

impl Drop for Counted {
    fn drop(&mut self) {
        self.0.counts.connections.fetch_sub(1, Ordering::Relaxed);
    }
}

async fn serve(
    server: &Server,
    router: Router,
    place: Place,
    socket: TcpStream,
    peer: SocketAddr,
    tls: Option<TlsAcceptor>,
) {
    let _ = socket.set_nodelay(true);
    let patience = Duration::from_secs_f64(server.settings.limits.patience_s);
    match tls {
        None => requests(&server.clock, router, place, socket, peer, patience).await,
        Some(tls) => {
            if let Ok(Ok(stream)) = server.clock.deadline(patience, tls.accept(socket)).await {
                requests(&server.clock, router, place, stream, peer, patience).await;
            }
        }
    }
}

async fn requests<S>(
    clock: &Clock,
    router: Router,
    place: Place,
    stream: S,
    peer: SocketAddr,
    patience: Duration,
) where
    S: AsyncRead + AsyncWrite + Unpin + Send + 'static,
{
    let service = TowerToHyperService::new(router);
    let place = Mutex::new(place);
    let service = service_fn(move |mut request: Request<Incoming>| {
        request.extensions_mut().insert(Peer(peer.ip()));
        let stop = is_stop(request.method(), request.uri());
        let active = place
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .activate();
        // A stop needs no place.
        let answer = (active || stop).then(|| hyper::service::Service::call(&service, request));
        async move {
            let words = "expected fewer connections at once, found more than this server, or one \
            peer, has places for";
            let mut answer = match answer {
                Some(answer) => answer.await?,
                None => Refusal::of(StatusCode::SERVICE_UNAVAILABLE, words).into_response(),
            };
            if !active {
                // The server closes connections beyond the limit.
                answer
                    .headers_mut()
                    .insert(header::CONNECTION, HeaderValue::from_static("close"));
            }
            Ok::<_, Infallible>(answer)
        }
    });
    let stream = TimedStream {
        stream,
        clock: clock.clone(),
        patience,
        waits: None,
        instead: None,
    };
    // However a connection ends is its peer's business.
    let _ = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(patience)
        .max_buf_size(HEAD_BYTES)
        .serve_connection(TokioIo::new(stream), service)
        .await;
}

/// A stream that gives up a peer which does not accept what is sent to it. Replies that the HTTP
/// library generates itself, to an invalid or overlong head, get the format of every other
/// refusal.
struct TimedStream<S> {
    stream: S,
    clock: Clock,
    patience: Duration,
    waits: Option<Pin<Box<dyn Future<Output = ()> + Send>>>,
    /// Bytes that replace such an answer, and how many of them were sent.
    instead: Option<(Vec<u8>, usize)>,
}

/// Returns a refusal that replaces one that the library made, which has no body, or `None` for
/// any other reply.
fn instead_of(answer: &[u8]) -> Option<Vec<u8>> {
    let text = std::str::from_utf8(answer).ok()?;
    let status: u16 = text.strip_prefix("HTTP/1.")?.get(2..5)?.parse().ok()?;
    let lower = text.to_ascii_lowercase();
    let bare = (400..500).contains(&status)
        && lower.ends_with("\r\n\r\n")
        && !lower.contains("\r\ncontent-type:");
    if !bare || !lower.contains("\r\ncontent-length: 0\r\n") {
        return None;
    }
    let status = StatusCode::from_u16(status).ok()?;
    let message = match status {
        StatusCode::REQUEST_HEADER_FIELDS_TOO_LARGE => {
            format!(
                "expected a head of at most {HEAD_BYTES} bytes and 100 lines, found a longer one"
            )
        }
        StatusCode::URI_TOO_LONG => "expected a shorter path".to_owned(),
        _ => "expected a request of HTTP/1.1, found something else".to_owned(),
    };
    let body = serde_json::to_string(&Problem {
        code: code_of(status).to_owned(),
        message,
    })
    .ok()?;
    let head = format!(
        "HTTP/1.1 {status}\r\ncontent-type: application/json\r\ncontent-length: {}\r\n\
        connection: close\r\n\r\n",
        body.len()
    );
    Some((head + &body).into_bytes())
}

impl<S> TimedStream<S> {
    fn judge<T>(
        &mut self,
        context: &mut Context<'_>,
        sent: Poll<io::Result<T>>,
    ) -> Poll<io::Result<T>> {
        if sent.is_ready() {
            self.waits = None;
            return sent;
        }
        let (clock, patience) = (self.clock.clone(), self.patience);
        let waits = self
            .waits
            .get_or_insert_with(|| Box::pin(async move { clock.sleep(patience).await }));
        ready!(waits.as_mut().poll(context));
        Poll::Ready(Err(io::ErrorKind::TimedOut.into()))
    }
}

impl<S: AsyncRead + Unpin> AsyncRead for TimedStream<S> {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_read(context, buffer)
    }
}

impl<S: AsyncWrite + Unpin> AsyncWrite for TimedStream<S> {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        if self.instead.is_none() {
            self.instead = instead_of(bytes).map(|answer| (answer, 0));
        }
        while let Some((answer, done)) = self.instead.take() {
            let sent = Pin::new(&mut self.stream).poll_write(context, &answer[done..]);
            let sent = self.judge(context, sent);
            let Poll::Ready(Ok(count)) = sent else {
                self.instead = Some((answer, done));
                return sent;
            };
            if done + count >= answer.len() {
                return Poll::Ready(Ok(bytes.len()));
            }
            self.instead = Some((answer, done + count));
        }
        let sent = Pin::new(&mut self.stream).poll_write(context, bytes);
        self.judge(context, sent)
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        let sent = Pin::new(&mut self.stream).poll_flush(context);
        self.judge(context, sent)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        let sent = Pin::new(&mut self.stream).poll_shutdown(context);
        self.judge(context, sent)
    }
}

#[cfg(test)]
mod tests {
    use super::{ActivePlaces, Bounds, RESERVED, instead_of};
    use std::net::{IpAddr, Ipv4Addr};

    #[test]
    fn one_peer_leaves_a_quarter_of_the_places_and_gives_them_back() {
        let (active, one, other) = (
            ActivePlaces::of(8),
            IpAddr::V4(Ipv4Addr::LOCALHOST),
            IpAddr::V4(Ipv4Addr::UNSPECIFIED),
        );
        let mut held: Vec<_> = (0..8).map(|_| active.take(one)).collect();
        assert_eq!(held.iter().flatten().count(), 6);
        let others: Vec<_> = (0..4).map(|_| active.take(other)).collect();
        assert_eq!(others.iter().flatten().count(), 2);
        held.clear();
        held.extend((0..8).map(|_| active.take(one)));
        assert_eq!(held.iter().flatten().count(), 6);
    }

    #[test]
    fn connections_leave_files_for_a_stop_whatever_the_system_grants() {
        assert_eq!(
            Bounds::of(512, 1_048_576),
            Bounds {
                active: 512,
                silent: 512,
                flood: 8192,
                all: 1_048_448
            }
        );
        assert_eq!(
            Bounds::of(512, 1024),
            Bounds {
                active: 448,
                silent: 448,
                flood: 448,
                all: 896
            }
        );
        for files in [8, 64, 256, 300, 1024, 4096, 1_048_576] {
            let bounds = Bounds::of(512, files);
            assert!(
                bounds.active >= 1
                    && bounds.flood >= 1
                    && bounds.active + bounds.flood <= bounds.all,
                "{files}: {bounds:?}"
            );
            assert!(
                bounds.all + RESERVED.min(files / 2) <= files,
                "{files}: {bounds:?}"
            );
        }
    }

    #[test]
    fn only_an_answer_that_the_library_made_is_exchanged() {
        let bare = b"HTTP/1.1 431 Request Header Fields Too Large\r\nconnection: close\r\ncontent-length: 0\r\n\r\n";
        let text = String::from_utf8(instead_of(bare).unwrap()).unwrap();
        assert!(
            text.starts_with("HTTP/1.1 431 Request Header Fields Too Large\r\n"),
            "{text}"
        );
        assert!(
            text.contains(
                "{\"code\":\"head_too_large\",\"message\":\"expected a head of at most 16384 bytes"
            ),
            "{text}"
        );
        for kept in [
            "HTTP/1.1 404 Not Found\r\ncontent-type: application/json\r\ncontent-length: 0\r\n\r\n",
            "HTTP/1.1 200 OK\r\ncontent-length: 0\r\n\r\n",
            "HTTP/1.1 400 Bad Request\r\ncontent-length: 5\r\n\r\nhello",
            "any bytes of a body",
        ] {
            assert_eq!(instead_of(kept.as_bytes()), None, "{kept}");
        }
    }
}
