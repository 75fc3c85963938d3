//! The procedures of VXI-11 (TCP/IP Instrument Protocol, revision 1.0, annex C): the calls of a
//! client on the core and abort channels and their replies.

use super::{
    WireError,
    rpc::{Program, Reader, Writer},
};

/// Program and version of the core channel.
pub const CORE: Program = Program {
    number: 0x0006_07af,
    version: 1,
};
/// Program and version of the abort channel.
pub const ABORT: Program = Program {
    number: 0x0006_07b0,
    version: 1,
};
/// The only procedure of the abort channel: its argument is the link, its result an error.
pub const DEVICE_ABORT: u32 = 1;

/// Flag of a write: its last byte ends a message.
pub const FLAG_END: u32 = 0x08;
/// Flag of a read: it ends with the byte that is named.
pub const FLAG_TERM_CHAR: u32 = 0x80;
/// A read ended because the requested number of bytes arrived.
pub const REASON_COUNT: u32 = 1;
/// A read ended with the byte that was named.
pub const REASON_CHAR: u32 = 2;
/// A read ended with the end of the message.
pub const REASON_END: u32 = 4;

/// Bytes of an argument that are kept of a device's name, a lock's handle or a low-level command.
const MOST_TEXT: usize = 1 << 10;

/// Status of a call that an instrument executed (table B.2).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Status(pub u32);

impl Status {
    /// Nothing is wrong.
    pub const OK: Self = Self(0);
    /// No such device.
    pub const NOT_ACCESSIBLE: Self = Self(3);
    /// No such link.
    pub const INVALID_LINK: Self = Self(4);
    /// The instrument does not do that.
    pub const NOT_SUPPORTED: Self = Self(8);
    /// No link is left.
    pub const OUT_OF_RESOURCES: Self = Self(9);
    /// Nothing came in time.
    pub const TIMEOUT: Self = Self(15);
    /// The transfer failed.
    pub const IO_ERROR: Self = Self(17);
    /// Ended through the abort channel.
    pub const ABORTED: Self = Self(23);

    /// Returns the meaning of the status as text.
    pub fn meaning(self) -> &'static str {
        match self.0 {
            0 => "no error",
            1 => "syntax error",
            3 => "device not accessible",
            4 => "invalid link identifier",
            5 => "parameter error",
            6 => "channel not established",
            8 => "operation not supported",
            9 => "out of resources",
            11 => "device locked by another link",
            12 => "no lock held by this link",
            15 => "I/O timeout",
            17 => "I/O error",
            21 => "invalid address",
            23 => "abort",
            29 => "channel already established",
            _ => "a number that the standard does not know",
        }
    }
}

/// A call of the core channel.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Request {
    /// Opens a link to a device, such as `inst0`.
    CreateLink {
        /// The device's name.
        device: String,
    },
    /// Sends bytes to the device.
    Write {
        /// The link.
        link: u32,
        /// How long it may take, ms.
        io_timeout_ms: u32,
        /// [`FLAG_END`].
        flags: u32,
        /// The bytes.
        data: Vec<u8>,
    },
    /// Reads bytes from the device.
    Read {
        /// The link.
        link: u32,
        /// Most bytes that are wanted.
        size: u32,
        /// How long it may take, ms.
        io_timeout_ms: u32,
        /// Ends the read, where wanted.
        term_char: Option<u8>,
    },
    /// Requests the status byte, as a serial poll does.
    ReadStatus {
        /// The link.
        link: u32,
    },
    /// Discards the received input and the pending replies.
    Clear {
        /// The link.
        link: u32,
    },
    /// Trigger, remote, local, lock, unlock, service requests: calls that return only an error
    /// code.
    Simple {
        /// Which.
        procedure: Simple,
        /// The link.
        link: u32,
    },
    /// A low-level command.
    Command {
        /// The link.
        link: u32,
    },
    /// Closes a link.
    DestroyLink {
        /// The link.
        link: u32,
    },
    /// Enables or disables callbacks for service requests.
    Interrupts {
        /// To call back.
        create: bool,
    },
}

