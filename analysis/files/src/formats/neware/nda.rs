//! `.nda`: a head, and records of one length. The version in the head determines the layout of a
//! record.

use super::bts9;
use super::fields::{count, i16_at, i32_at, offset_at, u8_at, u16_at, u32_at, u64_at};
use super::record::{self, Decoded, Fault, Moment, Row, amperes_per_count, date_s, scaled};
use std::collections::HashMap;

/// Offset of the version in the head.
const VERSION_AT: usize = 14;
/// Offset of the pointer to the second part of the head, and of the range in that part.
const SECOND_AT: usize = 16;
const RANGE_AT: usize = 26;
/// Offsets of the pointers to the records and to those of the auxiliary channels.
const DATA_AT: usize = 64;
const AUXILIARY_AT: usize = 72;
/// First byte of a record, and of one of an auxiliary channel.
const RECORD: u8 = 85;
const AUXILIARY: u8 = 101;
/// First bytes of the first record in version 29, which has no pointer to it.
const FIRST: &[u8] = &[RECORD, 0, 1, 0, 0, 0];
/// Volts of a count.
const VOLT: f64 = 1.0e-4;
/// Degrees of a count.
const DEGREE: f64 = 0.1;

/// Layout of a record. The type of the step follows its number; the voltage and the current, 4 bytes
/// each, follow the time.
struct Layout {
    size: usize,
    index: usize,
    step: usize,
    /// Bytes of the number of the step.
    step_bytes: usize,
    /// Offset of a counter of jumps between steps.
    jumps: Option<usize>,
    time: usize,
    clock: Clock,
    /// Offset of the range of the current; `None` if the head has one range for all records.
    range: Option<usize>,
}

/// Time stamp of a record.
#[derive(Clone, Copy, PartialEq)]
enum Clock {
    /// Seconds since 1970, 8 bytes. The time of the step has 4 bytes and counts seconds.
    Seconds(usize),
    /// The same. The time of the step has 8 bytes and counts milliseconds.
    SecondsLong(usize),
    /// A date. The time of the step as before.
    Date(usize),
}

const OLD: Layout = Layout {
    size: 59,
    index: 1,
    step: 9,
    step_bytes: 1,
    jumps: None,
    time: 11,
    clock: Clock::Seconds(47),
    range: None,
};
const LONG: Layout = Layout {
    size: 86,
    index: 2,
    step: 10,
    step_bytes: 2,
    jumps: Some(13),
    time: 14,
    clock: Clock::SecondsLong(70),
    range: Some(78),
};
const DATED: Layout = Layout {
    clock: Clock::Date(70),
    ..LONG
};

/// Reads a file.
///
/// # Errors
/// Returns an error for an unknown version, a truncated file and an unknown range of the current.
pub(super) fn read(bytes: &[u8]) -> Result<Decoded, Fault> {
    let version = u8_at(bytes, VERSION_AT);
    let (layout, records, auxiliary) = match version {
        5..=8 => (OLD, pointed(bytes, DATA_AT)?, None),
        14 | 16 | 17 | 20 | 22..=24 => {
            let auxiliary = pointed(bytes, AUXILIARY_AT)?;
            (LONG, pointed(bytes, DATA_AT)?, Some(auxiliary))
        }
        26 | 28 | 29 => {
            let at = bytes.windows(FIRST.len()).position(|at| at == FIRST);
            let at = at.ok_or_else(|| Fault::Cut("it holds no record".to_owned()))?;
            (DATED, &bytes[at..], Some(&bytes[at..]))
        }
        129 | 130 => return bts9::read(bytes),
        _ => {
            return Err(Fault::Version {
                part: ".nda",
                version: version.into(),
            });
        }
    };
    let temperatures =
        auxiliary.map_or_else(Auxiliary::default, |part| Auxiliary::of(part, layout.size));
    let second = offset_at(bytes, SECOND_AT);
    let fixed = i32_at(bytes, second.saturating_add(RANGE_AT));
    let mut rows = Vec::new();
    for record in records
        .chunks_exact(layout.size)
        .filter(|record| layout.is_record(record))
    {
        rows.push(layout.row(record, fixed, &temperatures)?);
    }
    record::text(rows, temperatures.note.into_iter().collect())
}

