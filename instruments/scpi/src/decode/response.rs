//! The controller's side: a stream of bytes becomes answers.

use super::{Terminator, is_line_end};
use crate::{
    block::{self, BlockHeader},
    excerpt, text_of,
};

/// Maximum number of text bytes before the `#` of a block: some instruments repeat the header of
/// the query there.
pub const MAX_PREFIX: usize = 64;

/// Room for a prefix, a block's header and the line ends around them.
const SLACK: usize = MAX_PREFIX + 32;

/// Kind of reply that the caller requested.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Expect {
    /// A line of text.
    Line,
    /// A definite or indefinite block.
    Block,
}

/// A complete answer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Response {
    /// A line without its terminator.
    Line(String),
    /// A block.
    Block {
        /// The text before `#`, mostly empty.
        prefix: String,
        /// The bytes of the block, without header and terminator.
        payload: Vec<u8>,
    },
}

impl Response {
    /// Returns the reply as text: the line, or the contents of a block.
    pub fn into_text(self) -> String {
        match self {
            Self::Line(line) => line,
            Self::Block { payload, .. } => text_of(&payload),
        }
    }

    /// Returns the reply as bytes: the contents of a block, or the line.
    pub fn into_bytes(self) -> Vec<u8> {
        match self {
            Self::Line(line) => line.into_bytes(),
            Self::Block { payload, .. } => payload,
        }
    }
}

/// How a stream is to be read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DecoderOptions {
    /// Terminator of a line.
    pub terminator: Terminator,
    /// Longest line, bytes.
    pub max_line: usize,
    /// Longest payload of a block, bytes.
    pub max_block: usize,
    /// Removes XON and XOFF (0x11, 0x13) at any position; not for instruments that send blocks.
    pub strip_flow_bytes: bool,
    /// The transport marks the end of a message and [`ResponseDecoder::end`] will be called;
    /// without it an indefinite block ends at the first NL.
    pub has_end_flag: bool,
}

impl Default for DecoderOptions {
    /// Lines of 64 KiB, blocks of 64 MiB, NL, no END flag.
    fn default() -> Self {
        Self {
            terminator: Terminator::Lf,
            max_line: 64 << 10,
            max_block: 64 << 20,
            strip_flow_bytes: false,
            has_end_flag: false,
        }
    }
}

/// A stream that does not contain the expected reply. The decoder is unusable after it until
/// [`ResponseDecoder::clear`].
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum DecodeError {
    /// A line without end.
    #[error("expected a line of at most {limit} bytes, found no end of `{found}`")]
    LineTooLong {
        /// The limit, bytes.
        limit: usize,
        /// How the line starts.
        found: String,
    },
    /// A line with control characters: the wrong baud rate, or binary data where text was expected.
    #[error("expected a line of text, found `{0}`")]
    Garbage(String),
    /// Any reply other than a block.
    #[error("expected a block (`#` and its length after at most 64 bytes of text), found `{0}`")]
    NotABlock(String),
    /// A block that is too large.
    #[error("expected a block of at most {limit} bytes, found one of {found}")]
    BlockTooLarge {
        /// The limit, bytes.
        limit: usize,
        /// The announced or received length, bytes.
        found: usize,
    },
    /// More bytes than any answer may have.
    #[error("expected at most {limit} bytes before they are read as an answer, found more")]
    Overflow {
        /// The limit, bytes.
        limit: usize,
    },
}

/// Collects bytes and returns complete replies. Push the result of one read, then pull.
///
/// ```
/// use instruments_scpi::decode::{DecoderOptions, Expect, Response, ResponseDecoder};
/// # fn main() -> Result<(), instruments_scpi::decode::DecodeError> {
/// let mut decoder = ResponseDecoder::new(DecoderOptions::default());
/// decoder.push(b"3.70");
/// assert_eq!(decoder.pull(Expect::Line)?, None);
/// decoder.push(b"1\n");
/// assert_eq!(
///     decoder.pull(Expect::Line)?,
///     Some(Response::Line("3.701".to_owned()))
/// );
/// # Ok(())
/// # }
/// ```
#[derive(Debug)]
pub struct ResponseDecoder {
    options: DecoderOptions,
    buffer: Vec<u8>,
    /// Up to here no terminator was found, so that long answers are searched once.
    searched: usize,
    /// Position at which the transport marked the end of a message.
    end_at: Option<usize>,
    overflowed: bool,
}

impl ResponseDecoder {
    /// Creates an empty decoder.
    pub fn new(options: DecoderOptions) -> Self {
        Self {
            options,
            buffer: Vec::new(),
            searched: 0,
            end_at: None,
            overflowed: false,
        }
    }

