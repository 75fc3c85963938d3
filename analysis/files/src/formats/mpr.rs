//! Converts BioLogic EC-Lab's binary files, `.mpr`, to the text that EC-Lab would export: the
//! columns of an impedance, of a record over time, and those that separate sweeps.
//!
//! The format is not published. This reader supports the part that was reverse-engineered by others
//! and agrees between galvani 0.5 and yadg 7.0: modules that begin with `MODULE`; the module `VMP
//! data` contains the number of points, the number of columns, their identifiers, and, from an offset
//! that depends on the version, one record for each point. All values are little-endian, except the
//! identifiers since EC-Lab 11.50.

use super::error::FormatError;
use std::fmt::Write as _;
use std::path::Path;

/// First bytes of a file.
const MAGIC: &[u8] = b"BIO-LOGIC MODULAR FILE";
/// Bytes before the first module.
const PREFACE: usize = 52;
/// Beginning of a module.
const MODULE: &[u8] = b"MODULE";
/// Bytes of the names of a module, and the offset of its length after them, before EC-Lab 11.50.
const NAMES: usize = 35;
/// Value of the length field since EC-Lab 11.50: another header follows.
const LONG_HEADER: u32 = u32::MAX;
/// Short name of the module that holds the points.
const DATA: &[u8] = b"VMP data";
/// Offset of the first record by the version of the module: 2 and 3 before EC-Lab 11.50, then the
/// versions since.
const RECORDS_OF_0: usize = 100;
const RECORDS_OF_2: usize = 405;
const RECORDS_OF_3: usize = 406;
const RECORDS_SINCE_11_50: usize = 1007;
/// Offset of the identifiers of the columns.
const COLUMNS: usize = 5;

/// Columns whose bits share one byte.
const FLAGS: [u16; 6] = [1, 2, 3, 21, 31, 65];
/// Columns of eight bytes, all floating-point.
const DOUBLE: [u16; 24] = [
    4, 7, 11, 13, 23, 24, 74, 110, 112, 115, 116, 123, 124, 125, 126, 182, 211, 438, 467, 498, 499,
    500, 501, 502,
];
/// Columns of two bytes and of four, whole numbers, and of one.
const SHORT: [u16; 2] = [39, 131];
const WHOLE: [u16; 4] = [212, 213, 468, 469];
const BYTE: [u16; 2] = [253, 509];
/// Columns of four bytes, floating-point: first and last of those that follow each other.
const SINGLE: [(u16, u16); 33] = [
    (5, 6),
    (8, 9),
    (15, 17),
    (19, 20),
    (26, 27),
    (32, 38),
    (45, 46),
    (69, 70),
    (75, 78),
    (96, 96),
    (98, 101),
    (105, 106),
    (135, 136),
    (163, 163),
    (166, 169),
    (172, 179),
    (185, 185),
    (206, 206),
    (215, 215),
    (217, 225),
    (230, 249),
    (271, 272),
    (301, 302),
    (331, 332),
    (361, 362),
    (391, 392),
    (422, 426),
    (430, 435),
    (441, 441),
    (462, 462),
    (471, 474),
    (476, 497),
    (505, 505),
];
/// Columns that are read, by the names that EC-Lab exports. If a record has several currents or
/// voltages, the first is used.
const NAMED: [(u16, &str); 17] = [
    (4, "time/s"),
    (6, "Ewe/V"),
    (77, "<Ewe>/V"),
    (174, "<Ewe>/V"),
    (8, "I/mA"),
    (11, "<I>/mA"),
    (76, "<I>/mA"),
    (32, "freq/Hz"),
    (35, "Phase(Z)/deg"),
    (36, "|Z|/Ohm"),
    (37, "Re(Z)/Ohm"),
    (38, "-Im(Z)/Ohm"),
    (24, "cycle number"),
    (213, "z cycle"),
    (469, "z cycle"),
    (7, DELTA_Q),
    (23, DELTA_Q),
];
/// Charge since the previous record, which techniques without a current column (GCPL) store: the
/// current is this charge divided by the time since that record.
const DELTA_Q: &str = "dq/mA.h";
/// The mode, in the two lowest bits of the flags; 3 is at rest.
const MODE: &str = "mode";
const MODE_BITS: u8 = 3;

/// Kind of a value.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Kind {
    Double,
    Single,
    Whole,
    /// The byte of the flags.
    Flags,
    /// Bytes that are skipped.
    Other(usize),
}

