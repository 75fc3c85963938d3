//! Link to one instrument: sends a question and returns its answer. One exchange at a time, by
//! `&mut self`.
//!
//! The link keeps the rules that hold for every instrument: gaps and deadlines, the error queue
//! after a write, reading back what was set, every message on the tap. After a timeout, a closed
//! connection or an answer that is none, the stream is dropped and stays so until
//! [`Link::reconnect`], for the next answer would be the last question's. The same holds when a
//! caller abandons an exchange half-way. Nothing is ever sent twice. Where the transport can clear
//! the instrument, reconnecting does so.
//!
//! Opening sends no message, closing sends none: disconnecting is not switching off.

mod connection;
mod error;
mod guard;
mod profile;
mod recovery;

use std::time::Duration;

pub use error::LinkError;
pub use guard::{Grammar, NEVER_SENT};
pub use profile::{LinkOptions, LinkProfile};

use instruments_scpi::{
    decode::{Expect, Response},
    excerpt,
    status::{self, ErrorEntry},
    text_of,
};

use connection::{Broken, Connection};
use guard::Refusal;

use crate::{
    clock::{Clock, TimeMode},
    transcript::{BlockRecord, Direction, INLINE_BLOCK_BYTES, Payload, Record},
    transport::{self, Address},
};

/// Most entries that are taken out of an error queue at once; real queues hold 10 to 30.
const MAX_QUEUED_ERRORS: usize = 20;
/// Bytes that data on a stream must not hold: those that end a message, and the one that begins a
/// block.
pub const ENDS_MESSAGES: [u8; 3] = [b'\n', b'\r', b'#'];

/// A connection to one instrument.
#[derive(Debug)]
pub struct Link {
    options: LinkOptions,
    /// Taken out during an exchange, so that an abandoned exchange drops it.
    connection: Option<Connection>,
    /// One on which an answer is overdue, and which can be cleared.
    stalled: Option<Connection>,
    /// Last question.
    asked: String,
    /// The instrument's answer to `*IDN?`.
    identity: Option<String>,
    /// Why there is no connection.
    why: String,
    /// Bench time before which nothing may be sent, s.
    ready_at_s: f64,
}

impl Link {
    /// Connects. Sends nothing; a serial line must first be silent for the profile's `quiet`.
    ///
    /// # Errors
    /// [`LinkError::Connect`], [`LinkError::ConnectTimeout`], or [`LinkError::VirtualTime`] for a
    /// real port in virtual time.
    pub async fn open(options: LinkOptions) -> Result<Self, LinkError> {
        let quiet = options.profile.quiet;
        let mut link = Self::unconnected(options);
        link.connect(quiet).await?;
        Ok(link)
    }

    /// A link without a connection, dropped until [`Link::reconnect`]: for an instrument that
    /// somebody else still talks to.
    pub fn unconnected(options: LinkOptions) -> Self {
        Self {
            options,
            connection: None,
            stalled: None,
            asked: String::new(),
            identity: None,
            why: "not connected yet".to_owned(),
            ready_at_s: f64::NEG_INFINITY,
        }
    }

    /// The instrument's name on this bench.
    pub fn name(&self) -> &str {
        &self.options.name
    }

    /// The clock whose time is on the tap.
    pub fn clock(&self) -> &Clock {
        &self.options.clock
    }

    /// Where the instrument is.
    pub fn address(&self) -> &Address {
        &self.options.address
    }

    /// How the instrument wants to be talked to.
    pub fn profile(&self) -> &LinkProfile {
        &self.options.profile
    }

    /// The link answers nothing until it is reconnected.
    pub fn is_dropped(&self) -> bool {
        self.connection.is_none()
    }

    /// Reconnects and sends nothing. A serial line must first be silent for the longest time that
    /// an answer may take, since the answer to an old question could still be on its way. VXI-11,
    /// HiSLIP, USBTMC and GPIB keep their connection if it is of use; the instrument is cleared
    /// there, and asked a harmless question, before it is used again.
    ///
    /// # Errors
    /// As [`Link::open`], and [`LinkError::NotCleared`]; the link stays dropped then.
    pub async fn reconnect(&mut self) -> Result<(), LinkError> {
        if let Some(stalled) = self.stalled.take() {
            match self.recover(stalled).await {
                Ok(()) => return Ok(()),
                Err(error) => self.drop_connection(&error),
            }
        }
        let quiet = self.options.profile.quiet.max(self.options.profile.timeout);
        self.connect(quiet).await?;
        match self
            .connection
            .take_if(|connection| connection.can_be_cleared())
        {
            Some(connection) => self
                .recover(connection)
                .await
                .inspect_err(|error| self.drop_connection(error)),
            None => Ok(()),
        }
    }