    /// Appends bytes from the stream. Bytes beyond the largest possible reply are dropped, and the
    /// next pull returns an error.
    pub fn push(&mut self, bytes: &[u8]) {
        let room = self.limit().saturating_sub(self.buffer.len());
        if self.options.strip_flow_bytes {
            let before = self.buffer.len();
            self.buffer.extend(
                bytes
                    .iter()
                    .filter(|&&byte| !matches!(byte, 0x11 | 0x13))
                    .take(room + 1),
            );
            self.overflowed |= self.buffer.len() - before > room;
        } else {
            self.overflowed |= bytes.len() > room;
            self.buffer
                .extend_from_slice(bytes.get(..room).unwrap_or(bytes));
        }
    }

    /// Marks the end of a message (END) after the last pushed byte, as reported by the transport.
    pub fn end(&mut self) {
        self.end_at = Some(self.buffer.len());
    }

    /// Returns the next complete reply, or `None` while bytes are missing. Empty lines before it
    /// are skipped: the NL after a block may come late or twice.
    ///
    /// # Errors
    /// [`DecodeError`] if the stream contains anything other than `expect`.
    pub fn pull(&mut self, expect: Expect) -> Result<Option<Response>, DecodeError> {
        if self.overflowed {
            return Err(DecodeError::Overflow {
                limit: self.limit(),
            });
        }
        let empty = self
            .buffer
            .iter()
            .take_while(|&&byte| is_line_end(byte))
            .count();
        self.consume(empty);
        match expect {
            Expect::Line => self.pull_line(),
            Expect::Block => self.pull_block(),
        }
    }

    /// Removes and returns the buffered data, without line ends at its start.
    pub fn take_rest(&mut self) -> Vec<u8> {
        let mut rest = std::mem::take(&mut self.buffer);
        self.clear();
        rest.drain(..rest.iter().take_while(|&&byte| is_line_end(byte)).count());
        rest
    }

    /// Discards all data and errors.
    pub fn clear(&mut self) {
        *self = Self::new(self.options);
    }

    /// Bytes that are buffered.
    pub fn buffered(&self) -> usize {
        self.buffer.len()
    }

    fn limit(&self) -> usize {
        self.options
            .max_line
            .max(self.options.max_block)
            .saturating_add(SLACK)
    }

    fn pull_line(&mut self) -> Result<Option<Response>, DecodeError> {
        let limit = self.options.max_line;
        let end = self
            .find_terminator(0)
            .or(self.end_at.filter(|&end| end > 0));
        if end.unwrap_or(self.buffer.len()) > limit {
            return Err(DecodeError::LineTooLong {
                limit,
                found: excerpt(&self.buffer),
            });
        }
        let Some(end) = end else { return Ok(None) };
        let mut line = self.buffer.get(..end).unwrap_or_default();
        while let Some(shorter) = line.strip_suffix(b"\r") {
            line = shorter;
        }
        let text = text_of(line);
        if text.chars().any(|c| c.is_control() && c != '\t') {
            return Err(DecodeError::Garbage(excerpt(line)));
        }
        self.consume(end + 1);
        Ok(Some(Response::Line(text)))
    }

    fn pull_block(&mut self) -> Result<Option<Response>, DecodeError> {
        let not_a_block = || DecodeError::NotABlock(excerpt(&self.buffer));
        let head = self.buffer.get(..=MAX_PREFIX).unwrap_or(&self.buffer);
        let Some(at) = head
            .iter()
            .position(|&byte| byte == b'#' || self.options.terminator.ends(byte))
        else {
            let hopeless = self.buffer.len() > MAX_PREFIX || self.end_at.is_some_and(|end| end > 0);
            return if hopeless {
                Err(not_a_block())
            } else {
                Ok(None)
            };
        };
        match block::parse_header(self.buffer.get(at..).unwrap_or_default()) {
            BlockHeader::Invalid => Err(not_a_block()),
            BlockHeader::Incomplete => Ok(None),
            BlockHeader::Definite {
                header_len,
                payload_len,
            } => self.take_block(at, at + header_len, payload_len),
            BlockHeader::Indefinite => self.pull_indefinite(at),
        }
    }

    fn pull_indefinite(&mut self, at: usize) -> Result<Option<Response>, DecodeError> {
        let start = at + 2;
        let end = if self.options.has_end_flag {
            self.end_at.map(|end| {
                if self
                    .buffer
                    .get(..end)
                    .is_some_and(|bytes| bytes.ends_with(b"\n"))
                {
                    end - 1
                } else {
                    end
                }
            })
        } else {
            self.find_terminator(start)
        };
        match end {
            Some(end) => self.take_block(at, start, end.saturating_sub(start)),
            None => self
                .check_block(self.buffer.len().saturating_sub(start + 1))
                .map(|()| None),
        }
    }

