//! State of the one connection that all handles of a link share, and the rules of one exchange on
//! it. `Link` decides which handle speaks next; here one handle has the connection.

use std::time::Duration;

use instruments_scpi::{
    decode::{Expect, Response},
    excerpt,
    status::{self, ErrorEntry},
    text_of,
};

use super::{
    connection::{Broken, Connection},
    error::LinkError,
    guard::{self, Refusal},
    profile::{LinkOptions, LinkProfile},
};
use crate::{
    clock::{Clock, TimeMode},
    transcript::{BlockRecord, Direction, INLINE_BLOCK_BYTES, Payload, Record},
    transport::{self, Address},
};

/// Bytes that data on a stream must not hold: those that end a message, and the one that begins a
/// block.
pub const ENDS_MESSAGES: [u8; 3] = [b'\n', b'\r', b'#'];
/// Most entries that are taken out of an error queue at once; real queues hold 10 to 30.
const MAX_QUEUED_ERRORS: usize = 20;

/// A connection to one instrument, and its known state.
#[derive(Debug)]
pub(super) struct Conversation {
    /// Options of the handle that speaks.
    pub(super) options: LinkOptions,
    /// Taken out during an exchange, so that an abandoned exchange drops it.
    pub(super) connection: Option<Connection>,
    /// One on which an answer is overdue, and which can be cleared.
    pub(super) stalled: Option<Connection>,
    /// Last question.
    pub(super) asked: String,
    /// The instrument's answer to `*IDN?`.
    pub(super) identity: Option<String>,
    /// Reason for the missing connection.
    why: String,
    /// The error that dropped the connection last.
    dropped_by: String,
    /// Bench time before which nothing may be sent, s.
    ready_at_s: f64,
}

impl Conversation {
    /// Creates the state without a connection.
    pub(super) fn new(options: LinkOptions) -> Self {
        Self {
            options,
            connection: None,
            stalled: None,
            asked: String::new(),
            identity: None,
            why: "not connected yet".to_owned(),
            dropped_by: String::new(),
            ready_at_s: f64::NEG_INFINITY,
        }
    }

    /// Returns the clock that timestamps the tap.
    pub(super) fn clock(&self) -> &Clock {
        &self.options.clock
    }

    pub(super) async fn reconnect(&mut self) -> Result<(), LinkError> {
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

    pub(super) async fn send_data(&mut self, head: &str, data: &[u8]) -> Result<(), LinkError> {
        // For the grammar, a number replaces the data.
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

    /// Drops the connection.
    pub(super) fn disconnect(&mut self, why: &str) {
        (self.connection, self.stalled) = (None, None);
        why.clone_into(&mut self.why);
        self.remark(&format!("dropped: {why}"));
    }

    /// Sends a query and waits for a line; stores an identity.
    pub(super) async fn query(&mut self, message: &str) -> Result<String, LinkError> {
        let answer = self
            .ask(message, Expect::Line)
            .await
            .map(Response::into_text)?;
        if message == "*IDN?" {
            self.identity = Some(answer.clone());
        }
        Ok(answer)
    }

    pub(super) async fn drain_errors(&mut self) -> Result<Vec<ErrorEntry>, LinkError> {
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

    pub(super) async fn connect(&mut self, quiet: Duration) -> Result<(), LinkError> {
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
    pub(super) async fn tell(&mut self, message: &str) -> Result<(), LinkError> {
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
    pub(super) async fn ask(
        &mut self,
        message: &str,
        expect: Expect,
    ) -> Result<Response, LinkError> {
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

    pub(super) async fn hand_over(
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

    /// Discards unexpected bytes, which are not an answer to the next question.
    pub(super) async fn drain(
        &self,
        connection: &mut Connection,
        message: &str,
    ) -> Result<(), LinkError> {
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

    pub(super) fn drop_connection(&mut self, error: &LinkError) {
        self.connection = None;
        self.why = error.to_string();
        // An instrument that stays away is tried often; the log names each error once.
        if self.dropped_by == self.why {
            tracing::debug!(link = %self.options.name, %error, "the link is dropped again");
        } else {
            tracing::warn!(link = %self.options.name, %error, "the link is dropped");
            self.dropped_by.clone_from(&self.why);
        }
        self.remark(&format!("dropped: {error}"));
    }

    pub(super) fn error(&self, broken: Broken, message: &str) -> LinkError {
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

    pub(super) fn remark(&self, text: &str) {
        self.record(Direction::Remark, Payload::Text(text.to_owned()));
    }

    pub(super) fn record(&self, direction: Direction, payload: Payload) {
        self.options.tap.record(&Record {
            time_s: self.options.clock.now_s(),
            link: self.link(),
            direction,
            payload,
        });
    }

    pub(super) fn link(&self) -> String {
        self.options.name.clone()
    }
}

fn payload_of(answer: &Response) -> Payload {
    match answer {
        Response::Line(line) => Payload::Text(line.clone()),
        Response::Block { prefix, payload } => Payload::Block(BlockRecord::new(prefix, payload)),
    }
}
