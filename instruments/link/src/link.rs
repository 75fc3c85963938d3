//! Link to one instrument: sends a query and returns its reply.
//!
//! The link enforces the rules that apply to every instrument: gaps and deadlines, the error queue
//! after a write, read-backs of settings, every message on the tap. After a timeout, a closed
//! connection or an invalid reply, the stream is dropped and stays so until [`Link::reconnect`],
//! because the next reply could belong to the last query. The same applies if a caller abandons an
//! exchange half-way. Nothing is ever sent twice. If the transport can clear the instrument,
//! reconnecting does so.
//!
//! Most instruments accept one client. [`Link::share`] returns a second handle on the same
//! connection, so that a watch can read a meter while a procedure drives the instrument. Handles
//! take turns, one exchange at a time and in the order of their requests: no handle waits longer
//! than the running exchange. [`Link::take_over`] locks out all other handles; this gives switching
//! off priority.
//!
//! Opening and closing send no message: disconnecting does not switch off.

mod connection;
mod conversation;
mod error;
mod guard;
mod profile;
mod recovery;

use std::{
    collections::BTreeSet,
    sync::{
        Arc, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
    time::Duration,
};

pub use conversation::ENDS_MESSAGES;
pub use error::LinkError;
pub use guard::{Grammar, NEVER_SENT};
pub use profile::{LinkOptions, LinkProfile};

use instruments_scpi::{
    decode::{Expect, Response},
    excerpt,
    status::ErrorEntry,
};
use tokio::sync::{Mutex, MutexGuard, Notify};

use conversation::Conversation;

use crate::{
    clock::Clock,
    transcript::{Direction, Payload, Record},
    transport::Address,
};

/// How long an exchange may go on after another handle has taken over: an answer that is on its way
/// is faster than a new connection.
const LAST_WORDS: Duration = Duration::from_millis(300);
/// No handle has taken over.
const SHARED: u64 = 0;

/// A handle on the connection to one instrument.
#[derive(Debug)]
pub struct Link {
    options: LinkOptions,
    shared: Arc<Shared>,
    /// Number of this handle among those of the connection, from 1.
    handle: u64,
}

/// State that the handles of one connection share.
#[derive(Debug)]
struct Shared {
    /// Handles wait for it in the order of their requests.
    conversation: Mutex<Conversation>,
    /// The only handle that may speak, or [`SHARED`].
    speaker: AtomicU64,
    speaker_changed: Notify,
    handles: AtomicU64,
    /// How long the last two questions for a line took, s, the later one first.
    answer_times_s: std::sync::Mutex<[f64; 2]>,
    /// Queries that the unit does not answer although it answers others.
    lacking: std::sync::Mutex<BTreeSet<String>>,
    /// Peculiarities of the unit, in words.
    notes: std::sync::Mutex<BTreeSet<String>>,
}

/// One exchange, given up shortly after another handle has taken over.
macro_rules! exchange {
    ($self:ident, |$conversation:ident| $work:expr) => {{
        let mut turn = $self.turn().await?;
        let $conversation = &mut *turn;
        tokio::select! {
            biased;
            outcome = $work => outcome,
            () = $self.taken_away() => Err($self.taken_over()),
        }
    }};
}

impl Link {
    /// Connects and sends nothing. A serial line must first be silent for the profile's `quiet`.
    ///
    /// # Errors
    /// [`LinkError::Connect`], [`LinkError::ConnectTimeout`], or [`LinkError::VirtualTime`] for a
    /// real port in virtual time.
    pub async fn open(options: LinkOptions) -> Result<Self, LinkError> {
        let mut link = Self::unconnected(options);
        link.connect().await?;
        Ok(link)
    }

    /// Connects for the first time, and sends nothing.
    ///
    /// # Errors
    /// As [`Link::open`].
    pub async fn connect(&mut self) -> Result<(), LinkError> {
        let quiet = self.options.profile.quiet;
        exchange!(self, |conversation| conversation.connect(quiet))
    }

    /// Creates a link without a connection, dropped until [`Link::connect`] or
    /// [`Link::reconnect`]: for an instrument that another client still uses.
    pub fn unconnected(options: LinkOptions) -> Self {
        let shared = Shared {
            conversation: Mutex::new(Conversation::new(options.clone())),
            speaker: AtomicU64::new(SHARED),
            speaker_changed: Notify::new(),
            handles: AtomicU64::new(1),
            answer_times_s: std::sync::Mutex::default(),
            lacking: std::sync::Mutex::default(),
            notes: std::sync::Mutex::default(),
        };
        Self {
            options,
            shared: Arc::new(shared),
            handle: 1,
        }
    }

    /// Returns a second handle on the same connection. Its waits count on `clock`.
    #[must_use]
    pub fn share(&self, clock: &Clock) -> Self {
        Self {
            options: LinkOptions {
                clock: clock.clone(),
                ..self.options.clone()
            },
            shared: self.shared.clone(),
            handle: self.shared.handles.fetch_add(1, Ordering::Relaxed) + 1,
        }
    }

    /// Keeps every other handle out until [`Link::release`]: their exchanges fail with
    /// [`LinkError::TakenOver`], the one in work after 0.3 s.
    pub fn take_over(&self) {
        self.shared.speaker.store(self.handle, Ordering::SeqCst);
        self.shared.speaker_changed.notify_waiters();
    }

    /// Lets every handle speak again.
    pub fn release(&self) {
        self.shared.speaker.store(SHARED, Ordering::SeqCst);
    }

    /// Returns the instrument's name on this bench.
    pub fn name(&self) -> &str {
        &self.options.name
    }

    /// Returns whether the unit does not know a query, as far as [`Self::note_lacking`] was called.
    pub fn lacks(&self, question: &str) -> bool {
        let lacking = &self.shared.lacking;
        let lacking = lacking.lock().unwrap_or_else(PoisonError::into_inner);
        lacking.contains(question)
    }

    /// Remembers a query that the unit does not know, for every handle, with the consequence in
    /// words.
    pub fn note_lacking(&self, question: &str, words: &str) {
        let lacking = &self.shared.lacking;
        lacking
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .insert(question.to_owned());
        self.note(&format!("`{question}` is {words}"));
    }

    /// Remembers a peculiarity of the unit that a report must name.
    pub fn note(&self, text: &str) {
        let notes = &self.shared.notes;
        let mut notes = notes.lock().unwrap_or_else(PoisonError::into_inner);
        if !notes.insert(text.to_owned()) {
            return;
        }
        tracing::warn!(link = self.name(), "{text}");
        self.options.tap.record(&Record {
            time_s: self.options.clock.now_s(),
            link: self.link(),
            direction: Direction::Remark,
            payload: Payload::Text(text.to_owned()),
        });
    }

    /// Returns the peculiarities of the unit so far.
    pub fn notes(&self) -> Vec<String> {
        let notes = &self.shared.notes;
        let notes = notes.lock().unwrap_or_else(PoisonError::into_inner);
        notes.iter().cloned().collect()
    }

    /// Returns the clock that timestamps the tap.
    pub fn clock(&self) -> &Clock {
        &self.options.clock
    }

    /// Returns the address of the instrument.
    pub fn address(&self) -> &Address {
        &self.options.address
    }

    /// Returns the communication profile of the instrument.
    pub fn profile(&self) -> &LinkProfile {
        &self.options.profile
    }

    /// Returns whether the link is dropped: it answers nothing until it is reconnected. A
    /// connection on which another handle runs an exchange does not count as dropped.
    pub fn is_dropped(&self) -> bool {
        self.shared
            .conversation
            .try_lock()
            .is_ok_and(|conversation| conversation.connection.is_none())
    }

    /// Reconnects and sends nothing. A serial line must first be silent for the longest possible
    /// reply time, because the reply to an old query could still be on its way. VXI-11, HiSLIP,
    /// USBTMC and GPIB keep their connection if it is usable; there the instrument is cleared, and
    /// receives a harmless query, before it is used again.
    ///
    /// # Errors
    /// As [`Link::open`], and [`LinkError::NotCleared`]; in these cases the link stays dropped.
    pub async fn reconnect(&mut self) -> Result<(), LinkError> {
        exchange!(self, |conversation| conversation.reconnect())
    }

    /// Drops the connection. Errors contain `why` until [`Self::reconnect`].
    pub async fn disconnect(&mut self, why: &str) {
        if let Ok(mut conversation) = self.turn().await {
            conversation.disconnect(why);
        }
    }

    /// Sends a message without a reply, then empties the error queue if the profile has one.
    ///
    /// # Errors
    /// [`LinkError::Refused`] if there was an error in the queue; otherwise as [`Link::query`].
    pub async fn send(&mut self, message: &str) -> Result<(), LinkError> {
        self.send_unchecked(message).await?;
        if self.options.profile.errors_on_demand {
            return Ok(());
        }
        let mut entries = self.drain_errors().await?.into_iter();
        match entries.next() {
            None => Ok(()),
            Some(ErrorEntry {
                code,
                message: text,
            }) => Err(LinkError::Refused {
                link: self.link(),
                message: message.to_owned(),
                code,
                text,
                further: entries.collect(),
            }),
        }
    }

    /// Sends a message without a reply and without an error query: for instruments that have no
    /// error queue and whose state is read back later.
    ///
    /// # Errors
    /// As [`Link::query`], without a deadline for an answer.
    pub async fn send_unchecked(&mut self, message: &str) -> Result<(), LinkError> {
        exchange!(self, |conversation| conversation.tell(message))
    }

    /// Sends a message whose last argument is raw data without a block header. No query follows;
    /// the caller reads the effect back later.
    ///
    /// # Errors
    /// [`LinkError::Malformed`] if the data contains a byte that would end the message; otherwise
    /// as [`Link::send_unchecked`].
    pub async fn send_data(&mut self, head: &str, data: &[u8]) -> Result<(), LinkError> {
        exchange!(self, |conversation| conversation.send_data(head, data))
    }

    /// Sends a query and waits for a line.
    ///
    /// # Errors
    /// [`LinkError::Timeout`], [`LinkError::WriteTimeout`], [`LinkError::Closed`],
    /// [`LinkError::Io`], [`LinkError::Garbage`] and [`LinkError::Noise`] drop the link;
    /// [`LinkError::Dropped`] if it was dropped before; [`LinkError::Unsendable`] if `message` is
    /// not printable ASCII.
    pub async fn query(&mut self, message: &str) -> Result<String, LinkError> {
        exchange!(self, |conversation| async {
            let asked_s = self.options.clock.machine_s();
            let answer = conversation.query(message).await;
            if matches!(answer, Ok(_) | Err(LinkError::Timeout { .. })) {
                self.note_answer_time(self.options.clock.machine_s() - asked_s);
            }
            answer
        })
    }

    fn note_answer_time(&self, time_s: f64) {
        let times = &self.shared.answer_times_s;
        let mut times_s = times.lock().unwrap_or_else(PoisonError::into_inner);
        *times_s = [time_s, times_s[0]];
    }

    /// Returns the shorter of the times, s, of the last two line queries by any handle; a query
    /// without a reply in time counts with its deadline. Time in which another handle had its turn
    /// does not count. Zero before the second query.
    pub fn answer_time_s(&self) -> f64 {
        let times = &self.shared.answer_times_s;
        let [last_s, before_s] = *times.lock().unwrap_or_else(PoisonError::into_inner);
        last_s.min(before_s)
    }

    /// Sends a query, waits for a block and returns its payload.
    ///
    /// # Errors
    /// As [`Link::query`], with the deadline for blocks.
    pub async fn query_block(&mut self, message: &str) -> Result<Vec<u8>, LinkError> {
        exchange!(self, |conversation| conversation
            .ask(message, Expect::Block))
        .map(Response::into_bytes)
    }

    /// Sends a setting and reads it back. `accept` checks the reply and returns the expected one if
    /// they differ.
    ///
    /// # Errors
    /// [`LinkError::ReadBack`] if the reply is not accepted; otherwise as [`Link::send`].
    pub async fn set(
        &mut self,
        message: &str,
        read_back: &str,
        accept: impl Fn(&str) -> Result<(), String>,
    ) -> Result<(), LinkError> {
        self.send(message).await?;
        let answered = self.query(read_back).await?;
        accept(&answered).map_err(|expected| LinkError::ReadBack {
            link: self.link(),
            sent: message.to_owned(),
            asked: read_back.to_owned(),
            answered: excerpt(answered.as_bytes()),
            expected,
        })
    }

    /// Removes the entries from the error queue, oldest first, at most 20. Returns an empty list if
    /// the profile has no error query.
    ///
    /// # Errors
    /// As [`Link::query`], and [`LinkError::ErrorQueue`], which drops the link, if the reply is not
    /// an error entry.
    pub async fn drain_errors(&mut self) -> Result<Vec<ErrorEntry>, LinkError> {
        let question = self.options.profile.error_query.unwrap_or_default();
        if self.lacks(question) {
            return Ok(Vec::new());
        }
        let entries = exchange!(self, |conversation| conversation.drain_errors());
        if !(self.options.profile.errors_on_demand
            && matches!(entries, Err(LinkError::Timeout { .. })))
        {
            return entries;
        }
        // Older firmware has no queue; an answer may also have been lost.
        self.reconnect().await?;
        self.query("*IDN?").await?;
        let entries = exchange!(self, |conversation| conversation.drain_errors());
        if !matches!(entries, Err(LinkError::Timeout { .. })) {
            return entries;
        }
        self.reconnect().await?;
        self.query("*IDN?").await?;
        self.note_lacking(
            question,
            "not known on this unit: only read-backs show what it refuses",
        );
        Ok(Vec::new())
    }

    /// Waits until this handle may speak.
    async fn turn(&self) -> Result<MutexGuard<'_, Conversation>, LinkError> {
        if self.is_kept_out() {
            return Err(self.taken_over());
        }
        let mut conversation = self.shared.conversation.lock().await;
        if self.is_kept_out() {
            return Err(self.taken_over());
        }
        conversation.options.clock.clone_from(&self.options.clock);
        Ok(conversation)
    }

    fn is_kept_out(&self) -> bool {
        let speaker = self.shared.speaker.load(Ordering::SeqCst);
        speaker != SHARED && speaker != self.handle
    }

    /// Returns when the exchange in work must give way to the handle that has taken over.
    async fn taken_away(&self) {
        loop {
            let changed = self.shared.speaker_changed.notified();
            if self.is_kept_out() {
                break;
            }
            changed.await;
        }
        let _ = self
            .options
            .clock
            .deadline(LAST_WORDS, std::future::pending::<()>())
            .await;
    }

    fn taken_over(&self) -> LinkError {
        LinkError::TakenOver { link: self.link() }
    }

    fn link(&self) -> String {
        self.options.name.clone()
    }
}
