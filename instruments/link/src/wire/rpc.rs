//! ONC RPC version 2 over TCP (RFC 5531) with XDR (RFC 4506) and the port mapper (RFC 1833,
//! section 3), as far as VXI-11 needs them: no authentication.

use super::WireError;

/// A program that answers calls.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Program {
    /// Its number.
    pub number: u32,
    /// Its version.
    pub version: u32,
}

/// The port mapper's program, its question for a port, and its port.
pub const PORT_MAPPER: Program = Program {
    number: 100_000,
    version: 2,
};
/// Procedure of the port mapper that returns a program's port.
pub const GET_PORT: u32 = 3;
/// The port of the port mapper.
pub const PORT_MAPPER_PORT: u16 = 111;
/// Number of TCP in questions to the port mapper.
pub const TCP: u32 = 6;

const CALL: u32 = 0;
const REPLY: u32 = 1;
const RPC_VERSION: u32 = 2;
/// Longest credential or verifier (RFC 5531, section 8.2), bytes.
const MOST_AUTHENTICATION: usize = 400;
const LAST_FRAGMENT: u32 = 1 << 31;

/// Reads XDR values from the front of a slice.
#[derive(Debug, Clone)]
pub struct Reader<'a>(&'a [u8]);

impl<'a> Reader<'a> {
    /// Starts at the first byte.
    pub fn new(bytes: &'a [u8]) -> Self {
        Self(bytes)
    }

    /// Reads an unsigned or signed integer, an enumeration or a boolean.
    ///
    /// # Errors
    /// Fewer than four bytes are left.
    pub fn word(&mut self) -> Result<u32, WireError> {
        let Some((word, rest)) = self.0.split_first_chunk() else {
            return Err(WireError::new(
                "an XDR word of 4 bytes",
                format!("{} bytes", self.0.len()),
            ));
        };
        self.0 = rest;
        Ok(u32::from_be_bytes(*word))
    }

    /// Reads opaque data or a string of at most `most` bytes.
    ///
    /// # Errors
    /// It is longer, or fewer bytes are left.
    pub fn opaque(&mut self, most: usize) -> Result<&'a [u8], WireError> {
        let length = self.word()? as usize;
        if length > most {
            return Err(WireError::new(
                format!("XDR data of at most {most} bytes"),
                format!("{length} bytes"),
            ));
        }
        let padded = length.next_multiple_of(4);
        let Some((data, rest)) = self.0.split_at_checked(padded) else {
            return Err(WireError::new(
                format!("XDR data of {length} bytes"),
                format!("{} bytes", self.0.len()),
            ));
        };
        self.0 = rest;
        Ok(data.get(..length).unwrap_or_default())
    }

    /// Bytes that have not been read.
    pub fn rest(self) -> &'a [u8] {
        self.0
    }
}

/// Writes XDR values.
#[derive(Debug, Clone, Default)]
pub struct Writer(Vec<u8>);

impl Writer {
    /// Appends XDR words.
    #[must_use]
    pub fn words(mut self, words: &[u32]) -> Self {
        self.0
            .extend(words.iter().flat_map(|word| word.to_be_bytes()));
        self
    }

    /// Appends opaque data or a string with its length and padding.
    #[must_use]
    pub fn opaque(self, data: &[u8]) -> Self {
        let mut writer = self.words(&[u32::try_from(data.len()).unwrap_or(u32::MAX)]);
        writer.0.extend_from_slice(data);
        writer.0.resize(writer.0.len().next_multiple_of(4), 0);
        writer
    }

    /// Appends bytes that are XDR already.
    #[must_use]
    pub fn raw(mut self, bytes: &[u8]) -> Self {
        self.0.extend_from_slice(bytes);
        self
    }

    /// Returns the bytes.
    pub fn done(self) -> Vec<u8> {
        self.0
    }
}

/// A call, without its record mark.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Call<'a> {
    /// Chosen by the client; comes back with the reply.
    pub id: u32,
    /// Program and version.
    pub program: Program,
    /// Procedure of the program.
    pub procedure: u32,
    /// Arguments in XDR.
    pub arguments: &'a [u8],
}

impl<'a> Call<'a> {
    /// Parses a call.
    ///
    /// # Errors
    /// The record is not a call of RPC version 2.
    pub fn parse(record: &'a [u8]) -> Result<Self, WireError> {
        let mut reader = Reader::new(record);
        let (id, kind, version) = (reader.word()?, reader.word()?, reader.word()?);
        if (kind, version) != (CALL, RPC_VERSION) {
            return Err(WireError::new(
                "a call of RPC version 2",
                format!("message type {kind}, version {version}"),
            ));
        }
        let program = Program {
            number: reader.word()?,
            version: reader.word()?,
        };
        let procedure = reader.word()?;
        for _credential_and_verifier in 0..2 {
            reader.word()?;
            reader.opaque(MOST_AUTHENTICATION)?;
        }
        Ok(Self {
            id,
            program,
            procedure,
            arguments: reader.rest(),
        })
    }

