//! HiSLIP messages (IVI-6.1, revision 1.1): a header of 16 bytes and a payload. Encryption and
//! authentication (version 2) are not supported.

use super::WireError;

/// The port of the standard.
pub const PORT: u16 = 4880;
/// Bytes of a header.
pub const HEADER_BYTES: usize = 16;
/// First message id of a session, and after a device clear.
pub const FIRST_ID: u32 = 0xffff_ff00;
/// From one message of the client to the next.
pub const ID_STEP: u32 = 2;
/// Version 1.0 in the upper half of a parameter.
pub const VERSION: u32 = 0x0100;
/// Code of a fatal error of a server that serves another client.
pub const TOO_MANY_CLIENTS: u8 = 4;
/// Code of a fatal error about an order of messages that does not start a session.
pub const BAD_INITIALISATION: u8 = 3;
/// Code of an error about an unknown message type.
pub const UNKNOWN_MESSAGE: u8 = 1;

const PROLOGUE: [u8; 2] = *b"HS";

/// The kinds of messages of version 1 (table 4).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[expect(missing_docs, reason = "named as in the standard")]
#[repr(u8)]
pub enum Kind {
    Initialize = 0,
    InitializeResponse = 1,
    FatalError = 2,
    Error = 3,
    AsyncLock = 4,
    AsyncLockResponse = 5,
    Data = 6,
    DataEnd = 7,
    DeviceClearComplete = 8,
    DeviceClearAcknowledge = 9,
    AsyncRemoteLocalControl = 10,
    AsyncRemoteLocalResponse = 11,
    Trigger = 12,
    Interrupted = 13,
    AsyncInterrupted = 14,
    AsyncMaxMsgSize = 15,
    AsyncMaxMsgSizeResponse = 16,
    AsyncInitialize = 17,
    AsyncInitializeResponse = 18,
    AsyncDeviceClear = 19,
    AsyncServiceRequest = 20,
    AsyncStatusQuery = 21,
    AsyncStatusResponse = 22,
    AsyncDeviceClearAcknowledge = 23,
    AsyncLockInfo = 24,
    AsyncLockInfoResponse = 25,
}

impl Kind {
    const ALL: [Self; 26] = [
        Self::Initialize,
        Self::InitializeResponse,
        Self::FatalError,
        Self::Error,
        Self::AsyncLock,
        Self::AsyncLockResponse,
        Self::Data,
        Self::DataEnd,
        Self::DeviceClearComplete,
        Self::DeviceClearAcknowledge,
        Self::AsyncRemoteLocalControl,
        Self::AsyncRemoteLocalResponse,
        Self::Trigger,
        Self::Interrupted,
        Self::AsyncInterrupted,
        Self::AsyncMaxMsgSize,
        Self::AsyncMaxMsgSizeResponse,
        Self::AsyncInitialize,
        Self::AsyncInitializeResponse,
        Self::AsyncDeviceClear,
        Self::AsyncServiceRequest,
        Self::AsyncStatusQuery,
        Self::AsyncStatusResponse,
        Self::AsyncDeviceClearAcknowledge,
        Self::AsyncLockInfo,
        Self::AsyncLockInfoResponse,
    ];
}

/// A message.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Message {
    /// Its kind; the number itself where version 1 has none.
    pub kind: Result<Kind, u8>,
    /// The control code.
    pub control: u8,
    /// The message parameter: mostly the id of a message.
    pub parameter: u32,
    /// The payload.
    pub payload: Vec<u8>,
}

impl Message {
    /// Creates a message without payload.
    pub fn new(kind: Kind, control: u8, parameter: u32) -> Self {
        Self {
            kind: Ok(kind),
            control,
            parameter,
            payload: Vec::new(),
        }
    }

    /// Adds a payload.
    #[must_use]
    pub fn with(self, payload: impl Into<Vec<u8>>) -> Self {
        Self {
            payload: payload.into(),
            ..self
        }
    }

    /// Returns its bytes.
    pub fn encode(&self) -> Vec<u8> {
        let number = match self.kind {
            Ok(kind) => kind as u8,
            Err(number) => number,
        };
        let mut bytes = Vec::with_capacity(HEADER_BYTES + self.payload.len());
        bytes.extend(PROLOGUE);
        bytes.extend([number, self.control]);
        bytes.extend(self.parameter.to_be_bytes());
        bytes.extend((self.payload.len() as u64).to_be_bytes());
        bytes.extend(&self.payload);
        bytes
    }
}