    /// Removes the block whose prefix is `prefix` bytes long and whose payload starts at `start`,
    /// if it is complete.
    fn take_block(
        &mut self,
        prefix: usize,
        start: usize,
        payload_len: usize,
    ) -> Result<Option<Response>, DecodeError> {
        self.check_block(payload_len)?;
        let Some(payload) = self.buffer.get(start..start + payload_len) else {
            return Ok(None);
        };
        let payload = payload.to_vec();
        let prefix = text_of(self.buffer.get(..prefix).unwrap_or_default());
        self.consume(start + payload_len);
        Ok(Some(Response::Block { prefix, payload }))
    }

    fn check_block(&self, found: usize) -> Result<(), DecodeError> {
        let limit = self.options.max_block;
        if found > limit {
            Err(DecodeError::BlockTooLarge { limit, found })
        } else {
            Ok(())
        }
    }

    fn find_terminator(&mut self, from: usize) -> Option<usize> {
        let start = self.searched.max(from);
        let found = self
            .buffer
            .iter()
            .skip(start)
            .position(|&byte| self.options.terminator.ends(byte));
        if found.is_none() {
            self.searched = self.buffer.len();
        }
        found.map(|offset| start + offset)
    }

    fn consume(&mut self, count: usize) {
        let count = count.min(self.buffer.len());
        if count > 0 {
            self.buffer.drain(..count);
            self.searched = 0;
            self.end_at = self
                .end_at
                .filter(|&end| end > count)
                .map(|end| end - count);
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn line(text: &str) -> Response {
        Response::Line(text.to_owned())
    }

    fn block(prefix: &str, payload: &[u8]) -> Response {
        Response::Block {
            prefix: prefix.to_owned(),
            payload: payload.to_vec(),
        }
    }

    /// Feeds `pieces` and pulls the expected answers as they become complete, as a link does.
    fn decode(
        options: DecoderOptions,
        pieces: &[&[u8]],
        wanted: &[Expect],
    ) -> Result<Vec<Response>, DecodeError> {
        let mut decoder = ResponseDecoder::new(options);
        let mut wanted = wanted.iter().copied().peekable();
        let mut answers = Vec::new();
        for piece in pieces {
            decoder.push(piece);
            while let Some(&expect) = wanted.peek() {
                let Some(answer) = decoder.pull(expect)? else {
                    break;
                };
                answers.push(answer);
                wanted.next();
            }
        }
        Ok(answers)
    }

    /// Streams of real instruments with the answers they hold.
    fn streams() -> Vec<(&'static [u8], Vec<Expect>, Vec<Response>)> {
        use Expect::{Block, Line};
        vec![
            (
                b"1.5\n2\r\n",
                vec![Line, Line],
                vec![line("1.5"), line("2")],
            ),
            (
                b"#15a\nb\r\n\n+0\n",
                vec![Block, Line],
                vec![block("", b"a\nb\r\n"), line("+0")],
            ),
            (
                b"#13abc\n\nTrig'd\n",
                vec![Block, Line],
                vec![block("", b"abc"), line("Trig'd")],
            ),
            (
                b"#13abc#12xy\n",
                vec![Block, Block],
                vec![block("", b"abc"), block("", b"xy")],
            ),
            (
                b"C1:WF ALL,#9000000003\n\n\n\n\nOK\n",
                vec![Block, Line],
                vec![block("C1:WF ALL,", b"\n\n\n"), line("OK")],
            ),
            (
                b"#0abc\ndef\n",
                vec![Block, Line],
                vec![block("", b"abc"), line("def")],
            ),
            (
                b"#10\n\nx\n",
                vec![Block, Line],
                vec![block("", b""), line("x")],
            ),
            (
                b"\n\r\n#12\r\n\r\n7\r\r\n",
                vec![Block, Line],
                vec![block("", b"\r\n"), line("7")],
            ),
            (
                b"25.3 \xb0C\n\xc2\xb0C\n",
                vec![Line, Line],
                vec![line("25.3 °C"), line("°C")],
            ),
        ]
    }

    #[test]
    fn every_split_in_two_and_every_single_byte_give_the_same_answers() {
        for (stream, wanted, answers) in streams() {
            for cut in 0..=stream.len() {
                let (left, right) = stream.split_at(cut);
                let found = decode(DecoderOptions::default(), &[left, right], &wanted);
                assert_eq!(
                    found.as_ref(),
                    Ok(&answers),
                    "{} cut at {cut}",
                    stream.escape_ascii()
                );
            }
            let single: Vec<&[u8]> = stream.chunks(1).collect();
            assert_eq!(
                decode(DecoderOptions::default(), &single, &wanted),
                Ok(answers),
                "{}",
                stream.escape_ascii()
            );
        }
    }

    #[test]
    fn serial_lines_end_with_cr_and_lose_their_flow_bytes() {
        let options = DecoderOptions {
            terminator: Terminator::Cr,
            strip_flow_bytes: true,
            ..DecoderOptions::default()
        };
        let stream = b"\x1323.\x1150\r\n\x11\x130\r";
        for cut in 0..=stream.len() {
            let (left, right) = stream.split_at(cut);
            assert_eq!(
                decode(options, &[left, right], &[Expect::Line; 2]),
                Ok(vec![line("23.50"), line("0")]),
                "cut at {cut}"
            );
        }
    }

    #[test]
    fn an_end_flag_ends_lines_and_indefinite_blocks() {
        let mut decoder = ResponseDecoder::new(DecoderOptions {
            has_end_flag: true,
            ..DecoderOptions::default()
        });
        decoder.push(b"#0a\nb");
        assert_eq!(decoder.pull(Expect::Block), Ok(None));
        decoder.push(b"\n");
        decoder.end();
        assert_eq!(decoder.pull(Expect::Block), Ok(Some(block("", b"a\nb"))));
        assert_eq!(
            decoder.pull(Expect::Line),
            Ok(None),
            "the final NL is not an answer"
        );
        decoder.push(b"1.5");
        assert_eq!(decoder.pull(Expect::Line), Ok(None));
        decoder.end();
        assert_eq!(decoder.pull(Expect::Line), Ok(Some(line("1.5"))));
    }

    #[test]
    fn what_was_not_expected_is_named() {
        let options = DecoderOptions {
            max_line: 16,
            max_block: 100,
            ..DecoderOptions::default()
        };
        let long_prefix = [b'x'; 65];
        let table: [(&[u8], Expect, &str); 8] = [
            (
                b"-113,\"x\"\n",
                Expect::Block,
                "expected a block (`#` and its length after at most 64 bytes of text), found \
                `-113,\"x\"\\n`",
            ),
            (b"#H1F\n", Expect::Block, "found `#H1F\\n`"),
            (&long_prefix, Expect::Block, "xxxx… (65 bytes)`"),
            (
                b"#9000000101",
                Expect::Block,
                "expected a block of at most 100 bytes, found one of 101",
            ),
            (
                b"01234567890123456",
                Expect::Line,
                "expected a line of at most 16 bytes, found no end of `01234567890123456`",
            ),
            (
                b"01234567890123456\n",
                Expect::Line,
                "expected a line of at most 16 bytes",
            ),
            (
                b"\x00\xff1\n",
                Expect::Line,
                "expected a line of text, found `\\u{0}ÿ1`",
            ),
            (
                &[b'#'; 1000],
                Expect::Block,
                "expected at most 196 bytes before they are read as an answer",
            ),
        ];
        for (stream, expect, text) in table {
            let message = decode(options, &[stream], &[expect])
                .unwrap_err()
                .to_string();
            assert!(
                message.contains(text),
                "{}: {message}",
                stream.escape_ascii()
            );
        }
        let endless = [b"#0".as_slice(), &[b'x'; 102]].concat();
        assert_eq!(
            decode(options, &[&endless], &[Expect::Block]),
            Err(DecodeError::BlockTooLarge {
                limit: 100,
                found: 101
            })
        );
    }

    #[test]
    fn the_rest_can_be_taken_out_before_the_next_query() {
        let mut decoder = ResponseDecoder::new(DecoderOptions::default());
        decoder.push(b"1\n\r\nlate\n");
        assert_eq!(decoder.pull(Expect::Line), Ok(Some(line("1"))));
        assert_eq!(decoder.take_rest(), b"late\n");
        assert_eq!(decoder.take_rest(), b"");
    }

    proptest! {
        #[test]
        fn answers_do_not_depend_on_how_the_stream_is_cut(
            payload in prop::collection::vec(any::<u8>(), 0..60),
            prefix in "[A-Z0-9:, ]{0,20}",
            text in "[!-~][ -~]{0,20}",
            tail in prop::sample::select(vec!["\n", "\n\n", "\r\n", ""]),
            cuts in prop::collection::vec(any::<prop::sample::Index>(), 0..8),
        ) {
            let mut stream = prefix.clone().into_bytes();
            stream.extend(block::encode_definite(&payload).unwrap());
            stream.extend(tail.bytes());
            stream.extend(text.bytes());
            stream.push(b'\n');
            let mut at: Vec<usize> = cuts.iter().map(|cut| cut.index(stream.len() + 1)).collect();
            at.extend([0, stream.len()]);
            at.sort_unstable();
            let pieces: Vec<&[u8]> = at.windows(2).map(|pair| &stream[pair[0]..pair[1]]).collect();
            let answers = decode(DecoderOptions::default(), &pieces, &[Expect::Block, Expect::Line]);
            prop_assert_eq!(answers, Ok(vec![block(&prefix, &payload), line(&text)]));
        }
    }
}
