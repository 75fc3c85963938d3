//! Incremental SHA-256 in 64 digits.

use std::{fs::File, io::Read, path::Path};

use sha2::{Digest, Sha256};

use crate::ArchiveError;

/// Number of bytes in one read.
const PIECE: usize = 1 << 18;

/// State of a hash, with the number of bytes.
#[derive(Debug, Default)]
pub(crate) struct Hasher {
    hash: Sha256,
    bytes: u64,
}

/// SHA-256 and size of bytes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Hashed {
    /// SHA-256, in 64 digits.
    pub(crate) sha256: String,
    /// Number of bytes.
    pub(crate) bytes: u64,
}

impl Hasher {
    /// Adds the next bytes.
    pub(crate) fn take(&mut self, bytes: &[u8]) {
        self.hash.update(bytes);
        self.bytes += bytes.len() as u64;
    }

    /// Returns the hash of all bytes.
    pub(crate) fn end(self) -> Hashed {
        let digest = self.hash.finalize();
        Hashed {
            sha256: digest.iter().map(|byte| format!("{byte:02x}")).collect(),
            bytes: self.bytes,
        }
    }
}

impl Hashed {
    /// Returns the digest of bytes in memory.
    pub(crate) fn of(bytes: &[u8]) -> Self {
        let mut hasher = Hasher::default();
        hasher.take(bytes);
        hasher.end()
    }

    /// Returns the digest of a file, read in pieces.
    ///
    /// # Errors
    /// The file cannot be read.
    pub(crate) fn of_file(path: &Path) -> Result<Self, ArchiveError> {
        let failed = || ArchiveError::io(path, "read the file");
        let mut file = File::open(path).map_err(failed())?;
        let (mut hasher, mut piece) = (Hasher::default(), vec![0; PIECE]);
        loop {
            match file.read(&mut piece).map_err(failed())? {
                0 => return Ok(hasher.end()),
                count => hasher.take(&piece[..count]),
            }
        }
    }

    /// Size and hash in words.
    pub(crate) fn words(&self) -> String {
        format!("{} bytes of SHA-256 {}", self.bytes, self.sha256)
    }
}
