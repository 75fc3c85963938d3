//! `.ndax`: a ZIP archive of tables (`.ndc`), each of a version of its own. From version 11 on
//! `data.ndc` holds the voltage and the current of each row, `data_runInfo.ndc` the times of some rows
//! and the interval of those that follow, and `data_step.ndc` the types of the steps.

use super::fields::{count, f32_at, i32_at, u8_at, u16_at, u32_at, u64_at};
use super::record::{self, Decoded, Fault, Moment, Row, amperes_per_count, date_s, scaled};
use std::collections::HashMap;
use std::io::{Cursor, Read as _};
use zip::ZipArchive;

const DATA: &str = "data.ndc";
const RUN_INFO: &str = "data_runInfo.ndc";
const STEPS: &str = "data_step.ndc";
/// Maximum size of a decompressed table: a year at 10 Hz has 320 million rows of 8 bytes, more than
/// any record of a cycler.
const MOST_BYTES: u64 = 1 << 30;
/// Bytes of a block; the first block is a head. A mask after it marks the places that contain a
/// row.
const BLOCK: usize = 4096;
const MASK_AT: usize = 4;
const ROWS_AT: usize = 132;
/// The same before version 5, without a mask.
const OLD_BLOCK: usize = 512;
const OLD_ROWS_AT: usize = 5;
/// Bytes at the end of a block without rows.
const END: usize = 1;
/// Length of a row of `data.ndc` before version 11; in version 2 seven bytes precede it.
const OLD_ROW: usize = 87;
const BEFORE_2: usize = 7;
/// Length of a row of `data.ndc` from version 11 on.
const ROW: usize = 8;
/// Volts of a count.
const VOLT: f64 = 1.0e-4;

/// A table with its version.
struct Table {
    version: u8,
    bytes: Vec<u8>,
}

/// Times of a row of `data_runInfo.ndc`.
#[derive(Clone, Copy)]
struct Info {
    time_s: f64,
    interval_s: f64,
    unix_s: f64,
    /// Number of the step, from 1.
    step: u32,
}

/// Reads an archive; returns `None` for another kind of archive.
///
/// # Errors
/// Returns an error for an unknown version and for a missing or truncated table.
pub(super) fn read(bytes: &[u8]) -> Option<Result<Decoded, Fault>> {
    let mut archive = ZipArchive::new(Cursor::new(bytes)).ok()?;
    archive.index_for_name(DATA)?;
    Some(of_archive(&mut archive))
}

fn of_archive(archive: &mut ZipArchive<Cursor<&[u8]>>) -> Result<Decoded, Fault> {
    let data = table(archive, DATA)?;
    let names = archive.file_names().filter_map(Result::ok);
    let others: Vec<String> = names
        .map(std::borrow::Cow::into_owned)
        .filter(|name| is_auxiliary(name))
        .collect();
    let rows = match data.version {
        2 | 5 => whole(&data)?,
        11 | 14 | 16 | 17 => joined(&data, &table(archive, RUN_INFO)?, &table(archive, STEPS)?)?,
        version => {
            return Err(Fault::Version {
                part: DATA,
                version: version.into(),
            });
        }
    };
    let note = format!("the auxiliary channels are not read: {}", others.join(", "));
    let notes = if others.is_empty() {
        Vec::new()
    } else {
        vec![note]
    };
    record::text(rows, notes)
}

/// Returns whether a table belongs to an auxiliary channel: `data_AUX_1_2_3.ndc`, `data_1.ndc`.
fn is_auxiliary(name: &str) -> bool {
    let number = name
        .strip_suffix(".ndc")
        .and_then(|stem| stem.rsplit_once('_'));
    number.is_some_and(|(_, number)| number.bytes().all(|b| b.is_ascii_digit()))
}

fn table(archive: &mut ZipArchive<Cursor<&[u8]>>, name: &'static str) -> Result<Table, Fault> {
    let failed = |reason: &dyn std::fmt::Display| Fault::Cut(format!("{name}: {reason}"));
    let part = archive.by_name(name).map_err(|error| failed(&error))?;
    let mut bytes = Vec::new();
    part.take(MOST_BYTES + 1)
        .read_to_end(&mut bytes)
        .map_err(|error| failed(&error))?;
    if bytes.len() as u64 > MOST_BYTES {
        return Err(failed(&format!("it is larger than {MOST_BYTES} bytes")));
    }
    let version = u8_at(&bytes, 2);
    Ok(Table { version, bytes })
}

impl Table {
    /// Returns the rows that the mask marks, with their indices from 1.
    fn rows(&self, name: &str, size: usize) -> Result<Vec<(u32, &[u8])>, Fault> {
        let per_block = (BLOCK - ROWS_AT - END) / size;
        let mut rows = Vec::new();
        let mut place = 0;
        for block in self.blocks(name, BLOCK)? {
            for k in 0..per_block {
                place += 1;
                let at = ROWS_AT + k * size;
                if u8_at(block, MASK_AT + k / 8) >> (k % 8) & 1 == 1 {
                    rows.extend(block.get(at..at + size).map(|row| (place, row)));
                }
            }
        }
        Ok(rows)
    }

