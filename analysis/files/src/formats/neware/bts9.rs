//! `.nda` of BTS 9: blocks of records, whose layout depends on the version of the records.

use super::fields::{count, f32_at, long_offset_at, u8_at, u16_at, u32_at, u64_at};
use super::record::{self, Decoded, Fault, Moment, Row};

/// Bytes of a head; each block has its own head if there are several.
const HEAD: usize = 1024;
const MARK: &[u8] = b"NEWARE";
/// Offset of the version of the records.
const VERSION_AT: usize = 16;
/// Offset of the pointer to a block (its start and length), and of the last pointer of a head, whose
/// end is the next head.
const DATA_AT: usize = 82;
const LAST_AT: usize = 242;
/// Mark of a record.
const RECORD: u8 = 85;
/// Length of a record of versions 2 and 3.
const SIZE_2: usize = 88;
/// Lengths of a record of version 19.
const SIZES_19: [usize; 3] = [52, 56, 60];
/// Milliamperes of an ampere.
const MILLI: f64 = 1.0e3;

/// Reads a file.
///
/// # Errors
/// Returns an error for an unknown version and for a truncated file.
pub(super) fn read(bytes: &[u8]) -> Result<Decoded, Fault> {
    let version = u16_at(bytes, VERSION_AT);
    let blocks = blocks(bytes)?;
    let (size, row): (usize, fn(&[u8]) -> Row) = match version {
        2 | 3 => (SIZE_2, row_2),
        19 => (size_19(&blocks)?, row_19),
        _ => {
            return Err(Fault::Version {
                part: "BTS 9's records",
                version,
            });
        }
    };
    if let Some(block) = blocks
        .iter()
        .find(|block| !block.len().is_multiple_of(size))
    {
        return Err(Fault::Cut(format!(
            "a block of {} bytes, which is not a multiple of {size}, the length of a record",
            block.len()
        )));
    }
    let mark_at = if size == SIZE_2 { 4 } else { 0 };
    let records = blocks.iter().flat_map(|block| block.chunks_exact(size));
    let records = records.filter(|record| u8_at(record, mark_at) == RECORD);
    record::text(records.map(row).collect(), Vec::new())
}

/// The blocks of records.
fn blocks(bytes: &[u8]) -> Result<Vec<&[u8]>, Fault> {
    let block = |head: usize| {
        let at = head.saturating_add(DATA_AT);
        let (begin, length) = (long_offset_at(bytes, at), long_offset_at(bytes, at + 8));
        bytes.get(begin..begin.saturating_add(length)).ok_or_else(|| {
            Fault::Cut(format!(
                "its head announces {length} bytes from byte {begin} on, and it has {}; copy it again",
                bytes.len()
            ))
        })
    };
    let is_head = |head: usize| bytes.get(head..).is_some_and(|at| at.starts_with(MARK));
    if long_offset_at(bytes, DATA_AT) != 0 || !is_head(HEAD) {
        return Ok(vec![block(0)?]);
    }
    let (mut all, mut head) = (Vec::new(), HEAD);
    while is_head(head) {
        all.push(block(head)?);
        let last = head.saturating_add(LAST_AT);
        let next = long_offset_at(bytes, last).saturating_add(long_offset_at(bytes, last + 8));
        // Heads form a chain: a head that points back would cause an endless loop.
        if next <= head {
            break;
        }
        head = next;
    }
    Ok(all)
}

/// Returns the only length with which all blocks consist of records.
fn size_19(blocks: &[&[u8]]) -> Result<usize, Fault> {
    let fits = |size: &usize| {
        blocks.iter().all(|block| {
            let whole = block.len().is_multiple_of(*size);
            whole
                && block
                    .chunks_exact(*size)
                    .all(|record| u16_at(record, 0) == u16::from(RECORD))
        })
    };
    let sizes: Vec<usize> = SIZES_19.into_iter().filter(fits).collect();
    match sizes.as_slice() {
        [only] => Ok(*only),
        _ => Err(Fault::Cut(format!(
            "records of BTS 9 whose length is none of {SIZES_19:?} bytes throughout; export the data as \
             CSV or Excel from BTSDA"
        ))),
    }
}

fn row_2(record: &[u8]) -> Row {
    Row {
        index: u32_at(record, 16),
        step: u32::from(u8_at(record, 9)),
        step_type: u8_at(record, 10),
        at: Moment::OfStep(count(u64_at(record, 28)) / 1.0e6),
        voltage_v: f32_at(record, 36),
        current_a: f32_at(record, 40) / MILLI,
        unix_s: count(u64_at(record, 68)) / 1.0e6,
        temperature_degc: f64::NAN,
    }
}

fn row_19(record: &[u8]) -> Row {
    let seconds =
        |at: usize| f64::from(u32_at(record, at)) + 1.0e-9 * f64::from(u32_at(record, at + 4));
    let (clock, temperature) = match record.len() {
        60 => (36, Some(48)),
        56 => (44, Some(52)),
        _ => (44, None),
    };
    Row {
        index: u32_at(record, 8),
        step: u32::from(u8_at(record, 2)),
        step_type: u8_at(record, 3),
        at: Moment::OfTest(seconds(12)),
        voltage_v: f32_at(record, 24),
        current_a: f32_at(record, 20) / MILLI,
        unix_s: seconds(clock),
        temperature_degc: temperature.map_or(f64::NAN, |at| f32_at(record, at)),
    }
}
