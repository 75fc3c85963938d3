//! Text format of the traffic with an instrument. A tap on the link writes it, a replay serves it,
//! and a person can read it.
//!
//! One line per message: bench time in seconds, name of the link, direction, text.
//!
//! ```text
//! 12.345678 scope > :WAVeform:PREamble?
//! 12.351200 scope <# 4 fnv1a64=5c2ad1d50cf0b6a5 hex=000aff10 prefix=C1:WF ALL,
//! 12.360000 supply ! late answer\n
//! 12.370000 supply * dropped: no answer to `MEAS:CURR?` within 2s
//! ```
//!
//! `>` marks a sent message, `<` a received one, `!` one that was received without a query, and `*`
//! a remark of the link. `#` after the direction marks a block: its length in bytes, its hash
//! (64-bit FNV-1a, against mistakes and not against forgery), its bytes unless it is long, and the
//! text before it if there was any. Characters that could break a line are escaped: `\n`, `\r`,
//! `\t`, `\\` and `\u{…}` for other control characters.

use std::{
    fmt, io,
    str::FromStr,
    sync::{Arc, Mutex, PoisonError},
};

/// Longest block whose bytes a tap writes out. For longer blocks it records only the length and the
/// hash, since raw captures are stored elsewhere.
pub const INLINE_BLOCK_BYTES: usize = 512;

/// Which way a message went.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Direction {
    /// To the instrument.
    Sent,
    /// Received from the instrument, as the reply to the message sent before.
    Received,
    /// Received from the instrument without a query.
    Unsolicited,
    /// Not on the wire: an action of the link (opened, dropped).
    Remark,
}

impl Direction {
    const SIGNS: [(char, Self); 4] = [
        ('>', Self::Sent),
        ('<', Self::Received),
        ('!', Self::Unsolicited),
        ('*', Self::Remark),
    ];

    fn sign(self) -> char {
        Self::SIGNS
            .iter()
            .find(|(_, direction)| *direction == self)
            .map_or('?', |&(sign, _)| sign)
    }
}

/// Content that went over the wire.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Payload {
    /// A line without its terminator.
    Text(String),
    /// A block.
    Block(BlockRecord),
}

/// A block in a transcript.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BlockRecord {
    /// The text before `#`.
    pub prefix: String,
    /// Bytes of payload.
    pub len: usize,
    /// 64-bit FNV-1a of the payload.
    pub fnv1a64: u64,
    /// The payload, if it was short enough.
    pub bytes: Option<Vec<u8>>,
}

impl BlockRecord {
    /// Describes a block; its bytes are kept up to [`INLINE_BLOCK_BYTES`].
    pub fn new(prefix: &str, payload: &[u8]) -> Self {
        let bytes = (payload.len() <= INLINE_BLOCK_BYTES).then(|| payload.to_vec());
        Self {
            prefix: prefix.to_owned(),
            len: payload.len(),
            fnv1a64: fnv1a64(payload),
            bytes,
        }
    }

    /// Returns whether `payload` is the recorded block.
    pub fn describes(&self, payload: &[u8]) -> bool {
        self.len == payload.len() && self.fnv1a64 == fnv1a64(payload)
    }
}

/// One line of a transcript.
#[derive(Debug, Clone, PartialEq)]
pub struct Record {
    /// Bench time, s; written to the microsecond.
    pub time_s: f64,
    /// Name of the link.
    pub link: String,
    /// Which way it went.
    pub direction: Direction,
    /// Content of the record.
    pub payload: Payload,
}

/// A line that is not a valid record.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("line {line}: expected {expected}, found `{found}`")]
pub struct TranscriptError {
    line: usize,
    expected: &'static str,
    found: String,
}

/// A recorded conversation.
///
/// ```
/// use instruments_link::transcript::{Direction, Payload, Transcript};
/// # fn main() -> Result<(), instruments_link::transcript::TranscriptError> {
/// let transcript = Transcript::parse("0.100000 load > MEAS:VOLT?\n0.102000 load < 3.701\n")?;
/// let answer = &transcript.records[1];
/// assert_eq!(answer.direction, Direction::Received);
/// assert_eq!(answer.payload, Payload::Text("3.701".to_owned()));
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Transcript {
    /// The messages in their order.
    pub records: Vec<Record>,
    /// Text of a last line without end: the writer was killed in the middle of it.
    pub torn: Option<String>,
}