/// Returns the part of a file that a pointer in its head refers to (start and length).
fn pointed(bytes: &[u8], at: usize) -> Result<&[u8], Fault> {
    let (begin, length) = (offset_at(bytes, at), offset_at(bytes, at + 4));
    bytes.get(begin..begin.saturating_add(length)).ok_or_else(|| {
        Fault::Cut(format!(
            "its head announces {length} bytes from byte {begin} on, and it has {}; copy it again",
            bytes.len()
        ))
    })
}

impl Layout {
    fn is_record(&self, record: &[u8]) -> bool {
        let first = u8_at(record, 0);
        let known = match self.clock {
            Clock::Seconds(_) => first == 0 || first == RECORD,
            Clock::SecondsLong(_) => first == RECORD,
            // Without a pointer, the end of the records is unknown; the bytes after them have no
            // such marks.
            Clock::Date(_) => first == RECORD && u8_at(record, 1) == 0 && u32_at(record, 82) == 0,
        };
        known && u32_at(record, self.index) != 0
    }

    fn row(&self, record: &[u8], fixed: i32, temperatures: &Auxiliary) -> Result<Row, Fault> {
        let index = u32_at(record, self.index);
        let step = match self.step_bytes {
            1 => u32::from(u8_at(record, self.step)),
            _ => u32::from(u16_at(record, self.step)),
        };
        let jumps = self.jumps.map_or(0, |at| u8_at(record, at));
        let (unix_s, time_s, electric) = match self.clock {
            Clock::Seconds(at) => {
                let time_s = f64::from(u32_at(record, self.time));
                (count(u64_at(record, at)), time_s, self.time + 4)
            }
            Clock::SecondsLong(at) | Clock::Date(at) => {
                let unix_s = if self.clock == Clock::Date(at) {
                    date_s(record, at)
                } else {
                    count(u64_at(record, at))
                };
                let time_s = count(u64_at(record, self.time)) / 1000.0;
                (unix_s, time_s, self.time + 8)
            }
        };
        let range = self.range.map_or(0, |at| i32_at(record, at));
        let unit_a = amperes_per_count(if range == 0 { fixed } else { range })?;
        Ok(Row {
            index,
            step: step << 8 | u32::from(jumps),
            step_type: u8_at(record, self.step + self.step_bytes),
            at: Moment::OfStep(time_s),
            voltage_v: scaled(record, electric, VOLT),
            current_a: scaled(record, electric + 4, unit_a),
            unix_s,
            temperature_degc: temperatures
                .of_index
                .get(&index)
                .copied()
                .unwrap_or(f64::NAN),
        })
    }
}

/// Temperatures of the first auxiliary channel.
#[derive(Default)]
struct Auxiliary {
    of_index: HashMap<u32, f64>,
    /// Returns a remark on the channels that are not read.
    note: Option<String>,
}

impl Auxiliary {
    fn of(part: &[u8], size: usize) -> Self {
        let records = || {
            let all = part.chunks_exact(size);
            all.filter(|record| u8_at(record, 0) == AUXILIARY)
        };
        let mut channels: Vec<u8> = records().map(|record| u8_at(record, 1)).collect();
        channels.sort_unstable();
        channels.dedup();
        let Some((first, others)) = channels.split_first() else {
            return Self::default();
        };
        let degrees = |record: &[u8]| f64::from(i16_at(record, 34)) * DEGREE;
        let of_first = records().filter(|record| u8_at(record, 1) == *first);
        let mut of_index: HashMap<u32, f64> = of_first
            .map(|record| (u32_at(record, 2), degrees(record)))
            .collect();
        // A channel without a sensor contains only zeros.
        if of_index.values().all(|degrees| *degrees == 0.0) {
            of_index.clear();
        }
        let note = (!others.is_empty()).then(|| {
            format!(
                "of {} auxiliary channels the temperature of channel {first} is read",
                channels.len()
            )
        });
        Self { of_index, note }
    }
}
