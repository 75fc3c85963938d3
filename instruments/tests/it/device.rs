//! A scripted device for the tests of the link: it replies as its script defines and does nothing
//! else.

use std::{
    io,
    sync::{Arc, Mutex},
    time::Duration,
};

use instruments::{
    clock::Clock,
    link::{Link, LinkError, LinkOptions, LinkProfile},
    scpi::decode::{ProgramFramer, Terminator},
    transcript::{Tap, Transcript},
    transport::{Address, MemoryHub},
};
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};

/// Reply of the device to one message.
#[derive(Debug, Clone)]
pub(crate) enum Reply {
    /// Sends no reply.
    Silence,
    /// Writes these pieces, each after a wait in bench seconds.
    Pieces(Vec<(f64, Vec<u8>)>),
    /// Closes the connection after these bytes.
    Hangup(Vec<u8>),
}

pub(crate) fn now(bytes: impl Into<Vec<u8>>) -> Reply {
    Reply::Pieces(vec![(0.0, bytes.into())])
}

pub(crate) fn later(after_s: f64, bytes: impl Into<Vec<u8>>) -> Reply {
    Reply::Pieces(vec![(after_s, bytes.into())])
}

/// Answers messages on `stream` until it ends.
pub(crate) async fn serve(
    mut stream: impl AsyncRead + AsyncWrite + Unpin,
    terminator: Terminator,
    clock: Clock,
    mut reply: impl FnMut(&str) -> Reply,
) {
    let mut framer = ProgramFramer::new(terminator, 4096);
    let mut buffer = [0; 4096];
    while let Ok(count @ 1..) = stream.read(&mut buffer).await {
        framer.push(&buffer[..count]);
        while let Some(message) = framer.pull() {
            let message = String::from_utf8(message.unwrap()).unwrap();
            match reply(&message) {
                Reply::Silence => {}
                Reply::Pieces(pieces) => {
                    for (after_s, bytes) in pieces {
                        clock.sleep_s(after_s).await;
                        // The other side may have disconnected in the meantime; a device ignores
                        // that.
                        if stream.write_all(&bytes).await.is_err() {
                            return;
                        }
                        stream.flush().await.unwrap();
                    }
                }
                Reply::Hangup(bytes) => {
                    stream.write_all(&bytes).await.unwrap();
                    return;
                }
            }
        }
    }
}

/// Serves `memory:device` on `hub`: every connection gets the same script, and the received
/// messages are collected.
pub(crate) fn serve_memory(
    hub: &MemoryHub,
    clock: &Clock,
    reply: impl FnMut(&str) -> Reply + Send + Clone + 'static,
) -> Arc<Mutex<Vec<(f64, String)>>> {
    let mut listener = hub.listen("device").unwrap();
    let heard = Arc::new(Mutex::new(Vec::new()));
    let (clock, log) = (clock.clone(), heard.clone());
    tokio::spawn(async move {
        while let Some(stream) = listener.accept().await {
            let (clock, log, mut reply) = (clock.clone(), log.clone(), reply.clone());
            tokio::spawn(async move {
                let device_clock = clock.clone();
                let heard = move |message: &str| {
                    log.lock()
                        .unwrap()
                        .push((clock.now_s(), message.to_owned()));
                    reply(message)
                };
                serve(stream, Terminator::Lf, device_clock, heard).await;
            });
        }
    });
    heard
}

/// A profile with short deadlines and no error queue.
pub(crate) fn plain() -> LinkProfile {
    LinkProfile {
        first_timeout: Duration::from_secs(3),
        timeout: Duration::from_secs(1),
        block_timeout: Duration::from_secs(5),
        error_query: None,
        ..LinkProfile::scpi()
    }
}

/// A writer that tests can read.
#[derive(Debug, Clone, Default)]
pub(crate) struct SharedText(Arc<Mutex<Vec<u8>>>);

impl SharedText {
    pub(crate) fn text(&self) -> String {
        String::from_utf8(self.0.lock().unwrap().clone()).unwrap()
    }

    /// The lines without their times, checked to be a transcript that can be read.
    pub(crate) fn lines(&self) -> Vec<String> {
        let transcript = Transcript::parse(&self.text()).unwrap();
        assert_eq!(transcript.torn, None);
        transcript
            .records
            .iter()
            .map(|record| record.to_string().split_once(' ').unwrap().1.to_owned())
            .collect()
    }
}

impl io::Write for SharedText {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.lock().unwrap().extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Opens a link named `dev`.
pub(crate) async fn open(
    address: &str,
    profile: LinkProfile,
    clock: &Clock,
    hub: &MemoryHub,
    tap: Tap,
) -> Result<Link, LinkError> {
    let address: Address = address.parse().unwrap();
    Link::open(LinkOptions {
        name: "dev".to_owned(),
        address,
        profile,
        clock: clock.clone(),
        hub: hub.clone(),
        tap,
    })
    .await
}