impl Transcript {
    /// Parses a transcript. Empty lines and lines that start with `#` are skipped; a last line
    /// without an end is set aside.
    ///
    /// # Errors
    /// [`TranscriptError`] with the line, the expected text and the text found.
    pub fn parse(text: &str) -> Result<Self, TranscriptError> {
        let whole_len = text.rfind('\n').map_or(0, |end| end + 1);
        let (whole, torn) = text.split_at_checked(whole_len).unwrap_or((text, ""));
        let mut records = Vec::new();
        for (index, line) in whole.lines().enumerate() {
            if !line.is_empty() && !line.starts_with('#') {
                let failed = |(expected, found)| TranscriptError {
                    line: index + 1,
                    expected,
                    found,
                };
                records.push(parse_line(line).map_err(failed)?);
            }
        }
        Ok(Self {
            records,
            torn: (!torn.is_empty()).then(|| torn.to_owned()),
        })
    }
}

impl FromStr for Transcript {
    type Err = TranscriptError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        Self::parse(text)
    }
}

impl fmt::Display for Record {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{:.6} {} {}",
            self.time_s,
            escape(&self.link, true),
            self.direction.sign()
        )?;
        match &self.payload {
            Payload::Text(text) => write!(f, " {}", escape(text, false)),
            Payload::Block(block) => {
                write!(f, "# {} fnv1a64={:016x}", block.len, block.fnv1a64)?;
                if let Some(bytes) = &block.bytes {
                    f.write_str(" hex=")?;
                    bytes.iter().try_for_each(|byte| write!(f, "{byte:02x}"))?;
                }
                if block.prefix.is_empty() {
                    Ok(())
                } else {
                    write!(f, " prefix={}", escape(&block.prefix, false))
                }
            }
        }
    }
}

type Mistake = (&'static str, String);

fn parse_line(line: &str) -> Result<Record, Mistake> {
    let mut fields = line.splitn(4, ' ');
    let mut next = || fields.next().unwrap_or("");
    let (time, link, sign, rest) = (next(), next(), next(), next());
    let time_s = time
        .parse()
        .ok()
        .filter(|time_s: &f64| time_s.is_finite())
        .ok_or_else(|| ("bench time in seconds", time.to_owned()))?;
    let link = unescape(link)
        .filter(|name| !name.is_empty())
        .ok_or_else(|| ("the name of a link", link.to_owned()))?;
    let (direction, is_block) =
        parse_sign(sign).ok_or_else(|| ("one of > < ! * with or without #", sign.to_owned()))?;
    let payload = if is_block {
        Payload::Block(parse_block(rest).ok_or_else(|| {
            (
                "LENGTH fnv1a64=HASH [hex=BYTES] [prefix=TEXT]",
                rest.to_owned(),
            )
        })?)
    } else {
        Payload::Text(unescape(rest).ok_or_else(|| {
            (
                "text with the escapes \\n \\r \\t \\\\ \\u{…}",
                rest.to_owned(),
            )
        })?)
    };
    Ok(Record {
        time_s,
        link,
        direction,
        payload,
    })
}

fn parse_sign(sign: &str) -> Option<(Direction, bool)> {
    let (sign, is_block) = sign
        .strip_suffix('#')
        .map_or((sign, false), |sign| (sign, true));
    let mut chars = sign.chars();
    let first = chars.next().filter(|_| chars.next().is_none())?;
    Direction::SIGNS
        .iter()
        .find(|(sign, _)| *sign == first)
        .map(|&(_, direction)| (direction, is_block))
}

fn parse_block(rest: &str) -> Option<BlockRecord> {
    let (len, rest) = rest.split_once(' ')?;
    let rest = rest.strip_prefix("fnv1a64=")?;
    let (hash, mut rest) = rest.split_once(' ').unwrap_or((rest, ""));
    let len: usize = len.parse().ok()?;
    let fnv1a64 = u64::from_str_radix(hash, 16).ok()?;
    let mut bytes = None;
    if let Some(after) = rest.strip_prefix("hex=") {
        let (hex, after) = after.split_once(' ').unwrap_or((after, ""));
        bytes = Some(from_hex(hex)?);
        rest = after;
    }
    let prefix = match rest.strip_prefix("prefix=") {
        Some(prefix) => unescape(prefix)?,
        None if rest.is_empty() => String::new(),
        None => return None,
    };
    let block = BlockRecord {
        prefix,
        len,
        fnv1a64,
        bytes,
    };
    block
        .bytes
        .as_ref()
        .is_none_or(|bytes| block.describes(bytes))
        .then_some(block)
}

fn from_hex(hex: &str) -> Option<Vec<u8>> {
    let digit = |c: u8| {
        char::from(c)
            .to_digit(16)
            .and_then(|digit| u8::try_from(digit).ok())
    };
    let pairs = hex.as_bytes().chunks(2).map(|pair| match pair {
        [high, low] => Some(digit(*high)? << 4 | digit(*low)?),
        _ => None,
    });
    pairs.collect()
}

fn escape(text: &str, blanks_too: bool) -> String {
    let mut escaped = String::with_capacity(text.len());
    for c in text.chars() {
        // U+2028 and U+2029 end lines in the eyes of some readers.
        if c.is_control() || matches!(c, '\\' | '\u{2028}' | '\u{2029}') {
            escaped.extend(c.escape_default());
        } else if blanks_too && c.is_whitespace() {
            escaped.extend(c.escape_unicode());
        } else {
            escaped.push(c);
        }
    }
    escaped
}

fn unescape(text: &str) -> Option<String> {
    let mut plain = String::with_capacity(text.len());
    let mut chars = text.chars();
    while let Some(c) = chars.next() {
        if c != '\\' {
            plain.push(c);
            continue;
        }
        plain.push(match chars.next()? {
            'n' => '\n',
            'r' => '\r',
            't' => '\t',
            '\\' => '\\',
            'u' => {
                let (code, rest) = chars.as_str().strip_prefix('{')?.split_once('}')?;
                chars = rest.chars();
                char::from_u32(u32::from_str_radix(code, 16).ok()?)?
            }
            _ => return None,
        });
    }
    Some(plain)
}

/// Returns the 64-bit FNV-1a hash.
fn fnv1a64(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0xcbf2_9ce4_8422_2325, |hash, &byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
    })
}

