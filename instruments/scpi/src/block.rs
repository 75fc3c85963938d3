//! Arbitrary blocks (IEEE 488.2 clauses 7.7.6 and 8.7.9, 8.7.10): `#` d n…n payload, where d is the
//! number of digits and n…n the payload's length in bytes; `#0` payload for a block whose length is
//! not known beforehand. This module parses and writes the header; [`super::decode`] finds the end
//! of the payload.

/// The header of a block, as far as it has arrived.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BlockHeader {
    /// More bytes are needed to decide.
    Incomplete,
    /// `payload_len` bytes follow after `header_len` bytes of header.
    Definite {
        /// Bytes from `#` to the last digit.
        header_len: usize,
        /// Announced bytes of payload.
        payload_len: usize,
    },
    /// `#0`: the payload starts after two bytes and ends with the message.
    Indefinite,
    /// Not the header of a block.
    Invalid,
}

/// Reads a block's header from the front of `bytes`, which must start with `#`.
pub fn parse_header(bytes: &[u8]) -> BlockHeader {
    match bytes {
        [] | [b'#'] => BlockHeader::Incomplete,
        [b'#', b'0', ..] => BlockHeader::Indefinite,
        [b'#', count @ b'1'..=b'9', rest @ ..] => {
            let wanted = usize::from(count - b'0');
            let digits = rest.get(..wanted).unwrap_or(rest);
            if !digits.iter().all(u8::is_ascii_digit) {
                return BlockHeader::Invalid;
            }
            if digits.len() < wanted {
                return BlockHeader::Incomplete;
            }
            // At most nine digits, so that the sum stays far from overflow.
            let payload_len = digits
                .iter()
                .fold(0_usize, |sum, digit| sum * 10 + usize::from(digit - b'0'));
            BlockHeader::Definite {
                header_len: 2 + wanted,
                payload_len,
            }
        }
        _ => BlockHeader::Invalid,
    }
}

/// Writes `payload` as a definite block, with as few digits as needed. Returns `None` if it is
/// longer than the 999 999 999 bytes that nine digits can express.
///
/// ```
/// use instruments_scpi::block::{BlockHeader, encode_definite, parse_header};
///
/// let block = encode_definite(b"abc").unwrap_or_default();
/// assert_eq!(block, b"#13abc");
/// assert_eq!(
///     parse_header(&block),
///     BlockHeader::Definite { header_len: 3, payload_len: 3 }
/// );
/// ```
pub fn encode_definite(payload: &[u8]) -> Option<Vec<u8>> {
    let length = payload.len().to_string();
    if length.len() > 9 {
        return None;
    }
    let mut bytes = format!("#{}{length}", length.len()).into_bytes();
    bytes.extend_from_slice(payload);
    Some(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn headers_are_distinguished_as_they_arrive() {
        let table: [(&[u8], BlockHeader); 12] = [
            (b"", BlockHeader::Incomplete),
            (b"#", BlockHeader::Incomplete),
            (b"#2", BlockHeader::Incomplete),
            (b"#21", BlockHeader::Incomplete),
            (
                b"#210",
                BlockHeader::Definite {
                    header_len: 4,
                    payload_len: 10,
                },
            ),
            (
                b"#9000000346xyz",
                BlockHeader::Definite {
                    header_len: 11,
                    payload_len: 346,
                },
            ),
            (
                b"#10",
                BlockHeader::Definite {
                    header_len: 3,
                    payload_len: 0,
                },
            ),
            (b"#0abc", BlockHeader::Indefinite),
            (b"#H1F", BlockHeader::Invalid),
            (b"#2x", BlockHeader::Invalid),
            (b"#21x", BlockHeader::Invalid),
            (b"abc", BlockHeader::Invalid),
        ];
        for (bytes, expected) in table {
            assert_eq!(parse_header(bytes), expected, "{}", bytes.escape_ascii());
        }
    }

    #[test]
    fn blocks_are_written_with_the_fewest_digits() {
        assert_eq!(encode_definite(b"").unwrap(), b"#10");
        assert_eq!(encode_definite(b"0123456789").unwrap(), b"#2100123456789");
    }
}
