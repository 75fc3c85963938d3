//! Backplane between a device and the transports that carry whole messages: an inbox and an output
//! queue, device clear, a seat for one client.
//!
//! The device handles its messages one after the other in a separate task, at its own pace; its
//! replies wait in the queue until they are read. As in a real instrument the queue outlives the
//! client: only a device clear empties it.

use std::{
    collections::VecDeque,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    time::Duration,
};

use instruments_link::clock::Clock;
use instruments_scpi::decode::{ProgramFramer, Terminator};
use tokio::{
    sync::{Mutex as Seat, Notify, OwnedMutexGuard, mpsc, watch},
    task::JoinHandle,
};

use super::{
    LONGEST_MESSAGE,
    answer::{Step, Then, answer},
};
use crate::Device;

/// Messages that may wait for the device.
const INBOX: usize = 64;
/// Bytes in the output queue beyond which the device waits for a read.
const MOST_WAITING: usize = 1 << 20;
/// How long a client waits for the one before it to leave.
const SEAT: Duration = Duration::from_millis(500);
/// Bit of the status byte: an answer is waiting (IEEE 488.2, clause 11.2.1.2).
pub(super) const MESSAGE_AVAILABLE: u8 = 0x10;

/// A transport's handle on a device; all clones share the device.
#[derive(Clone)]
pub(super) struct Backplane {
    terminator: Terminator,
    inbox: mpsc::Sender<Message>,
    shared: Arc<Shared>,
    seat: Arc<Seat<()>>,
    breaks: watch::Receiver<u64>,
}

struct Shared {
    output: Mutex<Output>,
    /// Counts device clears.
    generation: AtomicU64,
    /// A client has come since the last message.
    has_come: AtomicBool,
    changed: Notify,
    taken: Notify,
    cleared: Notify,
}

struct Message {
    generation: u64,
    id: u32,
    bytes: Vec<u8>,
}

#[derive(Default)]
struct Output {
    pieces: VecDeque<Piece>,
    bytes: usize,
    /// Nothing more is sent to this client once the queue is empty.
    stops: bool,
}

struct Piece {
    id: u32,
    bytes: VecDeque<u8>,
    end: bool,
}

/// Piece of an answer that was read out of the queue.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct ResponsePiece {
    /// Of the message that is answered.
    pub(super) id: u32,
    pub(super) bytes: Vec<u8>,
    /// With the last byte the message ends.
    pub(super) end: bool,
    /// The instrument sends nothing after this.
    pub(super) stops: bool,
}

impl Backplane {
    /// Puts a device behind a backplane; the task is the device's.
    pub(super) fn start(device: Box<dyn Device>, clock: Clock) -> (Self, JoinHandle<()>) {
        let (inbox, messages) = mpsc::channel(INBOX);
        let (broken, breaks) = watch::channel(0);
        let shared = Arc::new(Shared {
            output: Mutex::default(),
            generation: AtomicU64::new(0),
            has_come: AtomicBool::new(false),
            changed: Notify::new(),
            taken: Notify::new(),
            cleared: Notify::new(),
        });
        let plane = Self {
            terminator: device.terminator(),
            inbox,
            shared: shared.clone(),
            seat: Arc::default(),
            breaks,
        };
        (
            plane,
            tokio::spawn(work(device, messages, shared, broken, clock)),
        )
    }

    /// Takes the seat for one client, as soon as the one before it has left; `None` when it stays.
    pub(super) async fn sit_down(&self, clock: &Clock) -> Option<OwnedMutexGuard<()>> {
        let seat = clock
            .deadline(SEAT, self.seat.clone().lock_owned())
            .await
            .ok()?;
        self.shared.output().stops = false;
        self.shared.has_come.store(true, Ordering::SeqCst);
        Some(seat)
    }

    /// Framer that separates the messages of one client.
    pub(super) fn framer(&self) -> ProgramFramer {
        ProgramFramer::new(self.terminator, LONGEST_MESSAGE)
    }

    /// Waits until the device drops its connections.
    pub(super) fn breaks(&self) -> watch::Receiver<u64> {
        let mut breaks = self.breaks.clone();
        breaks.mark_unchanged();
        breaks
    }

