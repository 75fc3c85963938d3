//! Tables as Parquet, with metadata and a checksum over the whole file.
//!
//! The checksum is looked at before the bytes are given to the decoder, which trusts them: of a damaged file it may ask for more memory than there
//! is. It stands in the metadata and is reckoned with itself as zeros, by FNV-1a (64 bits): against accidents, not against malice.

use std::collections::BTreeMap;
use std::io::Cursor;
use std::path::Path;

use polars::prelude::{DataFrame, KeyValueMetadata, ParquetReader, ParquetWriter, PolarsError, SerReader};

use super::disk::{io_error, write_atomically};
use super::{ColumnSpec, DatasetError};

/// What stands before the digits of the checksum; not found in the base64 of the schema, for its colon.
const MARK: &[u8] = b"fnv1a64:";
const DIGITS: usize = 16;

/// Writes a frame with what its columns mean and more metadata.
pub(super) fn write_frame(
    path: &Path,
    frame: &mut DataFrame,
    columns: &[ColumnSpec],
    more: Vec<(String, String)>,
) -> Result<(), DatasetError> {
    let about = |spec: &ColumnSpec| (format!("column.{}", spec.name), format!("{} [{}]", spec.doc, spec.unit));
    let blank = format!("{}{}", String::from_utf8_lossy(MARK), "0".repeat(DIGITS));
    // Last, so that nothing that follows can look like it.
    let pairs = columns.iter().map(about).chain(more).chain([("checksum".to_owned(), blank)]).collect();
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
pub(super) fn read_frame(path: &Path) -> Result<(DataFrame, BTreeMap<String, String>), DatasetError> {
    let mut bytes = std::fs::read(path).map_err(|source| io_error(path, "read the file", source))?;
    check(path, &mut bytes)?;
    let mut reader = ParquetReader::new(Cursor::new(bytes));
    let metadata = reader.get_metadata().map_err(|source| parquet_error(path, "read it as Parquet", source))?;
    let pairs = metadata.key_value_metadata().iter().flatten();
    let pairs = pairs.filter_map(|pair| pair.value.clone().map(|value| (pair.key.clone(), value))).collect();
    let frame = reader.finish().map_err(|source| parquet_error(path, "decode the table", source))?;
    Ok((frame, pairs))
}

pub(super) fn parquet_error(path: &Path, action: &'static str, source: PolarsError) -> DatasetError {
    DatasetError::Parquet { path: path.to_path_buf(), action, source }
}

/// Compares the checksum in the file with that of its bytes; blanks it.
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
    if expected == found { Ok(()) } else { Err(wrong(&expected, &found)) }
}

/// Where the digits of the checksum stand.
fn digits(bytes: &[u8]) -> Option<std::ops::Range<usize>> {
    let start = bytes.windows(MARK.len()).rposition(|window| window == MARK)? + MARK.len();
    (start + DIGITS <= bytes.len()).then_some(start..start + DIGITS)
}

fn checksum(bytes: &[u8]) -> String {
    let mix = |hash: u64, byte: &u8| (hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3);
    format!("{:016x}", bytes.iter().fold(0xcbf2_9ce4_8422_2325, mix))
}