/// Calls that return only an error code.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[expect(missing_docs, reason = "named as in the standard")]
pub enum Simple {
    Trigger,
    Remote,
    Local,
    Lock,
    Unlock,
    EnableServiceRequests,
}

impl Simple {
    const NUMBERS: [(u32, Self); 6] = [
        (14, Self::Trigger),
        (16, Self::Remote),
        (17, Self::Local),
        (18, Self::Lock),
        (19, Self::Unlock),
        (20, Self::EnableServiceRequests),
    ];
}

impl Request {
    /// Reads the arguments of a procedure; `None` for a procedure that the core channel does not
    /// have. Data of a write may be `most` bytes long.
    ///
    /// # Errors
    /// The arguments are not those of the procedure.
    pub fn parse(procedure: u32, arguments: &[u8], most: usize) -> Result<Option<Self>, WireError> {
        let mut reader = Reader::new(arguments);
        if procedure == 25 || procedure == 26 {
            return Ok(Some(Self::Interrupts {
                create: procedure == 25,
            }));
        }
        if procedure == 10 {
            let (_client, _lock, _lock_timeout) = (reader.word()?, reader.word()?, reader.word()?);
            let device = String::from_utf8_lossy(reader.opaque(MOST_TEXT)?).into_owned();
            return Ok(Some(Self::CreateLink { device }));
        }
        if !(11..=23).contains(&procedure) || procedure == 21 {
            return Ok(None);
        }
        let link = reader.word()?;
        Ok(Some(match procedure {
            11 => {
                let (io_timeout_ms, _lock_timeout, flags) =
                    (reader.word()?, reader.word()?, reader.word()?);
                Self::Write {
                    link,
                    io_timeout_ms,
                    flags,
                    data: reader.opaque(most)?.to_vec(),
                }
            }
            12 => {
                let (size, io_timeout_ms, _lock_timeout) =
                    (reader.word()?, reader.word()?, reader.word()?);
                let (flags, byte) = (reader.word()?, reader.word()?);
                #[expect(
                    clippy::cast_possible_truncation,
                    reason = "a character takes a word in XDR"
                )]
                let term_char = (flags & FLAG_TERM_CHAR != 0).then_some(byte as u8);
                Self::Read {
                    link,
                    size,
                    io_timeout_ms,
                    term_char,
                }
            }
            13 => Self::ReadStatus { link },
            15 => Self::Clear { link },
            22 => Self::Command { link },
            23 => Self::DestroyLink { link },
            other => match Simple::NUMBERS.iter().find(|(number, _)| *number == other) {
                Some(&(_, procedure)) => Self::Simple { procedure, link },
                None => return Ok(None),
            },
        }))
    }

    /// Returns the number of the procedure and its arguments.
    pub fn encode(&self) -> (u32, Vec<u8>) {
        let words = |words: &[u32]| Writer::default().words(words);
        // Flags, lock timeout and I/O timeout of the calls without further arguments: 2 s.
        let generic = |link: u32| words(&[link, 0, 0, 2000]);
        let (procedure, arguments) = match self {
            Self::CreateLink { device } => (10, words(&[0, 0, 0]).opaque(device.as_bytes())),
            Self::Write {
                link,
                io_timeout_ms,
                flags,
                data,
            } => (11, words(&[*link, *io_timeout_ms, 0, *flags]).opaque(data)),
            Self::Read {
                link,
                size,
                io_timeout_ms,
                term_char,
            } => {
                let flags = if term_char.is_some() {
                    FLAG_TERM_CHAR
                } else {
                    0
                };
                (
                    12,
                    words(&[
                        *link,
                        *size,
                        *io_timeout_ms,
                        0,
                        flags,
                        term_char.unwrap_or(0).into(),
                    ]),
                )
            }
            Self::ReadStatus { link } => (13, generic(*link)),
            Self::Clear { link } => (15, generic(*link)),
            Self::Simple { procedure, link } => {
                let number = Simple::NUMBERS
                    .iter()
                    .find(|(_, known)| known == procedure)
                    .map_or(0, |&(number, _)| number);
                (number, generic(*link))
            }
            Self::Command { link } => (22, words(&[*link, 0, 0, 0, 0, 0, 0]).opaque(&[])),
            Self::DestroyLink { link } => (23, words(&[*link])),
            Self::Interrupts { create } => (if *create { 25 } else { 26 }, words(&[0; 5])),
        };
        (procedure, arguments.done())
    }
}