    /// Passes complete messages of the framer on; waits while the device's inbox is full.
    pub(super) async fn hand_over(&self, framer: &mut ProgramFramer, id: u32) {
        while let Some(message) = framer.pull() {
            match message {
                Ok(bytes) => {
                    let message = Message {
                        generation: self.shared.generation(),
                        id,
                        bytes,
                    };
                    if self.inbox.send(message).await.is_err() {
                        return;
                    }
                }
                Err(error) => tracing::warn!(%error, "message dropped"),
            }
        }
    }

    /// Waits for an answer and takes up to `most` bytes of it, up to the byte `until` if it is
    /// there. May be abandoned.
    pub(super) async fn take(&self, most: usize, until: Option<u8>) -> ResponsePiece {
        loop {
            let changed = self.shared.changed.notified();
            if let Some(taken) = self.shared.output().take(most, until) {
                self.shared.taken.notify_one();
                return taken;
            }
            changed.await;
        }
    }

    /// An answer is waiting.
    pub(super) fn status_byte(&self) -> u8 {
        if self.shared.output().pieces.is_empty() {
            0
        } else {
            MESSAGE_AVAILABLE
        }
    }

    /// Discards the received messages, the running operation and the pending replies.
    pub(super) fn clear(&self) {
        self.shared.generation.fetch_add(1, Ordering::SeqCst);
        let mut output = self.shared.output();
        output.pieces.clear();
        output.bytes = 0;
        drop(output);
        self.shared.cleared.notify_waiters();
        self.shared.taken.notify_one();
    }
}

impl Shared {
    fn output(&self) -> MutexGuard<'_, Output> {
        self.output.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn generation(&self) -> u64 {
        self.generation.load(Ordering::SeqCst)
    }

    /// Waits for a device clear that came after this message.
    async fn cleared_since(&self, message: &Message) {
        loop {
            let cleared = self.cleared.notified();
            if message.generation != self.generation() {
                return;
            }
            cleared.await;
        }
    }

    /// Plays an answer into the queue.
    async fn play(&self, steps: Vec<Step>, message: &Message, clock: &Clock) {
        for step in steps {
            match step {
                Step::Wait(seconds) => clock.sleep_s(seconds).await,
                Step::Put { bytes, end } => {
                    while self.output().bytes > MOST_WAITING {
                        self.taken.notified().await;
                    }
                    if message.generation == self.generation() {
                        self.output().put(Piece {
                            id: message.id,
                            bytes: bytes.into(),
                            end,
                        });
                        self.changed.notify_waiters();
                    }
                }
            }
        }
    }
}

impl Output {
    fn put(&mut self, piece: Piece) {
        self.bytes += piece.bytes.len();
        self.pieces.push_back(piece);
    }

    fn take(&mut self, most: usize, until: Option<u8>) -> Option<ResponsePiece> {
        let piece = self.pieces.front_mut()?;
        let wanted = until
            .and_then(|until| piece.bytes.iter().position(|&byte| byte == until))
            .map_or(usize::MAX, |at| at + 1);
        let bytes: Vec<u8> = piece
            .bytes
            .drain(..wanted.min(most).min(piece.bytes.len()))
            .collect();
        let (id, whole) = (piece.id, piece.bytes.is_empty());
        let end = whole && piece.end;
        if whole {
            self.pieces.pop_front();
        }
        self.bytes -= bytes.len();
        Some(ResponsePiece {
            id,
            bytes,
            end,
            stops: self.stops && self.pieces.is_empty(),
        })
    }
}

/// The device at work.
async fn work(
    mut device: Box<dyn Device>,
    mut inbox: mpsc::Receiver<Message>,
    shared: Arc<Shared>,
    broken: watch::Sender<u64>,
    clock: Clock,
) {
    while let Some(message) = inbox.recv().await {
        if message.generation != shared.generation() {
            continue;
        }
        if shared.has_come.swap(false, Ordering::SeqCst) {
            device.connected(clock.now_s());
        }
        let (steps, then) = answer(device.as_mut(), clock.now_s(), &message.bytes);
        let says_nothing = !steps.iter().any(|step| matches!(step, Step::Put { .. }));
        tokio::select! {
            () = shared.play(steps, &message, &clock) => {}
            () = shared.cleared_since(&message) => {}
        }
        shared.output().stops |= then == Then::StopSending && !says_nothing;
        if then == Then::HangUp || (then == Then::StopSending && says_nothing) {
            broken.send_modify(|breaks| *breaks += 1);
        }
    }
}
