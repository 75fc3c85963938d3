//! A recorded conversation as a device: it answers what was answered then, as long as it is asked what was asked then, and stops at the first difference.

use std::sync::{Arc, Mutex, PoisonError};

use super::Device;
use crate::{
    scpi::decode::Terminator,
    transcript::{Direction, Payload, Record, Transcript},
};

/// Where a conversation left its record.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Divergence {
    /// Another message came.
    #[error("message {number}: expected `{expected}`, met `{met}`")]
    Other {
        /// Number of the message, from 1.
        number: usize,
        /// What was sent then.
        expected: String,
        /// What was sent now.
        met: String,
    },
    /// A message came after the last one of the record.
    #[error("message {number}: expected nothing more, met `{met}`")]
    Beyond {
        /// Number of the message, from 1.
        number: usize,
        /// What was sent now.
        met: String,
    },
    /// The record has only length and hash of a block.
    #[error("message {number}: `{sent}`: expected the bytes of the answer in the record, found only their length")]
    Unknown {
        /// Number of the message, from 1.
        number: usize,
        /// What was sent.
        sent: String,
    },
}

/// How a conversation went; clones are the same.
#[derive(Debug, Clone, Default)]
pub struct Outcome(Arc<Mutex<(usize, Option<Divergence>)>>);

impl Outcome {
    /// Messages that were as recorded.
    pub fn followed(&self) -> usize {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).0
    }

    /// The first difference.
    pub fn divergence(&self) -> Option<Divergence> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).1.clone()
    }
}

/// A message of the record and the whole reply to it; no reply where it cannot be given.
#[derive(Debug, Clone)]
struct Turn {
    sent: String,
    reply: Option<Vec<u8>>,
}

/// A recorded conversation.
pub struct Replay {
    turns: Vec<Turn>,
    terminator: Terminator,
    outcome: Outcome,
}

impl Replay {
    /// The conversation over one link of a transcript, and how it will have gone. `terminator` is that of the dialect.
    pub fn new(transcript: &Transcript, link: &str, terminator: Terminator) -> (Self, Outcome) {
        let mut turns: Vec<Turn> = Vec::new();
        for Record { direction, payload, .. } in transcript.records.iter().filter(|record| record.link == link) {
            match (direction, payload) {
                (Direction::Sent, Payload::Text(text)) => turns.push(Turn { sent: text.clone(), reply: Some(Vec::new()) }),
                (Direction::Received | Direction::Unsolicited, payload) => {
                    if let Some(turn) = turns.last_mut() {
                        turn.reply = turn.reply.take().zip(bytes(payload, terminator)).map(|(reply, more)| [reply, more].concat());
                    }
                }
                (Direction::Sent, Payload::Block(_)) | (Direction::Remark, _) => {}
            }
        }
        let outcome = Outcome::default();
        (Self { turns, terminator, outcome: outcome.clone() }, outcome)
    }

    /// The messages of the record, in order.
    pub fn messages(&self) -> impl Iterator<Item = &str> {
        self.turns.iter().map(|turn| turn.sent.as_str())
    }

    fn follow(&self, (number, met): (usize, String)) -> Result<Vec<u8>, Divergence> {
        let Some(turn) = self.turns.get(number - 1) else { return Err(Divergence::Beyond { number, met }) };
        if turn.sent != met {
            return Err(Divergence::Other { number, expected: turn.sent.clone(), met });
        }
        turn.reply.clone().ok_or(Divergence::Unknown { number, sent: met })
    }
}

/// What went over the wire, its end included; nothing for a block of which only the length is known.
fn bytes(payload: &Payload, terminator: Terminator) -> Option<Vec<u8>> {
    let end: &[u8] = if terminator == Terminator::Lf { b"\n" } else { b"\r\n" };
    match payload {
        Payload::Text(text) => Some([text.as_bytes(), end].concat()),
        Payload::Block(block) => {
            let length = block.len.to_string();
            let head = format!("{}#{}{length}", block.prefix, length.len());
            block.bytes.as_ref().map(|bytes| [head.as_bytes(), bytes, b"\n"].concat())
        }
    }
}

impl Device for Replay {
    fn terminator(&self) -> Terminator {
        self.terminator
    }

    fn handle(&mut self, _: f64, message: &[u8]) -> Vec<u8> {
        let mut outcome = self.outcome.0.lock().unwrap_or_else(PoisonError::into_inner);
        if outcome.1.is_some() {
            return Vec::new();
        }
        match self.follow((outcome.0 + 1, String::from_utf8_lossy(message).into_owned())) {
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
