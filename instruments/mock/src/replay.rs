//! Serves a recorded transcript as a device. It returns the recorded replies as long as the queries
//! match the record, and stops at the first difference.

use std::sync::{Arc, Mutex, PoisonError};

use instruments_link::transcript::{Direction, Payload, Record, Transcript};
use instruments_scpi::{decode::Terminator, excerpt};

use super::Device;

/// Point at which a session deviated from its record.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Divergence {
    /// Another message came.
    #[error("message {number}: expected `{expected}`, met `{met}`")]
    Other {
        /// Number of the message, from 1.
        number: usize,
        /// Message that was sent then.
        expected: String,
        /// Message that was sent now.
        met: String,
    },
    /// A message came after the last one of the record.
    #[error("message {number}: expected nothing more, met `{met}`")]
    Beyond {
        /// Number of the message, from 1.
        number: usize,
        /// Message that was sent now.
        met: String,
    },
    /// The record has only length and hash of a block.
    #[error(
        "message {number}: `{sent}`: expected the bytes of the answer in the record, found only \
        their length"
    )]
    Unknown {
        /// Number of the message, from 1.
        number: usize,
        /// Message that was sent.
        sent: String,
    },
}

/// Outcome of a session; all clones share it.
#[derive(Debug, Clone, Default)]
pub struct Outcome(Arc<Mutex<(usize, Option<Divergence>)>>);

impl Outcome {
    /// Messages that were as recorded.
    pub fn followed(&self) -> usize {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).0
    }

    /// Returns the first difference.
    pub fn divergence(&self) -> Option<Divergence> {
        self.0
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .1
            .clone()
    }
}

/// A message of the record and the whole reply to it; no reply if it cannot be reproduced.
#[derive(Debug, Clone)]
struct Turn {
    sent: Payload,
    reply: Option<Vec<u8>>,
}

impl Turn {
    fn is(&self, message: &[u8]) -> bool {
        match &self.sent {
            Payload::Text(text) => text.as_bytes() == message,
            Payload::Block(block) => message
                .strip_prefix(block.prefix.as_bytes())
                .is_some_and(|data| block.describes(data)),
        }
    }

    fn text(&self) -> String {
        match &self.sent {
            Payload::Text(text) => text.clone(),
            Payload::Block(block) => format!("{}… {} bytes", block.prefix, block.len),
        }
    }
}

/// A recorded conversation.
pub struct Replay {
    turns: Vec<Turn>,
    terminator: Terminator,
    outcome: Outcome,
}

impl Replay {
    /// Creates the device of the session over one link of a transcript, and its outcome.
    /// `terminator` is that of the dialect.
    pub fn new(transcript: &Transcript, link: &str, terminator: Terminator) -> (Self, Outcome) {
        let mut turns: Vec<Turn> = Vec::new();
        for Record {
            direction, payload, ..
        } in transcript
            .records
            .iter()
            .filter(|record| record.link == link)
        {
            match (direction, payload) {
                (Direction::Sent, sent) => turns.push(Turn {
                    sent: sent.clone(),
                    reply: Some(Vec::new()),
                }),
                (Direction::Received | Direction::Unsolicited, payload) => {
                    if let Some(turn) = turns.last_mut() {
                        turn.reply = turn
                            .reply
                            .take()
                            .zip(bytes(payload, terminator))
                            .map(|(reply, more)| [reply, more].concat());
                    }
                }
                (Direction::Remark, _) => {}
            }
        }
        let outcome = Outcome::default();
        (
            Self {
                turns,
                terminator,
                outcome: outcome.clone(),
            },
            outcome,
        )
    }

    /// Returns the messages of the record, in order.
    pub fn messages(&self) -> impl Iterator<Item = String> {
        self.turns.iter().map(Turn::text)
    }

    fn follow(&self, number: usize, message: &[u8]) -> Result<Vec<u8>, Divergence> {
        let met = || excerpt(message);
        let Some(turn) = self.turns.get(number - 1) else {
            return Err(Divergence::Beyond { number, met: met() });
        };
        if !turn.is(message) {
            return Err(Divergence::Other {
                number,
                expected: turn.text(),
                met: met(),
            });
        }
        turn.reply.clone().ok_or_else(|| Divergence::Unknown {
            number,
            sent: met(),
        })
    }
}

/// Bytes that went over the wire, the terminator included; `None` for a block of which only the
/// length is known.
fn bytes(payload: &Payload, terminator: Terminator) -> Option<Vec<u8>> {
    let end: &[u8] = if terminator == Terminator::Lf {
        b"\n"
    } else {
        b"\r\n"
    };
    match payload {
        Payload::Text(text) => Some([text.as_bytes(), end].concat()),
        Payload::Block(block) => {
            let length = block.len.to_string();
            let head = format!("{}#{}{length}", block.prefix, length.len());
            block
                .bytes
                .as_ref()
                .map(|bytes| [head.as_bytes(), bytes, b"\n"].concat())
        }
    }
}

impl Device for Replay {
    fn terminator(&self) -> Terminator {
        self.terminator
    }

    fn handle(&mut self, _: f64, message: &[u8]) -> Vec<u8> {
        let mut outcome = self
            .outcome
            .0
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        if outcome.1.is_some() {
            return Vec::new();
        }
        match self.follow(outcome.0 + 1, message) {
            Ok(reply) => {
                outcome.0 += 1;
                reply
            }
            Err(divergence) => {
                outcome.1 = Some(divergence);
                Vec::new()
            }
        }
    }
}