/// The result of a call of the core channel.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Response {
    /// Of [`Request::CreateLink`].
    Link {
        /// Status of the call.
        status: Status,
        /// The link.
        link: u32,
        /// Port of the abort channel.
        abort_port: u16,
        /// Most bytes that one write may carry.
        most_bytes: u32,
    },
    /// Of [`Request::Write`].
    Written {
        /// Status of the call.
        status: Status,
        /// Bytes that were taken.
        size: u32,
    },
    /// Of [`Request::Read`].
    Data {
        /// Status of the call.
        status: Status,
        /// [`REASON_END`] and the others; 0 if only a part was available.
        reason: u32,
        /// The bytes.
        data: Vec<u8>,
    },
    /// Of [`Request::ReadStatus`].
    StatusByte {
        /// Status of the call.
        status: Status,
        /// The status byte.
        byte: u8,
    },
    /// Of [`Request::Command`].
    CommandData {
        /// Status of the call.
        status: Status,
    },
    /// Of all others.
    Done {
        /// Status of the call.
        status: Status,
    },
}

impl Response {
    /// Reads the results of the procedure `of`; data of a read may be `most` bytes long.
    ///
    /// # Errors
    /// The results are not those of the procedure.
    pub fn parse(of: &Request, results: &[u8], most: usize) -> Result<Self, WireError> {
        let mut reader = Reader::new(results);
        let status = Status(reader.word()?);
        Ok(match of {
            Request::CreateLink { .. } => {
                let (link, port, most_bytes) = (reader.word()?, reader.word()?, reader.word()?);
                let abort_port = u16::try_from(port)
                    .map_err(|_| WireError::new("a port below 65536", port.to_string()))?;
                Self::Link {
                    status,
                    link,
                    abort_port,
                    most_bytes,
                }
            }
            Request::Write { .. } => Self::Written {
                status,
                size: reader.word()?,
            },
            Request::Read { .. } => Self::Data {
                status,
                reason: reader.word()?,
                data: reader.opaque(most)?.to_vec(),
            },
            #[expect(
                clippy::cast_possible_truncation,
                reason = "a character takes a word in XDR"
            )]
            Request::ReadStatus { .. } => Self::StatusByte {
                status,
                byte: reader.word()? as u8,
            },
            Request::Command { .. } => Self::CommandData { status },
            _ => Self::Done { status },
        })
    }

    /// Returns the results.
    pub fn encode(&self) -> Vec<u8> {
        let words = |words: &[u32]| Writer::default().words(words);
        match self {
            Self::Link {
                status,
                link,
                abort_port,
                most_bytes,
            } => words(&[status.0, *link, u32::from(*abort_port), *most_bytes]),
            Self::Written { status, size } => words(&[status.0, *size]),
            Self::Data {
                status,
                reason,
                data,
            } => words(&[status.0, *reason]).opaque(data),
            Self::StatusByte { status, byte } => words(&[status.0, u32::from(*byte)]),
            Self::CommandData { status } => words(&[status.0]).opaque(&[]),
            Self::Done { status } => words(&[status.0]),
        }
        .done()
    }

    /// Status of the call.
    pub fn status(&self) -> Status {
        match self {
            Self::Link { status, .. }
            | Self::Written { status, .. }
            | Self::Data { status, .. }
            | Self::StatusByte { status, .. }
            | Self::CommandData { status }
            | Self::Done { status } => *status,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn requests() -> Vec<Request> {
        let mut requests = vec![
            Request::CreateLink {
                device: "inst0".to_owned(),
            },
            Request::Write {
                link: 1,
                io_timeout_ms: 2000,
                flags: FLAG_END,
                data: b"*IDN?\n".to_vec(),
            },
            Request::Read {
                link: 1,
                size: 4096,
                io_timeout_ms: 2000,
                term_char: None,
            },
            Request::Read {
                link: 1,
                size: 4096,
                io_timeout_ms: 2000,
                term_char: Some(b'\n'),
            },
            Request::ReadStatus { link: 1 },
            Request::Clear { link: 1 },
            Request::Command { link: 1 },
            Request::DestroyLink { link: 1 },
            Request::Interrupts { create: true },
            Request::Interrupts { create: false },
        ];
        requests
            .extend(Simple::NUMBERS.map(|(_, procedure)| Request::Simple { procedure, link: 7 }));
        requests
    }

    #[test]
    fn every_call_is_read_back_and_numbered_as_in_the_standard() {
        let mut numbers: Vec<u32> = Vec::new();
        for request in requests() {
            let (procedure, arguments) = request.encode();
            assert_eq!(
                Request::parse(procedure, &arguments, 100),
                Ok(Some(request))
            );
            numbers.push(procedure);
        }
        numbers.sort_unstable();
        numbers.dedup();
        assert_eq!(
            numbers,
            [10, 11, 12, 13, 14, 15, 16, 17, 18, 19, 20, 22, 23, 25, 26]
        );
        for procedure in [0, 9, 21, 24, 27] {
            assert_eq!(
                Request::parse(procedure, &[0; 64], 100),
                Ok(None),
                "{procedure}"
            );
        }
    }

    #[test]
    fn a_write_and_a_read_have_the_bytes_of_the_standard() {
        let write = Request::Write {
            link: 3,
            io_timeout_ms: 10_000,
            flags: FLAG_END,
            data: b"OUTP?".to_vec(),
        };
        let expected = [
            [0, 0, 0, 3],
            [0, 0, 0x27, 0x10],
            [0; 4],
            [0, 0, 0, 8],
            [0, 0, 0, 5],
            *b"OUTP",
            *b"?\0\0\0",
        ]
        .concat();
        assert_eq!(write.encode(), (11, expected));
        let read = Request::Read {
            link: 3,
            size: 256,
            io_timeout_ms: 0,
            term_char: Some(b'\n'),
        };
        let results = [[0; 4], [0, 0, 0, 4], [0, 0, 0, 2], *b"1\n\0\0"].concat();
        let expected = Response::Data {
            status: Status::OK,
            reason: REASON_END,
            data: b"1\n".to_vec(),
        };
        assert_eq!(Response::parse(&read, &results, 256), Ok(expected.clone()));
        assert_eq!(expected.encode(), results);
        assert!(
            Response::parse(&read, &results, 1).is_err(),
            "longer than was asked for"
        );
    }

    #[test]
    fn a_result_that_is_cut_short_is_named() {
        let link = Request::CreateLink {
            device: String::new(),
        };
        let error = Response::parse(&link, &[0; 8], 0).unwrap_err();
        assert_eq!(
            error.to_string(),
            "expected an XDR word of 4 bytes, found 0 bytes"
        );
        let error = Response::parse(&link, &[[0; 4], [0; 4], [0, 1, 0, 0], [0; 4]].concat(), 0)
            .unwrap_err();
        assert_eq!(
            error.to_string(),
            "expected a port below 65536, found 65536"
        );
    }
}