    /// Returns the record, without its mark.
    pub fn encode(&self) -> Vec<u8> {
        let Program { number, version } = self.program;
        Writer::default()
            .words(&[
                self.id,
                CALL,
                RPC_VERSION,
                number,
                version,
                self.procedure,
                0,
                0,
                0,
                0,
            ])
            .raw(self.arguments)
            .done()
    }
}

/// Verdict of a server on a call.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// It was executed; results follow.
    Success,
    /// The program is another one.
    ProgramUnavailable,
    /// The program is there in these versions only.
    VersionMismatch {
        /// The lowest.
        low: u32,
        /// The highest.
        high: u32,
    },
    /// The program has no such procedure.
    ProcedureUnavailable,
    /// The arguments cannot be read.
    GarbageArguments,
    /// Another error of the server.
    SystemError,
    /// The call was not accepted at all: another RPC version, or authentication.
    Denied,
}

/// A reply, without its record mark.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Reply<'a> {
    /// The call's.
    pub id: u32,
    /// Verdict of the server.
    pub verdict: Verdict,
    /// Results in XDR.
    pub results: &'a [u8],
}

impl<'a> Reply<'a> {
    /// Parses a reply.
    ///
    /// # Errors
    /// The record is not a reply.
    pub fn parse(record: &'a [u8]) -> Result<Self, WireError> {
        let mut reader = Reader::new(record);
        let (id, kind, denied) = (reader.word()?, reader.word()?, reader.word()?);
        if kind != REPLY || denied > 1 {
            return Err(WireError::new(
                "an RPC reply",
                format!("message type {kind}, status {denied}"),
            ));
        }
        if denied == 1 {
            return Ok(Self {
                id,
                verdict: Verdict::Denied,
                results: &[],
            });
        }
        reader.word()?;
        reader.opaque(MOST_AUTHENTICATION)?;
        let verdict = match reader.word()? {
            0 => Verdict::Success,
            1 => Verdict::ProgramUnavailable,
            2 => Verdict::VersionMismatch {
                low: reader.word()?,
                high: reader.word()?,
            },
            3 => Verdict::ProcedureUnavailable,
            4 => Verdict::GarbageArguments,
            5 => Verdict::SystemError,
            other => {
                return Err(WireError::new(
                    "an RPC status from 0 to 5",
                    other.to_string(),
                ));
            }
        };
        Ok(Self {
            id,
            verdict,
            results: reader.rest(),
        })
    }

    /// Returns the record, without its mark.
    pub fn encode(&self) -> Vec<u8> {
        let accepted = |status: u32| Writer::default().words(&[self.id, REPLY, 0, 0, 0, status]);
        match self.verdict {
            Verdict::Success => accepted(0).raw(self.results),
            Verdict::ProgramUnavailable => accepted(1),
            Verdict::VersionMismatch { low, high } => accepted(2).words(&[low, high]),
            Verdict::ProcedureUnavailable => accepted(3),
            Verdict::GarbageArguments => accepted(4),
            Verdict::SystemError => accepted(5),
            // Rejected for its RPC version: 2 is the only one.
            Verdict::Denied => {
                Writer::default().words(&[self.id, REPLY, 1, 0, RPC_VERSION, RPC_VERSION])
            }
        }
        .done()
    }
}

/// Returns a record with its mark, in one fragment.
pub fn marked(record: &[u8]) -> Vec<u8> {
    let length = u32::try_from(record.len()).unwrap_or(u32::MAX) & !LAST_FRAGMENT;
    [&(length | LAST_FRAGMENT).to_be_bytes(), record].concat()
}

/// Puts the fragments of a stream together to records (RFC 5531, section 11).
#[derive(Debug)]
pub struct Records {
    buffer: Vec<u8>,
    record: Vec<u8>,
    limit: usize,
}

impl Records {
    /// Creates a reader for records of at most `limit` bytes.
    pub fn new(limit: usize) -> Self {
        Self {
            buffer: Vec::new(),
            record: Vec::new(),
            limit,
        }
    }

    /// Takes in bytes from the stream.
    pub fn push(&mut self, bytes: &[u8]) {
        self.buffer.extend_from_slice(bytes);
    }

    /// Bytes that are held.
    pub fn held(&self) -> usize {
        self.buffer.len() + self.record.len()
    }

