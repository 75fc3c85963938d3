//! Pipes inside this process, by name: mocks that need no port, and the only transport that is
//! exact in virtual time.

use std::{
    collections::HashMap,
    sync::{Arc, Mutex, PoisonError},
};

use tokio::{
    io::DuplexStream,
    sync::mpsc::{self, error::TrySendError},
};

use super::TransportError;

/// Bytes that a pipe holds in each direction before the writer waits.
const PIPE_BYTES: usize = 64 << 10;
/// Connections that a listener may leave waiting.
const BACKLOG: usize = 8;

/// The names that have a listener in this process. Cheap to clone; all clones share the same names.
#[derive(Debug, Clone, Default)]
pub struct MemoryHub {
    listeners: Arc<Mutex<HashMap<String, mpsc::Sender<DuplexStream>>>>,
}

impl MemoryHub {
    /// Creates a hub without listeners.
    pub fn new() -> Self {
        Self::default()
    }

    /// Listens under `name` until the listener is dropped; then the name is free again.
    ///
    /// # Errors
    /// [`TransportError::AlreadyListening`] if the name already has a listener.
    pub fn listen(&self, name: &str) -> Result<MemoryListener, TransportError> {
        let mut listeners = self
            .listeners
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        if listeners
            .get(name)
            .is_some_and(|listener| !listener.is_closed())
        {
            return Err(TransportError::AlreadyListening {
                name: name.to_owned(),
            });
        }
        let (sender, receiver) = mpsc::channel(BACKLOG);
        listeners.insert(name.to_owned(), sender);
        Ok(MemoryListener { receiver })
    }

    pub(super) fn connect(&self, name: &str) -> Result<DuplexStream, TransportError> {
        let listeners = self
            .listeners
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        let name = || name.to_owned();
        let listener = listeners
            .get(&name())
            .ok_or_else(|| TransportError::NobodyListens { name: name() })?;
        let (ours, theirs) = tokio::io::duplex(PIPE_BYTES);
        match listener.try_send(theirs) {
            Ok(()) => Ok(ours),
            Err(TrySendError::Full(_)) => Err(TransportError::Busy { name: name() }),
            Err(TrySendError::Closed(_)) => Err(TransportError::NobodyListens { name: name() }),
        }
    }
}

/// Takes in the connections to one name.
#[derive(Debug)]
pub struct MemoryListener {
    receiver: mpsc::Receiver<DuplexStream>,
}

impl MemoryListener {
    /// Waits for the next connection; `None` when the hub is gone and none can come.
    pub async fn accept(&mut self) -> Option<DuplexStream> {
        self.receiver.recv().await
    }
}
