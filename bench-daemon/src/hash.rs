//! SHA-256 as it is written in files: hexadecimal, lower case.

use sha2::{Digest, Sha256};

/// SHA-256 of bytes, in 64 digits.
pub fn sha256(bytes: impl AsRef<[u8]>) -> String {
    hex(&Sha256::digest(bytes))
}

/// Bytes in two digits each.
pub fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