    /// Returns the blocks after the head.
    fn blocks(&self, name: &str, size: usize) -> Result<std::slice::ChunksExact<'_, u8>, Fault> {
        let length = self.bytes.len();
        if length < size || !length.is_multiple_of(size) {
            return Err(Fault::Cut(format!(
                "{name}: {length} bytes, which are not blocks of {size}; copy the file again"
            )));
        }
        Ok(self.bytes[size..].chunks_exact(size))
    }
}

/// Returns the rows of a table with all quantities.
fn whole(data: &Table) -> Result<Vec<Row>, Fault> {
    if data.version == 5 {
        let rows = data.rows(DATA, OLD_ROW)?.into_iter();
        return rows.map(|(_, row)| old_row(row)).collect();
    }
    let blocks = data.blocks(DATA, OLD_BLOCK)?;
    let size = BEFORE_2 + OLD_ROW;
    let end = OLD_ROWS_AT + (OLD_BLOCK - OLD_ROWS_AT - END) / size * size;
    let rows = blocks.flat_map(|block| block[OLD_ROWS_AT..end].chunks_exact(size));
    let rows = rows.map(|row| &row[BEFORE_2..]);
    rows.filter(|row| u32_at(row, 1) != 0)
        .map(old_row)
        .collect()
}

fn old_row(row: &[u8]) -> Result<Row, Fault> {
    Ok(Row {
        index: u32_at(row, 1),
        step: u32::from(u8_at(row, 9)),
        step_type: u8_at(row, 10),
        at: Moment::OfStep(count(u64_at(row, 16)) / 1000.0),
        voltage_v: scaled(row, 24, VOLT),
        current_a: scaled(row, 28, amperes_per_count(i32_at(row, 75))?),
        unix_s: date_s(row, 68),
        temperature_degc: f64::NAN,
    })
}

/// Returns the rows from three tables.
fn joined(data: &Table, run_info: &Table, steps: &Table) -> Result<Vec<Row>, Fault> {
    let infos = infos(run_info)?;
    let types = step_types(steps)?;
    let (volt, ampere) = match data.version {
        11 => (VOLT, 1.0e-3),
        14 | 17 => (1.0, 1.0),
        _ => (VOLT, 1.0e-3),
    };
    let mut rows = Vec::new();
    let mut last: Option<(Info, f64)> = None;
    for (index, row) in data.rows(DATA, ROW)? {
        last = match (infos.get(&index), last) {
            (Some(info), _) => Some((*info, 0.0)),
            (None, Some((info, behind))) => Some((info, behind + 1.0)),
            (None, None) => None,
        };
        let (info, behind) = last.ok_or_else(|| {
            Fault::Cut(format!("{RUN_INFO}: no time for the first row of {DATA}"))
        })?;
        let place = usize::try_from(info.step).unwrap_or(0).checked_sub(1);
        let step_type = place.and_then(|place| types.get(place)).copied();
        rows.push(Row {
            index,
            step: info.step,
            step_type: step_type.ok_or_else(|| {
                Fault::Cut(format!(
                    "{STEPS}: no step {} in {} steps",
                    info.step,
                    types.len()
                ))
            })?,
            at: Moment::OfStep(info.time_s + behind * info.interval_s),
            voltage_v: f32_at(row, 0) * volt,
            current_a: f32_at(row, 4) * ampere,
            unix_s: info.unix_s + behind * info.interval_s,
            temperature_degc: f64::NAN,
        });
    }
    Ok(rows)
}

/// Returns times by the index of their row; the first one counts if a row has several.
fn infos(table: &Table) -> Result<HashMap<u32, Info>, Fault> {
    let size = match table.version {
        11 => 47,
        14 => 55,
        16 | 17 => 100,
        version => {
            return Err(Fault::Version {
                part: RUN_INFO,
                version: version.into(),
            });
        }
    };
    let (mut infos, mut step, mut before) = (HashMap::new(), 0, None);
    for (_, row) in table.rows(RUN_INFO, size)? {
        let number = u32_at(row, 37);
        if before.replace(number).is_none_or(|before| before != number) {
            step += 1;
        }
        infos.entry(u32_at(row, 41)).or_insert(Info {
            time_s: f64::from(u32_at(row, 0)) / 1000.0,
            interval_s: f64::from(i32_at(row, 29)) / 1000.0,
            unix_s: f64::from(u32_at(row, 33)) + f64::from(u16_at(row, 45)) / 1000.0,
            step,
        });
    }
    Ok(infos)
}

fn step_types(table: &Table) -> Result<Vec<u8>, Fault> {
    let size = match table.version {
        11 | 14 => 37,
        16 | 17 => 100,
        version => {
            return Err(Fault::Version {
                part: STEPS,
                version: version.into(),
            });
        }
    };
    let rows = table.rows(STEPS, size)?.into_iter();
    Ok(rows.map(|(_, row)| u8_at(row, 24)).collect())
}