    /// Gives out the next whole record; `None` while bytes are missing.
    ///
    /// # Errors
    /// It is longer than the limit; the stream is of no use after that.
    pub fn pull(&mut self) -> Result<Option<Vec<u8>>, WireError> {
        loop {
            let Some((mark, rest)) = self.buffer.split_first_chunk() else {
                return Ok(None);
            };
            let mark = u32::from_be_bytes(*mark);
            let length = (mark & !LAST_FRAGMENT) as usize;
            if length > self.limit - self.record.len() {
                let found = format!("one of {} or more", self.record.len() + length);
                return Err(WireError::new(
                    format!("an RPC record of at most {} bytes", self.limit),
                    found,
                ));
            }
            let Some(fragment) = rest.get(..length) else {
                return Ok(None);
            };
            self.record.extend_from_slice(fragment);
            self.buffer.drain(..4 + length);
            if mark & LAST_FRAGMENT != 0 {
                return Ok(Some(std::mem::take(&mut self.record)));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_call_and_a_reply_have_the_bytes_of_the_standard() {
        // GETPORT for program 395183 version 1 over TCP, and the answer 1024.
        let arguments = Writer::default().words(&[395_183, 1, TCP, 0]).done();
        let call = Call {
            id: 7,
            program: PORT_MAPPER,
            procedure: GET_PORT,
            arguments: &arguments,
        };
        let bytes = marked(&call.encode());
        let expected = [
            [0x80, 0, 0, 0x38],
            [0, 0, 0, 7],
            [0, 0, 0, 0],
            [0, 0, 0, 2],
            [0, 1, 0x86, 0xa0],
            [0, 0, 0, 2],
            [0, 0, 0, 3],
            [0; 4],
            [0; 4],
            [0; 4],
            [0; 4],
            [0, 6, 7, 0xaf],
            [0, 0, 0, 1],
            [0, 0, 0, 6],
            [0; 4],
        ];
        assert_eq!(bytes, expected.concat());
        assert_eq!(Call::parse(&bytes[4..]), Ok(call));
        let reply = [
            [0, 0, 0, 7],
            [0, 0, 0, 1],
            [0; 4],
            [0; 4],
            [0; 4],
            [0; 4],
            [0, 0, 4, 0],
        ]
        .concat();
        let expected = Reply {
            id: 7,
            verdict: Verdict::Success,
            results: &[0, 0, 4, 0],
        };
        assert_eq!(Reply::parse(&reply), Ok(expected));
        assert_eq!(expected.encode(), reply);
    }

    #[test]
    fn every_verdict_is_read_back() {
        for verdict in [
            Verdict::Success,
            Verdict::ProgramUnavailable,
            Verdict::VersionMismatch { low: 1, high: 3 },
            Verdict::ProcedureUnavailable,
            Verdict::GarbageArguments,
            Verdict::SystemError,
            Verdict::Denied,
        ] {
            let reply = Reply {
                id: 9,
                verdict,
                results: &[],
            };
            assert_eq!(Reply::parse(&reply.encode()), Ok(reply));
        }
    }

    #[test]
    fn records_come_in_fragments_and_in_any_pieces() {
        let stream = [
            &[0, 0, 0, 2][..],
            b"ab",
            &[0, 0, 0, 0],
            &[0x80, 0, 0, 1],
            b"c",
            &marked(b""),
            &marked(b"defg"),
        ]
        .concat();
        for cut in 0..=stream.len() {
            let mut records = Records::new(4);
            let mut found = Vec::new();
            for piece in [&stream[..cut], &stream[cut..]] {
                records.push(piece);
                while let Some(record) = records.pull().unwrap() {
                    found.push(record);
                }
            }
            assert_eq!(found, [&b"abc"[..], b"", b"defg"], "cut at {cut}");
            assert_eq!(records.held(), 0);
        }
        let mut records = Records::new(4);
        records.push(&[0, 0, 0, 3, 1, 2, 3, 0x80, 0, 0, 2]);
        assert_eq!(
            records.pull().unwrap_err().to_string(),
            "expected an RPC record of at most 4 bytes, found one of 5 or more"
        );
    }

    #[test]
    fn what_is_cut_short_or_too_long_is_named() {
        assert_eq!(
            Reader::new(&[1, 2]).word().unwrap_err().to_string(),
            "expected an XDR word of 4 bytes, found 2 bytes"
        );
        let text = Writer::default().opaque(b"abcde").done();
        assert_eq!(text.len(), 12);
        assert_eq!(Reader::new(&text).opaque(5), Ok(&b"abcde"[..]));
        assert_eq!(
            Reader::new(&text).opaque(4).unwrap_err().to_string(),
            "expected XDR data of at most 4 bytes, found 5 bytes"
        );
        assert_eq!(
            Reader::new(&text[..8]).opaque(5).unwrap_err().to_string(),
            "expected XDR data of 5 bytes, found 4 bytes"
        );
        let other = Call {
            id: 1,
            program: Program {
                number: 1,
                version: 1,
            },
            procedure: 1,
            arguments: &[],
        }
        .encode();
        assert_eq!(
            Reply::parse(&other).unwrap_err().to_string(),
            "expected an RPC reply, found message type 0, status 2"
        );
    }
}