/// Destination of the links' transcript. Cheap to clone; all clones write to the same place, one
/// whole line at a time.
#[derive(Clone, Default)]
pub struct Tap {
    inner: Option<Arc<Mutex<TapState>>>,
}

struct TapState {
    writer: Box<dyn io::Write + Send>,
    error: Option<io::Error>,
}

impl Tap {
    /// Writes to `writer`, flushed after every line, so that a killed process loses at most the
    /// line it was writing.
    pub fn new(writer: impl io::Write + Send + 'static) -> Self {
        Self {
            inner: Some(Arc::new(Mutex::new(TapState {
                writer: Box::new(writer),
                error: None,
            }))),
        }
    }

    /// Writes nothing.
    pub fn none() -> Self {
        Self::default()
    }

    /// Writes one line. A full disk must not end a measurement: a failure is kept for
    /// [`Tap::take_error`], and the next line is tried again.
    pub fn record(&self, record: &Record) {
        let Some(inner) = &self.inner else { return };
        let mut state = inner.lock().unwrap_or_else(PoisonError::into_inner);
        let line = format!("{record}\n");
        let written = state
            .writer
            .write_all(line.as_bytes())
            .and_then(|()| state.writer.flush());
        if let Err(error) = written {
            state.error.get_or_insert(error);
        }
    }

    /// Returns the first failure since the last call: the transcript has a gap.
    pub fn take_error(&self) -> Option<io::Error> {
        self.inner.as_ref().and_then(|inner| {
            inner
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
                .error
                .take()
        })
    }
}

impl fmt::Debug for Tap {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(if self.inner.is_some() {
            "Tap(writer)"
        } else {
            "Tap(none)"
        })
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn record(direction: Direction, payload: Payload) -> Record {
        Record {
            time_s: 12.345678,
            link: "scope".to_owned(),
            direction,
            payload,
        }
    }

