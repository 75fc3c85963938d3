//! The device's side: a stream of bytes becomes program messages.

use std::collections::VecDeque;

use super::Terminator;
use crate::block::{self, BlockHeader};

/// A message that could not be received; the framer continues after the next terminator.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum FrameError {
    /// Longer than a device of this kind can hold.
    #[error("expected a message of at most {limit} bytes, found a longer one")]
    TooLong {
        /// The limit, bytes.
        limit: usize,
    },
}

/// Splits an incoming stream into program messages, without their terminators and without empty
/// ones. A terminator inside a definite block does not count; inside a string it does, so that a
/// missing quote costs one message and not the connection.
///
/// ```
/// use instruments_scpi::decode::{ProgramFramer, Terminator};
///
/// let mut framer = ProgramFramer::new(Terminator::Lf, 1024);
/// framer.push(b"*RST\nMEAS:");
/// assert_eq!(framer.pull(), Some(Ok(b"*RST".to_vec())));
/// assert_eq!(framer.pull(), None);
/// framer.push(b"VOLT?\n");
/// assert_eq!(framer.pull(), Some(Ok(b"MEAS:VOLT?".to_vec())));
/// ```
#[derive(Debug)]
pub struct ProgramFramer {
    terminator: Terminator,
    limit: usize,
    buffer: Vec<u8>,
    state: State,
    ready: VecDeque<Result<Vec<u8>, FrameError>>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum State {
    /// Between arguments or in one; the payload of a block that came before ends at `block_end`.
    Text { block_end: usize },
    /// In a string with this quote.
    Quoted { quote: u8, block_end: usize },
    /// In the header of a block that starts at this index.
    Header { start: usize, block_end: usize },
    /// In the payload of a block that ends at this index.
    Payload { end: usize },
    /// In an indefinite block: only the terminator counts.
    Indefinite,
    /// Too long: skipping to the terminator.
    Skipping,
}

const START: State = State::Text { block_end: 0 };

impl ProgramFramer {
    /// Creates a framer for messages of at most `limit` bytes.
    pub fn new(terminator: Terminator, limit: usize) -> Self {
        Self {
            terminator,
            limit,
            buffer: Vec::new(),
            state: START,
            ready: VecDeque::new(),
        }
    }

    /// Takes in bytes from the stream.
    pub fn push(&mut self, bytes: &[u8]) {
        let mut rest = bytes;
        while let Some((&byte, after)) = rest.split_first() {
            if let State::Payload { end } = self.state {
                // Payloads are long: copied in one go.
                let (payload, after) = rest
                    .split_at_checked(end - self.buffer.len())
                    .unwrap_or((rest, &[]));
                self.buffer.extend_from_slice(payload);
                if self.buffer.len() == end {
                    self.state = State::Text { block_end: end };
                }
                rest = after;
            } else {
                self.push_byte(byte);
                rest = after;
            }
        }
    }

    /// Marks the end of a message after the last pushed byte, as reported by the transport; it
    /// counts as a terminator, in a block too.
    pub fn end(&mut self) {
        self.finish();
    }

    /// Bytes that are held of a message without end.
    pub fn held(&self) -> usize {
        self.buffer.len()
    }

    /// Gives out the next message.
    pub fn pull(&mut self) -> Option<Result<Vec<u8>, FrameError>> {
        self.ready.pop_front()
    }

    /// Discards all data: for a new connection, or the character that clears a device's input.
    pub fn clear(&mut self) {
        *self = Self::new(self.terminator, self.limit);
    }

    fn push_byte(&mut self, byte: u8) {
        if self.terminator.ends(byte) {
            return self.finish();
        }
        if self.state == State::Skipping {
            return;
        }
        if self.buffer.len() >= self.limit {
            return self.overflow();
        }
        self.buffer.push(byte);
        self.state = match self.state {
            State::Text { block_end } => self.after_text(byte, block_end),
            State::Quoted { quote, block_end } if byte == quote => State::Text { block_end },
            State::Header { start, block_end } => self.after_header(start, block_end),
            other => other,
        };
        if matches!(self.state, State::Payload { end } if end > self.limit) {
            self.overflow();
        }
    }

    fn after_text(&self, byte: u8, block_end: usize) -> State {
        let previous = self
            .buffer
            .len()
            .checked_sub(2)
            .and_then(|index| self.buffer.get(index));
        match byte {
            b'"' | b'\'' => State::Quoted {
                quote: byte,
                block_end,
            },
            // A block is an argument: after a blank or a comma only.
            b'#' if previous.is_some_and(|&previous| previous <= b' ' || previous == b',') => {
                State::Header {
                    start: self.buffer.len() - 1,
                    block_end,
                }
            }
            _ => State::Text { block_end },
        }
    }

    fn after_header(&self, start: usize, block_end: usize) -> State {
        match block::parse_header(self.buffer.get(start..).unwrap_or_default()) {
            BlockHeader::Incomplete => State::Header { start, block_end },
            BlockHeader::Definite { payload_len: 0, .. } => State::Text {
                block_end: self.buffer.len(),
            },
            BlockHeader::Definite { payload_len, .. } => State::Payload {
                end: self.buffer.len() + payload_len,
            },
            BlockHeader::Indefinite => State::Indefinite,
            BlockHeader::Invalid => State::Text { block_end },
        }
    }