impl Kind {
    fn width(self) -> usize {
        match self {
            Self::Double => 8,
            Self::Single | Self::Whole => 4,
            Self::Flags => 1,
            Self::Other(width) => width,
        }
    }
}

/// A column in a record.
struct Column {
    name: &'static str,
    at: usize,
    kind: Kind,
}

/// Returns the text of a file; `None` if it is not an EC-Lab file.
///
/// # Errors
/// [`FormatError::Decode`] if the file is truncated, has an unknown version, or has columns of
/// unknown width.
pub(super) fn text(path: &Path, bytes: &[u8]) -> Option<Result<String, FormatError>> {
    bytes.starts_with(MAGIC).then(|| {
        decoded(bytes).map_err(|reason| FormatError::Decode {
            file: path.to_owned(),
            kind: "an EC-Lab .mpr",
            reason,
        })
    })
}

fn decoded(bytes: &[u8]) -> Result<String, String> {
    let (data, since_11_50, version) = module(bytes)?;
    let count = u32_at(data, 0)? as usize;
    let columns = usize::from(*data.get(4).ok_or("a data module without columns")?);
    let packed = version == 0 && data.get(COLUMNS).is_some_and(|first| *first != 0);
    let ids = ids(data, columns, since_11_50, packed)?;
    let start = match version {
        0 if packed => RECORDS_OF_0,
        0 => RECORDS_SINCE_11_50,
        2 => RECORDS_OF_2,
        3 => RECORDS_OF_3,
        other => {
            return Err(format!(
                "a data module of version {other}, which is not known"
            ));
        }
    };
    let records = data.get(start..).unwrap_or_default();
    let record = records.len().checked_div(count).unwrap_or(0);
    if record * count != records.len() {
        let bytes = records.len();
        return Err(format!(
            "{bytes} bytes are not {count} records of one length"
        ));
    }
    let columns = placed(&ids, record)?;
    let has = |names: &[&str]| columns.iter().any(|column| names.contains(&column.name));
    let lacks_current = !has(&["I/mA", "<I>/mA", "freq/Hz"]);
    let (of_charge, of_mode) = (
        lacks_current && has(&[DELTA_Q]),
        lacks_current && !has(&[DELTA_Q]),
    );
    let columns: Vec<Column> = columns
        .into_iter()
        .filter(|column| (column.name != DELTA_Q || of_charge) && (column.name != MODE || of_mode))
        .collect();
    let time = columns.iter().position(|column| column.name == "time/s");
    // Like the text export of EC-Lab's technique OCV, which has no current.
    let mut text = if of_mode {
        "EC-Lab ASCII FILE\n".to_owned()
    } else {
        String::new()
    };
    for (nth, column) in columns.iter().enumerate() {
        text.push_str(if nth > 0 { "\t" } else { "" });
        text.push_str(if column.name == DELTA_Q {
            "I/mA"
        } else {
            column.name
        });
    }
    text.push('\n');
    let mut before_s = f64::NAN;
    for record in records.chunks_exact(record.max(1)) {
        let double = |column: &Column| {
            let eight = record.get(column.at..).and_then(<[u8]>::first_chunk);
            eight.map_or(f64::NAN, |eight| f64::from_le_bytes(*eight))
        };
        let now_s = time.map_or(f64::NAN, |time| double(&columns[time]));
        for (nth, column) in columns.iter().enumerate() {
            text.push_str(if nth > 0 { "\t" } else { "" });
            let value = record.get(column.at..).unwrap_or_default();
            // Writing to a string cannot fail.
            if column.name == DELTA_Q {
                // The first record has no previous record.
                let amps = double(column) * 3600.0 / (now_s - before_s);
                let _ = write!(text, "{}", if amps.is_finite() { amps } else { 0.0 });
                continue;
            }
            let _ = match (column.kind, value.first_chunk(), value.first_chunk()) {
                (Kind::Double, Some(eight), _) => write!(text, "{}", f64::from_le_bytes(*eight)),
                (Kind::Single, _, Some(four)) => write!(text, "{}", f32::from_le_bytes(*four)),
                (Kind::Whole, _, Some(four)) => write!(text, "{}", u32::from_le_bytes(*four)),
                (Kind::Flags, ..) => {
                    write!(
                        text,
                        "{}",
                        value.first().map_or(0, |flags| flags & MODE_BITS)
                    )
                }
                _ => Ok(()),
            };
        }
        before_s = now_s;
        text.push('\n');
    }
    Ok(text)
}