    /// Sends a message that has no answer, then empties the error queue where the profile names
    /// one.
    ///
    /// # Errors
    /// [`LinkError::Refused`] when there was an error in the queue; else as [`Link::query`].
    pub async fn send(&mut self, message: &str) -> Result<(), LinkError> {
        self.send_unchecked(message).await?;
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

    /// Sends a message that has no answer and asks nothing: for instruments without error queue
    /// whose state is read back later.
    ///
    /// # Errors
    /// As [`Link::query`], without a deadline for an answer.
    pub async fn send_unchecked(&mut self, message: &str) -> Result<(), LinkError> {
        self.tell(message).await
    }

    /// Sends a message whose last argument is data as it is, without a block's header. Nothing is
    /// asked: what became of it is read back later.
    ///
    /// # Errors
    /// [`LinkError::Malformed`] for data with a byte that would end the message; else as
    /// [`Link::send_unchecked`].
    pub async fn send_data(&mut self, head: &str, data: &[u8]) -> Result<(), LinkError> {
        // The grammar sees a number in the place of the data.
        self.guard(&format!("{head}0"), false)?;
        if let Some(byte) = data.iter().find(|byte| ENDS_MESSAGES.contains(byte)) {
            let reason =
                format!("expected data without the byte {byte:#04x}, which would end the message");
            return Err(LinkError::Malformed {
                link: self.link(),
                message: head.to_owned(),
                reason,
            });
        }
        let mut connection = self.begin(head)?;
        let sent = self.hand_over_data(&mut connection, head, data).await;
        self.finish(connection, sent)
    }

    /// Asks and waits for a line.
    ///
    /// # Errors
    /// [`LinkError::Timeout`], [`LinkError::WriteTimeout`], [`LinkError::Closed`],
    /// [`LinkError::Io`], [`LinkError::Garbage`] and [`LinkError::Noise`] drop the link;
    /// [`LinkError::Dropped`] when it was dropped before; [`LinkError::Unsendable`] when `message`
    /// is not printable ASCII.
    pub async fn query(&mut self, message: &str) -> Result<String, LinkError> {
        let answer = self
            .ask(message, Expect::Line)
            .await
            .map(Response::into_text)?;
        if message == "*IDN?" {
            self.identity = Some(answer.clone());
        }
        Ok(answer)
    }

    /// Asks and waits for a block; answers its payload.
    ///
    /// # Errors
    /// As [`Link::query`], with the deadline for blocks.
    pub async fn query_block(&mut self, message: &str) -> Result<Vec<u8>, LinkError> {
        self.ask(message, Expect::Block)
            .await
            .map(Response::into_bytes)
    }

    /// Sets something and reads it back. `accept` says of the answer what was expected instead.
    ///
    /// # Errors
    /// [`LinkError::ReadBack`] when the answer is not accepted; else as [`Link::send`].
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

    /// Takes the entries out of the error queue, the oldest first, at most 20. Empty where the
    /// profile names no error query.
    ///
    /// # Errors
    /// As [`Link::query`], and [`LinkError::ErrorQueue`], which drops the link, when the answer is
    /// no entry.
    pub async fn drain_errors(&mut self) -> Result<Vec<ErrorEntry>, LinkError> {
        let mut entries = Vec::new();
        let Some(error_query) = self.options.profile.error_query else {
            return Ok(entries);
        };
        while entries.len() < MAX_QUEUED_ERRORS {
            let answer = self.query(error_query).await?;
            match status::parse_error(&answer) {
                Ok(entry) if entry.is_ok() => break,
                Ok(entry) => entries.push(entry),
                Err(source) => {
                    let error = LinkError::ErrorQueue {
                        link: self.link(),
                        message: error_query.to_owned(),
                        source,
                    };
                    self.drop_connection(&error);
                    return Err(error);
                }
            }
        }
        Ok(entries)
    }

    async fn connect(&mut self, quiet: Duration) -> Result<(), LinkError> {
        (self.connection, self.stalled) = (None, None);
        self.why = "connecting was abandoned".to_owned();
        match self.try_connect(quiet).await {
            Ok(connection) => {
                self.connection = Some(connection);
                self.remark(&format!("connected to {}", self.options.address));
                Ok(())
            }
            Err(error) => {
                self.drop_connection(&error);
                Err(error)
            }
        }
    }

    async fn try_connect(&self, quiet: Duration) -> Result<Connection, LinkError> {
        let LinkOptions {
            address,
            profile,
            clock,
            hub,
            ..
        } = &self.options;
        if clock.mode() == TimeMode::Virtual && !matches!(address, Address::Memory { .. }) {
            return Err(LinkError::VirtualTime {
                link: self.link(),
                address: address.clone(),
            });
        }
        let deadline = profile.first_timeout;
        let channel = match clock
            .deadline(deadline, transport::connect(address, hub))
            .await
        {
            Err(_) => {
                return Err(LinkError::ConnectTimeout {
                    link: self.link(),
                    address: address.clone(),
                    deadline,
                });
            }
            Ok(opened) => opened.map_err(|source| LinkError::Connect {
                link: self.link(),
                source,
            })?,
        };
        let mut connection = Connection::new(channel, profile.decoder_options());
        if connection.is_serial() {
            self.wait_for_silence(&mut connection, quiet).await?;
        }
        self.leave_nothing_behind(&mut connection).await?;
        Ok(connection)
    }

    async fn wait_for_silence(
        &self,
        connection: &mut Connection,
        quiet: Duration,
    ) -> Result<(), LinkError> {
        const MAX_INTERRUPTIONS: usize = 50;
        for _ in 0..MAX_INTERRUPTIONS {
            match self
                .options
                .clock
                .deadline(quiet, connection.read_more(quiet))
                .await
            {
                Err(_) => return Ok(()),
                Ok(read) => read.map_err(|broken| self.error(broken, "connecting"))?,
            }
            self.drain(connection, "connecting").await?;
        }
        Err(LinkError::Noise {
            link: self.link(),
            message: "connecting".to_owned(),
            bytes: MAX_INTERRUPTIONS,
        })
    }

    #[tracing::instrument(
        name = "exchange",
        level = "trace",
        skip_all,
        fields(otel.kind = "client", eis_bench.instrument = %self.options.name, eis_bench.message = %message)
    )]
    async fn tell(&mut self, message: &str) -> Result<(), LinkError> {
        self.guard(message, false)?;
        let mut connection = self.begin(message)?;
        let handed_over = self.hand_over(&mut connection, message).await;
        self.finish(connection, handed_over)
    }

    #[tracing::instrument(
        name = "exchange",
        level = "trace",
        skip_all,
        fields(otel.kind = "client", eis_bench.instrument = %self.options.name, eis_bench.message = %message)
    )]
    async fn ask(&mut self, message: &str, expect: Expect) -> Result<Response, LinkError> {
        self.guard(message, true)?;
        let mut connection = self.begin(message)?;
        let answer = match self.hand_over(&mut connection, message).await {
            Ok(()) => self.wait_for_answer(&mut connection, message, expect).await,
            Err(error) => Err(error),
        };
        self.finish(connection, answer)
    }

    fn guard(&self, message: &str, answered: bool) -> Result<(), LinkError> {
        let LinkProfile {
            grammar,
            never_sent,
            ..
        } = self.options.profile;
        let text = || excerpt(message.as_bytes());
        if message.is_empty()
            || !message
                .bytes()
                .all(|byte| byte == b' ' || byte.is_ascii_graphic())
        {
            return Err(LinkError::Unsendable {
                link: self.link(),
                message: text(),
            });
        }
        guard::judge(grammar, never_sent, message, answered).map_err(|refusal| match refusal {
            Refusal::Malformed(reason) => LinkError::Malformed {
                link: self.link(),
                message: text(),
                reason,
            },
            Refusal::Forbidden(header) => LinkError::Forbidden {
                link: self.link(),
                message: text(),
                header,
            },
        })
    }

    fn begin(&mut self, message: &str) -> Result<Connection, LinkError> {
        let Some(connection) = self.connection.take() else {
            return Err(LinkError::Dropped {
                link: self.link(),
                why: self.why.clone(),
            });
        };
        self.why = format!("`{message}` was abandoned before it was done");
        message.clone_into(&mut self.asked);
        Ok(connection)
    }

    fn finish<T>(
        &mut self,
        connection: Connection,
        outcome: Result<T, LinkError>,
    ) -> Result<T, LinkError> {
        match &outcome {
            Ok(_) => self.connection = Some(connection),
            Err(error) => {
                self.drop_connection(error);
                let is_overdue = matches!(
                    error,
                    LinkError::Timeout { .. } | LinkError::WriteTimeout { .. }
                );
                self.stalled =
                    Some(connection).filter(|connection| is_overdue && connection.can_be_cleared());
            }
        }
        outcome
    }

    async fn hand_over(
        &mut self,
        connection: &mut Connection,
        message: &str,
    ) -> Result<(), LinkError> {
        self.hand_over_data(connection, message, &[]).await
    }

    async fn hand_over_data(
        &mut self,
        connection: &mut Connection,
        message: &str,
        data: &[u8],
    ) -> Result<(), LinkError> {
        let LinkProfile {
            terminator,
            timeout: deadline,
            min_gap,
            write_gap,
            ..
        } = self.options.profile;
        let clock = self.options.clock.clone();
        clock.sleep_s(self.ready_at_s - clock.now_s()).await;
        self.drain(connection, message).await?;
        let payload = if data.is_empty() {
            Payload::Text(message.to_owned())
        } else {
            Payload::Block(BlockRecord::new(message, data))
        };
        self.record(Direction::Sent, payload);
        let bytes = [message.as_bytes(), data, terminator.bytes()].concat();
        let timed_out = |_| LinkError::WriteTimeout {
            link: self.link(),
            message: message.to_owned(),
            deadline,
        };
        let written = clock
            .deadline(deadline, connection.write(&bytes))
            .await
            .map_err(timed_out)?;
        written.map_err(|broken| self.error(broken, message))?;
        self.ready_at_s = clock.now_s() + min_gap.max(write_gap).as_secs_f64();
        Ok(())
    }

    async fn wait_for_answer(
        &mut self,
        connection: &mut Connection,
        message: &str,
        expect: Expect,
    ) -> Result<Response, LinkError> {
        let LinkProfile {
            first_timeout,
            timeout,
            block_timeout,
            min_gap,
            ..
        } = self.options.profile;
        let clock = self.options.clock.clone();
        let usual = if expect == Expect::Block {
            block_timeout
        } else {
            timeout
        };
        let deadline = if connection.has_answered {
            usual
        } else {
            usual.max(first_timeout)
        };
        let timed_out = |_| LinkError::Timeout {
            link: self.link(),
            message: message.to_owned(),
            deadline,
        };
        let read = clock
            .deadline(deadline, connection.read(expect, deadline))
            .await
            .map_err(timed_out)?;
        let answer = read.map_err(|broken| self.error(broken, message))?;
        self.record(Direction::Received, payload_of(&answer));
        self.ready_at_s = clock.now_s() + min_gap.as_secs_f64();
        Ok(answer)
    }

    /// Throws away bytes that came unasked: they are no answer to the next question.
    async fn drain(&self, connection: &mut Connection, message: &str) -> Result<(), LinkError> {
        let unasked = connection
            .drain()
            .await
            .map_err(|broken| self.error(broken, message))?;
        if !unasked.is_empty() {
            tracing::warn!(
                link = %self.options.name,
                bytes = unasked.len(),
                found = %excerpt(&unasked),
                before = message,
                "unasked bytes were thrown away"
            );
            let is_short = unasked.len() <= INLINE_BLOCK_BYTES;
            let payload = if is_short {
                Payload::Text(text_of(&unasked))
            } else {
                Payload::Block(BlockRecord::new("", &unasked))
            };
            self.record(Direction::Unsolicited, payload);
        }
        Ok(())
    }

    fn drop_connection(&mut self, error: &LinkError) {
        self.connection = None;
        self.why = error.to_string();
        tracing::warn!(link = %self.options.name, %error, "the link is dropped");
        self.remark(&format!("dropped: {error}"));
    }

    fn error(&self, broken: Broken, message: &str) -> LinkError {
        let (link, message) = (self.link(), message.to_owned());
        match broken {
            Broken::Closed => LinkError::Closed { link, message },
            Broken::Io(source) => LinkError::Io {
                link,
                message,
                source,
            },
            Broken::Garbage(source) => LinkError::Garbage {
                link,
                message,
                source,
            },
            Broken::Noise(bytes) => LinkError::Noise {
                link,
                message,
                bytes,
            },
        }
    }

    fn remark(&self, text: &str) {
        self.record(Direction::Remark, Payload::Text(text.to_owned()));
    }

    fn record(&self, direction: Direction, payload: Payload) {
        self.options.tap.record(&Record {
            time_s: self.options.clock.now_s(),
            link: self.link(),
            direction,
            payload,
        });
    }

    fn link(&self) -> String {
        self.options.name.clone()
    }
}

fn payload_of(answer: &Response) -> Payload {
    match answer {
        Response::Line(line) => Payload::Text(line.clone()),
        Response::Block { prefix, payload } => Payload::Block(BlockRecord::new(prefix, payload)),
    }
}