    fn overflow(&mut self) {
        self.ready
            .push_back(Err(FrameError::TooLong { limit: self.limit }));
        self.buffer = Vec::new();
        self.state = State::Skipping;
    }

    fn finish(&mut self) {
        let mut message = std::mem::take(&mut self.buffer);
        let protected = match std::mem::replace(&mut self.state, START) {
            State::Text { block_end }
            | State::Quoted { block_end, .. }
            | State::Header { block_end, .. } => block_end,
            State::Indefinite | State::Skipping | State::Payload { .. } => message.len(),
        };
        // A CR before NL belongs to the terminator, unless it is the last byte of a block.
        if message.len() > protected && message.last() == Some(&b'\r') {
            message.pop();
        }
        if !message.is_empty() {
            self.ready.push_back(Ok(message));
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::message::{Argument, Command, parse_program};

    type Frame = Result<Vec<u8>, FrameError>;

    fn frames(terminator: Terminator, limit: usize, pieces: &[&[u8]]) -> Vec<Frame> {
        let mut framer = ProgramFramer::new(terminator, limit);
        let mut messages = Vec::new();
        for piece in pieces {
            framer.push(piece);
            messages.extend(std::iter::from_fn(|| framer.pull()));
        }
        messages
    }

    #[test]
    fn every_split_gives_the_same_messages() {
        let too_long = Err(FrameError::TooLong { limit: 24 });
        let ok = |message: &[u8]| Ok(message.to_vec());
        let table: [(Terminator, &[u8], Vec<Frame>); 11] = [
            (
                Terminator::Lf,
                b"*IDN?\nVOLT 1\r\n\n",
                vec![ok(b"*IDN?"), ok(b"VOLT 1")],
            ),
            (
                Terminator::Cr,
                b"IN_PV_00\rSTATUS\r\n",
                vec![ok(b"IN_PV_00"), ok(b"STATUS")],
            ),
            (
                Terminator::Lf,
                b"DATA #14a\n\nb,1\nX\n",
                vec![ok(b"DATA #14a\n\nb,1"), ok(b"X")],
            ),
            (
                Terminator::Lf,
                b"DATA v,#12\r\n\nX\n",
                vec![ok(b"DATA v,#12\r\n"), ok(b"X")],
            ),
            (
                Terminator::Lf,
                b"DATA #12ab\r\nX\n",
                vec![ok(b"DATA #12ab"), ok(b"X")],
            ),
            (
                Terminator::Lf,
                b"A \"x #15\"\nB\n",
                vec![ok(b"A \"x #15\""), ok(b"B")],
            ),
            (
                Terminator::Lf,
                b"A \"open\nB\n",
                vec![ok(b"A \"open"), ok(b"B")],
            ),
            (
                Terminator::Lf,
                b"A #H1F\nB #2\nC #10\nD #0 #15\n",
                vec![ok(b"A #H1F"), ok(b"B #2"), ok(b"C #10"), ok(b"D #0 #15")],
            ),
            (
                Terminator::Lf,
                b"AAAAAAAAAAAAAAAAAAAAAAAAA\nB\n",
                vec![too_long.clone(), ok(b"B")],
            ),
            (
                Terminator::Lf,
                b"A #9999999999xyz\nB\n",
                vec![too_long, ok(b"B")],
            ),
            (
                Terminator::Lf,
                b"AAAAAAAAAAAAAAAAAAAAAAAA\n",
                vec![ok(b"AAAAAAAAAAAAAAAAAAAAAAAA")],
            ),
        ];
        for (terminator, stream, expected) in table {
            for cut in 0..=stream.len() {
                let (left, right) = stream.split_at(cut);
                assert_eq!(
                    frames(terminator, 24, &[left, right]),
                    expected,
                    "{} cut at {cut}",
                    stream.escape_ascii()
                );
            }
        }
    }

    #[test]
    fn a_message_that_is_too_long_says_so() {
        let errors = frames(Terminator::Lf, 4, &[b"VOLT 1\n"]);
        assert_eq!(
            errors[0].as_ref().unwrap_err().to_string(),
            "expected a message of at most 4 bytes, found a longer one"
        );
    }

    proptest! {
        #[test]
        fn messages_with_blocks_survive_every_cut(
            payload in prop::collection::vec(any::<u8>(), 0..60),
            value in -100.0..100.0_f64,
            cut in any::<prop::sample::Index>(),
        ) {
            let first = Command::new("SOUR:VOLT").fixed(value, 3).build().unwrap();
            let mut second = b"DATA:ARB name,".to_vec();
            second.extend(block::encode_definite(&payload).unwrap());
            let stream = [first.as_bytes(), b"\r\n", &second, b"\n"].concat();
            let (left, right) = stream.split_at(cut.index(stream.len() + 1));
            let messages = frames(Terminator::Lf, 200, &[left, right]);
            prop_assert_eq!(&messages, &vec![Ok(first.into_bytes()), Ok(second.clone())]);
            let units = parse_program(&second).unwrap();
            prop_assert_eq!(&units[0].arguments[1], &Argument::Block(payload));
        }
    }
}