/// Returns the content of the data module, whether it was written by EC-Lab 11.50 or later, and its
/// version.
fn module(bytes: &[u8]) -> Result<(&[u8], bool, u32), String> {
    let mut rest = bytes.get(PREFACE..).unwrap_or_default();
    while let Some(module) = rest.strip_prefix(MODULE) {
        let since_11_50 = u32_at(module, NAMES)? == LONG_HEADER;
        // Name, length, version, date; with a longest length and a second version since 11.50.
        let (length, version, header) = if since_11_50 {
            (NAMES + 4, NAMES + 8, NAMES + 24)
        } else {
            (NAMES, NAMES + 4, NAMES + 16)
        };
        let end = header + u32_at(module, length)? as usize;
        let content = module
            .get(header..end)
            .ok_or("the file ends within a module; it was cut off")?;
        if module.starts_with(DATA) {
            return Ok((content, since_11_50, u32_at(module, version)?));
        }
        rest = &module[end..];
    }
    Err("it has no module with points; it was cut off or never measured".to_owned())
}

/// Identifiers of the columns.
fn ids(data: &[u8], count: usize, since_11_50: bool, packed: bool) -> Result<Vec<u16>, String> {
    let width = if packed { 1 } else { 2 };
    let bytes = data
        .get(COLUMNS..COLUMNS + count * width)
        .ok_or("the file ends within the list of columns")?;
    Ok(bytes
        .chunks_exact(width)
        .map(|id| match id {
            [high, low] if since_11_50 => u16::from_be_bytes([*high, *low]),
            [low, high] => u16::from_le_bytes([*low, *high]),
            [one] => u16::from(*one),
            _ => 0,
        })
        .collect())
}

/// Returns the columns that are read, with their offsets in a record of the given size.
fn placed(ids: &[u16], record: usize) -> Result<Vec<Column>, String> {
    let mut kinds: Vec<Option<Kind>> = Vec::new();
    let mut met_flags = false;
    for id in ids {
        let is_flag = FLAGS.contains(id);
        // All flags of a record share the byte of the first flag.
        let kind = if is_flag && met_flags {
            Some(Kind::Other(0))
        } else {
            kind(*id)
        };
        met_flags |= is_flag;
        kinds.push(kind);
    }
    let known: usize = kinds.iter().flatten().map(|kind| kind.width()).sum();
    let unknown: Vec<u16> = std::iter::zip(ids, &kinds)
        .filter(|(_, kind)| kind.is_none())
        .map(|(id, _)| *id)
        .collect();
    // A single column of unknown width has the bytes that remain.
    let left = match (unknown.as_slice(), record.checked_sub(known)) {
        ([], Some(0)) => 0,
        ([_], Some(left @ (1 | 2 | 4 | 8))) => left,
        _ => {
            return Err(format!(
                "records of {record} bytes, of which the known columns take {known}; the columns \
                 {unknown:?} are not known; export it as .mpt"
            ));
        }
    };
    let mut columns: Vec<Column> = Vec::new();
    let mut at = 0;
    for (id, kind) in ids.iter().zip(kinds) {
        let kind = kind.unwrap_or(Kind::Other(left));
        if kind == Kind::Flags {
            columns.push(Column {
                name: MODE,
                at,
                kind,
            });
        }
        let name = NAMED.iter().find(|(named, _)| named == id);
        if let Some((_, name)) = name.filter(|(_, name)| columns.iter().all(|c| c.name != *name)) {
            columns.push(Column { name, at, kind });
        }
        at += kind.width();
    }
    Ok(columns)
}

fn kind(id: u16) -> Option<Kind> {
    if DOUBLE.contains(&id) {
        Some(Kind::Double)
    } else if WHOLE.contains(&id) {
        Some(Kind::Whole)
    } else if SHORT.contains(&id) {
        Some(Kind::Other(2))
    } else if FLAGS.contains(&id) {
        Some(Kind::Flags)
    } else if BYTE.contains(&id) {
        Some(Kind::Other(1))
    } else {
        let single = SINGLE
            .iter()
            .any(|(first, last)| (*first..=*last).contains(&id));
        single.then_some(Kind::Single)
    }
}

fn u32_at(bytes: &[u8], at: usize) -> Result<u32, String> {
    bytes
        .get(at..)
        .and_then(<[u8]>::first_chunk)
        .map(|four| u32::from_le_bytes(*four))
        .ok_or_else(|| "the file ends within a header; it was cut off".to_owned())
}
