//! Tables as Parquet, with metadata and a checksum over the whole file.
//!
//! The checksum is verified before decoding, because the decoder trusts the bytes and may allocate
//! more memory than available for a damaged file. It is part of the metadata and is computed over
//! the file with its own digits set to zero, by FNV-1a (64 bits). It detects accidents, not
//! manipulation.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Cursor, Read, Seek, SeekFrom};
use std::path::Path;

use polars::io::mmap::MmapBytesReader;
use polars::prelude::{
    DataFrame, KeyValueMetadata, ParquetReader, ParquetWriter, PolarsError, SerReader,
};

use analysis_fit::fit::PROGRAM;

use super::disk::{io_error, write_atomically};
use super::{ColumnSpec, DatasetError};

/// Text before the digits of the checksum. The base64 of the schema cannot contain it, because it
/// has a colon.
const MARK: &[u8] = b"fnv1a64:";
const DIGITS: usize = 16;
/// Largest distance of the checksum from the end of the file, bytes.
const TAIL: u64 = 1 << 16;
/// Bytes that are read at once.
const PIECE: usize = 1 << 20;
/// Start value of FNV-1a.
const SEED: u64 = 0xcbf2_9ce4_8422_2325;

/// Writes a frame with the meaning of its columns and further metadata.
pub(super) fn write_frame(
    path: &Path,
    frame: &mut DataFrame,
    columns: &[ColumnSpec],
    more: Vec<(String, String)>,
) -> Result<(), DatasetError> {
    let about = |spec: &ColumnSpec| {
        (
            format!("column.{}", spec.name),
            format!("{} [{}]", spec.doc, spec.unit),
        )
    };
    let blank = format!("{}{}", String::from_utf8_lossy(MARK), "0".repeat(DIGITS));
    // Last, so that no later bytes can be mistaken for it.
    let pairs = columns
        .iter()
        .map(about)
        .chain(more)
        .chain([("program".to_owned(), PROGRAM.to_owned())])
        .chain([("checksum".to_owned(), blank)])
        .collect();
    let mut bytes = Vec::new();
    ParquetWriter::new(&mut bytes)
        .set_parallel(false)
        .with_key_value_metadata(Some(KeyValueMetadata::from_static(pairs)))
        .finish(frame)
        .map_err(|source| parquet_error(path, "encode the table", source))?;
    let checksum = checksum(&bytes);
    if let Some(digits) = digits(&bytes).and_then(|range| bytes.get_mut(range)) {
        digits.copy_from_slice(checksum.as_bytes());
    }
    write_atomically(path, &bytes)
}

/// Reads a frame and the metadata of its file.
pub(super) fn read_frame(
    path: &Path,
) -> Result<(DataFrame, BTreeMap<String, String>), DatasetError> {
    let mut bytes =
        std::fs::read(path).map_err(|source| io_error(path, "read the file", source))?;
    check(path, &mut bytes)?;
    let mut reader = ParquetReader::new(Cursor::new(bytes));
    let pairs = metadata(path, &mut reader)?;
    let frame = reader
        .finish()
        .map_err(|source| parquet_error(path, "decode the table", source))?;
    Ok((frame, pairs))
}

/// The metadata of a file.
pub(super) fn metadata<R: MmapBytesReader>(
    path: &Path,
    reader: &mut ParquetReader<R>,
) -> Result<BTreeMap<String, String>, DatasetError> {
    let metadata = reader
        .get_metadata()
        .map_err(|source| parquet_error(path, "read it as Parquet", source))?;
    let pairs = metadata.key_value_metadata().iter().flatten();
    Ok(pairs
        .filter_map(|pair| pair.value.clone().map(|value| (pair.key.clone(), value)))
        .collect())
}

/// Like [`check`], for a file that is read in pieces.
pub(super) fn check_file(path: &Path) -> Result<(), DatasetError> {
    let wrong = |expected: &str, found: &str| DatasetError::Checksum {
        path: path.to_path_buf(),
        expected: expected.to_owned(),
        found: found.to_owned(),
    };
    let summed = || -> io::Result<Option<(String, String)>> {
        let mut file = File::open(path)?;
        let length = file.metadata()?.len();
        let from = length.saturating_sub(TAIL);
        file.seek(SeekFrom::Start(from))?;
        let mut tail = Vec::new();
        (&file).take(TAIL).read_to_end(&mut tail)?;
        let Some(range) = digits(&tail) else {
            return Ok(None);
        };
        let stored = tail
            .get(range.clone())
            .map(|bytes| String::from_utf8_lossy(bytes).into_owned())
            .unwrap_or_default();
        let blanked = (from + range.start as u64)..(from + range.end as u64);
        file.seek(SeekFrom::Start(0))?;
        let (mut hash, mut at, mut buffer) = (SEED, 0_u64, vec![0; PIECE]);
        loop {
            let count = file.read(&mut buffer)?;
            if count == 0 {
                return Ok(Some((stored, format!("{hash:016x}"))));
            }
            let piece = &mut buffer[..count];
            for position in blanked
                .clone()
                .filter(|position| (at..at + count as u64).contains(position))
            {
                piece[(position - at) as usize] = b'0';
            }
            hash = mixed(hash, piece);
            at += count as u64;
        }
    };
    match summed().map_err(|source| io_error(path, "read the file", source))? {
        None => Err(wrong("in its metadata", "none")),
        Some((expected, found)) if expected != found => Err(wrong(&expected, &found)),
        Some(_) => Ok(()),
    }
}

pub(super) fn parquet_error(
    path: &Path,
    action: &'static str,
    source: PolarsError,
) -> DatasetError {
    DatasetError::Parquet {
        path: path.to_path_buf(),
        action,
        source,
    }
}

/// Compares the checksum in the file with the checksum of its bytes, after setting its digits to
/// zero.
fn check(path: &Path, bytes: &mut [u8]) -> Result<(), DatasetError> {
    let wrong = |expected: &str, found: &str| DatasetError::Checksum {
        path: path.to_path_buf(),
        expected: expected.to_owned(),
        found: found.to_owned(),
    };
    let Some(stored) = digits(bytes).and_then(|range| bytes.get_mut(range)) else {
        return Err(wrong("in its metadata", "none"));
    };
    let expected = String::from_utf8_lossy(stored).into_owned();
    stored.fill(b'0');
    let found = checksum(bytes);
    if expected == found {
        Ok(())
    } else {
        Err(wrong(&expected, &found))
    }
}

/// Returns the range of the checksum's digits.
fn digits(bytes: &[u8]) -> Option<std::ops::Range<usize>> {
    let start = bytes
        .windows(MARK.len())
        .rposition(|window| window == MARK)?
        + MARK.len();
    (start + DIGITS <= bytes.len()).then_some(start..start + DIGITS)
}

fn checksum(bytes: &[u8]) -> String {
    format!("{:016x}", mixed(SEED, bytes))
}

fn mixed(hash: u64, bytes: &[u8]) -> u64 {
    bytes.iter().fold(hash, |hash, byte| {
        (hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3)
    })
}