    #[test]
    fn lines_look_as_documented() {
        let table = [
            (
                record(Direction::Sent, Payload::Text(":WAV:PRE?".to_owned())),
                "12.345678 scope > :WAV:PRE?",
            ),
            (
                record(Direction::Unsolicited, Payload::Text("late\r\n".to_owned())),
                "12.345678 scope ! late\\r\\n",
            ),
            // Both hashes are among the published test vectors of FNV-1a.
            (
                record(
                    Direction::Received,
                    Payload::Block(BlockRecord::new("C1:WF ALL,", b"a")),
                ),
                "12.345678 scope <# 1 fnv1a64=af63dc4c8601ec8c hex=61 prefix=C1:WF ALL,",
            ),
            (
                record(
                    Direction::Received,
                    Payload::Block(BlockRecord::new("", b"")),
                ),
                "12.345678 scope <# 0 fnv1a64=cbf29ce484222325 hex=",
            ),
        ];
        for (record, line) in table {
            assert_eq!(record.to_string(), line);
            assert_eq!(
                Transcript::parse(&format!("{line}\n")).unwrap().records,
                [record]
            );
        }
    }

    #[test]
    fn long_blocks_keep_length_and_hash_only() {
        let payload = vec![7; INLINE_BLOCK_BYTES + 1];
        let block = BlockRecord::new("", &payload);
        let line = record(Direction::Received, Payload::Block(block.clone())).to_string();
        assert!(
            line.len() < 80 && line.contains("<# 513 fnv1a64="),
            "{line}"
        );
        assert!(block.describes(&payload) && !block.describes(&payload[1..]));
    }

    #[test]
    fn mistakes_are_named_and_a_torn_line_is_set_aside() {
        let table = [
            (
                "soon scope > x\n",
                "line 1: expected bench time in seconds, found `soon`",
            ),
            (
                "# remark\n\n1.0 scope ? x\n",
                "line 3: expected one of > < ! * with or without #, found `?`",
            ),
            ("1.0\n", "line 1: expected the name of a link, found ``"),
            (
                "1.0 a > \\x\n",
                "line 1: expected text with the escapes \\n \\r \\t \\\\ \\u{…}, found `\\x`",
            ),
            (
                "1.0 a <# 2 fnv1a64=af63dc4c8601ec8c hex=61\n",
                "line 1: expected LENGTH fnv1a64=HASH [hex=BYTES] [prefix=TEXT], found `2 \
                fnv1a64=af63dc4c8601ec8c hex=61`",
            ),
        ];
        for (text, message) in table {
            assert_eq!(Transcript::parse(text).unwrap_err().to_string(), message);
        }
        let torn = Transcript::parse("1.0 a > *IDN?\n2.0 a < KEP").unwrap();
        assert_eq!(
            (torn.records.len(), torn.torn.as_deref()),
            (1, Some("2.0 a < KEP"))
        );
    }

    struct FullDisk;

    impl io::Write for FullDisk {
        fn write(&mut self, _bytes: &[u8]) -> io::Result<usize> {
            Err(io::ErrorKind::StorageFull.into())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn a_full_disk_is_remembered_not_fatal() {
        let tap = Tap::new(FullDisk);
        assert!(tap.take_error().is_none());
        tap.record(&record(Direction::Sent, Payload::Text("x".to_owned())));
        assert_eq!(tap.take_error().unwrap().kind(), io::ErrorKind::StorageFull);
        assert!(tap.take_error().is_none());
    }

    fn any_record() -> impl Strategy<Value = Record> {
        let payload = prop_oneof![
            any::<String>().prop_map(Payload::Text),
            ("\\PC{0,10}", prop::collection::vec(any::<u8>(), 0..40))
                .prop_map(|(prefix, bytes)| Payload::Block(BlockRecord::new(&prefix, &bytes))),
        ];
        let direction =
            prop::sample::select(Direction::SIGNS.map(|(_, direction)| direction).to_vec());
        (0_u32..4_000_000_000, ".{1,10}", direction, payload).prop_map(
            |(micros, link, direction, payload)| Record {
                time_s: f64::from(micros) / 1.0e6,
                link,
                direction,
                payload,
            },
        )
    }

    proptest! {
        #[test]
        fn what_is_written_is_read_back(records in prop::collection::vec(any_record(), 0..5)) {
            let text: String = records.iter().map(|record| format!("{record}\n")).collect();
            prop_assert_eq!(text.lines().count(), records.len());
            prop_assert_eq!(Transcript::parse(&text), Ok(Transcript { records, torn: None }));
        }

        #[test]
        fn no_text_makes_the_reader_panic(text in "([0-9.]{1,4} [a-z ]{0,4}[><!*#]{0,2} )?[ -~\n\
        ]{0,40}\n?") {
            let _ = Transcript::parse(&text);
        }
    }
}