/// Cuts a stream into messages.
#[derive(Debug)]
pub struct Messages {
    buffer: Vec<u8>,
    limit: usize,
}

impl Messages {
    /// Creates a reader for payloads of at most `limit` bytes.
    pub fn new(limit: usize) -> Self {
        Self {
            buffer: Vec::new(),
            limit,
        }
    }

    /// Takes in bytes from the stream.
    pub fn push(&mut self, bytes: &[u8]) {
        self.buffer.extend_from_slice(bytes);
    }

    /// Bytes that are held.
    pub fn held(&self) -> usize {
        self.buffer.len()
    }

    /// Returns the next complete message; `None` while bytes are missing.
    ///
    /// # Errors
    /// The bytes are not HiSLIP, or the payload is longer than the limit; the stream is then
    /// unusable.
    pub fn pull(&mut self) -> Result<Option<Message>, WireError> {
        let Some((&[h, s, number, control, ref fields @ ..], rest)) =
            self.buffer.split_first_chunk::<HEADER_BYTES>()
        else {
            return Ok(None);
        };
        if [h, s] != PROLOGUE {
            return Err(WireError::new(
                "a HiSLIP message that starts with `HS`",
                format!("`{}`", [h, s].escape_ascii()),
            ));
        }
        let (parameter, length) = fields.split_at(4);
        let word = |bytes: &[u8]| {
            bytes
                .iter()
                .fold(0_u64, |word, &byte| word << 8 | u64::from(byte))
        };
        let length = usize::try_from(word(length)).unwrap_or(usize::MAX);
        if length > self.limit {
            return Err(WireError::new(
                format!("a HiSLIP payload of at most {} bytes", self.limit),
                format!("one of {length}"),
            ));
        }
        let Some(payload) = rest.get(..length) else {
            return Ok(None);
        };
        #[expect(clippy::cast_possible_truncation, reason = "four bytes")]
        let parameter = word(parameter) as u32;
        let kind = Kind::ALL.get(usize::from(number)).copied().ok_or(number);
        let message = Message {
            kind,
            control,
            parameter,
            payload: payload.to_vec(),
        };
        self.buffer.drain(..HEADER_BYTES + length);
        Ok(Some(message))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_message_has_the_bytes_of_the_standard() {
        let initialize =
            Message::new(Kind::Initialize, 0, VERSION << 16 | 0x7878).with(*b"hislip0");
        let bytes = b"HS\0\0\x01\x00xx\0\0\0\0\0\0\0\x07hislip0";
        assert_eq!(initialize.encode(), bytes);
        let query = Message::new(Kind::AsyncStatusQuery, 1, FIRST_ID);
        assert_eq!(query.encode(), b"HS\x15\x01\xff\xff\xff\0\0\0\0\0\0\0\0\0");
    }

    #[test]
    fn every_kind_is_read_back_from_any_pieces() {
        let mut messages: Vec<Message> = Kind::ALL
            .map(|kind| Message::new(kind, 3, 0x0102_0304).with(vec![kind as u8; 5]))
            .into();
        messages.push(Message {
            kind: Err(200),
            ..Message::new(Kind::Error, 1, 2)
        });
        let stream = messages
            .iter()
            .flat_map(Message::encode)
            .collect::<Vec<u8>>();
        for cut in 0..=stream.len() {
            let mut reader = Messages::new(5);
            let mut found = Vec::new();
            for piece in [&stream[..cut], &stream[cut..]] {
                reader.push(piece);
                while let Some(message) = reader.pull().unwrap() {
                    found.push(message);
                }
            }
            assert_eq!(found, messages, "cut at {cut}");
        }
        for (index, kind) in Kind::ALL.into_iter().enumerate() {
            assert_eq!(kind as usize, index);
        }
    }

    #[test]
    fn what_is_not_a_message_is_named() {
        let mut reader = Messages::new(100);
        reader.push(b"HTTP/1.1 400 Bad Request");
        assert_eq!(
            reader.pull().unwrap_err().to_string(),
            "expected a HiSLIP message that starts with `HS`, found `HT`"
        );
        let mut reader = Messages::new(100);
        reader.push(b"HS\x06\0\0\0\0\0\xff\xff\xff\xff\xff\xff\xff\xff");
        let error = reader.pull().unwrap_err().to_string();
        assert!(
            error.starts_with("expected a HiSLIP payload of at most 100 bytes, found one of "),
            "{error}"
        );
    }
}
